"""Binomial smoothing (thesis, section 2.6.2: accelerations at 30 Hz, a window of 16 frames)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import regular, width_of
from kinegraph.stream.filter import Filter, FilterState
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param


@kernel
def weigh(
    x: Samples, weights: Samples, ring: Samples, places: Times, time: Times, delay_ns: int, out: Samples, stamps: Times
) -> None:
    """Weighted mean of the newest values of every channel of `x` (n, c) into `out` (n, c).

    weights  (w,)     for the newest value, the one before it, ...; sum 1
    ring     (2w, c)  the newest w values, each written twice, w rows apart, so that any w of them stand in a row
    places   (2, c)   the place in the ring that is filled next, and how many are filled
    """
    w = weights.shape[0]
    for i in range(x.shape[0]):
        stamps[i] = time[i] - delay_ns
        for c in range(x.shape[1]):
            v = out[i, c] = finite(x[i, c])
            if v != v:
                continue
            at = places[0, c]
            ring[at, c] = v
            ring[at + w, c] = v
            places[0, c] = 0 if at == w - 1 else at + 1
            places[1, c] = min(places[1, c] + 1, w)
            total = 0.0
            weight = 0.0
            for k in range(places[1, c]):
                total += weights[k] * ring[at + w - k, c]
                weight += weights[k]
            out[i, c] = total if places[1, c] == w else total / weight


@dataclass(slots=True)
class BinomialState(FilterState):
    weights: Samples
    ring: Samples
    places: Times


@dataclass(frozen=True, slots=True)
class Binomial(Filter[BinomialState]):
    """A mean of the newest `window` samples, weighted by the binomial coefficients of order `window` - 1 (near to a Gaussian).

    Stamps are those of the window's centre, (window - 1) / 2 samples earlier: the declared delay, exact at all frequencies. Until the
    window is full, the mean is that of what has come, by the weights it will have had. Bad samples do not enter the window.

    The thesis names a window of 16 frames and neither its weights nor its alignment: here they are C(15, k) / 2^15 and the centre.

    >>> Binomial(window=3)(np.array([0.0, 4.0, 0.0, 0.0]), rate_hz=100)
    array([0.        , 1.33333333, 2.        , 1.        ])
    """

    delays: ClassVar[str] = "(window - 1) / 2 samples"
    references: ClassVar[str] = "thesis 2.6.2"
    window: int = param(16, least=1, most=1000, help="how many samples are weighed")
    kernel = weigh

    def begin(self, spec: StreamSpec) -> BinomialState:
        rate_hz, c, w = regular(spec), width_of(spec), self.window
        return BinomialState(
            delay_s=(w - 1) / 2 / rate_hz,
            settling_s=(w - 1) / rate_hz,
            weights=np.array([math.comb(w - 1, k) / 2 ** (w - 1) for k in range(w)]),
            ring=np.zeros((2 * w, c)),
            places=np.zeros((2, c), np.int64),
        )

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(7).normal(size=(300, 3))
        return [Case(cls(), {"in": (StreamSpec((3,), rate_hz=30.0), grid(30.0, 300), data)}, least=300)]
