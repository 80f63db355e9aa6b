"""Ridge regression from few frames, Gaussian or linear; width and ridge by leaving out one frame after the other (thesis 9.3.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from kinegraph.stream.chunk import Samples

Regression: TypeAlias = Literal["kernel", "linear"]
REGRESSIONS: tuple[Regression, ...] = get_args(Regression)
FAR = 3.0
"""A linear regression goes no farther from its mean than this many kernel widths from the training take it: it must not explode."""
WIDTHS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
"""In median distances of the frames."""
RIDGES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)


@dataclass(frozen=True, slots=True)
class Learned:
    """mean (q,) + sum over frames of exp(-scale |x - centres[f]|^2) weights[f]; `error` is that of the frames left out (mean square).

    Where `scale` is negative, the regression is linear, as equation 9.11: mean (q,) + (x - mean of the centres) weights (d, q). What is
    `FAR` or more kernel widths from all frames is then held back; a kernel width is the median distance of frames.
    """

    centres: Samples
    weights: Samples
    mean: Samples
    scale: float
    width: float
    ridge: float
    error: float

    def __call__(self, x: Samples) -> Samples:
        if self.linear:
            far = np.sqrt(-2.0 * self.scale * squares(x, self.centres).min(axis=1))
            share = np.minimum(1.0, FAR / np.maximum(far, 1e-12))[:, None]
            return np.asarray(self.mean + share * ((x - self.centres.mean(axis=0)) @ self.weights))
        return np.asarray(self.mean + np.exp(-self.scale * squares(x, self.centres)) @ self.weights)

    @property
    def linear(self) -> bool:
        return self.scale < 0.0

    def outside(self, x: Samples) -> float:
        """How far `x` (d,) lies from the nearest frame of the training, in kernel widths."""
        return float(np.sqrt(2.0 * abs(self.scale) * squares(x[None], self.centres).min()))


def squares(a: Samples, b: Samples) -> Samples:
    """Squared distances (n, m) of rows."""
    return np.asarray(((a[:, None] - b[None]) ** 2).sum(-1))


def learn(x: Samples, y: Samples, regression: Regression = "kernel") -> Learned:
    """The regression from `x` (f, d) to `y` (f, q) with the smallest leave-one-out error."""
    if regression == "linear" and len(x) > 1:
        return _linear(x, y)
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


def _linear(x: Samples, y: Samples) -> Learned:
    """Least squares with a ridge, in the dual form, for few frames."""
    n, middle, mean = len(x), x.mean(axis=0), y.mean(axis=0)
    gram = (x - middle) @ (x - middle).T
    median = max(float(np.median(np.sqrt(squares(x, x)[np.triu_indices(n, 1)]))), 1e-12)
    best: Learned | None = None
    for ridge in RIDGES:
        inverse = np.linalg.inv(gram + max(ridge * float(np.trace(gram)) / n, 1e-15) * np.eye(n))
        dual = inverse @ (y - mean)
        rest = 1.0 - 1.0 / n - np.diag(gram @ inverse)  # of 1: what a frame does not say of itself
        error = float((((y - mean) - gram @ dual) ** 2 / np.maximum(rest, 1e-9)[:, None] ** 2).mean())
        if best is None or error < best.error:
            best = Learned(x, (x - middle).T @ dual, mean, -0.5 / median**2, 1.0, ridge, error)
    assert best is not None
    return best
