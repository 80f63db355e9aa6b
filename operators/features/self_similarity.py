"""Self-similarity: how far each moment is from those before it, so that what repeats can be seen (thesis, 2.2 and 2.3.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.stream.chunk import Chunk, Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import regular, width_of
from kinegraph.stream.filter import Filter, FilterState, reset_gap
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param


@kernel
def compare(x: Samples, ring: Samples, held: Times, every: int, time: Times, out: Samples, stamps: Times) -> None:
    """Of each `every`-th row of `x` (n, c), its distance to the rows compared before it: `out` (m, lags), the one just before it first.

    ring  (lags, c)  the rows compared last
    held  (3,)       how many rows pass before the next one is compared, the place in the ring filled next, how many are filled

    Euclidean, divided by the root of c; over the features that both rows have, and NaN where they share no feature, or without a row.
    """
    lags, width = ring.shape
    first = held[0]
    for k in range(out.shape[0]):
        i = first + k * every
        at = held[1]
        stamps[k] = time[i]
        for lag in range(lags):
            out[k, lag] = math.nan
            if lag >= held[2]:
                continue
            row = at - 1 - lag
            row += lags if row < 0 else 0
            total, shared = 0.0, 0
            for c in range(width):
                d = finite(x[i, c]) - ring[row, c]
                if d == d:
                    total += d * d
                    shared += 1
            if shared:
                out[k, lag] = math.sqrt(total / shared)
        for c in range(width):
            ring[at, c] = finite(x[i, c])
        held[1] = 0 if at + 1 == lags else at + 1
        held[2] = min(held[2] + 1, lags)
    held[0] = first + out.shape[0] * every - x.shape[0]


@dataclass(slots=True)
class SelfSimilarityState(FilterState):
    ring: Samples
    held: Times


@dataclass(frozen=True, slots=True)
class SelfSimilarity(Filter[SelfSimilarityState]):
    """Features in (width,); out come distances (lags,): of every `every`-th frame, to the one compared before it, the one before that, ...

    The distance is Euclidean, divided by the root of the number of features, as in `operators.segmentation.Segment`; over the features
    that both frames have; NaN without any. The page draws it as the square matrix of the thesis (panel `similarity`). Row
    after row costs `lags` distances, and the state is `lags` frames, however long the session is. No delay. In a gap the lost frames are
    counted, so that lags stay times; a longer one than `reset_gap_s` starts afresh.

    Source: thesis, 2.2 (the matrix) and 2.3.1 (the distance). Departure: only the newest `lags` frames are compared.

    >>> SelfSimilarity(every=1, lags=2)(np.array([0.0, 3.0, 4.0]), rate_hz=30)
    array([[nan, nan],
           [ 3., nan],
           [ 1.,  4.]])
    """

    blends: ClassVar[bool] = False
    every: int = param(15, least=1, help="compare one frame in this many")
    lags: int = param(120, least=2, most=1000, help="with how many frames before it")
    reset_gap_s: float = reset_gap(60.0)
    kernel = compare

    def begin(self, spec: StreamSpec) -> SelfSimilarityState:
        regular(spec)
        return SelfSimilarityState(ring=np.full((self.lags, width_of(spec)), np.nan), held=np.zeros(3, np.int64))

    def gives(self, spec: StreamSpec) -> StreamSpec:
        unit = spec.units[0] if len(set(spec.units)) == 1 else ""
        rate_hz = regular(spec) / self.every
        return spec.derive(
            shape=(self.lags,), rate_hz=rate_hz, channels=(), units=(unit,), channel_axis=0, meta={"lag_s": 1 / rate_hz}
        )

    def rows(self, n: int) -> int:
        return (n - self.state.held.item(0) + self.every - 1) // self.every

    def gap(self, chunk: Chunk) -> int:
        """Frames that would have been compared stand in the ring as not known; a long gap starts afresh."""
        ring, held = self.state.ring, self.state.held
        if self.breaks(chunk):
            held[:] = 0
            return -1
        missing = self.missing(chunk)
        for _ in range(min(max(0, (missing - held.item(0) + self.every - 1) // self.every), self.lags)):
            ring[held[1]] = np.nan
            held[1] = (held[1] + 1) % self.lags
            held[2] = min(held[2] + 1, self.lags)
        held[0] = (held[0] - missing) % self.every
        return -1

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(17).normal(size=(400, 3)).cumsum(axis=0)
        spec = StreamSpec((3,), rate_hz=100.0, units=("cm",))
        return [Case(cls(every=7, lags=12), {"in": (spec, grid(100.0, 400), data)}, least=57)]
