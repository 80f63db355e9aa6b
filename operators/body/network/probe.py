"""Where a network's points lie in the image, and what depth was measured there."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples
from kinegraph.stream.data.ordering import median
from kinegraph.stream.kernel import kernel

REACH, LEAST = 3, 4
"""The median of this many pixels to each side is a landmark's depth, if at least LEAST of them belong to the person."""


@kernel(nogil=True)
def box_of(depth: NDArray[np.uint16], out: Samples) -> None:
    """The box of what is not 0 in `depth` (h, w): middle x and y, width, height into `out` (4,)."""
    top, bottom, left, right = depth.shape[0], -1, depth.shape[1], -1
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            if depth[y, x] != 0:
                top, bottom, left, right = min(top, y), max(bottom, y), min(left, x), max(right, x)
    out[0], out[1], out[2], out[3] = (
        (left + right + 1) / 2.0,
        (top + bottom + 1) / 2.0,
        right - left + 1.0,
        bottom - top + 1.0,
    )


@kernel(nogil=True)
def probe(raw: Samples, world: Samples, square: Samples, depth: NDArray[np.uint16], out: Samples) -> None:
    """The network's points `raw` (39, 5) and `world` (39, 3) in the image, by its `square` (4,), with the depth there: `out` (34, 8)."""
    scale, cosine, sine = square[2] / 256.0, math.cos(square[3]), math.sin(square[3])
    for k in range(33):
        u, v = (raw[k, 0] - 128.0) * scale, (raw[k, 1] - 128.0) * scale
        out[k, 0], out[k, 1] = square[0] + u * cosine - v * sine, square[1] + u * sine + v * cosine
        out[k, 3], out[k, 4] = 1.0 / (1.0 + math.exp(-raw[k, 3])), 1.0 / (1.0 + math.exp(-raw[k, 4]))
        out[k, 5] = world[k, 0] * cosine - world[k, 1] * sine
        out[k, 6] = world[k, 0] * sine + world[k, 1] * cosine
        out[k, 7] = world[k, 2]
    for i in range(8):
        out[33, i] = (out[7, i] + out[8, i]) / 2.0
    for k in range(34):
        out[k, 2] = _depth_at(depth, out[k, 0], out[k, 1])


@kernel
def _depth_at(depth: NDArray[np.uint16], x: float, y: float) -> float:
    """The person's depth (m) around a pixel, NaN where there is not enough of it."""
    h, w = depth.shape
    if not (0.0 <= x < w and 0.0 <= y < h):
        return math.nan
    column, row = int(x), int(y)
    found = np.empty((2 * REACH + 1) ** 2)
    n = 0
    for i in range(max(0, row - REACH), min(h, row + REACH + 1)):
        for j in range(max(0, column - REACH), min(w, column + REACH + 1)):
            if depth[i, j] != 0:
                found[n] = depth[i, j]
                n += 1
    return median(found, n) / 1000.0 if n >= LEAST else math.nan
