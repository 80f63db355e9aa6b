"""The five-point derivative (thesis, sections 2.3 and 2.8: the direction of movement)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from operators.continuity import Continuity, Filter, back, nothing, numeric, regular, rows, watch
from stream.chunk import Chunk, Samples, Specs, StreamSpec, Times
from stream.kernel import kernel
from stream.operator import Case, grid
from stream.params import param

POINTS = 5


@kernel
def five_point(
    x: Samples, rate_hz: float, past: Samples, skip: int, time: Times, delay_ns: int, out: Samples, stamps: Times
) -> None:
    """Derivatives per second at the middle of every five rows of `past` (4, c) and `x` (n, c), from row `skip` of `x` on.

    `out` (n - skip, c), `stamps` (n - skip,); `past` then holds the newest four rows. NaN where any of the five is not finite.
    """
    for i in range(x.shape[0]):
        if i >= skip:
            stamps[i - skip] = time[i] - delay_ns
        for c in range(x.shape[1]):
            v = x[i, c] if abs(x[i, c]) < math.inf else math.nan
            if i >= skip:
                near = past[3, c] - past[1, c]
                far = v - past[0, c]
                out[i - skip, c] = (8.0 * near - far) / 12.0 * rate_hz + 0.0 * past[2, c]
            past[0, c] = past[1, c]
            past[1, c] = past[2, c]
            past[2, c] = past[3, c]
            past[3, c] = v


@dataclass(slots=True)
class DerivativeState(Continuity):
    rate_hz: float
    past: Samples
    known: int
    """How many rows of `past` are filled."""


@dataclass(frozen=True, slots=True)
class Derivative(Filter[DerivativeState]):
    """The slope per second, (x[-2] - 8 x[-1] + 8 x[1] - x[2]) / 12 times the rate: exact for polynomials up to the fourth degree.

    It is centred: stamps are two samples earlier (the declared delay), and nothing comes out until five samples have come, at the start
    and after a gap. A bad sample spoils the five values that rest on it, or are centred on it: they are NaN (here the general rule, to
    hold the state and go on, would give wrong slopes). The nominal rate counts, not the jitter of the stamps.
    """

    reset_gap_s: float = param(
        0.0, least=0.0, help="a longer gap begins anew; samples around a shorter one count as neighbours"
    )

    def open(self, specs: Specs) -> Specs:
        spec = numeric(specs["in"])
        rate_hz = regular(spec)
        seen = watch(specs["in"], delay_s=2 / rate_hz, reset_gap_s=self.reset_gap_s)
        past = np.zeros((POINTS - 1, seen["width"]))
        self.hold(DerivativeState(**seen, rate_hz=rate_hz, past=past, known=0), delay_s=2 / rate_hz)
        return {"out": spec.derive(units=tuple(f"{unit}/s" if unit else "1/s" for unit in spec.units))}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        state = self.state
        n = len(chunk.time)
        if not n:
            return nothing(chunk, state)
        if chunk.lost and state.breaks(chunk):
            state.known = 0
        state.last[0] = chunk.time[-1]
        skip = min(n, POINTS - 1 - state.known)
        state.known += skip
        out: Samples = np.empty((n - skip, *chunk.data.shape[1:]))
        stamps = np.empty(n - skip, np.int64)
        x, flat = chunk.data, out
        if not state.plain:
            x, flat = rows(x, state.width), out.reshape(n - skip, state.width)
        five_point(x, state.rate_hz, state.past, skip, chunk.time, state.delay_ns, flat, stamps)
        return Chunk(stamps, out, back(chunk.until, state.delay_ns), chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(8).normal(size=(300, 3)).cumsum(axis=0)
        spec = StreamSpec((3,), rate_hz=100.0, units=("m",))
        return [Case(cls(), {"in": (spec, grid(100.0, 300), data)}, least=290)]
