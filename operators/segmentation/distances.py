"""Frames and their distances: each frame against those shortly before it, the radius that follows, who has a neighbour."""

from __future__ import annotations

import math

import numpy as np

from operators.segmentation.layout import (
    BAND,
    BAND_LEAST,
    BAND_MOST,
    FACTOR,
    FIXED,
    LAG,
    NEXT,
    RADIUS,
    ROWS,
    SEED,
    SINCE,
    WINDOW,
    Memory,
)
from stream.chunk import Samples
from stream.kernel import kernel

SAMPLED = 64
"""Frames, evenly spaced over the window, whose distances to each other give the scale of the radius."""


@kernel
def insert(s: Memory, x: Samples, stamp: int) -> int:
    """Take frame `x` (features,) and its distances to the LAG frames before it; returns its number.

    Distances are Euclidean over the root of the number of features (the thesis's generalised radius). A frame with a value that is not
    finite stands for the one before it, and has no neighbours.
    """
    b = s.books
    t = int(b[NEXT])
    b[NEXT] = t + 1
    ring = s.times.shape[0]
    width = s.frames.shape[0]
    p = t % ring
    good = True
    for d in range(width):
        good = good and math.isfinite(x[d])
    for d in range(width):
        v = x[d] if good else s.frames[d, (t - 1) % ring]
        s.frames[d, p] = v
        s.frames[d, p + ring] = v
    s.times[p] = stamp
    row = s.rows[t % s.rows.shape[0]]
    n = min(b[LAG], t - b[SINCE])
    row[:] = 0.0
    for d in range(width):
        line = s.frames[d, p + ring - n : p + ring + 1]
        v = line[n]
        for k in range(1, n + 1):
            apart = v - line[n - k]
            row[k] += apart * apart
    for k in range(1, n + 1):
        row[k] = math.sqrt(row[k] / width)
    for k in range(n + 1, row.shape[0]):
        row[k] = math.inf
    s.near[t % s.near.shape[0]] = 0 if good else 2
    return t


@kernel
def reflect(s: Memory, t: int, image: Samples) -> None:
    """`image` (features,) is the mirror image of frame `t`; not known where a value is not finite, or the frame was bad."""
    good = s.near[t % s.near.shape[0]] != 2
    for d in range(image.shape[0]):
        good = good and math.isfinite(image[d])
    row = s.mirrored[t % s.mirrored.shape[0]]
    for d in range(image.shape[0]):
        row[d] = image[d] if good else math.nan


@kernel
def between(s: Memory, i: int, j: int) -> float:
    """Distance of two frames of the window."""
    ring = s.times.shape[0]
    total = 0.0
    for d in range(s.frames.shape[0]):
        apart = s.frames[d, i % ring] - s.frames[d, j % ring]
        total += apart * apart
    return math.sqrt(total / s.frames.shape[0])


@kernel
def mark(s: Memory, i: int, seed: int) -> bool:
    """Whether frame `i` has a neighbour: at least BAND, at most LAG frames before it, not before `seed`. Notes it in `near`."""
    b = s.books
    place = i % s.near.shape[0]
    if s.near[place] == 2:
        return False
    row = s.rows[place % s.rows.shape[0]]
    s.near[place] = 0
    for k in range(b[BAND], min(b[LAG], i - seed) + 1):
        if row[k] <= s.values[RADIUS]:
            s.near[place] = 1
            return True
    return False


@kernel
def choose_radius(s: Memory, t: int) -> None:
    """The radius is a share of the median distance between frames of the window, the band follows from it; then who has a neighbour."""
    b = s.books
    if not b[FIXED]:
        first = max(b[SINCE], t - b[WINDOW] + 1)
        step = max(1, (t - first + 1) // SAMPLED)
        n = (t - first) // step + 1
        apart = np.empty(n * (n - 1) // 2)
        at = 0
        for i in range(n):
            for j in range(i):
                apart[at] = between(s, first + i * step, first + j * step)
                at += 1
        s.values[RADIUS] = s.values[FACTOR] * np.median(apart)
    choose_band(s, t)
    b[ROWS] = 0
    for i in range(max(b[SEED], t - b[LAG] + 1), t):
        b[ROWS] += mark(s, i, b[SEED])


@kernel
def choose_band(s: Memory, t: int) -> None:
    """How long frames typically stay within the radius of themselves, half as long again, within the bounds."""
    b = s.books
    first = max(b[SINCE], t - b[LAG])
    count = np.zeros(b[BAND_MOST] + 1, np.int64)
    for i in range(first, t):
        row = s.rows[i % s.rows.shape[0]]
        k = 1
        while k < b[BAND_MOST] and k <= i - b[SINCE] and row[k] <= s.values[RADIUS]:
            k += 1
        count[k] += 1
    total, k = 0, 0
    while k < b[BAND_MOST] and 2 * (total + count[k]) < t - first:
        total += count[k]
        k += 1
    b[BAND] = min(b[BAND_MOST], max(b[BAND_LEAST], k + k // 2))
