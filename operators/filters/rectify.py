"""Full-wave rectification (thesis, section 6.2.3: the absolute value of the raw EMG)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.stream.chunk import Samples, StreamSpec
from kinegraph.stream.data.finite import finite
from kinegraph.stream.filter import SampleWise
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid


@kernel
def magnitudes(x: Samples, out: Samples) -> None:
    """Absolute values of `x` (n, c) into `out` (n, c); what is not finite becomes NaN."""
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            out[i, c] = finite(abs(x[i, c]))


@dataclass(frozen=True, slots=True)
class Rectify(SampleWise[None]):
    """Every number's absolute value, as float64. No delay; works at any rate, and passes gaps on as they are.

    >>> Rectify()(np.array([-2.0, 3.0, -0.5]), rate_hz=100)
    array([2. , 3. , 0.5])
    """

    references: ClassVar[str] = "thesis 6.2.3"
    kernel = magnitudes

    def begin(self, spec: StreamSpec) -> None:
        """Nothing is remembered."""

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(1).normal(size=(400, 3))
        return [Case(cls(), {"in": (StreamSpec((3,), rate_hz=1000.0), grid(1000.0, 400), data)}, least=400)]
