"""The search: the k nearest and all within a radius, in one pass over tops, groups, tiles and lanes.

Order and ties. A frame is before another if its d2 (see distance.py) is smaller, or equal and its number is lower: the older one. The k
nearest are the first k; so the answer does not depend on the order in which tiles are visited, nor on what is sealed.

A small window is looked through from end to end (scan.py). In a large one the tiles that hold the successors of the nearest of the query
before are visited first: in motion those are about the nearest now, so that the bound is tight from the beginning. Where most tiles survive
all the same, as in noise, the next queries leave the boxes aside.
"""

from __future__ import annotations

import numpy as np

from operators.neighbours.candidates import NOTHING, gather, put_in_order
from operators.neighbours.distance import box_distances, four_distances, lanes_at_most, tile_distances
from operators.neighbours.lanes import lowest
from operators.neighbours.layout import (
    AT_GROUP_REACH,
    AT_GROUPS,
    AT_SCRATCH,
    AT_TOPS,
    AT_WARM,
    BLOCK,
    BLOCKS,
    FARTHEST,
    FOUND,
    GROUPS,
    IN_KEYS,
    IN_NEAR,
    IN_PLACES,
    IN_SEEN,
    IN_SUMS,
    IN_TABLE,
    IN_WARM,
    LANES,
    NEAR,
    NEXT,
    PLAIN,
    QUERIES,
    SCANNED,
    SINCE,
    TOPS,
    WARM,
    WARM_AT,
    WIDTH,
    WINDOW,
    Floats,
)
from operators.neighbours.scan import scan
from operators.neighbours.window import oldest, tile_at
from stream.chunk import Times
from stream.kernel import kernel

MOST_SURVIVE, PLAIN_FOR = 0.9, 15
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
    books[FOUND] = 0
    marked = visit(floats, books, at, band, k, within, both)
    put_in_order(floats, books, k)
    if books[NEAR]:
        warm, near = books[IN_WARM], books[IN_NEAR]
        for i in range(books[NEAR]):
            books[warm + i] = books[near + i]
        books[WARM], books[WARM_AT] = books[NEAR], at
    return marked


@kernel
def visit(floats: Floats, books: Times, at: int, band: int, k: int, within: np.float32, both: bool) -> int:
    """Gather the frames that are near enough; returns how many were marked."""
    if books[SCANNED]:
        return scan(floats, books, at, band, k, within, both)
    books[QUERIES] += 1
    limit, marked = NOTHING, 0
    if k > 0:
        limit, marked = visit_successors(floats, books, at, band, k, within, both)
    if books[PLAIN] > 0:
        books[PLAIN] -= 1
        return marked + visit_all(floats, books, limit, at, band, k, within, both)
    found, looked = visit_boxes(floats, books, limit, at, band, k, within, both)
    if looked * LANES > MOST_SURVIVE * min(books[WINDOW], books[NEXT] - books[SINCE]):
        books[PLAIN] = PLAIN_FOR
    return marked + found


