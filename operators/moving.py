"""Moving mean and root mean square over a window of samples, without drift.

A running sum that adds the newest sample and subtracts the oldest gathers rounding errors for ever. Here every sum is kept in two doubles
(the second holds what rounding took from the first: Knuth's two-sum), and after every window's length it is replaced by a sum that was
begun afresh one window ago. So no error outlives a window, and the result is that of a correctly rounded sum, whatever came before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from operators.continuity import Continuity, Filter, numeric, regular, samples_in, watch
from stream.chunk import Array, Samples, Specs, StreamSpec, Times
from stream.kernel import kernel
from stream.operator import Case, grid
from stream.params import param


@kernel
def add(sums: Samples, row: int, c: int, v: float) -> None:
    """Add `v` to the sum in `sums[row, c]`, whose remainder is `sums[row + 1, c]`."""
    high = sums[row, c]
    total = high + v
    part = total - high
    low = sums[row + 1, c] + ((high - (total - part)) + (v - part))
    sums[row, c] = total + low
    sums[row + 1, c] = low - (sums[row, c] - total)


@kernel
def slide(v: float, c: int, ring: Samples, sums: Samples, places: Times) -> float:
    """Take `v` into channel `c`'s window; returns the mean of what the window holds.

    ring    (w, c)  the newest w values
    sums    (4, c)  of the window, and of what came since the ring's first place was last filled; each with its remainder
    places  (2, c)  the place in the ring that is filled next, and how many are filled
    """
    w = ring.shape[0]
    at = places[0, c]
    if places[1, c] == w:
        add(sums, 0, c, -ring[at, c])
    else:
        places[1, c] += 1
    ring[at, c] = v
    add(sums, 0, c, v)
    add(sums, 2, c, v)
    if at == w - 1:
        sums[0, c] = sums[2, c]
        sums[1, c] = sums[3, c]
        sums[2, c] = 0.0
        sums[3, c] = 0.0
        places[0, c] = 0
    else:
        places[0, c] = at + 1
    mean: float = sums[0, c] / places[1, c]
    return mean


@kernel
def moving_mean(
    x: Samples, ring: Samples, sums: Samples, places: Times, time: Times, delay_ns: int, out: Samples, stamps: Times
) -> None:
    """Mean over the newest values of every channel of `x` (n, c); see `slide` for the memory."""
    for i in range(x.shape[0]):
        stamps[i] = time[i] - delay_ns
        for c in range(x.shape[1]):
            v = x[i, c]
            out[i, c] = slide(v, c, ring, sums, places) if abs(v) < math.inf else math.nan


@kernel
def moving_rms(
    x: Samples, ring: Samples, sums: Samples, places: Times, time: Times, delay_ns: int, out: Samples, stamps: Times
) -> None:
    """Root mean square over the newest values of every channel of `x` (n, c); see `slide` for the memory."""
    for i in range(x.shape[0]):
        stamps[i] = time[i] - delay_ns
        for c in range(x.shape[1]):
            v = x[i, c]
            out[i, c] = math.sqrt(max(0.0, slide(v * v, c, ring, sums, places))) if abs(v) < math.inf else math.nan


@dataclass(slots=True)
class MovingState(Continuity):
    ring: Samples
    sums: Samples
    places: Times


class Moving(Filter[MovingState]):
    """A window that moves with every sample; subclasses say what is made of it."""

    __slots__ = ()
    window_s: float
    reset_gap_s: float

    def open(self, specs: Specs) -> Specs:
        spec = numeric(specs["in"])
        rate_hz = regular(spec)
        w = samples_in("window_s", self.window_s, rate_hz)
        delay_s = (w - 1) / 2 / rate_hz
        seen = watch(specs["in"], delay_s=delay_s, reset_gap_s=self.reset_gap_s)
        c = seen["width"]
        state = MovingState(**seen, ring=np.zeros((w, c)), sums=np.zeros((4, c)), places=np.zeros((2, c), np.int64))
        self.hold(state, delay_s=delay_s)
        return {"out": spec.derive(settling_s=spec.settling_s + (w - 1) / rate_hz)}

    def rest(self) -> None:
        self.state.sums[:] = 0.0
        self.state.places[:] = 0


@dataclass(frozen=True, slots=True)
class MovingMean(Moving):
    """The mean over the newest `window_s`; stamps are those of the window's centre, half a window earlier (the declared delay).

    The window holds a number of samples, `window_s` times the rate, rounded. Until it is full the mean is that of what has come. Bad
    samples do not enter it, so a channel's window then reaches further back.
    """

    window_s: float = param(above=0.0, help="length of the window")
    reset_gap_s: float = param(0.1, least=0.0, help="a longer gap empties the window")

    def work(self, x: Samples, time: Times, out: Samples, stamps: Times) -> None:
        state = self.state
        moving_mean(x, state.ring, state.sums, state.places, time, state.delay_ns, out, stamps)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [Case(cls(window_s=window_s), _inputs(), least=500) for window_s in (0.25, 0.01)]


@dataclass(frozen=True, slots=True)
class MovingRms(Moving):
    """The root mean square over the newest `window_s`; window, stamps and delay as in MovingMean."""

    window_s: float = param(above=0.0, help="length of the window")
    reset_gap_s: float = param(0.1, least=0.0, help="a longer gap empties the window")

    def work(self, x: Samples, time: Times, out: Samples, stamps: Times) -> None:
        state = self.state
        moving_rms(x, state.ring, state.sums, state.places, time, state.delay_ns, out, stamps)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [Case(cls(window_s=window_s), _inputs(), least=500) for window_s in (0.25, 0.01)]


def _inputs() -> dict[str, tuple[StreamSpec, Array, Array]]:
    data = np.random.default_rng(4).normal(size=(500, 3)) * 10.0 ** np.arange(3)
    return {"in": (StreamSpec((3,), rate_hz=100.0), grid(100.0, 500), data)}
