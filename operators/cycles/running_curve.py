"""Mean and spread of curves that come one by one, and of which one may be taken out again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Array, Samples


@dataclass(slots=True)
class RunningCurve:
    """count (m,): curves per muscle; mean, squares (points, m): their mean, the sum of squared differences from it (Welford 1962)."""

    count: Samples
    mean: Samples
    squares: Samples

    @staticmethod
    def empty(points: int, muscles: int) -> RunningCurve:
        return RunningCurve(np.zeros(muscles), np.zeros((points, muscles)), np.zeros((points, muscles)))

    def add(self, curve: Samples) -> Array:
        """One more curve (points, m); a muscle with NaN does not count. Gives which muscles did (m,)."""
        there = np.asarray(~np.isnan(curve).any(axis=0))
        self.count[there] += 1
        before = curve[:, there] - self.mean[:, there]
        self.mean[:, there] += before / self.count[there]
        self.squares[:, there] += before * (curve[:, there] - self.mean[:, there])
        return there

    def remove(self, curve: Samples) -> None:
        """Take out a curve that was added."""
        there = ~np.isnan(curve).any(axis=0)
        self.count[there] -= 1
        left = np.maximum(self.count[there], 1)
        off = curve[:, there] - self.mean[:, there]
        self.mean[:, there] = np.where(self.count[there] > 0, self.mean[:, there] - off / left, 0.0)
        self.squares[:, there] -= off * (curve[:, there] - self.mean[:, there])
        self.squares[:, self.count < 2] = 0.0

    def centre(self) -> Samples:
        """The mean curves; NaN where nothing was added."""
        return np.where(self.count > 0, self.mean, np.nan)

    def sd(self) -> Samples:
        """The standard deviation (n - 1) point by point; NaN below two curves."""
        return np.where(self.count > 1, np.sqrt(np.maximum(self.squares, 0.0) / np.maximum(self.count - 1, 1)), np.nan)

    def variance_ratio(self) -> Samples:
        """Variance about the mean curve over variance about the grand mean (m,) (Hershler and Milner 1978)."""
        points = len(self.mean)
        within = self.squares.sum(axis=0)
        between = self.count * ((self.mean - self.mean.mean(axis=0)) ** 2).sum(axis=0)
        return np.asarray((within / (points * (self.count - 1))) / ((within + between) / (points * self.count - 1)))
