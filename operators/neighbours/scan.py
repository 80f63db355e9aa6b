"""The search through a small window: the distance to every frame, without asking any box.

Where all tiles take little room, their sums are found sooner than the boxes that would spare some of them: 64 slots at a time, in order of
age, no sum waiting for another. In a window without sealed blocks a frame's slot is its number modulo the slots, and there its sum is put.
"""

from __future__ import annotations

import math

import numpy as np

from operators.neighbours.candidates import NOTHING, gather
from operators.neighbours.distance import four_at_most, four_distances
from operators.neighbours.layout import (
    AT_GROUP_REACH,
    AT_SQUARED,
    FARTHEST,
    FOUR,
    GROUP,
    IN_WARM,
    LANES,
    NEXT,
    SLOTS,
    WARM,
    WARM_AT,
    WIDTH,
    Floats,
)
from operators.neighbours.window import oldest, tile_at
from stream.chunk import Times
from stream.kernel import kernel


@kernel
def scan(floats: Floats, books: Times, at: int, band: int, k: int, within: np.float32, both: bool) -> int:
    """Gather the frames that are near enough; returns how many were marked. As in `search`."""
    ring, sums, first, last = books[SLOTS], books[AT_SQUARED], oldest(books), books[NEXT]
    turn, size = first - first % ring, (1 + books[WIDTH]) * LANES
    start = (first - turn) // FOUR * FOUR
    stop = last - turn
    for slot in range(start, stop, FOUR):
        slot -= ring if slot >= ring else 0
        tile = tile_at(books, slot // LANES)
        four_distances(floats, books, tile, tile + size, tile + 2 * size, tile + 3 * size, sums + slot)
    for frame in range(max(at - band, first), min(at + band + 1, last)):
        place = frame - turn
        floats[sums + place - (ring if place >= ring else 0)] = math.inf
    limit = successors_limit(floats, books, at, k) if k > 0 else NOTHING
    marked = 0
    for slot in range(start, stop, FOUR):
        slot -= ring if slot >= ring else 0
        radius = max(within, floats[books[AT_GROUP_REACH] + slot // GROUP]) if both else within
        lanes = four_at_most(floats, books, max(limit, radius), sums + slot)
        if lanes:
            limit, found = gather(floats, books, limit, slot, lanes, sums + slot, at, band, k, within, both)
            marked += found
    return marked


@kernel
def successors_limit(floats: Floats, books: Times, at: int, k: int) -> np.float32:
    """The largest sum of the frames after the nearest of the query before: if these are k, none of the k nearest is farther."""
    ring, sums, first, last, warm = books[SLOTS], books[AT_SQUARED], oldest(books), books[NEXT], books[IN_WARM]
    later = at - books[WARM_AT]
    turn = first - first % ring
    successors = 0
    limit = np.float32(0.0)
    for i in range(books[WARM]):
        frame = books[warm + i] + later
        if first <= frame < last:
            place = frame - turn
            squared = floats[sums + place - (ring if place >= ring else 0)]
            if squared <= FARTHEST:
                limit = max(limit, squared)
                successors += 1
    return limit if successors >= k else FARTHEST
