"""The search: the k nearest and all within a radius, in one pass over tops, groups, tiles and lanes.

Order and ties. A frame is before another if its d2 (see distance.py) is smaller, or equal and its number is lower: the older one. The k
nearest are the first k; so the answer does not depend on the order in which tiles are visited, nor on what is sealed.

The tiles that hold the successors of the nearest of the query before are visited first: in motion those are about the nearest now, so
that the bound is tight from the beginning. Where most tiles survive all the same, as in noise, the next queries leave the boxes aside.
"""

from __future__ import annotations

import math

import numpy as np

from operators.neighbours.distance import box_distances, tile_distances
from operators.neighbours.lanes import lowest
from operators.neighbours.layout import (
    AT_GROUP_REACH,
    AT_GROUPS,
    AT_NEAR,
    AT_REACH,
    AT_SCRATCH,
    AT_SQUARED,
    AT_TOPS,
    BLOCK,
    BLOCKS,
    GROUPS,
    IN_FRAMES,
    IN_MARKS,
    IN_NEAR,
    IN_SEEN,
    IN_WARM,
    LANES,
    NEAR,
    NEXT,
    PLAIN,
    QUERIES,
    SINCE,
    TOPS,
    WARM,
    WARM_AT,
    WIDTH,
    WINDOW,
    Floats,
)
from operators.neighbours.window import oldest, slot_of, tile_at
from stream.chunk import Times
from stream.kernel import kernel

FARTHEST = np.float32(np.finfo(np.float32).max)
"""No limit: everything but infinity, which is what lanes without a living frame hold."""

MOST_SURVIVE, PLAIN_FOR = 0.6, 15
"""Beyond this share of tiles that were looked into, so many queries leave the boxes aside."""


@kernel
def search(floats: Floats, books: Times, at: int, band: int, k: int, within: np.float32, both: bool) -> int:
    """Find the k nearest of the frame that was prepared, and mark all with d2 <= `within`; returns how many were marked.

    at, band  frames whose number is at most `band` from `at` are passed over (band -1: none)
    k         how many, 0 to MOST; they stand afterwards at AT_NEAR and IN_NEAR, in order, NEAR of them
    within    square of the radius; negative: nothing is marked for being near
    both      mark also the frames in whose own radius this one lies

    As the frame asked about is usually the newest, `at` is its number; else any.
    """
    books[NEAR] = 0
    books[QUERIES] += 1
    marked = 0
    if k > 0:
        marked = visit_successors(floats, books, at, band, k, within, both)
    looked = 0
    if books[PLAIN] > 0:
        books[PLAIN] -= 1
        marked += visit_all(floats, books, at, band, k, within, both)
    else:
        found, looked = visit_boxes(floats, books, at, band, k, within, both)
        marked += found
        if looked * LANES > MOST_SURVIVE * min(books[WINDOW], books[NEXT] - books[SINCE]):
            books[PLAIN] = PLAIN_FOR
    if k > 0:
        put_in_order(floats, books)
        for i in range(books[NEAR]):
            books[books[IN_WARM] + i] = books[books[IN_NEAR] + i]
        if books[NEAR]:
            books[WARM], books[WARM_AT] = books[NEAR], at
    return marked


@kernel
def nearest_limit(floats: Floats, books: Times, k: int) -> np.float32:
    """Only what is at most so far can be among the k nearest."""
    if books[NEAR] < k:
        return FARTHEST
    return floats[books[AT_NEAR]] if k > 0 else np.float32(-1.0)


@kernel
def visit_successors(
    floats: Floats, books: Times, at: int, band: int, k: int, within: np.float32, both: bool
) -> int:
    """Look into the tiles of the frames that came after the nearest of the query before."""
    first, last = oldest(books), books[NEXT]
    later = at - books[WARM_AT]
    marked = 0
    for i in range(books[WARM]):
        frame = books[books[IN_WARM] + i] + later
        if first <= frame < last:
            tile = slot_of(books, frame) // LANES
            if books[books[IN_SEEN] + tile] != books[QUERIES]:
                marked += visit_tile(floats, books, tile, at, band, k, within, both)
    return marked


@kernel
def visit_boxes(
    floats: Floats, books: Times, at: int, band: int, k: int, within: np.float32, both: bool
) -> tuple[int, int]:
    """Look into all tiles whose box, and whose group's box, is near enough; returns how many frames were marked, tiles seen."""
    top_sums, group_sums = books[AT_SCRATCH], books[AT_SCRATCH] + LANES
    stride = (1 + 2 * books[WIDTH]) * LANES
    marked, looked = 0, 0
    radius = farthest_reach(floats, books, within) if both else within
    for top in range(books[TOPS]):
        limit = max(nearest_limit(floats, books, k), radius)
        groups = box_distances(floats, books, books[AT_TOPS] + top * stride, limit, top_sums)
        while groups:
            lane = lowest(groups)
            groups &= groups - 1
            group = top * LANES + lane
            own = max(within, floats[books[AT_GROUP_REACH] + group]) if both else within
            limit = max(nearest_limit(floats, books, k), own)
            if floats[top_sums + lane] > limit:
                continue
            tiles = box_distances(floats, books, books[AT_GROUPS] + group * stride, limit, group_sums)
            while tiles:
                lane = lowest(tiles)
                tiles &= tiles - 1
                tile = group * LANES + lane
                if floats[group_sums + lane] > max(nearest_limit(floats, books, k), own):
                    continue
                looked += 1
                if books[books[IN_SEEN] + tile] != books[QUERIES]:
                    marked += visit_tile(floats, books, tile, at, band, k, within, both)
    return marked, looked


