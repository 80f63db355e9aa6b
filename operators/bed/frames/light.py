"""Light in which depths become noisier is no movement: nothing is displaced."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples

STEADY = 0.2
"""Noise, unlike movement, scatters by less than this share of its level."""
LIGHT_S, LIGHT_SHARE = 12.0, 0.9
"""A rise for at least so long, with hardly a pause, and as steady as noise, may be a light that makes depths noisier, however faint."""
DISPLACED = 0.2
"""It does not count as light where it grows by this share of itself over twice the time: a random walk grows by 0.41, movement by 1."""


def lit(
    change: Samples, far: Samples, moving: NDArray[np.bool_], n: int, level: float, scatter: float, far_level: float
) -> NDArray[np.bool_]:
    """Which averages (slots,) above the threshold lie in a stretch of `n` that is all but throughout raised, steady, and displaces nothing.

    far             the change over twice the time; NaN: not known, and then nothing is lit
    level, scatter  of the change while nothing happens; far_level: the same of `far`
    """
    found = np.zeros(len(change), np.bool_)
    for first in range(len(change) - n + 1):
        part = slice(first, first + n)
        seen = np.isfinite(change[part]) & np.isfinite(far[part])
        if seen.sum() < LIGHT_SHARE * n:
            continue
        near, farther = change[part][seen], far[part][seen]
        middle = float(np.mean(near))
        rise = middle - level
        if not np.quantile(near, 1 - LIGHT_SHARE) > level + scatter:
            continue
        grown = abs(float(np.mean(farther)) - far_level - rise)
        if float(np.std(near)) <= STEADY * middle and grown <= DISPLACED * rise:
            found[part] |= moving[part]
    return found
