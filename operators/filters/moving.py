"""Moving mean and root mean square over a window of samples, without drift.

A running sum that adds the newest sample and subtracts the oldest gathers rounding errors for ever. Here every sum is kept in two doubles
(the second holds what rounding took from the first: Knuth's two-sum), and after every window's length it is replaced by a sum that was
begun afresh one window ago. So no error outlives a window, and the result is that of a correctly rounded sum, whatever came before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.stream.chunk import Array, Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import regular, samples_in, width_of
from kinegraph.stream.filter import Filter, FilterState
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param


@kernel
def two_sum(high: float, low: float, v: float) -> tuple[float, float]:
    """The sum `high` + `low`, and `v` added to it, again as a double and its remainder."""
    total = high + v
    part = total - high
    rest = low + ((high - (total - part)) + (v - part))
    high = total + rest
    return high, rest - (high - total)


@kernel
def slide(row: Samples, ring: Samples, sums: Samples, places: Times) -> None:
    """Take the values `row` (c,) into their channels' windows, and put in their place the mean of what each window then holds.

    ring    (w, c)  the newest w values of each channel
    sums    (4, c)  of the window, and of what came since the ring's first place was last filled; each with its remainder
    places  (2, c)  the place in the ring that is filled next, and how many are filled

    NaN stays NaN and changes nothing. Where all channels stand at the same place, as they do until one has a bad sample, they are done
    side by side, which the machine does several times faster.
    """
    at, filled = places[0, 0], places[1, 0]
    abreast = True
    for c in range(row.shape[0]):
        abreast = abreast and places[0, c] == at and places[1, c] == filled and row[c] == row[c]
    if abreast:
        slide_from(at, filled, 0, row.shape[0], row, ring, sums, places)
        return
    for c in range(row.shape[0]):
        if row[c] == row[c]:
            slide_from(places[0, c], places[1, c], c, c + 1, row, ring, sums, places)


@kernel
def slide_from(
    at: int, filled: int, first: int, last: int, row: Samples, ring: Samples, sums: Samples, places: Times
) -> None:
    """`slide` for channels `first` to `last` - 1, which all stand at place `at` and have `filled` values."""
    w = ring.shape[0]
    full = filled == w
    count = filled if full else filled + 1
    wraps = at == w - 1
    for c in range(first, last):
        v = row[c]
        high, low = sums[0, c], sums[1, c]
        left_high, left_low = two_sum(high, low, -ring[at, c])
        high, low = two_sum(left_high if full else high, left_low if full else low, v)
        fresh_high, fresh_low = two_sum(sums[2, c], sums[3, c], v)
        ring[at, c] = v
        high = fresh_high if wraps else high
        sums[0, c] = high
        sums[1, c] = fresh_low if wraps else low
        sums[2, c] = 0.0 if wraps else fresh_high
        sums[3, c] = 0.0 if wraps else fresh_low
        places[0, c] = 0 if wraps else at + 1
        places[1, c] = count
        row[c] = high / count


@kernel
def moving_mean(
    x: Samples, ring: Samples, sums: Samples, places: Times, time: Times, delay_ns: int, out: Samples, stamps: Times
) -> None:
    """Mean over the newest values of every channel of `x` (n, c); see `slide` for the memory."""
    for i in range(x.shape[0]):
        stamps[i] = time[i] - delay_ns
        for c in range(x.shape[1]):
            out[i, c] = finite(x[i, c])
        slide(out[i], ring, sums, places)


@kernel
def moving_rms(
    x: Samples, ring: Samples, sums: Samples, places: Times, time: Times, delay_ns: int, out: Samples, stamps: Times
) -> None:
    """Root mean square over the newest values of every channel of `x` (n, c); see `slide` for the memory."""
    for i in range(x.shape[0]):
        stamps[i] = time[i] - delay_ns
        for c in range(x.shape[1]):
            out[i, c] = finite(x[i, c]) * finite(x[i, c])
        slide(out[i], ring, sums, places)
        for c in range(x.shape[1]):
            out[i, c] = math.sqrt(max(out[i, c], 0.0)) if out[i, c] == out[i, c] else math.nan


@dataclass(slots=True)
class MovingState(FilterState):
    ring: Samples
    sums: Samples
    places: Times


class _Moving(Filter[MovingState]):
    """A window that moves with every sample; subclasses say what is made of it."""

    delays: ClassVar[str] = "half the window"
    __slots__ = ()
    window_s: float

    def begin(self, spec: StreamSpec) -> MovingState:
        rate_hz, c = regular(spec), width_of(spec)
        w = samples_in("window_s", self.window_s, rate_hz)
        return MovingState(
            delay_s=(w - 1) / 2 / rate_hz,
            settling_s=(w - 1) / rate_hz,
            ring=np.zeros((w, c)),
            sums=np.zeros((4, c)),
            places=np.zeros((2, c), np.int64),
        )


@dataclass(frozen=True, slots=True)
class MovingMean(_Moving):
    """The mean over the newest `window_s`; stamps are those of the window's centre, half a window earlier (the declared delay).

    The window holds a number of samples, `window_s` times the rate, rounded. Until it is full the mean is that of what has come. Bad
    samples do not enter it, so a channel's window then reaches further back.

    >>> MovingMean(window_s=0.03)(np.array([1.0, 5.0, 3.0, 1.0]), rate_hz=100)
    array([1., 3., 3., 3.])
    """

    window_s: float = param(above=0.0, help="length of the window")
    kernel = moving_mean

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [Case(cls(window_s=window_s), _inputs(), least=500) for window_s in (0.25, 0.01)]


@dataclass(frozen=True, slots=True)
class MovingRms(_Moving):
    """The root mean square over the newest `window_s`; window, stamps and delay as in MovingMean.

    >>> MovingRms(window_s=0.02)(np.array([3.0, 4.0, -4.0]), rate_hz=100).round(3)
    array([3.   , 3.536, 4.   ])
    """

    window_s: float = param(above=0.0, help="length of the window")
    kernel = moving_rms

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [Case(cls(window_s=window_s), _inputs(), least=500) for window_s in (0.25, 0.01)]


def _inputs() -> dict[str, tuple[StreamSpec, Array, Array]]:
    data = np.random.default_rng(4).normal(size=(500, 3)) * 10.0 ** np.arange(3)
    return {"in": (StreamSpec((3,), rate_hz=100.0), grid(100.0, 500), data)}
