"""The five-point derivative (thesis, sections 2.3 and 2.8: the direction of movement)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import regular, width_of
from kinegraph.stream.filter import Filter, FilterState, reset_gap
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid

POINTS = 5


@kernel
def five_point(
    x: Samples, rate_hz: float, past: Samples, known: Times, time: Times, delay_ns: int, out: Samples, stamps: Times
) -> None:
    """Derivatives per second at the middle of every five rows of `past` (4, c) and `x` (n, c) into `out` and `stamps`.

    `known` (1,) says how many rows of `past` are filled; `past` then holds the newest four. NaN where any of the five is not finite.
    """
    skip = x.shape[0] - out.shape[0]
    known[0] += skip
    for i in range(x.shape[0]):
        if i >= skip:
            stamps[i - skip] = time[i] - delay_ns
        for c in range(x.shape[1]):
            v = finite(x[i, c])
            if i >= skip:
                near = past[3, c] - past[1, c]
                far = v - past[0, c]
                out[i - skip, c] = (8.0 * near - far) / 12.0 * rate_hz + 0.0 * past[2, c]
            past[0, c] = past[1, c]
            past[1, c] = past[2, c]
            past[2, c] = past[3, c]
            past[3, c] = v


@dataclass(slots=True)
class DerivativeState(FilterState):
    rate_hz: float
    past: Samples
    known: Times


@dataclass(frozen=True, slots=True)
class Derivative(Filter[DerivativeState]):
    """The slope per second, (x[-2] - 8 x[-1] + 8 x[1] - x[2]) / 12 times the rate: exact for polynomials up to the fourth degree.

    It is centred: stamps are two samples earlier (the declared delay), and nothing comes out until five samples have come, at the start
    and after a gap. A bad sample spoils the five values that rest on it, or are centred on it: they are NaN (here the general rule, to
    hold the state and go on, would give wrong slopes). The nominal rate counts, not the jitter of the stamps.

    >>> Derivative()(np.arange(6.0) ** 2, rate_hz=1)
    array([4., 6.])
    """

    delays: ClassVar[str] = "2 samples"
    references: ClassVar[str] = "thesis 2.3, 2.8"
    reset_gap_s: float = reset_gap(0.0)
    kernel = five_point

    def begin(self, spec: StreamSpec) -> DerivativeState:
        rate_hz = regular(spec)
        past = np.zeros((POINTS - 1, width_of(spec)))
        return DerivativeState(delay_s=2 / rate_hz, rate_hz=rate_hz, past=past, known=np.zeros(1, np.int64))

    def gives(self, spec: StreamSpec) -> StreamSpec:
        return spec.derive(units=tuple(f"{unit}/s" if unit else "1/s" for unit in spec.units))

    def rows(self, n: int) -> int:
        return n - min(n, POINTS - 1 - self.state.known.item(0))

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(8).normal(size=(300, 3)).cumsum(axis=0)
        spec = StreamSpec((3,), rate_hz=100.0, units=("m",))
        return [Case(cls(), {"in": (spec, grid(100.0, 300), data)}, least=290)]
