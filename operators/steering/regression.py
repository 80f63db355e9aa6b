"""Gaussian kernel ridge regression from few frames; width and ridge by leaving out one frame after the other (thesis 9.3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stream.chunk import Samples

WIDTHS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
"""In median distances of the frames."""
RIDGES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)


@dataclass(frozen=True, slots=True)
class Learned:
    """mean (q,) + sum over frames of exp(-scale |x - centres[f]|^2) weights[f]; `error` is that of the frames left out (mean square)."""

    centres: Samples
    weights: Samples
    mean: Samples
    scale: float
    width: float
    ridge: float
    error: float

    def __call__(self, x: Samples) -> Samples:
        return np.asarray(self.mean + np.exp(-self.scale * squares(x, self.centres)) @ self.weights)

    def outside(self, x: Samples) -> float:
        """How far `x` (d,) lies from the nearest frame of the training, in kernel widths."""
        return float(np.sqrt(2.0 * self.scale * squares(x[None], self.centres).min()))


def squares(a: Samples, b: Samples) -> Samples:
    """Squared distances (n, m) of rows."""
    return np.asarray(((a[:, None] - b[None]) ** 2).sum(-1))


def learn(x: Samples, y: Samples) -> Learned:
    """The regression from `x` (f, d) to `y` (f, q) whose frames, left out one by one, it predicts best."""
    apart, mean = squares(x, x), y.mean(axis=0)
    if len(x) < 2:
        return Learned(x, np.zeros_like(y), mean, 1.0, 1.0, 1.0, 0.0)
    median = max(float(np.median(np.sqrt(apart[np.triu_indices(len(x), 1)]))), 1e-12)
    best: Learned | None = None
    for share in WIDTHS:
        scale = 1.0 / (2.0 * (share * median) ** 2)
        kernel = np.exp(-scale * apart)
        for ridge in RIDGES:
            inverse = np.linalg.inv(kernel + ridge * np.eye(len(x)))
            weights = inverse @ (y - mean)
            error = float(((weights / np.diag(inverse)[:, None]) ** 2).mean())
            if best is None or error < best.error:
                best = Learned(x, weights, mean, scale, share, ridge, error)
    assert best is not None
    return best