@kernel
def visit_all(floats: Floats, books: Times, at: int, band: int, k: int, within: np.float32, both: bool) -> int:
    """Look into every tile that holds a living frame, whatever its box."""
    stride = (1 + 2 * books[WIDTH]) * LANES
    marked = 0
    for group in range(books[GROUPS]):
        if floats[books[AT_TOPS] + group // LANES * stride + group % LANES] != 0.0:
            continue
        for tile in range(group * LANES, (group + 1) * LANES):
            alive = floats[books[AT_GROUPS] + group * stride + tile % LANES] == 0.0
            if alive and books[books[IN_SEEN] + tile] != books[QUERIES]:
                marked += visit_tile(floats, books, tile, at, band, k, within, both)
    return marked


@kernel
def farthest_reach(floats: Floats, books: Times, within: np.float32) -> np.float32:
    """The largest radius, squared, of this frame and all others."""
    for group in range(books[GROUPS]):
        within = max(within, floats[books[AT_GROUP_REACH] + group])
    return within


@kernel
def visit_tile(
    floats: Floats, books: Times, tile: int, at: int, band: int, k: int, within: np.float32, both: bool
) -> int:
    """Offer the frames of a tile; returns how many were marked."""
    books[books[IN_SEEN] + tile] = books[QUERIES]
    sums = books[AT_SCRATCH] + 2 * LANES
    radius = max(within, floats[books[AT_GROUP_REACH] + tile // LANES]) if both else within
    limit = max(nearest_limit(floats, books, k), radius)
    lanes = tile_distances(floats, books, tile_at(books, tile), limit, sums)
    marked = 0
    while lanes:
        lane = lowest(lanes)
        lanes &= lanes - 1
        slot = tile * LANES + lane
        frame = books[books[IN_FRAMES] + slot]
        if abs(frame - at) <= band:
            continue
        squared = floats[sums + lane]
        if k > 0:
            offer(floats, books, k, squared, frame)
        if squared <= within or (both and squared <= floats[books[AT_REACH] + slot]):
            place = frame % (books[BLOCKS] * books[BLOCK])
            floats[books[AT_SQUARED] + place] = squared
            books[books[IN_MARKS] + place // 64] |= 1 << (place % 64)
            marked += 1
    return marked


@kernel
def offer(floats: Floats, books: Times, k: int, squared: np.float32, frame: int) -> None:
    """Take a frame into the heap of the nearest, the farthest of which is at its top, if it is near enough."""
    near, frames, count = books[AT_NEAR], books[IN_NEAR], books[NEAR]
    if count == k:
        if before(floats[near], books[frames], squared, frame):
            return
        sink(floats, books, k, squared, frame)
        return
    i = count
    while i > 0:
        parent = (i - 1) // 2
        if not before(floats[near + parent], books[frames + parent], squared, frame):
            break
        floats[near + i], books[frames + i] = floats[near + parent], books[frames + parent]
        i = parent
    floats[near + i], books[frames + i] = squared, frame
    books[NEAR] = count + 1


@kernel
def before(squared: np.float32, frame: int, other_squared: np.float32, other_frame: int) -> bool:
    """Whether a frame comes before another: it is nearer, or as near and older."""
    return squared < other_squared or (squared == other_squared and frame < other_frame)


@kernel
def sink(floats: Floats, books: Times, count: int, squared: np.float32, frame: int) -> None:
    """Put an entry in place of the top of a heap of `count`, and let it sink to where it belongs."""
    near, frames = books[AT_NEAR], books[IN_NEAR]
    i = 0
    while 2 * i + 1 < count:
        child = 2 * i + 1
        if child + 1 < count and before(
            floats[near + child], books[frames + child], floats[near + child + 1], books[frames + child + 1]
        ):
            child += 1
        if not before(squared, frame, floats[near + child], books[frames + child]):
            break
        floats[near + i], books[frames + i] = floats[near + child], books[frames + child]
        i = child
    floats[near + i], books[frames + i] = squared, frame


@kernel
def put_in_order(floats: Floats, books: Times) -> None:
    """Turn the heap into a list, the nearest first."""
    near, frames = books[AT_NEAR], books[IN_NEAR]
    for last in range(books[NEAR] - 1, 0, -1):
        squared, frame = floats[near + last], books[frames + last]
        floats[near + last], books[frames + last] = floats[near], books[frames]
        sink(floats, books, last, squared, frame)


@kernel
def radius_squared(radius: float) -> np.float32:
    """The largest d2 whose root, rounded to float32, is at most the radius in float32: so d <= r holds for what is reported.

    Negative for no radius: NaN, or below 0.
    """
    if not radius >= 0.0:
        return np.float32(-1.0)
    if radius * radius >= FARTHEST:
        return FARTHEST
    r = np.float32(radius)
    squared = r * r
    while squared < FARTHEST and math.sqrt(np.nextafter(squared, FARTHEST)) <= r:
        squared = np.nextafter(squared, FARTHEST)
    while math.sqrt(squared) > r:
        squared = np.nextafter(squared, np.float32(-1.0))
    return squared
