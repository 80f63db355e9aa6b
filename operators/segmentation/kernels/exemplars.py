"""Exemplars' frames, in one ring, and the index of `operators.neighbours` over it, which says which exemplars can match at all."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.neighbours.bare import bare_index
from kinegraph.operators.neighbours.candidates import radius_squared
from kinegraph.operators.neighbours.follow import enter, take_marked
from kinegraph.operators.neighbours.layout import LARGEST, BareIndex
from kinegraph.operators.neighbours.search import search
from kinegraph.operators.neighbours.window import prepare
from kinegraph.operators.segmentation.kernels.layout import (
    LONGEST_EXEMPLARS,
    Memory,
)
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.kernel import kernel

ROUNDING = 2.0**-22
"""A frame's features, as float32, lie this share of their size away at the most; so do the sums of as many squares, per feature."""
SHORTEST = 1e-15
"""Within a smaller radius float32 says nothing."""
ALL = -1
"""Told of a frame of which the index knows nothing: every exemplar may match."""


@kernel
def store(s: Memory, slot: int, first: int, length: int) -> None:
    """Frames `first`, ... of the window are the exemplar in `slot` from now on."""
    ring = s.times.shape[0]
    frames = np.empty((s.frames.shape[0], length))
    for c in range(length):
        for d in range(s.frames.shape[0]):
            frames[d, c] = s.frames[d, (first + c) % ring]
    s.cluster_numbers[slot] = -1
    make_room(s, length)
    append(s, slot, frames)


@kernel
def make_room(s: Memory, length: int) -> None:
    """The ring goes round: exemplars in the way of the next `length` frames are moved on, the oldest first."""
    room = s.exemplars.shape[1]
    while True:
        oldest = -1
        for k in range(s.cluster_numbers.shape[0]):
            if s.cluster_numbers[k] >= 0 and (oldest < 0 or s.exemplar_starts[k] < s.exemplar_starts[oldest]):
                oldest = k
        if oldest < 0 or s.exemplar_starts[oldest] >= s.kept + length - room:
            return
        append(s, oldest, copied(s, oldest))


@kernel
def copied(s: Memory, slot: int) -> Samples:
    """The frames of an exemplar (features, length)."""
    length, room = s.exemplar_sizes[slot], s.exemplars.shape[1]
    frames = np.empty((s.exemplars.shape[0], length))
    for c in range(length):
        for d in range(s.exemplars.shape[0]):
            frames[d, c] = s.exemplars[d, (s.exemplar_starts[slot] + c) % room]
    return frames


@kernel
def append(s: Memory, slot: int, frames: Samples) -> None:
    """Write an exemplar's frames (features, length) where the ring goes on, and enter them into the index."""
    room, whole = s.exemplars.shape[1], 1
    s.exemplar_starts[slot], s.exemplar_sizes[slot] = s.kept, frames.shape[1]
    row = np.empty(frames.shape[0])
    for c in range(frames.shape[1]):
        place = s.kept % room
        for d in range(frames.shape[0]):
            row[d] = s.exemplars[d, place] = frames[d, c]
            whole = whole if abs(row[d]) <= LARGEST else 0
        s.owners[place] = slot
        enter(s.lookup, s.lookup_books, row, math.nan)
        s.kept += 1
    s.exemplar_whole[slot] = whole


@kernel
def vacate(s: Memory, length: int) -> int:
    """A free slot, after those used longest ago have left, as many as keep `length` frames from their place."""
    while True:
        free, oldest, frames = -1, -1, length
        for k in range(s.cluster_numbers.shape[0]):
            if s.cluster_numbers[k] < 0:
                free = k if free < 0 else free
                continue
            frames += s.exemplar_sizes[k]
            if oldest < 0 or s.exemplar_uses[k] < s.exemplar_uses[oldest]:
                oldest = k
        if free >= 0 and (oldest < 0 or frames <= LONGEST_EXEMPLARS * s.max_lag):
            return int(free)
        s.cluster_numbers[oldest] = -1


@kernel
def candidates(s: Memory, first: int, last: int) -> Array:
    """Which exemplars (slots,) may lie within the radius of frames first..last on the mean: those with a frame within it of one of these.

    A path's mean distance is not below its least one, so that the others cannot. What lacks features, or lies beyond float32, may.
    """
    may = np.zeros(s.cluster_numbers.shape[0], np.bool_)
    for k in range(may.shape[0]):
        may[k] = s.cluster_numbers[k] >= 0 and not s.exemplar_whole[k]
    ix, room, ring = bare_index(s.lookup, s.lookup_books), s.exemplars.shape[1], s.times.shape[0]
    numbers, far, ways = np.empty(room, np.int64), np.empty(room, np.float32), np.empty((room, 2), np.bool_)
    row = np.empty(s.frames.shape[0])
    for i in range(first, last + 1):
        for d in range(row.shape[0]):
            row[d] = s.frames[d, i % ring]
        found = near(ix, row, s.radius, numbers, far, ways)
        if found == ALL:
            may[:] = True
            return may
        for k in range(found):
            slot = s.owners[numbers[k] % room]
            may[slot] = may[slot] or s.exemplar_starts[slot] <= numbers[k]
    return may


@kernel
def near(ix: BareIndex, x: Samples, radius: float, numbers: Times, far: Array, ways: Array) -> int:
    """The numbers of all frames in the index whose distance per feature to `x` (features,) may be at most `radius`; how many, or ALL.

    The index rounds to float32; the radius is wider by what that may do.
    """
    squares = 0.0
    for d in range(x.shape[0]):
        squares += x[d] * x[d]
    reach = radius * math.sqrt(x.shape[0])
    reach = (reach + ROUNDING * (math.sqrt(squares) + reach)) * (1.0 + ROUNDING * (x.shape[0] + 8))
    if not SHORTEST <= reach <= LARGEST or not prepare(ix, x):
        return ALL
    within = radius_squared(reach)
    if search(ix, ix.next, 0, 0, within, False) == 0:
        return 0
    return take_marked(ix, within, 0, numbers, far, ways)
