"""Removal of the mean: of a moving window, of everything so far, or of the beginning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.operators.filters.moving import slide, two_sum
from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import regular, samples_in, width_of
from kinegraph.stream.filter import Filter, FilterState, Kernel
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param


@kernel
def less_moving_mean(x: Samples, ring: Samples, sums: Samples, places: Times, out: Samples) -> None:
    """`x` (n, c) less the mean of the newest values, the present one included; see `moving.slide` for the memory."""
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            out[i, c] = finite(x[i, c])
        slide(out[i], ring, sums, places)
        for c in range(x.shape[1]):
            out[i, c] = x[i, c] - out[i, c]


@kernel
def less_running_mean(x: Samples, most: int, sums: Samples, places: Times, out: Samples) -> None:
    """`x` (n, c) less the mean of the first `most` values so far (0: of all), the present one included.

    `sums` (4, c) holds the sum and its remainder in its first two rows, `places` (2, c) how many values it counts in its second.
    """
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            v = out[i, c] = finite(x[i, c])
            if v != v:
                continue
            if most == 0 or places[1, c] < most:
                sums[0, c], sums[1, c] = two_sum(sums[0, c], sums[1, c], v)
                places[1, c] += 1
            out[i, c] = v - sums[0, c] / places[1, c]


@dataclass(slots=True)
class RemoveMeanState(FilterState):
    ring: Samples
    sums: Samples
    places: Times
    most: int


@dataclass(frozen=True, slots=True)
class RemoveMean(Filter[RemoveMeanState]):
    """Each number less a mean of what came up to it. Stamps unchanged, no delay.

    moving   the mean of the newest `window_s`, the present sample included: a simple high-pass, for offsets that wander
    running  the mean of everything since the start (or since a gap that resets); exact, however long it runs
    initial  the mean of the first `window_s`, kept from then on: a baseline taken at rest. Until it is complete: the mean so far

    Sums are kept as in MovingMean, so nothing drifts. A window holds a number of samples, `window_s` times the rate, rounded.

    >>> RemoveMean(mean="running")(np.array([4.0, 6.0, 8.0]), rate_hz=100)
    array([0., 1., 2.])
    """

    mean: Literal["moving", "running", "initial"] = param("moving", help="which mean is removed")
    window_s: float = param(1.0, above=0.0, help="over how long the moving or initial mean is taken")

    def begin(self, spec: StreamSpec) -> tuple[RemoveMeanState, Kernel]:
        rate_hz, c = regular(spec), width_of(spec)
        w = samples_in("window_s", self.window_s, rate_hz)
        state = RemoveMeanState(
            settling_s=(w - 1) / rate_hz,
            ring=np.zeros((w if self.mean == "moving" else 0, c)),
            sums=np.zeros((4, c)),
            places=np.zeros((2, c), np.int64),
            most=w if self.mean == "initial" else 0,
        )
        return state, less_moving_mean if self.mean == "moving" else less_running_mean

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(6).normal(size=(500, 3)) + np.array([0.0, 5.0, -100.0])
        inputs = {"in": (StreamSpec((3,), rate_hz=100.0), grid(100.0, 500), data)}
        return [
            Case(cls(), inputs, least=500),
            Case(cls(mean="running"), inputs, least=500),
            Case(cls(mean="initial", window_s=0.5), inputs, least=500),
        ]
