"""Which of several people is followed: by the colours of what they wear, remembered while one person is followed."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.body.network.crop import Image
from kinegraph.stream.chunk import Samples

PARTS = ((-0.16, -0.05), (0.05, 0.14))
"""Trunk and thighs: from and to, below the hips, in sides of the square that is looked at."""
BESIDE, POINTS = 0.03, 5
"""So far to both sides of the body's middle, in sides; points a row and rows of each part."""
OTHER = 40.0
"""Colours (0 to 255) that differ by more than this may be another person's."""
ALIKE = 0.5
"""Another person is taken with colours that differ by less than this share of what those of the followed one do."""
LEARN = 0.05
"""The share of each new frame in what is remembered."""


def colours(image: Image, square: Samples) -> Samples:
    """Mean colours (parts * channels,) of trunk and thighs of the person in `square` (4,); NaN outside the image."""
    x, y, side, turn = square.tolist()
    height, width, channels = image.shape
    made = np.full((len(PARTS), channels), np.nan)
    across = np.linspace(-BESIDE, BESIDE, POINTS) * side
    c, s = math.cos(turn), math.sin(turn)
    for k, (top, low) in enumerate(PARTS):
        down = np.linspace(top, low, POINTS)[:, None] * side
        at_x, at_y = x + across * c - down * s, y + across * s + down * c
        inside = (at_x >= 0) & (at_x < width) & (at_y >= 0) & (at_y < height)
        if inside.any():
            made[k] = image[at_y[inside].astype(int), at_x[inside].astype(int)].mean(axis=0)
    return made.ravel()


def unlike(now: Samples, remembered: Samples) -> float:
    """By how much colours differ: the mean of all that both have; 0 where there is nothing to compare."""
    off = np.abs(now - remembered)
    return float(off[~np.isnan(off)].mean()) if not np.isnan(off).all() else 0.0
