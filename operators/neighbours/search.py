"""The search: the k nearest and all within a radius, in one pass over tops, groups, tiles and lanes.

Order and ties. A frame is before another if its d2 (see distance.py) is smaller, or equal and its number is lower: the older one. The k
nearest are the first k; so the answer does not depend on the order in which tiles are visited, nor on what is sealed.

A small window is looked through from end to end (scan.py). In a large one the tiles that hold the successors of the nearest of the query
before are visited first: in motion those are about the nearest now, so that the bound is tight from the beginning. Where most tiles survive
all the same, as in noise, the next queries leave the boxes aside.
"""

from __future__ import annotations

import numpy as np

from kinegraph.operators.neighbours.candidates import NOTHING, gather, put_in_order
from kinegraph.operators.neighbours.distance import box_distances, four_distances, lanes_at_most, tile_distances
from kinegraph.operators.neighbours.layout import FARTHEST, LANES, BareIndex
from kinegraph.operators.neighbours.scan import scan
from kinegraph.operators.neighbours.vectors import lowest
from kinegraph.operators.neighbours.window import oldest, tile_at
from kinegraph.stream.chunk import Times
from kinegraph.stream.kernel import kernel

MOST_SURVIVE, PLAIN_FOR = 0.9, 15
"""Beyond this share of tiles that were looked into, this many queries leave the boxes aside."""


@kernel
def search(ix: BareIndex, at: int, band: int, k: int, within: np.float32, both: bool) -> int:
    """Find the k nearest of the frame that was prepared, and mark all with d2 <= `within`; returns how many were marked.

    at, band  frames numbered at most `band` from `at` are skipped (band -1: skip nothing)
    k         how many, 0 to MOST; they stand afterwards at AT_NEAR and IN_NEAR, in order, NEAR of them
    within    square of the radius; negative: nothing is marked for being near
    both      mark also the frames that have this one in their own radius

    As the frame asked about is usually the newest, `at` is its number; else any.
    """
    ix.found = 0
    marked = visit(ix, at, band, k, within, both)
    put_in_order(ix, k)
    if ix.near_count:
        warm, near = ix.warm, ix.near
        # the next query is mostly the next frame: what follows these nearest is near to it, and gives a tight limit at once
        for i in range(ix.near_count):
            warm[i] = near[i]
        ix.warm_count, ix.warm_frame = ix.near_count, at
    return marked


@kernel
def visit(ix: BareIndex, at: int, band: int, k: int, within: np.float32, both: bool) -> int:
    """Gather the frames that are near enough; returns how many were marked."""
    if ix.scanned:
        return scan(ix, at, band, k, within, both)
    ix.queries += 1
    limit, marked = NOTHING, 0
    if k > 0:
        limit, marked = visit_successors(ix, at, band, k, within, both)
    if ix.plain > 0:
        ix.plain -= 1
        return marked + visit_all(ix, limit, at, band, k, within, both)
    found, looked = visit_boxes(ix, limit, at, band, k, within, both)
    # the boxes exclude hardly anything in such data: comparing them is work for nothing, for a while
    if looked * LANES > MOST_SURVIVE * min(ix.window, ix.next - ix.since):
        ix.plain = PLAIN_FOR
    return marked + found


