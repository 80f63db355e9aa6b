"""Detects walking, turning and standing from a person's steps and from pauses between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.steps.steps import STEP, Steps, some_walk
from kinegraph.stream.chunk import NEVER, NS, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

CHANGE = np.dtype([("onset", "<i8"), ("activity", "<U8"), ("before", "<U8"), ("lasted_s", "<f8")])
"""From `onset` on a person does something else than `before`, which they did for `lasted_s` (NaN: since before the signal began)."""
CHANGE_UNITS = ("ns", "", "", "s")
UNKNOWN, STANDING, WALKING, TURNING = "unknown", "standing", "walking", "turning"
RESUMES = 2
"""This many steps in a row begin walking, or end a turn."""


@dataclass(slots=True)
class StepActivityState:
    """
    acceleration   which channels of the signal
    activity       what the person does, since `began` (NEVER: before the signal did)
    heard, ended   stamp and end of the latest step, or the first sample after a gap;  newest: the latest sample
    steps, since   walking steps in a row, and the onset of the first
    turned, turning   the sum of a turn's angles in degrees, and the onset of its first step (NEVER without one)
    straight, straightened   steps in a row that are no turns, and the onset of the first
    """

    acceleration: Times
    activity: str
    began: int
    heard: int
    ended: int
    newest: int
    steps: int
    since: int
    turned: float
    turning: int
    straight: int
    straightened: int


Found = list[tuple[int, tuple[int, str, str, float]]]


@dataclass(frozen=True, slots=True)
class StepActivity(Operator[StepActivityState]):
    """Steps (`operators.steps.steps.Steps`) and the signal that they are found in, an event out where a person begins to do another thing.

    walking    two walking steps in a row, from the onset of the first
    turning    steps of kind "turn", together by `turn_deg` or more, from the onset of the first, until two others follow in a row
    standing   no step for `still_s`, from the end of the latest; sitting, and a sensor that was put down, look the same
    unknown    no finite sample for more than `reset_gap_s`: from the last one

    Stamped when it is decided: with a step, or with the first sample after a pause that is long enough.

    >>> given, made = tried(StepActivity)
    >>> len(given["steps"]), made["activity"][:3].tolist()
    (29, ['standing', 'walking', 'standing'])
    """

    inputs = {"steps": Input(), "signal": Input()}
    outputs: ClassVar[tuple[str, ...]] = ("activity",)

    turn_deg: float = param(45.0, above=0.0, most=360.0, help="a turn is of this angle or more")
    still_s: float = param(1.2, least=0.3, most=10.0, help="without a step for so long a person stands")
    reset_gap_s: float = reset_gap(0.3, "after a longer gap it is not known what the person does", most=2.0)

    def open(self, specs: Specs) -> Specs:
        spec, steps = specs["signal"], specs["steps"]
        if steps.dtype != STEP:
            raise InputError("steps", steps.describe(), "steps (operators.steps.steps.Steps)")
        units = spec.units if spec.is_signal and len(spec.units) == spec.shape[0] else spec.units * 6
        acceleration = [i for i, unit in enumerate(units) if unit in ("m/s2", "m/s^2", "g")]
        if not spec.is_signal or not acceleration:
            raise InputError("signal", spec.describe(), "the signal that steps are found in, in m/s2 or g")
        channels = np.array(acceleration)[: spec.shape[0]]
        self.set_state(StepActivityState(channels, UNKNOWN, NEVER, NEVER, NEVER, NEVER, 0, NEVER, 0.0, NEVER, 0, NEVER))
        return {"activity": StreamSpec((), CHANGE, units=CHANGE_UNITS, meta=steps.meta)}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        found: Found = []
        if port == "steps":
            for stamp, step in zip(chunk.time.tolist(), chunk.data, strict=True):
                self._step(found, stamp, step)
        elif len(chunk):
            known = np.isfinite(chunk.data[:, self.state.acceleration]).all(axis=1)
            self._wait(found, chunk.time[known])
        stamps = np.array([stamp for stamp, _ in found], np.int64)
        return Chunk(stamps, np.array([row for _, row in found], CHANGE), chunk.until, -1 if chunk.lost else 0)

    @classmethod
    def cases(cls) -> list[Case]:
        spec, time, data = some_walk(20.0, 100.0, 6)
        data[1500:1560] = np.nan
        finder = Steps()
        out = finder.open({"in": spec})["steps"]
        steps = finder.process("in", Chunk(time, data, int(time[-1])))
        return [Case(cls(), {"steps": (out, steps.time, steps.data), "signal": (spec, time, data)}, least=5)]

    def _wait(self, found: Found, times: Times) -> None:
        """Samples without a step among them."""
        s, at = self.state, 0
        if len(times) and s.heard == NEVER:
            s.heard = s.ended = s.newest = int(times[0])
        while at < len(times):
            rest = times[at:]
            gaps = np.flatnonzero(np.diff(rest, prepend=s.newest) > round(self.reset_gap_s * NS))
            due = np.flatnonzero(rest > s.heard + round(self.still_s * NS)) if s.activity != STANDING else gaps[:0]
            if not len(gaps) and not len(due):
                break
            if not len(due) or (len(gaps) and gaps[0] <= due[0]):
                at += int(gaps[0])
                now, last = int(times[at]), int(times[at - 1]) if at else s.newest
                self._begin(found, now, last, UNKNOWN)
                s.heard = s.ended = s.newest = now
            else:
                at += int(due[0])
                self._begin(found, int(times[at]), s.ended, STANDING)
                s.newest = int(times[at])
            self._forget()
        if len(times):
            s.newest = int(times[-1])

    def _step(self, found: Found, stamp: int, step: np.void) -> None:
        s, kind, onset = self.state, str(step["kind"]), int(step["onset"])
        s.heard, s.ended = stamp, int(step["end"])
        if kind not in ("walk", "turn"):
            self._forget()
            return
        s.since = onset if not s.steps else s.since
        s.steps += 1
        if kind == "turn":
            s.turning = onset if s.turning == NEVER else s.turning
            s.turned += float(step["turn_deg"])
            s.straight = 0
        else:
            s.straightened = onset if not s.straight else s.straightened
            s.straight += 1
        if s.straight >= RESUMES:
            s.turning, s.turned = NEVER, 0.0
        if s.activity != TURNING and s.turning != NEVER and abs(s.turned) >= self.turn_deg:
            self._begin(found, stamp, s.turning, TURNING)
        elif s.activity == TURNING and s.straight >= RESUMES:
            self._begin(found, stamp, s.straightened, WALKING)
        elif s.activity not in (WALKING, TURNING) and s.steps >= RESUMES:
            self._begin(found, stamp, s.since, WALKING)

    def _begin(self, found: Found, stamp: int, onset: int, activity: str) -> None:
        s = self.state
        if activity == s.activity:
            return
        lasted_s = np.nan if s.began == NEVER else (onset - s.began) / NS
        found.append((stamp, (onset, activity, s.activity, lasted_s)))
        s.activity, s.began = activity, onset

    def _forget(self) -> None:
        """No steps follow those so far."""
        s = self.state
        s.steps = s.straight = 0
        s.turning, s.turned = NEVER, 0.0
