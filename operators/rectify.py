"""Full-wave rectification (thesis, section 6.2.3: the absolute value of the raw EMG)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from operators.continuity import Continuity, Filter, numeric, rows, watch
from stream.chunk import Chunk, Samples, Specs, StreamSpec
from stream.kernel import kernel
from stream.operator import Case, Step, grid


@kernel
def magnitudes(x: Samples, out: Samples) -> None:
    """Absolute values of `x` (n, c) into `out` (n, c); what is not finite becomes NaN."""
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            v = abs(x[i, c])
            out[i, c] = v if v < math.inf else math.nan


@dataclass(frozen=True, slots=True)
class Rectify(Filter[Continuity]):
    """Every number's absolute value, as float64. No delay; works at any rate, and passes gaps on as they are."""

    def open(self, specs: Specs) -> Specs:
        out = numeric(specs["in"])
        self.hold(Continuity(**watch(specs["in"])))
        return {"out": out}

    def kernel_step(self) -> Step:
        return Step(magnitudes, self.state)

    def process(self, port: str, chunk: Chunk) -> Chunk:
        state = self.state
        x = chunk.data
        made = out = state.spare.rows(len(x))
        if not state.plain:
            x, made = rows(x, state.width), out.reshape(x.shape)
        magnitudes(x, out)
        return Chunk(chunk.time, made, chunk.until, chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(1).normal(size=(400, 3))
        return [Case(cls(), {"in": (StreamSpec((3,), rate_hz=1000.0), grid(1000.0, 400), data)}, least=400)]
