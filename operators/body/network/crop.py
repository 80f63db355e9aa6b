"""A square part of an image as a pose network takes it: turned, scaled to the network's size, its contrast stretched."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

Image = NDArray[np.uint8]
Single = NDArray[np.float32]

DARK, LIGHT = 10.0, 245.0
"""What the darkest and the lightest pixels of a part become; a dark image loses every frame without it."""
DARK_SHARE, LIGHT_SHARE = 0.02, 0.995


@kernel(nogil=True)
def crop(image: Image, centre_x: float, centre_y: float, side: float, turn: float, out: Single) -> None:
    """The square of `side` pixels around a point of `image` (h, w, c), turned by `turn` rad, into `out` (n, n, 3), 0 to 1, interpolated.

    One channel is given three times. Outside of the image it is black. The contrast is stretched so that the share DARK_SHARE of the
    pixels inside is darker than DARK, and LIGHT_SHARE darker than LIGHT.
    """
    h, w, channels = image.shape
    n = out.shape[0]
    counts = np.zeros(256, np.int64)
    half = side / 2.0
    for y in range(max(0, int(centre_y - half)), min(h, int(centre_y + half) + 1)):
        for x in range(max(0, int(centre_x - half)), min(w, int(centre_x + half) + 1)):
            level = 0
            for c in range(channels):
                level += image[y, x, c]
            counts[level // channels] += 1
    low, high = _levels(counts)
    scale = (LIGHT - DARK) / max(high - low, 1.0)
    along, across = math.cos(turn) * side / n, math.sin(turn) * side / n
    for i in range(n):
        for j in range(n):
            u, v = j + 0.5 - n / 2.0, i + 0.5 - n / 2.0
            x, y = centre_x + u * along - v * across - 0.5, centre_y + u * across + v * along - 0.5
            left, top = math.floor(x), math.floor(y)
            if left < 0 or top < 0 or left + 1 >= w or top + 1 >= h:
                for c in range(3):
                    out[i, j, c] = 0.0
                continue
            right, down = x - left, y - top
            for c in range(channels):
                p = (image[top, left, c] * (1.0 - right) + image[top, left + 1, c] * right) * (1.0 - down)
                p += (image[top + 1, left, c] * (1.0 - right) + image[top + 1, left + 1, c] * right) * down
                out[i, j, c] = min(max((p - low) * scale + DARK, 0.0), 255.0) / 255.0
            for c in range(channels, 3):
                out[i, j, c] = out[i, j, 0]


@kernel
def _levels(counts: NDArray[Any]) -> tuple[float, float]:
    """The levels below which the shares DARK_SHARE and LIGHT_SHARE of the pixels lie, from a histogram `counts` (256,)."""
    total = counts.sum()
    low, high, seen = 0, 255, 0
    for level in range(256):
        if seen <= DARK_SHARE * total:
            low = level
        if seen < LIGHT_SHARE * total:
            high = level
        seen += counts[level]
    return float(low), float(high)


@kernel
def refine(heat: Single, points: Samples) -> None:
    """Move x and y of `points` (39, 5), in the network's pixels, to the middle of the heat around them, where the network is sure.

    heat   (k, k, 39)  logits; a quarter of the network's resolution
    """
    k = heat.shape[0]
    scale = 256.0 / k
    for p in range(points.shape[0]):
        x, y = int(points[p, 0] / scale), int(points[p, 1] / scale)
        if x < 0 or y < 0 or x >= k or y >= k:
            continue
        total, across, down, peak = 0.0, 0.0, 0.0, 0.0
        for i in range(max(0, y - 3), min(k, y + 4)):
            for j in range(max(0, x - 3), min(k, x + 4)):
                v = 1.0 / (1.0 + math.exp(-heat[i, j, p]))
                total += v
                across += v * j
                down += v * i
                peak = max(peak, v)
        if peak >= 0.5 and total > 0.0:
            points[p, 0], points[p, 1] = across / total * scale, down / total * scale
