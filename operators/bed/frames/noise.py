"""The noise of a movement signal, learned from its stillest epochs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Samples, Times

EPOCHS = 60
DECILE = 1.2816
"""How many standard deviations the lowest tenth lies below the median."""


@dataclass(slots=True)
class Noise:
    """
    level, scatter  (EPOCHS, k)  of the newest epochs: the median, and how far the lowest tenth is below it, as a standard deviation
    count           (k,)         how many epochs there were
    """

    level: Samples
    scatter: Samples
    count: Times

    @staticmethod
    def of(k: int) -> Noise:
        return Noise(np.zeros((EPOCHS, k)), np.zeros((EPOCHS, k)), np.zeros(k, np.int64))

    def learn(self, k: int, values: Samples) -> None:
        """One more epoch of channel `k`: its finite values."""
        place = int(self.count[k]) % EPOCHS
        middle = float(np.median(values))
        self.level[place, k] = middle
        self.scatter[place, k] = (middle - float(np.quantile(values, 0.1))) / DECILE
        self.count[k] += 1

    def level_of(self, k: int) -> float:
        """What channel `k` is in the stillest quarter of the epochs."""
        n = min(int(self.count[k]), EPOCHS)
        return float(np.sort(self.level[:n, k])[n // 4])

    def threshold(self, k: int, sigmas: float, min_rise: float) -> float:
        """What channel `k` exceeds only where something moves; at least one epoch must have been learned."""
        level = self.level_of(k)
        return level + max(sigmas * self.scatter_of(k), min_rise * level)

    def scatter_of(self, k: int) -> float:
        """How far channel `k` scatters in the stillest half of the epochs, as a standard deviation."""
        n = min(int(self.count[k]), EPOCHS)
        order = np.argsort(self.level[:n, k], kind="stable")
        return float(np.median(self.scatter[order[: max(1, n // 2)], k]))

    def steady(self, k: int, most: float, epochs: int) -> bool:
        """Whether the stillest half of at least this many epochs scatters by at most `most` of its level, in each and among all."""
        n = min(int(self.count[k]), EPOCHS)
        if n < epochs:
            return False
        order = np.argsort(self.level[:n, k], kind="stable")[: n // 2]
        level, scatter = self.level[order, k], self.scatter[order, k]
        middle = float(np.median(level))
        return float(level[-1] - level[0]) <= most * middle and float(np.median(scatter)) <= most * middle

    def clear(self) -> None:
        self.count[:] = 0
