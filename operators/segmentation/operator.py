"""The segmentation as an operator: features in, actions, repetitions and clusters out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.features.mirror import STACKED
from kinegraph.operators.inputs.channels import names_of
from kinegraph.operators.inputs.continuity import watch
from kinegraph.operators.segmentation.kernels.activities import ROOM, follow
from kinegraph.operators.segmentation.kernels.layout import allocate
from kinegraph.operators.segmentation.outputs import OUTPUTS, emitted, specs_of
from kinegraph.operators.segmentation.state import SegmentState
from kinegraph.stream.chunk import FOREVER, NEVER, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.require import numeric, regular, samples_in
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

REACH = 1.43
"""This many of the longest cycles back neighbours are looked for: it may be a sixth longer in turn, and must be the lowest lag around."""


@dataclass(frozen=True, slots=True)
class Segment(Operator[SegmentState]):
    """Features in (features,), stacked as a rule; actions, their repetitions, and which of them are alike out, as the motion goes on.

    in           features
    mirrored     input, optional: the same through operators.features.mirror.Mirror, for `side` and `symmetry`
    activity     final, one after another without holes: onset, end (ns; the stamp of the last frame that belongs to it), activity (its
                 number, from 0), repeats (whether repetitions were found), cluster (of its last repetition; or -1), repetitions,
                 transition (a stretch between activities no longer than `transition_s`; a longer rest after two repetitions or more is
                 an activity without repetitions), forced (ended by a gap or the end of the stream),
                 symmetry (of most of its repetitions; 1: both sides do the same at once, 2: in turn, 3: not; 0: not known),
                 certainty (0 to 1, by how near its repetitions come to one another; 0: motion of random phases comes as near, so that it
                 is not sure that anything was repeated)
    primitive    final: onset, end, activity, repetition (1, 2, ...; 0: outside repetitions, or no repeats), cluster
                 (or -1), forced, side. A repetition in which the sides take turns is reported as two steps of the same number, with
                 side 1 (where more moves in the first of each pair: left, or A) and 2; else side is 0
    bout         final: repetitions that follow one another without a pause longer than their cycle: onset, end, activity, bout (1, 2, ...
                 in the activity), repetitions (in it), cluster
    begin        final: onset of an activity that goes on, when its cycle is found, or `firm_s` after it was noticed
    count        at once: activity, and how many repetitions have come in it so far, this one included; certainty: of those that are
                 final. The last count of an activity is its `repetitions`
    merge        two clusters are found to be one: from now on `cluster` is `into`, the older one. Clusters never split
    provisional  at once: what is believed of an activity (repetition 0) or a repetition that has just been seen, before it is final;
                 again, under the same number, where its span is known better. The last one of a repetition has its final span
    rest         final, when it is over: onset, end of a stretch in which hardly anything moves; the first one, if nothing had moved before,
                 when the motion is known
    resting      at once: onset of a rest that has begun
    radius       the radius that an activity is opened with

    A frame's neighbours are the frames up to `cycle_s` before it within the radius, outside of a band around the diagonal; distances are
    Euclidean, divided by the root of the number of features (the thesis's generalised radius, 2.3.1). An activity opens when, of the newest
    `cycle_s`, frames worth `mass_s` have neighbours in it; it ends without such frames for `quiet_s`; growing backward finds its start. Its
    cycle is the shortest lag at which it comes back to itself. The first cycle is kept as an
    exemplar, one per cluster, and repetitions are shortest warping paths along it, so that they are counted however long ago the first one
    was, and cut at one phase in all activities of a cluster.

    radius_share  of the median distance between frames of the window: the radius, while no activity is open; `radius` fixes it

    A repetition and its steps are final at the latest 2.75 cycles after its end, a bout 3. Memory, in numbers, with times in frames:
    8 cycle_s^2 + 2 features window_s (mirrored: 3) + 46 features cycle_s, of 32 exemplars. Distances are taken
    over what both frames have; a frame has no neighbour if it lacks more than half of what has been there within `window_s`, and a feature
    that has not is left out, which is logged. A gap longer than `reset_gap_s` ends what is open; exemplars are kept.
    Source: thesis, 2.3 to 2.5. Departures: docs/method/segmentation.md.

    >>> angle = np.sin(2 * np.pi * 0.5 * np.arange(900) / 30)  # 15 times in 30 s
    >>> made = Segment()(np.stack([angle, angle**2], axis=1), rate_hz=30, units=["rad"])
    >>> len(made["primitive"])
    16
    """

    inputs = {"mirrored": Input(rows=True, optional=True), "in": Input(rows=True, trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = tuple(OUTPUTS)
    exemptions: ClassVar[dict[str, str]] = {
        "time": "what the end of the stream forces to close is stamped with the newest frame, so time is promised up to there only",
        "channels": "all features of a frame make one pose: a bad one is left out; the frame has no neighbours with most of them bad",
    }

    radius: float | None = param(
        None, above=0.0, help="radius per feature, in their unit; left out: found from the data"
    )
    radius_share: float = param(0.475, above=0.0, most=2.0, help="the radius as a share of the median distance")
    cycle_s: float = param(7.0, above=0.0, most=60.0, help="longest cycle")
    window_s: float = param(60.0, above=0.0, help="how much the radius is found from")
    learn_s: float = param(5.0, above=0.0, help="nothing is decided before this much has been seen")
    quiet_s: float = param(0.4, above=0.0, help="so long without a neighbour ends an activity")
    mass_s: float = param(1.0, above=0.0, help="frames with neighbours that open one, in seconds")
    settle_s: float = param(2.0, above=0.0, help="after its opening, until its start is searched for")
    firm_s: float = param(8.0, above=0.0, help="after its opening, until its start is final; no less than 2.86 cycle_s")
    band_s: tuple[float, float] = param((0.4, 0.7), above=0.0, help="bounds of the band around the diagonal")
    rest_s: float = param(1.0, above=0.0, help="who has hardly moved for so long is at rest")
    transition_s: float = param(
        2.5, least=0.0, help="a longer stretch between activities, or rest after repetitions, is one of its own"
    )
    reset_gap_s: float = reset_gap(1.0, "a longer gap ends what is open")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        frames = self._frames(spec)
        firsts = _firsts(spec, specs["mirrored"]) if "mirrored" in specs else None
        self.set_state(
            SegmentState(
                **watch(spec, reset_gap_s=self.reset_gap_s),
                memory=allocate(spec.shape[0], frames, self.radius, self.radius_share, firsts),
                longest=round(self.transition_s * 1e9),
                mirrored=np.full(0 if firsts is None else spec.shape[0], np.nan),
                mirrored_at=NEVER,
                absent=np.zeros(spec.shape[0], bool),
                names=list(names_of(spec)),
            ),
            decision_s=decisions(frames, spec.period_ns),
        )
        return specs_of(spec)

    def _frames(self, spec: StreamSpec) -> dict[str, int]:
        """All times as numbers of frames, and how long one is. Raises InputError and ParameterError."""
        numeric(spec)
        if not spec.is_signal or not 1 <= spec.shape[0] <= 4096:
            raise InputError("in", spec.describe(), "a signal of 1 to 4096 features")
        rate_hz = regular(spec)
        if rate_hz * REACH * self.cycle_s > 2000:
            raise InputError(
                "in",
                spec.describe(),
                f"at most {2000 / REACH / self.cycle_s:.4g} Hz with cycle_s {self.cycle_s:g}, "
                f"or cycle_s {2000 / REACH / rate_hz:.3g} at this rate",
            )
        if self.settle_s > self.firm_s:
            raise ParameterError("settle_s", self.settle_s, f"at most firm_s ({self.firm_s:g})")
        if self.mass_s > self.cycle_s:
            raise ParameterError("mass_s", self.mass_s, f"at most cycle_s ({self.cycle_s:g}), of which it is a part")
        if len(self.band_s) != 2 or not self.band_s[0] <= self.band_s[1] < self.cycle_s / 2:
            raise ParameterError("band_s", list(self.band_s), "two numbers, not falling, below half of cycle_s")
        seconds = {
            "max_lag": ("cycle_s", REACH * self.cycle_s), "window": ("window_s", self.window_s), "learn": ("learn_s", self.learn_s),
            "quiet": ("quiet_s", self.quiet_s), "mass": ("mass_s", self.mass_s), "settle": ("settle_s", self.settle_s),
            "firm": ("firm_s", self.firm_s), "min_band": ("band_s", self.band_s[0]), "max_band": ("band_s", self.band_s[1]),
            "rest": ("rest_s", self.rest_s),
        }  # fmt: skip
        frames = {name: samples_in(parameter, value, rate_hz) for name, (parameter, value) in seconds.items()}
        frames["learn"] = max(2, frames["learn"])
        frames["firm"] = max(frames["firm"], 2 * frames["max_lag"])
        frames["transition"] = min(round(self.transition_s * rate_hz), frames["max_lag"])
        frames["every"] = max(1, round(0.5 * rate_hz))
        frames["period_ns"] = spec.period_ns
        return frames

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        if port == "mirrored":
            if len(chunk):
                s.mirrored, s.mirrored_at = chunk.data[-1].copy(), int(chunk.time[-1])
            return []
        last = s.last.item(0)
        if not len(chunk):
            return self._emitted([], chunk.until if last == NEVER else min(chunk.until, last - 1), 0)
        gap = bool(chunk.lost) and last != NEVER and s.breaks(chunk)
        s.last[0] = chunk.time[-1]
        x = chunk.data
        images = np.full((len(x) if len(s.mirrored) else 0, s.width), np.nan)
        if len(images):
            images[chunk.time == s.mirrored_at] = s.mirrored
        tables: list[tuple[Times, Samples]] = []
        done = 0
        while done < len(x):
            memory = s.memory.with_room(4 * ROOM)
            done = follow(memory, x, images, chunk.time, done, gap and not done)
            tables.append(memory.reported())
        s.say_missing(1)
        return self._emitted(tables, min(chunk.until, s.last.item(0) - 1), -1 if chunk.lost else 0)

    def close(self) -> list[tuple[str, Chunk]]:
        s = self.state
        s.say_missing(0)
        s.memory.now = s.last.item(0)
        memory = s.memory.with_room(ROOM)
        follow(memory, np.empty((0, s.width)), np.empty((0, s.width)), np.empty(0, np.int64), 0, True)
        made = self._emitted([memory.reported()], FOREVER, 0)
        s.say_short()
        return made

    def _emitted(self, tables: list[tuple[Times, Samples]], until: int, lost: int) -> list[tuple[str, Chunk]]:
        made = emitted(tables, self.state.longest, until, lost)
        self.state.judge(made["activity"].data)
        return list(made.items())

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(5)
        n = 900
        time = grid(30.0, n)
        turn = np.arange(n) * 0.2 + 0.3 * np.sin(np.arange(n) * 0.01)
        x = np.stack([np.sin(turn + i) + 0.4 * np.cos(2.0 * turn - i) for i in range(4)], 1)
        x[320:380] = np.linspace(x[320], x[320] + 6.0, 60)
        x[380:600] = 3.0 + np.stack([np.cos(1.4 * turn[380:600] + 2 * i) for i in range(4)], 1)
        x += 0.03 * rng.normal(size=x.shape)
        motion = {"in": (StreamSpec((4,), rate_hz=30.0, units=("rad",)), time, x)}
        quick = {"cycle_s": 3.0, "learn_s": 3.0, "window_s": 15.0}
        spec = motion["in"][0]
        image = spec.derive(meta={"mirrored": True, "firsts": ["0", "1"]})
        sided = {"mirrored": (image, time, np.roll(x, 2, axis=1)), **motion}
        return [
            Case(cls(**quick), motion, least=20),  # type: ignore[arg-type]
            Case(cls(radius=0.5, **quick), motion, least=20),  # type: ignore[arg-type]
            Case(cls(**quick), sided, least=20),  # type: ignore[arg-type]
        ]


def decisions(frames: dict[str, int], period: int) -> dict[str, float]:
    """How long after what an event describes it comes at the latest, by output; rests and gaps that lie between come on top.

    An activity opens at most 3 `max_lag` after the first frame that is found to belong to it, and is decided `firm` later. A rest is
    reported with the next frame, but the one before the first motion only when that is known.
    """
    longest = (frames["firm"] + 3 * frames["max_lag"]) * period / 1e9
    late = dict.fromkeys(("activity", "primitive", "bout", "begin", "provisional"), longest)
    first = frames["rest"] + frames["mass"] + 2 * frames["every"]
    return late | {"resting": (frames["rest"] + 1) * period / 1e9, "rest": first * period / 1e9}


def _firsts(spec: StreamSpec, mirrored: StreamSpec) -> Times:
    """Per feature: 1 for the first of a pair that changes places in the mirror, of a stack at offset 0 only. Raises InputError."""
    same = mirrored.shape == spec.shape and mirrored.rate_hz == spec.rate_hz and mirrored.channels == spec.channels
    if not same or not mirrored.meta.get("mirrored"):
        raise InputError(
            "mirrored",
            mirrored.describe(),
            "the features of 'in', of the same rate, through operators.features.mirror.Mirror",
        )
    firsts = set(mirrored.meta["firsts"])
    names = names_of(spec)
    own = any(name.endswith("[+0]") for name in names)
    return np.array([STACKED.sub("", n) in firsts and (not own or n.endswith("[+0]")) for n in names], np.int64)
