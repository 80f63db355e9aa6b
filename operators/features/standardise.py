"""Robust standardisation as samples come: the running median taken away, and what is left over the running spread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import regular, samples_in, width_of
from kinegraph.stream.filter import SampleWise
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param

QUARTILES = 1.3489795003921634
"""The distance between a normal distribution's quartiles, in standard deviations."""


@kernel
def enter(v: float, ring: Samples, ranked: Samples, places: Times) -> None:
    """Take `v` into a window: `ring` (w,) holds it as it came, `ranked` (w,) in order; `places` (2,): the next place, how many."""
    w = ring.shape[0]
    at, filled = places[0], places[1]
    hole = filled
    if filled == w:
        hole = np.searchsorted(ranked, ring[at])
    else:
        places[1] = filled + 1
    while hole > 0 and ranked[hole - 1] > v:
        ranked[hole] = ranked[hole - 1]
        hole -= 1
    while hole < places[1] - 1 and ranked[hole + 1] < v:
        ranked[hole] = ranked[hole + 1]
        hole += 1
    ranked[hole] = v
    ring[at] = v
    places[0] = 0 if at == w - 1 else at + 1


@kernel
def quantile(ranked: Samples, count: int, share: float) -> float:
    """A quantile of the first `count` values of `ranked`, between neighbours on a straight line."""
    at = share * (count - 1)
    below = int(at)
    above = min(below + 1, count - 1)
    return float(ranked[below] + (at - below) * (ranked[above] - ranked[below]))


@kernel
def standardise(
    x: Samples,
    most: int,
    min_share: float,
    ring: Samples,
    ranked: Samples,
    places: Times,
    line: Samples,
    out: Samples,
) -> None:
    """Each value of `x` (n, c) less its window's median, over its spread, into `out` (n, c).

    most    after this many values a channel's median and spread stay as they are; 0: never
    ring, ranked (c, w), places (3, c): see `enter`; places[2] counts values
    line    (2, c)  each channel's median and spread
    """
    for i in range(x.shape[0]):
        largest = 0.0
        for c in range(x.shape[1]):
            v = finite(x[i, c])
            if v == v and (most == 0 or places[2, c] < most):
                enter(v, ring[c], ranked[c], places[:2, c])
                places[2, c] += 1
                count = places[1, c]
                line[0, c] = quantile(ranked[c], count, 0.5)
                line[1, c] = (quantile(ranked[c], count, 0.75) - quantile(ranked[c], count, 0.25)) / QUARTILES
            largest = max(largest, line[1, c])
        for c in range(x.shape[1]):
            v = out[i, c] = finite(x[i, c])
            spread = max(line[1, c], min_share * largest)
            if v == v:
                out[i, c] = (v - line[0, c]) / spread if spread > 0.0 else 0.0


@dataclass(slots=True)
class StandardiseState:
    settling_s: float
    most: int
    ring: Samples
    ranked: Samples
    places: Times
    line: Samples


@dataclass(frozen=True, slots=True)
class Standardise(SampleWise[StandardiseState]):
    """A signal in; out comes every channel less its running median, over its running spread (quartiles' distance / 1.349). No delay.

    Median and quartiles are those of the newest `window_s` of good values, so single outliers do not count. Statistics that go on running
    let features drift, and two poses that were alike are no longer: with `freeze_s` they stay what they were then.

    min_share  no channel's spread counts as less than this share of the largest: one that is silent is not blown up to noise

    >>> Standardise(window_s=1.0)(np.array([1.0, 2.0, 3.0, 4.0, 10.0]), rate_hz=10).round(2)
    array([0.  , 1.35, 1.35, 1.35, 4.72])
    """

    window_s: float = param(30.0, above=0.0, help="what median and spread are taken from")
    freeze_s: float = param(0.0, least=0.0, help="after this long they stay as they are; 0: never")
    min_share: float = param(0.05, least=0.0, most=1.0, help="a channel's least spread, as a share of the largest")
    kernel = standardise

    def begin(self, spec: StreamSpec) -> StandardiseState:
        rate_hz, width = regular(spec), width_of(spec)
        w = samples_in("window_s", self.window_s, rate_hz)
        most = samples_in("freeze_s", self.freeze_s, rate_hz) if self.freeze_s else 0
        w = min(w, most) if most else w
        blank = np.zeros((width, w))
        places, line = np.zeros((3, width), np.int64), np.zeros((2, width))
        return StandardiseState(self.freeze_s or self.window_s, most, blank, blank.copy(), places, line)

    def gives(self, spec: StreamSpec) -> StreamSpec:
        return spec.derive(units=("",))

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(32)
        data = rng.normal(size=(300, 3)) * (1.0, 10.0, 0.0)
        spec = StreamSpec((3,), rate_hz=30.0, units=("uV",))
        return [
            Case(cls(window_s=2.0), {"in": (spec, grid(30.0, 300), data)}, least=300),
            Case(cls(freeze_s=3.0), {"in": (spec, grid(30.0, 300), data.round(1))}, least=300),
        ]
