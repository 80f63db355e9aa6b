"""Frames and their distances: each frame against those shortly before it, the radius that follows, who has a neighbour."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.segmentation.kernels.layout import (
    Memory,
)
from kinegraph.operators.segmentation.kernels.rest import at_rest
from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.ordering import median
from kinegraph.stream.kernel import kernel

KNOWN, SHARED = 2, 4
"""A frame is known if one in KNOWN of its features is, and a distance if both frames have one in SHARED; of those known in the window."""
SAMPLED = 64
"""Frames, evenly spaced over the window, whose distances to each other give the scale of the radius."""


@kernel
def insert(s: Memory, x: Samples, stamp: int) -> int:
    """Take frame `x` (features,) and its distances to the `max_lag` frames before it; returns its number.

    Distances are Euclidean over the root of the number of features that both frames have (the thesis's generalised radius). A frame in
    which fewer than half of the features are known that have been known within the window stands for the one before it, and has no
    neighbours.
    """
    t = int(s.next_frame)
    s.next_frame = t + 1
    ring = s.times.shape[0]
    p = t % ring
    good = is_known(s, x, t)
    for d in range(s.frames.shape[0]):
        v = finite(x[d] if good else s.frames[d, (t - 1) % ring])
        if v != v:
            s.patchy = t
        s.frames[d, p] = v
        s.frames[d, p + ring] = v
    s.times[p] = stamp
    row = s.rows[t % s.rows.shape[0]]
    n = min(s.max_lag, t - s.since)
    if t - n > s.patchy:
        measure_whole(s, p + ring - n, n, row)
    else:
        measure(s, p + ring - n, n, row)
    for k in range(n + 1, row.shape[0]):
        row[k] = math.inf
    s.near[t % s.near.shape[0]] = 0 if good else 2
    s.moves[p] = s.moved
    return t


@kernel
def is_known(s: Memory, x: Samples, t: int) -> bool:
    """Whether enough of frame `t` is known, of what has been known lately; notes what is."""
    known, present = 0, 0
    for d in range(x.shape[0]):
        if math.isfinite(x[d]):
            s.known[d] = t
            known += 1
        present += t - s.known[d] < s.window
    s.present = present
    return known > 0 and known * KNOWN >= present


@kernel
def measure_whole(s: Memory, first: int, n: int, row: Samples) -> None:
    """Distances of the frame in column `first + n` to the n before it, all features being known, into `row`."""
    width = s.frames.shape[0]
    row[:] = 0.0
    for d in range(width):
        line = s.frames[d, first : first + n + 1]
        v = line[n]
        for k in range(1, n + 1):
            apart = v - line[n - k]
            row[k] += apart * apart
    for k in range(1, n + 1):
        row[k] = math.sqrt(row[k] / width)


@kernel
def measure(s: Memory, first: int, n: int, row: Samples) -> None:
    """The same over the features that both frames have; infinity where these are too few."""
    common = s.common
    row[:] = 0.0
    common[:] = 0.0
    for d in range(s.frames.shape[0]):
        line = s.frames[d, first : first + n + 1]
        v = line[n]
        if math.isnan(v):
            continue
        for k in range(1, n + 1):
            apart = v - line[n - k]
            if not math.isnan(apart):
                row[k] += apart * apart
                common[k] += 1.0
    for k in range(1, n + 1):
        row[k] = scaled(s, row[k], common[k])


@kernel
def scaled(s: Memory, squares: float, common: float) -> float:
    """The distance of two frames, from the number of features in common and the sum of their squared differences; infinity: too few."""
    if common == 0.0 or common * SHARED < s.present:
        return math.inf
    return math.sqrt(squares / common)


@kernel
def reflect(s: Memory, t: int, image: Samples) -> None:
    """`image` (features,) is the mirror image of frame `t`: NaN where it is not known, or the frame was not."""
    good = s.near[t % s.near.shape[0]] != 2
    row = s.mirrored[t % s.mirrored.shape[0]]
    for d in range(image.shape[0]):
        row[d] = finite(image[d]) if good else math.nan


@kernel
def between(s: Memory, i: int, j: int) -> float:
    """Distance of two frames of the window; infinity: they have too few features in common."""
    ring = s.times.shape[0]
    total, common = 0.0, 0.0
    for d in range(s.frames.shape[0]):
        apart = s.frames[d, i % ring] - s.frames[d, j % ring]
        if not math.isnan(apart):
            total += apart * apart
            common += 1.0
    return scaled(s, total, common)


@kernel
def mark(s: Memory, i: int, seed: int) -> bool:
    """Whether frame `i` has a neighbour: at least `band`, at most `max_lag` frames before it, not before `seed`. Notes it in `near`."""
    place = i % s.near.shape[0]
    if s.near[place] == 2:
        return False
    row = s.rows[place % s.rows.shape[0]]
    s.near[place] = 0
    if at_rest(s, i):
        return False
    for k in range(s.band, min(s.max_lag, i - seed) + 1):
        if row[k] <= s.radius:
            s.near[place] = 1
            return True
    return False


@kernel
def choose_radius(s: Memory, t: int) -> None:
    """The radius that is typical of the window; then the band, and who has a neighbour."""
    if not s.is_radius_fixed:
        s.radius = typical(s, t)
    choose_band(s, t)
    s.near_count = 0
    for i in range(max(s.seed, t - s.max_lag + 1), t):
        s.near_count += mark(s, i, s.seed)


@kernel
def typical(s: Memory, t: int) -> float:
    """A share of the median distance between the window's frames that are not at rest; no more than that of those since a longer rest."""
    radius = typical_since(s, max(s.since, t - s.window + 1), t)
    if s.resumed > s.since and t - s.resumed >= s.mass:
        radius = min(radius, typical_since(s, max(s.resumed, t - s.window + 1), t))
    return radius


@kernel
def typical_since(s: Memory, first: int, t: int) -> float:
    """The same for frames first..t."""
    moving = lively(s, first, t)
    step = max(1, len(moving) // SAMPLED)
    n = (len(moving) + step - 1) // step
    apart = np.empty(n * (n - 1) // 2)
    at = 0
    for i in range(n):
        for j in range(i):
            far = between(s, moving[i * step], moving[j * step])
            if far < math.inf:
                apart[at] = far
                at += 1
    return s.radius_share * median(apart, at) if at else 0.0


@kernel
def lively(s: Memory, first: int, last: int) -> Times:
    """The numbers of the frames first..last that are not at rest."""
    found, n = np.empty(last - first + 1, np.int64), 0
    for i in range(first, last + 1):
        if not at_rest(s, i):
            found[n] = i
            n += 1
    return found[:n]


@kernel
def choose_band(s: Memory, t: int) -> None:
    """How long frames typically stay within the radius of themselves, half as long again, within the bounds."""
    first = max(s.since, t - s.max_lag)
    count = np.zeros(s.max_band + 1, np.int64)
    seen = 0
    for i in lively(s, first, t - 1):
        seen += 1
        row = s.rows[i % s.rows.shape[0]]
        k = 1
        while k < s.max_band and k <= i - s.since and row[k] <= s.radius:
            k += 1
        count[k] += 1
    total, k = 0, 0
    while k < s.max_band and 2 * (total + count[k]) < seen:
        total += count[k]
        k += 1
    s.band = min(s.max_band, max(s.min_band, k + k // 2))
