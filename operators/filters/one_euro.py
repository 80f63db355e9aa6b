"""The One Euro filter: little jitter at rest, little lag in motion (Casiez, Roussel and Vogel 2012)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.inputs.slope import SlopeState
from kinegraph.stream.chunk import NEVER, Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.filter import Filter
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param


@kernel
def smoothed_by_speed(
    x: Samples,
    time: Times,
    cutoff_hz: float,
    beta: float,
    slope_hz: float,
    value: Samples,
    slope: Samples,
    when: Times,
    out: Samples,
) -> None:
    """Every channel of `x` (n, c) through a low-pass with a cut-off that rises by `beta` Hz for each unit per second, into `out` (n, c).

    value, slope  (c,)  what came out last, and its smoothed change per second
    when          (c,)  the stamp of the newest value that was finite
    """
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            v = out[i, c] = finite(x[i, c])
            if v != v:
                continue
            if when[c] != NEVER and time[i] > when[c]:
                dt = (time[i] - when[c]) * 1e-9
                share = 1.0 - math.exp(-2.0 * math.pi * slope_hz * dt)
                slope[c] += share * ((v - value[c]) / dt - slope[c])
                share = 1.0 - math.exp(-2.0 * math.pi * (cutoff_hz + beta * abs(slope[c])) * dt)
                value[c] += share * (v - value[c])
                when[c] = time[i]
            elif when[c] == NEVER:
                value[c], slope[c], when[c] = v, 0.0, time[i]
            out[i, c] = value[c]


@dataclass(frozen=True, slots=True)
class OneEuro(Filter[SlopeState]):
    """A low-pass filter with a cut-off that rises with speed, for positions shown to people.

    Stamps stay. The lag is 1 / (2 pi cutoff) at rest, 80 ms at 2 Hz, and less the faster it goes: 1 / (2 pi (cutoff_hz + beta |speed|)),
    at 2 Hz and beta 20 per metre 16 ms at .4 m/s. `operators.filters.predict.Predict` takes a constant part of it back. Any rate, also
    irregular.

    >>> OneEuro(cutoff_hz=1.0, beta=0.0)(np.array([0.0, 1.0, 1.0, 1.0]), rate_hz=30).round(3)
    array([0.   , 0.189, 0.342, 0.467])
    """

    delays: ClassVar[str] = "no declared delay; lags by 1 / (2 pi (cutoff_hz + beta speed))"
    references: ClassVar[str] = "Casiez 2012, with the exact share of a period"
    cutoff_hz: float = param(2.0, above=0.0, help="cut-off at rest")
    beta: float = param(20.0, least=0.0, help="by how many Hz it rises for each unit per second")
    slope_hz: float = param(1.0, above=0.0, help="cut-off of the speed")
    kernel = smoothed_by_speed

    def begin(self, spec: StreamSpec) -> SlopeState:
        return SlopeState.of(spec)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(11).normal(size=(200, 4, 3)).cumsum(axis=0)
        spec = StreamSpec((4, 3), rate_hz=30.0, channels=("a", "b", "c", "d"), units=("m",))
        return [
            Case(cls(), {"in": (spec, grid(30.0, 200), data)}, least=200),
            Case(cls(cutoff_hz=1.0, beta=0.0), {"in": (StreamSpec((3,)), grid(30.0, 200), data[:, 0])}, least=200),
        ]
