"""Threshold events with hysteresis: when a channel goes beyond a level, and when it comes back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from kinegraph.operators.inputs.channels import names_of, the_channel
from kinegraph.operators.inputs.continuity import Continuity, watch
from kinegraph.stream.chunk import NEVER, NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import numeric
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

UNKNOWN, OUTSIDE, CANDIDATE, INSIDE = range(4)
ONSET = np.dtype([("onset", "<i8")])
INTERVAL = np.dtype([("onset", "<i8"), ("end", "<i8"), ("peak", "<f8")])


@kernel
def crossings(
    x: Samples,
    time: Times,
    channel: int,
    levels: Samples,
    waits: Times,
    now: Times,
    peak: Samples,
    events: Times,
    peaks: Samples,
) -> int:
    """Follow one channel of `x` (n, c) through the states of an interval; returns how many events came about.

    levels  (3,)  +1 or -1 for above or below; both levels, times that sign: an interval begins at the first, ends below the second
    waits   (2,)  how long an interval must last, and for how long after one no new one begins (ns)
    now     (3,)  state, onset of the interval that runs, end of the one before
    peak    (1,)  the furthest value of the interval that runs, times the sign
    events  (2n, 3), peaks (2n,)  per event: the sample at which it was decided, onset, and end (-1: an onset); the furthest value
    """
    made = 0
    for i in range(x.shape[0]):
        v = finite(levels[0] * x[i, channel])
        if v != v:
            continue
        if v < levels[2]:
            if now[0] == INSIDE:
                events[made, 0], events[made, 1], events[made, 2] = i, now[1], time[i]
                peaks[made] = levels[0] * peak[0]
                made += 1
                now[2] = time[i]
            now[0] = OUTSIDE
            continue
        if now[0] == OUTSIDE and v >= levels[1]:
            late = now[2] == NEVER or time[i] - now[2] >= waits[1]
            now[0] = CANDIDATE if late else UNKNOWN
            now[1] = time[i]
            peak[0] = v
        peak[0] = max(peak[0], v)
        if now[0] == CANDIDATE and time[i] - now[1] >= waits[0]:
            now[0] = INSIDE
            events[made, 0], events[made, 1], events[made, 2] = i, now[1], -1
            made += 1
    return made


@dataclass(slots=True)
class ThresholdState(Continuity):
    channel: int
    levels: Samples
    waits: Times
    now: Times
    peak: Samples


@dataclass(frozen=True, slots=True)
class Threshold(Operator[ThresholdState]):
    """Intervals in which one channel of a signal is at or beyond `level`; each ends where it falls back behind `release`.

    onset     an event when an interval begins, decided once it has lasted `min_duration_s`: field onset (ns)
    interval  an event when it has ended: onset and end (ns), and the furthest value between them

    Events are stamped with the sample at which they were decided; no other delay. An interval with an unseen beginning (at the start,
    after a gap) is not reported. After an interval's end, crossings within `refractory_s` are passed over: the channel must fall back and
    cross once more. Bad samples change nothing. Works at any rate; every gap makes lost = -1 on both outputs.

    >>> found = Threshold(level=2.0)(np.array([0.0, 3.0, 4.0, 1.0, 0.0]), rate_hz=1)
    >>> found["interval"][["onset", "end"]].tolist()
    [(2000000000, 4000000000)]
    """

    delays: ClassVar[str] = "no delay: stamped when decided"
    outputs: ClassVar[tuple[str, ...]] = ("onset", "interval")
    inputs = {"in": Input(rows=True)}
    level: float = param(help="an interval begins where this is reached, in the channel's unit")
    release: float | None = param(None, help="an interval ends behind this (hysteresis); left out: level")
    direction: Literal["above", "below"] = param("above", help="on which side of the level intervals lie")
    channel: str | int | None = param(None, help="name, or number from 0; may be left out if there is only one")
    min_duration_s: float = param(0.0, least=0.0, help="shorter intervals are passed over")
    refractory_s: float = param(0.0, least=0.0, help="for how long after an interval no new one begins")
    reset_gap_s: float = reset_gap(0.1)

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        numeric(spec)
        if not spec.is_signal:
            raise InputError("in", spec.describe(), "a signal of channels")
        channel = the_channel(spec, self.channel)
        sign = 1.0 if self.direction == "above" else -1.0
        release = self.level if self.release is None else self.release
        if sign * release > sign * self.level:
            raise ParameterError(
                "release", release, f"{'at most' if sign > 0 else 'at least'} level, which is {self.level:g}"
            )
        state = ThresholdState(
            **watch(spec, reset_gap_s=self.reset_gap_s),
            channel=channel,
            levels=np.array([sign, sign * self.level, sign * release]),
            waits=np.array([round(self.min_duration_s * NS), round(self.refractory_s * NS)], np.int64),
            now=np.array([UNKNOWN, 0, NEVER], np.int64),
            peak=np.zeros(1),
        )
        told_s = self.min_duration_s + spec.period_ns / NS
        self.set_state(state, decision_s={"onset": told_s, "interval": spec.period_ns / NS})
        name = names_of(spec)[channel]
        unit = spec.units[channel % len(spec.units)]
        about: dict[str, Any] = {"settling_s": spec.settling_s, "meta": {**spec.meta, "channel": name}}
        return {
            "onset": StreamSpec((), ONSET, units=("ns",), **about),
            "interval": StreamSpec((), INTERVAL, units=("ns", "ns", unit), **about),
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        state = self.state
        time = chunk.time
        lost = 0
        n = len(time)
        if n:
            if chunk.lost:
                lost = -1
                if state.breaks(chunk):
                    state.now[:] = UNKNOWN, 0, NEVER
            state.last[0] = time[-1]
        events, peaks = np.empty((2 * n, 3), np.int64), np.empty(2 * n)
        made = crossings(
            chunk.data, time, state.channel, state.levels, state.waits, state.now, state.peak, events, peaks
        )
        if not made:
            empty = np.empty(0, np.int64)
            return [
                ("onset", Chunk(empty, np.empty(0, ONSET), chunk.until, lost)),
                ("interval", Chunk(empty, np.empty(0, INTERVAL), chunk.until, lost)),
            ]
        ended = events[:made, 2] >= 0
        onset = _rows(ONSET, onset=events[:made][~ended, 1])
        interval = _rows(INTERVAL, onset=events[:made][ended, 1], end=events[:made][ended, 2], peak=peaks[:made][ended])
        return [
            ("onset", Chunk(time[events[:made][~ended, 0]], onset, chunk.until, lost)),
            ("interval", Chunk(time[events[:made][ended, 0]], interval, chunk.until, lost)),
        ]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(14)
        data = np.sin(np.arange(600) / 15.0)[:, None] + 0.2 * rng.normal(size=(600, 2))
        spec = StreamSpec((2,), rate_hz=100.0, channels=("left", "right"), units=("N",))
        inputs = {"in": (spec, grid(100.0, 600), data)}
        return [
            Case(cls(0.5, channel="right"), inputs, least=12),
            Case(cls(-0.3, 0.0, "below", 0, 0.05, 0.1), inputs, least=8),
        ]


def _rows(dtype: np.dtype[np.void], **columns: Array) -> Array:
    made = np.empty(len(columns["onset"]), dtype)
    for name, column in columns.items():
        made[name] = column
    return made
