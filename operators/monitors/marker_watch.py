"""Alarms about swapped marker labels: a marker leaps, or a segment changes its length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.operators.inputs.marker_columns import marker_columns, marker_metres, marker_names
from kinegraph.operators.monitors.marker_watch_kernel import (
    BONE,
    FOUND,
    JUMP,
    JUMP_OVER,
    LENGTH,
    LIMITS,
    TRACK,
    follow_markers,
)
from kinegraph.stream.chunk import NEVER, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.domain.alarm import ON, OVER, FoundAlarms, alarm_chunk, alarms_spec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param

PAUSE_S, FIRST_S, LASTS_S, CALM_S = 0.05, 1.0, 0.1, 2.0
LEAPT = "look at the labels: contacts and angles from here on may be another marker's"
LONGER = "look at the labels, and whether a marker hangs loose or came off"


@dataclass(slots=True)
class MarkerWatchState:
    """`columns` (m, 3) of each marker; `ends` (s, 2) of each segment; what the kernel knows of both; `newest`: the newest stamp."""

    columns: Times
    ends: Times
    metres: float
    limits: Array
    tracks: Array
    bones: Array
    was: Samples
    newest: int
    names: list[str]


@dataclass(frozen=True, slots=True)
class MarkerWatch(Operator[MarkerWatchState]):
    """Markers in, an alarm for each that has probably taken another's label, and for each segment that has another length.

    leap      a marker is `jump_m` (and 100 m/s2 times the square of the time between samples) from where its speed takes it, and stays
              there for 0.05 s: a shorter ghost does not count. Where it lands within 0.1 m of where another marker just was, the alarm
              names that one. Reported after 0.05 s. Over once the marker's segments have had their length for 2 s; of a marker without
              segments never. Across a pause of more than 0.05 s a leap is not looked for.
    segment   the distance of two markers on one bone differs by more than `stretch` from its usual one for 0.1 s: the mean of its first
              second. Labels that are swapped from the start are seen as the two feet part. Over after 2 s, or once it keeps another
              length for a second. Skin moves: heel or ankle to toe varies by up to 13 % in sound walks.

    What is not finite, or exactly 0, 0, 0, was not seen.

    >>> given, made = tried(MarkerWatch)
    >>> given["in"].shape, made[["subject", "state", "what"]][0].item()
    ((900, 4, 3), ('LTOE', 'on', 'leapt by 0.20 m, to where RTOE was'))
    """

    markers: tuple[str, ...] = param((), help="the markers that are watched for leaps; empty: all that have names")
    segments: tuple[tuple[str, str], ...] = param((), help="pairs of markers on one bone: [[LANK, LTOE], [RANK, RTOE]]")
    unit: Literal["", "m", "cm", "mm"] = param("", help="unit of the positions; empty: the input's")
    jump_m: float = param(0.08, above=0.0, most=10.0, help="how far a leap goes")
    stretch: float = param(
        0.3, above=0.0, most=10.0, help="the part of its length by which a segment may become longer or shorter"
    )

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if spec.rate_hz is None:
            raise InputError("in", spec.describe(), "regular: its rate must be known")
        for segment in self.segments:
            if segment[0] == segment[1]:
                raise ParameterError("segments", list(segment), "two different markers")
        bones = [name for segment in self.segments for name in segment]
        names = list(dict.fromkeys([*(self.markers or marker_names(spec)), *bones]))
        if not names:
            raise ParameterError("markers", list(self.markers), "given: the input's markers have no names")
        columns = [marker_columns(spec, name, "segments" if name in bones else "markers") for name in names]
        state = MarkerWatchState(
            np.array(columns), np.array([[names.index(a), names.index(b)] for a, b in self.segments], np.int64).reshape(-1, 2),
            marker_metres(spec, np.ravel(columns).tolist(), self.unit),
            np.array([(self.jump_m, max(PAUSE_S, 3 / spec.rate_hz), self.stretch, FIRST_S, LASTS_S, CALM_S)], LIMITS),
            np.zeros(len(names), TRACK), np.zeros(len(self.segments), BONE), np.full((len(names), 3), np.nan), NEVER, names,
        )  # fmt: skip
        state.tracks["leapt"] = state.tracks["at"] = NEVER
        state.bones["off"] = state.bones["right"] = NEVER
        self.set_state(state, decision_s={"out": CALM_S + 1 / spec.rate_hz})
        return alarms_spec(spec.meta)

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s, n = self.state, len(chunk.time)
        flat = chunk.data.reshape(n, int(np.prod(chunk.data.shape[1:])))
        place = np.ascontiguousarray(flat[:, s.columns], np.float64) * s.metres
        rows = np.zeros(n * (2 * len(s.tracks) + len(s.bones)), FOUND)
        made = follow_markers(chunk.time, place, s.tracks, s.bones, s.ends, s.limits, s.was, rows)
        found: FoundAlarms = [(int(chunk.time[row["sample"]]), self._said(row)) for row in rows[:made]]
        return alarm_chunk(found, chunk)

    def _said(self, row: np.void) -> tuple[int, str, str, str, str]:
        s, since, kind = self.state, int(row["since"]), int(row["kind"])
        if kind in (JUMP, JUMP_OVER):
            where = f", to where {s.names[row['other']]} was" if row["other"] >= 0 else ""
            text = f"leapt by {row['value']:.2f} m{where}" if kind == JUMP else "leapt"
            return since, s.names[row["which"]], ON if kind == JUMP else OVER, text, LEAPT if kind == JUMP else ""
        a, b = (s.names[k] for k in s.ends[row["which"]])
        text = f"{row['value']:.1f} times as long as at first" if kind == LENGTH else "another length than at first"
        return since, f"{a}-{b}", ON if kind == LENGTH else OVER, text, LONGER if kind == LENGTH else ""

    @classmethod
    def cases(cls) -> Sequence[Case]:
        n, rate_hz = 900, 100.0
        seconds = np.arange(n) / rate_hz
        path = np.zeros((n, 4, 3))
        for k, phase in ((0, 0.0), (2, np.pi)):
            path[:, k, 1] = 1.2 * seconds + 0.3 * np.sin(2 * np.pi * seconds + phase)
            path[:, k, 0], path[:, k, 2] = 0.1 * k, 0.1
            path[:, k + 1] = path[:, k] + [0.0, 0.15, -0.05]
        path += np.random.default_rng(8).normal(0.0, 0.001, path.shape)
        path[300:520, [1, 3]] = path[300:520, [3, 1]]
        path[610, 1] += 1.0
        path[700:710, 2] = np.nan
        names = ("LANK", "LTOE", "RANK", "RTOE")
        spec = StreamSpec((4, 3), rate_hz=rate_hz, channels=names, units=("m",))
        flat = StreamSpec(
            (12,), rate_hz=rate_hz, channels=tuple(f"{m}_{c}" for m in names for c in "xyz"), units=("mm",)
        )
        given = {"in": (spec, grid(rate_hz, n), path)}
        bones = (("LANK", "LTOE"), ("RANK", "RTOE"))
        wide = {"in": (flat, grid(rate_hz, n), 1000.0 * path.reshape(n, 12))}
        return [
            Case(cls(segments=bones), given, least=6),
            Case(cls(), given, least=2),
            Case(cls(markers=("LTOE",), segments=bones[:1]), wide, least=3),
        ]
