"""Filling of short gaps: samples that were lost, and values that are not numbers (a marker that was hidden)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from kinegraph.operators.inputs.continuity import Continuity, watch
from kinegraph.stream.chunk import FOREVER, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import numeric
from kinegraph.stream.domain.rotation import rotation_free
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Emitted, Input, Operator, grid
from kinegraph.stream.params import param

ANY = 1 << 40
"""Samples: no limit to a run."""


@kernel
def fill(
    x: Samples,
    time: Times,
    last: int,
    furthest: int,
    most: int,
    longest: int,
    linear: bool,
    left: Samples,
    left_at: Times,
    runs: Times,
    work: Samples,
) -> int:
    """Append `x` (n, c) to the rows that wait at the head of `work` (p + n, c), and fill its runs of bad values.

    time            (p + n,)  stamps of all rows
    last, furthest  the stamp of the sample before `x`; beyond this distance in time nothing is filled
    most            the longest run, in samples, that is filled
    longest         the longest time between the good values beside a run that is filled, which then lies on a line by its stamps; 0: no
                    limit but `most`, and a line by the samples' numbers
    left, left_at   (c,)  each channel's newest good value before its run, and its stamp
    runs            (c,)  how long each channel's run of bad values is up to now; `most` + 1: too long, or nothing good came before it

    Returns how many of the newest rows may yet be filled.
    """
    start = work.shape[0] - x.shape[0]
    for i in range(start, work.shape[0]):
        far = time[i] - last > furthest
        last = time[i]
        for c in range(x.shape[1]):
            if far or 0 < longest < time[i] - left_at[c]:
                runs[c] = most + 1
            v = work[i, c] = finite(x[i - start, c])
            run = runs[c]
            if v != v:
                runs[c] = min(run + 1, most + 1)
                continue
            if 0 < run <= most:
                for k in range(1, run + 1):
                    share = 0.0
                    if linear and longest:
                        share = (time[i - run - 1 + k] - left_at[c]) / (time[i] - left_at[c])
                    elif linear:
                        share = k / (run + 1)
                    work[i - run - 1 + k, c] = left[c] + share * (v - left[c])
            left[c], left_at[c], runs[c] = v, time[i], 0
    keep = 0
    for c in range(x.shape[1]):
        if runs[c] <= most:
            keep = max(keep, runs[c])
    return keep


@dataclass(slots=True)
class FillState(Continuity):
    most: int
    longest: int
    left: Samples
    left_at: Times
    runs: Times
    pending: Samples
    stamps: Times
    lost: int
    """How many samples are missing before the first pending row."""


@dataclass(frozen=True, slots=True)
class FillGaps(Operator[FillState]):
    """Gaps of up to `limit_s` are filled from the values on both sides; longer ones are left as they are.

    Values that are not finite are filled channel by channel. In a regular stream lost samples (`lost`, with their number judged by the
    stamps) are put back at even distances, and then nothing is lost there; a run of both kinds counts as one. In an irregular stream
    `limit_s` is the time between the good values on both sides, and nothing is filled across lost samples. A run that is too long, or that
    nothing good precedes, stays NaN; across a gap in time that is too long nothing is filled.

    method  linear: a straight line between the neighbours, of numbers that are no rotations; hold: the value before the run
    delay   a sample that may yet be filled waits for the next good one, so `limit_s` at most; without bad samples there is no delay

    >>> FillGaps()(np.array([1.0, np.nan, np.nan, 4.0]), rate_hz=100)
    array([1., 2., 3., 4.])
    """

    delays: ClassVar[str] = "`limit_s`, only where something is bad"
    inputs = {"in": Input(rows=True)}
    limit_s: float = param(0.1, above=0.0, help="the longest gap that is filled")
    method: Literal["linear", "hold"] = param("linear", help="a straight line, or the last value")

    def open(self, specs: Specs) -> Specs:
        spec = numeric(specs["in"])
        if self.method == "linear":
            rotation_free(spec)
        most, gap_s = ANY, self.limit_s
        if spec.rate_hz is not None:
            most = math.floor(self.limit_s * spec.rate_hz + 1e-6)
            gap_s = (most + 0.5) / spec.rate_hz
            if most < 1:
                least = f"at least {1 / spec.rate_hz:g} (one sample at {spec.rate_hz:g} Hz)"
                raise ParameterError("limit_s", self.limit_s, least)
        seen = watch(spec, reset_gap_s=gap_s)
        c = seen["width"]
        state = FillState(
            **seen,
            most=most,
            longest=0 if spec.rate_hz else seen["limit_ns"],
            left=np.zeros(c),
            left_at=np.zeros(c, np.int64),
            runs=np.full(c, most + 1),
            pending=np.zeros((0, *spec.shape)),
            stamps=np.zeros(0, np.int64),
            lost=0,
        )
        self.set_state(state, delay_s=self.limit_s)
        return {"out": spec}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        state = self.state
        time = chunk.time
        if not len(time):
            return self._wait(chunk)
        x = chunk.data
        if not chunk.lost:
            return self._fill(chunk, time, x)
        missing = state.missing(chunk) if state.period_ns else 0
        if missing and not state.breaks(chunk):
            return self._fill(chunk, *self._put_back(time, x, missing))
        before = self._give_up(int(time[0]) - 1)
        state.lost = chunk.lost
        return [("out", before), ("out", self._fill(chunk, time, x))]

    def _fill(self, chunk: Chunk, time: Times, x: Samples) -> Chunk:
        """Take these samples, filled as far as can be, and emit what need not wait."""
        state = self.state
        waiting = len(state.stamps)
        total = waiting + len(time)
        work: Samples = np.empty((total, state.width))
        if waiting:
            work[:waiting] = state.pending.reshape(waiting, state.width)
            time = np.concatenate([state.stamps, time])
        furthest = state.limit_ns + state.period_ns
        linear = self.method == "linear"
        last, longest = state.last.item(0), state.longest
        keep = fill(x, time, last, furthest, state.most, longest, linear, state.left, state.left_at, state.runs, work)
        state.last[0] = time[-1]
        lost = state.lost
        data = work.reshape(total, *state.nothing.shape[1:])
        if keep or waiting:
            state.pending, state.stamps = data[total - keep :].copy(), time[total - keep :].copy()
            data, time = data[: total - keep], time[: total - keep]
        if len(time):
            state.lost = 0
        return Chunk(time, data, self._promise(chunk.until), lost if len(time) else 0)

    def _wait(self, chunk: Chunk) -> Chunk:
        """Time has passed without samples: what waits goes on waiting, unless the gap is now too long to be filled."""
        state = self.state
        if (
            len(state.stamps)
            and chunk.until - state.last.item(0) > state.limit_ns + state.period_ns
            and chunk.until != FOREVER
        ):
            return self._give_up(chunk.until)
        return Chunk(chunk.time, state.nothing, self._promise(chunk.until))

    def _put_back(self, time: Times, x: Samples, missing: int) -> tuple[Times, Samples]:
        """The samples with `missing` bad ones before them, evenly between the stamps on both sides."""
        before, after = self.state.last.item(0), int(time[0])
        stamps = [before + (after - before) * k // (missing + 1) for k in range(1, missing + 1)]
        bad = np.full((missing, self.state.width), np.nan)
        return np.concatenate([np.array(stamps, np.int64), time]), np.concatenate([bad, x])

    def _give_up(self, until: int) -> Chunk:
        """Emit what waits as it is: no neighbour will come."""
        state = self.state
        made = Chunk(state.stamps, state.pending, until, state.lost if len(state.stamps) else 0)
        state.pending, state.stamps = state.pending[:0].copy(), np.zeros(0, np.int64)
        state.runs[:] = state.most + 1
        if len(made.time):
            state.lost = 0
        return made

    def _promise(self, until: int) -> int:
        """No later output lies at or before this: not before what waits, and not inside a gap into which samples may yet be put back."""
        state = self.state
        if len(state.stamps):
            return int(state.stamps[0]) - 1
        if state.period_ns and until != FOREVER and until - state.last.item(0) <= state.limit_ns + state.period_ns:
            return min(until, state.last.item(0))
        return until

    def close(self) -> Emitted:
        return self._give_up(FOREVER)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(13)
        data = rng.normal(size=(400, 2)).cumsum(axis=0)
        for start, length in ((50, 3), (90, 10), (91, 4), (200, 11), (300, 2)):
            data[start : start + length, start % 2] = np.nan
        marker = StreamSpec((2,), rate_hz=100.0, units=("mm",))
        points = StreamSpec((2, 3), rate_hz=100.0, units=("m",))
        irregular = grid(100.0, 400) + rng.integers(0, 9_000_000, 400)
        hidden = np.where(rng.random((400, 2, 1)) < 0.05, np.nan, rng.normal(size=(400, 2, 3)))
        return [
            Case(cls(limit_s=0.1), {"in": (marker, grid(100.0, 400), data)}, least=400),
            Case(cls(limit_s=0.03, method="hold"), {"in": (points, grid(100.0, 400), hidden)}, least=400),
            Case(cls(limit_s=0.05), {"in": (replace(points, rate_hz=None), irregular, hidden)}, least=400),
        ]
