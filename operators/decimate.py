"""Thinning out: every so-many-th sample is kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from operators.continuity import Continuity, numeric, regular, rows, watch
from stream.chunk import Chunk, Samples, Specs, StreamSpec, Times
from stream.kernel import kernel
from stream.operator import Case, Operator, Step, grid
from stream.params import param


@kernel
def thin_out(x: Samples, first: int, every: int, time: Times, out: Samples, stamps: Times) -> None:
    """Rows first, first + every, ... of `x` (n, c) and `time` (n,) into `out` and `stamps`; what is not finite becomes NaN."""
    for k in range(out.shape[0]):
        i = first + k * every
        stamps[k] = time[i]
        for c in range(x.shape[1]):
            out[k, c] = x[i, c] if abs(x[i, c]) < math.inf else math.nan


@kernel
def thin_on(x: Samples, skip: Times, every: int, time: Times, out: Samples, stamps: Times) -> None:
    """`thin_out` after `skip[0]` samples, which is then moved on."""
    first = skip[0]
    thin_out(x, first, every, time, out, stamps)
    skip[0] = first + out.shape[0] * every - x.shape[0]


@dataclass(slots=True)
class DecimateState(Continuity):
    every: int
    skip: Times
    """(1,) how many samples pass before the next one is kept."""


@dataclass(frozen=True, slots=True)
class Decimate(Operator[DecimateState]):
    """Every `every`-th sample, unchanged, beginning with the first. No delay.

    There is no filter in it: what lies above half of the new rate folds down, so a low-pass must come before it (or use Resample). In a
    gap the lost samples are counted by time, so that what is kept stays on its grid; a gap above the limit begins a new grid. Bad samples
    are kept like others, infinity as NaN. While samples flow, `until` is told with every kept sample only.
    """

    contiguous: ClassVar[bool] = True

    every: int = param(least=1, help="one sample in so many is kept")
    reset_gap_s: float = param(0.1, least=0.0, help="the first sample after a longer gap is kept")

    def open(self, specs: Specs) -> Specs:
        spec = numeric(specs["in"])
        rate_hz = regular(spec)
        seen = watch(specs["in"], reset_gap_s=self.reset_gap_s)
        self.hold(DecimateState(**seen, every=self.every, skip=np.zeros(1, np.int64)))
        return {"out": spec.derive(rate_hz=rate_hz / self.every)}

    def kernel_step(self) -> Step:
        return Step(thin_on, self.state, self._kept, self.state.last)

    def _kept(self, n: int) -> int:
        """How many of the next `n` samples are kept."""
        return (n - self.state.skip.item(0) + self.every - 1) // self.every

    def process(self, port: str, chunk: Chunk) -> Chunk | None:
        state = self.state
        time = chunk.time
        n = len(time)
        lost = 0
        if chunk.lost:
            lost = -1
            state.skip[0] = 0 if state.breaks(chunk) else (state.skip[0] - state.missing(chunk)) % self.every
        if not n:
            return self._nothing(chunk, lost)
        m = self._kept(n)
        state.last[0] = time[-1]
        if not m:
            state.skip[0] -= n
            return self._nothing(chunk, lost) if lost else None
        x = chunk.data
        out, stamps = state.spare.both(m)
        made = out
        if not state.plain:
            x, made = rows(x, state.width), out.reshape((m, *x.shape[1:]))
        thin_on(x, state.skip, self.every, time, out, stamps)
        return Chunk(stamps, made, chunk.until, lost)

    def _nothing(self, chunk: Chunk, lost: int) -> Chunk:
        """Nothing is kept of this chunk. Told only where no sample is soon to be kept that tells it, or something is lost."""
        return Chunk(np.empty(0, np.int64), np.empty((0, *chunk.data.shape[1:])), chunk.until, lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(9).normal(size=(400, 3))
        return [Case(cls(every=7), {"in": (StreamSpec((3,), rate_hz=100.0), grid(100.0, 400), data)}, least=57)]
