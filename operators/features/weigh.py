"""Features of several sensors in one distance: how much each sensor counts, however many channels it has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from kinegraph.operators.inputs.channels import names_of
from kinegraph.stream.chunk import Samples, StreamSpec
from kinegraph.stream.data.finite import finite
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.filter import SampleWise
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param


@kernel
def weigh(x: Samples, scale: Samples, out: Samples) -> None:
    """`out` (n, c): every channel of `x` (n, c) times its `scale` (c,); what is not finite is NaN."""
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            out[i, c] = scale[c] * finite(x[i, c])


@dataclass(slots=True)
class WeighState:
    scale: Samples


@dataclass(frozen=True, slots=True)
class Weigh(SampleWise[WeighState]):
    """Standardised channels of several sensors in; the same out, so scaled that each sensor counts by its weight in a distance.

    weights   by channel, or by a pattern that several match ("EMG_*", "*.x"): how much these channels count together

    The mean square difference of two samples over all channels becomes the weighted mean of those of the sensors: sixteen muscles of weight
    1 count as much as three axes of weight 1. Every channel must match one weight. Units are made comparable by
    `operators.features.standardise.Standardise` before it. The output has no units;
    `meta["weights"]` says what was given. No delay, any rate.
    Source: thesis, 2.8, which joins EMG and acceleration and leaves open how.

    >>> Weigh(weights={"emg": 1.0, "acc": 2.0})(np.ones((1, 2)), rate_hz=100, channels=["emg", "acc"]).round(3)
    array([[0.816, 1.155]])
    """

    weights: dict[str, float] = param(help="how much these channels count together, by name or pattern")

    kernel = weigh

    def begin(self, spec: StreamSpec) -> WeighState:
        names = names_of(spec)
        if not self.weights or not all(0.0 < w < np.inf for w in self.weights.values()):
            raise ParameterError("weights", self.weights, "a number above 0 for each sensor")
        of = [[key for key in self.weights if fnmatchcase(name, key)] for name in names]
        for name, keys in zip(names, of, strict=True):
            if len(keys) != 1:
                raise ParameterError(
                    "weights", self.weights, f"one that {name} matches; {len(keys) or 'no channels'} do"
                )
        counts = {key: sum(key in keys for keys in of) for key in self.weights}
        if missing := [key for key, count in counts.items() if not count]:
            raise ParameterError("weights", missing[0], f"what matches one of {', '.join(names)}")
        total = sum(self.weights.values())
        share = np.array([self.weights[keys[0]] / total / counts[keys[0]] for keys in of])
        return WeighState(np.sqrt(share * len(names)))

    def gives(self, spec: StreamSpec) -> StreamSpec:
        return spec.derive(units=("",) * len(spec.units), meta={**spec.meta, "weights": dict(self.weights)})

    @classmethod
    def cases(cls) -> Sequence[Case]:
        x = np.random.default_rng(4).normal(size=(200, 4))
        spec = StreamSpec(
            (4,), rate_hz=30.0, channels=("EMG_1", "EMG_2", "EMG_3", "acc"), units=("uV", "uV", "uV", "g")
        )
        return [Case(cls(weights={"EMG_*": 1.0, "acc": 2.0}), {"in": (spec, grid(30.0, 200), x)}, least=100)]
