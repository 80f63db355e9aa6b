"""A step ahead: what a value will be a little later, so that the lag of what came before does not show."""

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
def ahead(
    x: Samples, time: Times, ahead_s: float, tau_s: float, value: Samples, slope: Samples, when: Times, out: Samples
) -> None:
    """Every channel of `x` (n, c) plus `ahead_s` times its change per second, into `out` (n, c): the smaller of the newest and the smoothed
    one, 0 where these differ in sign.

    value  (c,)  the newest values; slope (c,) their change per second, smoothed over `tau_s`; when (c,) their stamps
    """
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            v = out[i, c] = finite(x[i, c])
            if v != v:
                continue
            if when[c] != NEVER and time[i] > when[c]:
                dt = (time[i] - when[c]) * 1e-9
                newest = (v - value[c]) / dt
                slope[c] += (1.0 - math.exp(-dt / tau_s)) * (newest - slope[c])
                if newest * slope[c] > 0.0:
                    out[i, c] = v + ahead_s * math.copysign(min(abs(newest), abs(slope[c])), newest)
            value[c] = v
            when[c] = time[i]


@dataclass(frozen=True, slots=True)
class Predict(Filter[SlopeState]):
    """Each value as it will be `ahead_s` later, if it goes on as it does: its speed times that time is added.

    Stamps stay: what comes out is meant for the time that the lag of the filters before has cost. The speed is the smaller of the newest
    and of the smoothed one, and 0 where these disagree about the direction: so it hardly overshoots where motion stops or turns (by less
    than a tenth of a step that took .2 s, behind One Euro), and adds little noise.

    >>> Predict(ahead_s=0.1)(np.arange(0.0, 1.0, 0.1), rate_hz=10).round(2)
    array([0.  , 0.19, 0.3 , 0.4 , 0.5 , 0.6 , 0.7 , 0.8 , 0.9 , 1.  ])
    """

    delays: ClassVar[str] = "no delay; takes back `ahead_s` of lag"
    references: ClassVar[str] = "linear extrapolation"
    ahead_s: float = param(1 / 30, least=0.0, most=0.5, help="how far ahead: one frame at 30 Hz")
    tau_s: float = param(0.05, above=0.0, help="over how long the speed is smoothed")
    kernel = ahead

    def begin(self, spec: StreamSpec) -> SlopeState:
        return SlopeState.of(spec)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(12).normal(size=(200, 4, 3)).cumsum(axis=0)
        spec = StreamSpec((4, 3), rate_hz=30.0, channels=("a", "b", "c", "d"), units=("m",))
        return [Case(cls(), {"in": (spec, grid(30.0, 200), data)}, least=200)]