@kernel
def visit_successors(
    ix: BareIndex, at: int, band: int, k: int, within: np.float32, both: bool
) -> tuple[np.float32, int]:
    """Look into the tiles of the frames that came after the nearest of the query before; returns a limit for d2, and how many were marked.

    Where k such frames live, the k nearest are at most as far as the farthest of them.
    """
    first, last, later = oldest(ix), ix.next, at - ix.warm_frame
    bits = lowest(ix.block)
    base, turns = first >> bits, ix.blocks
    turn, mask = base % turns, ix.block - 1
    warm, seen, table, places, near = ix.warm, ix.seen, ix.table, ix.places, ix.near
    known, query, sums, keys = ix.sums, ix.queries, ix.warm_sums_at, ix.keys
    tiles, successors = 0, 0
    for i in range(ix.warm_count):
        frame = warm[i] + later
        if not first <= frame < last or abs(frame - at) <= band:
            continue
        stands = turn + (frame >> bits) - base
        stands = table[stands - turns if stands >= turns else stands]
        slot = places[(stands << bits) + (frame & mask)]
        tile = slot >> 4
        # several successors often lie in one tile, which is summed up once
        if seen[tile] != query:
            seen[tile] = query
            known[tile] = sums + tiles * LANES
            near[tiles] = tile
            tiles += 1
        keys[successors] = known[tile] + (slot & 15)
        successors += 1
    sum_up(ix, near, tiles, sums)
    limit = FARTHEST
    if successors >= k:
        limit = np.float32(0.0)
        for i in range(successors):
            limit = max(limit, ix.floats[keys[i]])
        limit = min(limit, FARTHEST)
    marked = 0
    for i in range(tiles):
        tile = near[i]
        radius = max(within, ix.group_reach[tile // LANES]) if both else within
        lanes = lanes_at_most(ix, max(limit, radius), sums)
        limit, found = gather(ix, limit, tile * LANES, lanes, sums, at, band, k, within, both)
        marked += found
        sums += LANES
    return limit, marked


@kernel
def sum_up(ix: BareIndex, near: Times, tiles: int, sums: int) -> None:
    """Writes all sums of the tiles numbered by the start of `near` at place `sums`; four at a time, the last ones once more."""
    # four at a time keep the processor's adders busy; the last tile is repeated instead of a loop of its own
    for i in range(0, tiles, 4):
        a, b = near[i], near[min(i + 1, tiles - 1)]
        c, d = near[min(i + 2, tiles - 1)], near[min(i + 3, tiles - 1)]
        out = sums + i * LANES
        four_distances(ix, tile_at(ix, a), tile_at(ix, b), tile_at(ix, c), tile_at(ix, d), out)


@kernel
def visit_boxes(
    ix: BareIndex, limit: np.float32, at: int, band: int, k: int, within: np.float32, both: bool
) -> tuple[int, int]:
    """Search all tiles with a box, and a group's box, near enough; returns how many frames were marked, tiles seen."""
    top_sums, group_sums = ix.scratch_at, ix.scratch_at + LANES
    stride = (1 + 2 * ix.width) * LANES
    marked, looked = 0, 0
    radius = farthest_reach(ix, within) if both else within
    for top in range(ix.tops):
        groups = box_distances(ix, ix.top_boxes_at + top * stride, max(limit, radius), top_sums)
        while groups:
            lane = lowest(groups)
            groups &= groups - 1
            group = top * LANES + lane
            own = max(within, ix.group_reach[group]) if both else within
            # the limit has shrunk since the boxes were compared: look again before going in
            if ix.floats[top_sums + lane] > max(limit, own):
                continue
            tiles = box_distances(ix, ix.group_boxes_at + group * stride, max(limit, own), group_sums)
            while tiles:
                lane = lowest(tiles)
                tiles &= tiles - 1
                tile = group * LANES + lane
                if ix.floats[group_sums + lane] > max(limit, own):
                    continue
                looked += 1
                if ix.seen[tile] != ix.queries:
                    limit, found = visit_tile(ix, limit, tile, at, band, k, within, both)
                    marked += found
    return marked, looked


@kernel
def visit_all(ix: BareIndex, limit: np.float32, at: int, band: int, k: int, within: np.float32, both: bool) -> int:
    """Look into every tile that holds a living frame, whatever its box."""
    stride = (1 + 2 * ix.width) * LANES
    marked = 0
    for group in range(ix.groups):
        if ix.top_boxes[group // LANES * stride + group % LANES] != 0.0:
            continue
        for tile in range(group * LANES, (group + 1) * LANES):
            alive = ix.group_boxes[group * stride + tile % LANES] == 0.0
            if alive and ix.seen[tile] != ix.queries:
                limit, found = visit_tile(ix, limit, tile, at, band, k, within, both)
                marked += found
    return marked


@kernel
def farthest_reach(ix: BareIndex, within: np.float32) -> np.float32:
    """The largest radius, squared, of this frame and all others."""
    for group in range(ix.groups):
        within = max(within, ix.group_reach[group])
    return within


@kernel
def visit_tile(
    ix: BareIndex,
    limit: np.float32,
    tile: int,
    at: int,
    band: int,
    k: int,
    within: np.float32,
    both: bool,
) -> tuple[np.float32, int]:
    """Gather the frames of a tile that are near enough; returns the limit that holds from now on, and how many were marked."""
    sums = ix.scratch_at + 2 * LANES
    radius = max(within, ix.group_reach[tile // LANES]) if both else within
    lanes = tile_distances(ix, tile_at(ix, tile), max(limit, radius), sums)
    if lanes == 0:
        return limit, 0
    return gather(ix, limit, tile * LANES, lanes, sums, at, band, k, within, both)
