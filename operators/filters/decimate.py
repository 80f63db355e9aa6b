"""Thinning out: every so-many-th sample is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.stream.chunk import Chunk, Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import regular
from kinegraph.stream.filter import Filter, FilterState
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param


@kernel
def thin_out(x: Samples, first: int, every: int, time: Times, out: Samples, stamps: Times) -> None:
    """Rows first, first + every, ... of `x` (n, c) and `time` (n,) into `out` and `stamps`; what is not finite becomes NaN."""
    for k in range(out.shape[0]):
        i = first + k * every
        stamps[k] = time[i]
        for c in range(x.shape[1]):
            out[k, c] = finite(x[i, c])


@kernel
def thin_on(x: Samples, skip: Times, every: int, time: Times, out: Samples, stamps: Times) -> None:
    """`thin_out` after `skip[0]` samples, which is then moved on."""
    first = skip[0]
    thin_out(x, first, every, time, out, stamps)
    skip[0] = first + out.shape[0] * every - x.shape[0]


@dataclass(slots=True)
class DecimateState(FilterState):
    skip: Times
    """(1,) how many samples pass before the next one is kept."""


@dataclass(frozen=True, slots=True)
class Decimate(Filter[DecimateState]):
    """Every `every`-th sample, unchanged, beginning with the first. No delay.

    There is no filter in it: what lies above half of the new rate folds down, so a low-pass must come before it (or use Resample). In a
    gap the lost samples are counted by time, so that what is kept stays on its grid; a gap above the limit begins a new grid. Bad samples
    are kept like others, infinity as NaN. While samples flow, `until` is reported with every kept sample only.

    >>> Decimate(every=3)(np.arange(8.0), rate_hz=100)
    array([0., 3., 6.])
    """

    blends: ClassVar[bool] = False
    every: int = param(least=1, help="keep one sample in this many")
    kernel = thin_on

    def begin(self, spec: StreamSpec) -> DecimateState:
        regular(spec)
        return DecimateState(skip=np.zeros(1, np.int64))

    def gives(self, spec: StreamSpec) -> StreamSpec:
        return spec.derive(rate_hz=regular(spec) / self.every)

    def rows(self, n: int) -> int:
        return (n - self.state.skip.item(0) + self.every - 1) // self.every

    def gap(self, chunk: Chunk) -> int:
        """What is kept stays on its grid, or the grid begins with the next sample. How many of the kept are lost is not counted."""
        skip = self.state.skip
        skip[0] = 0 if self.breaks(chunk) else (skip[0] - self.missing(chunk)) % self.every
        return -1

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(9).normal(size=(400, 3))
        return [Case(cls(every=7), {"in": (StreamSpec((3,), rate_hz=100.0), grid(100.0, 400), data)}, least=57)]