@kernel
def visit_successors(
    floats: Floats, books: Times, at: int, band: int, k: int, within: np.float32, both: bool
) -> tuple[np.float32, int]:
    """Look into the tiles of the frames that came after the nearest of the query before; returns a limit for d2, and how many were marked.

    Where k such frames live, none of the k nearest is farther than the farthest of them.
    """
    first, last, later = oldest(books), books[NEXT], at - books[WARM_AT]
    bits = lowest(books[BLOCK])
    base, turns = first >> bits, books[BLOCKS]
    turn, mask = base % turns, books[BLOCK] - 1
    warm, seen, table, places, near = books[IN_WARM], books[IN_SEEN], books[IN_TABLE], books[IN_PLACES], books[IN_NEAR]
    known, query, sums, keys = books[IN_SUMS], books[QUERIES], books[AT_WARM], books[IN_KEYS]
    tiles, successors = 0, 0
    for i in range(books[WARM]):
        frame = books[warm + i] + later
        if not first <= frame < last or abs(frame - at) <= band:
            continue
        stands = turn + (frame >> bits) - base
        stands = books[table + (stands - turns if stands >= turns else stands)]
        slot = books[places + (stands << bits) + (frame & mask)]
        tile = slot >> 4
        if books[seen + tile] != query:
            books[seen + tile] = query
            books[known + tile] = sums + tiles * LANES
            books[near + tiles] = tile
            tiles += 1
        books[keys + successors] = books[known + tile] + (slot & 15)
        successors += 1
    sum_up(floats, books, near, tiles, sums)
    limit = FARTHEST
    if successors >= k:
        limit = np.float32(0.0)
        for i in range(successors):
            limit = max(limit, floats[books[keys + i]])
        limit = min(limit, FARTHEST)
    marked = 0
    for i in range(tiles):
        tile = books[near + i]
        radius = max(within, floats[books[AT_GROUP_REACH] + tile // LANES]) if both else within
        lanes = lanes_at_most(floats, books, max(limit, radius), sums)
        limit, found = gather(floats, books, limit, tile * LANES, lanes, sums, at, band, k, within, both)
        marked += found
        sums += LANES
    return limit, marked


@kernel
def sum_up(floats: Floats, books: Times, near: int, tiles: int, sums: int) -> None:
    """All sums of some tiles, whose numbers stand from place `near` on, at place `sums`; four at a time, the last ones once more."""
    for i in range(0, tiles, 4):
        a, b = books[near + i], books[near + min(i + 1, tiles - 1)]
        c, d = books[near + min(i + 2, tiles - 1)], books[near + min(i + 3, tiles - 1)]
        out = sums + i * LANES
        four_distances(floats, books, tile_at(books, a), tile_at(books, b), tile_at(books, c), tile_at(books, d), out)


@kernel
def visit_boxes(
    floats: Floats, books: Times, limit: np.float32, at: int, band: int, k: int, within: np.float32, both: bool
) -> tuple[int, int]:
    """Look into all tiles whose box, and whose group's box, is near enough; returns how many frames were marked, tiles seen."""
    top_sums, group_sums = books[AT_SCRATCH], books[AT_SCRATCH] + LANES
    stride = (1 + 2 * books[WIDTH]) * LANES
    marked, looked = 0, 0
    radius = farthest_reach(floats, books, within) if both else within
    for top in range(books[TOPS]):
        groups = box_distances(floats, books, books[AT_TOPS] + top * stride, max(limit, radius), top_sums)
        while groups:
            lane = lowest(groups)
            groups &= groups - 1
            group = top * LANES + lane
            own = max(within, floats[books[AT_GROUP_REACH] + group]) if both else within
            if floats[top_sums + lane] > max(limit, own):
                continue
            tiles = box_distances(floats, books, books[AT_GROUPS] + group * stride, max(limit, own), group_sums)
            while tiles:
                lane = lowest(tiles)
                tiles &= tiles - 1
                tile = group * LANES + lane
                if floats[group_sums + lane] > max(limit, own):
                    continue
                looked += 1
                if books[books[IN_SEEN] + tile] != books[QUERIES]:
                    limit, found = visit_tile(floats, books, limit, tile, at, band, k, within, both)
                    marked += found
    return marked, looked


@kernel
def visit_all(
    floats: Floats, books: Times, limit: np.float32, at: int, band: int, k: int, within: np.float32, both: bool
) -> int:
    """Look into every tile that holds a living frame, whatever its box."""
    stride = (1 + 2 * books[WIDTH]) * LANES
    marked = 0
    for group in range(books[GROUPS]):
        if floats[books[AT_TOPS] + group // LANES * stride + group % LANES] != 0.0:
            continue
        for tile in range(group * LANES, (group + 1) * LANES):
            alive = floats[books[AT_GROUPS] + group * stride + tile % LANES] == 0.0
            if alive and books[books[IN_SEEN] + tile] != books[QUERIES]:
                limit, found = visit_tile(floats, books, limit, tile, at, band, k, within, both)
                marked += found
    return marked


@kernel
def farthest_reach(floats: Floats, books: Times, within: np.float32) -> np.float32:
    """The largest radius, squared, of this frame and all others."""
    for group in range(books[GROUPS]):
        within = max(within, floats[books[AT_GROUP_REACH] + group])
    return within


@kernel
def visit_tile(
    floats: Floats,
    books: Times,
    limit: np.float32,
    tile: int,
    at: int,
    band: int,
    k: int,
    within: np.float32,
    both: bool,
) -> tuple[np.float32, int]:
    """Gather the frames of a tile that are near enough; returns the limit that holds from now on, and how many were marked."""
    sums = books[AT_SCRATCH] + 2 * LANES
    radius = max(within, floats[books[AT_GROUP_REACH] + tile // LANES]) if both else within
    lanes = tile_distances(floats, books, tile_at(books, tile), max(limit, radius), sums)
    if lanes == 0:
        return limit, 0
    return gather(floats, books, limit, tile * LANES, lanes, sums, at, band, k, within, both)
