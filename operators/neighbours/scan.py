"""The search through a small window: the distance to every frame, without asking any box.

Where all tiles take little room, their sums are found sooner than the boxes that would spare some of them: 64 slots at a time, in order of
age, no sum waiting for another. In a window without sealed blocks a frame's slot is its number modulo the slots, and there its sum is put.
"""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.neighbours.candidates import NOTHING, gather
from kinegraph.operators.neighbours.distance import four_at_most, four_distances
from kinegraph.operators.neighbours.layout import FARTHEST, FOUR, GROUP, LANES, BareIndex
from kinegraph.operators.neighbours.window import oldest, tile_at
from kinegraph.stream.kernel import kernel


@kernel
def scan(ix: BareIndex, at: int, band: int, k: int, within: np.float32, both: bool) -> int:
    """Gather the frames that are near enough; returns how many were marked. As in `search`."""
    ring, sums, first, last = ix.slots, ix.squared_at, oldest(ix), ix.next
    turn, size = first - first % ring, (1 + ix.width) * LANES
    start = (first - turn) // FOUR * FOUR
    stop = last - turn
    for slot in range(start, stop, FOUR):
        slot -= ring if slot >= ring else 0
        tile = tile_at(ix, slot // LANES)
        four_distances(ix, tile, tile + size, tile + 2 * size, tile + 3 * size, sums + slot)
    for frame in range(max(at - band, first), min(at + band + 1, last)):
        place = frame - turn
        ix.floats[sums + place - (ring if place >= ring else 0)] = math.inf
    limit = successors_limit(ix, at, k) if k > 0 else NOTHING
    marked = 0
    for slot in range(start, stop, FOUR):
        slot -= ring if slot >= ring else 0
        radius = max(within, ix.group_reach[slot // GROUP]) if both else within
        lanes = four_at_most(ix, max(limit, radius), sums + slot)
        if lanes:
            limit, found = gather(ix, limit, slot, lanes, sums + slot, at, band, k, within, both)
            marked += found
    return marked


@kernel
def successors_limit(ix: BareIndex, at: int, k: int) -> np.float32:
    """The largest sum of the frames after the nearest of the query before: if these are k, all k nearest are within it."""
    ring, sums, first, last, warm = ix.slots, ix.squared_at, oldest(ix), ix.next, ix.warm
    later = at - ix.warm_frame
    turn = first - first % ring
    successors = 0
    limit = np.float32(0.0)
    for i in range(ix.warm_count):
        frame = warm[i] + later
        if first <= frame < last:
            place = frame - turn
            squared = ix.floats[sums + place - (ring if place >= ring else 0)]
            if squared <= FARTHEST:
                limit = max(limit, squared)
                successors += 1
    return limit if successors >= k else FARTHEST
