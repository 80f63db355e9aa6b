"""Squared distances to the 16 lanes of a tile, or to 16 boxes, on two paths that give the same bits: vectors, and plain loops.

The rule for every distance: with x, q and w in float32, d2 = 0 + (w1 (x1 - q1)) (x1 - q1) + (w2 (x2 - q2)) (x2 - q2) + ..., each
operation rounded to float32, in the order of the features. The distance to a box is summed in the same order from how far q lies outside of
it. As rounding never changes the order of two numbers, no frame's d2 is below that of a box that holds it: boxes prune without any
allowance, and the answer is that of a plain loop over all frames.
"""

from __future__ import annotations

import numpy as np

from kinegraph.operators.neighbours.layout import FARTHEST, LANES, BareIndex, Floats
from kinegraph.operators.neighbours.vectors import add_square, add_weighted, at_most, load, outside, store
from kinegraph.stream.kernel import kernel

AT_ONCE = 8
"""After this many features it is asked whether any lane can still qualify."""


@kernel
def tile_distances(ix: BareIndex, tile: int, limit: np.float32, out: int) -> int:
    """The lanes of the tile at place `tile` that are within d2 <= `limit`, as bits, and the 16 sums at place `out`, if there are any."""
    if ix.vector:
        return tile_by_vectors(ix, tile, limit, out)
    return tile_by_loops(ix, tile, limit, out)


@kernel
def box_distances(ix: BareIndex, boxes: int, limit: np.float32, out: int) -> int:
    """As `tile_distances`, of 16 boxes."""
    if ix.vector:
        return boxes_by_vectors(ix, boxes, limit, out)
    return boxes_by_loops(ix, boxes, limit, out)


@kernel
def tile_by_vectors(ix: BareIndex, tile: int, limit: np.float32, out: int) -> int:
    width, query, weights, weighted = ix.width, ix.query, ix.weights, ix.weighted
    total = load(ix.floats, tile)
    row = tile + LANES
    done = 0
    while done < width:
        stop = min(done + AT_ONCE, width)
        if weighted:
            for i in range(done, stop):
                total = add_weighted(total, load(ix.floats, row), query[i], weights[i])
                row += LANES
        else:
            for i in range(done, stop):
                total = add_square(total, load(ix.floats, row), query[i])
                row += LANES
        if at_most(total, limit) == 0:
            return 0
        done = stop
    store(ix.floats, out, total)
    found: int = at_most(total, limit)
    return found


@kernel
def four_distances(ix: BareIndex, first: int, second: int, third: int, fourth: int, out: int) -> None:
    """All sums of four tiles, at place `out`; infinite where no frame lives. With vectors side by side: no sum waits for another's."""
    if not ix.vector:
        for i, tile in enumerate((first, second, third, fourth)):
            tile_by_loops(ix, tile, FARTHEST, out + i * LANES)
        return
    width, query, weights = ix.width, ix.query, ix.weights
    a, b, c, d = load(ix.floats, first), load(ix.floats, second), load(ix.floats, third), load(ix.floats, fourth)
    if ix.weighted:
        for i in range(width):
            q, w, row = query[i], weights[i], (1 + i) * LANES
            a = add_weighted(a, load(ix.floats, first + row), q, w)
            b = add_weighted(b, load(ix.floats, second + row), q, w)
            c = add_weighted(c, load(ix.floats, third + row), q, w)
            d = add_weighted(d, load(ix.floats, fourth + row), q, w)
    else:
        for i in range(width):
            q, row = query[i], (1 + i) * LANES
            a = add_square(a, load(ix.floats, first + row), q)
            b = add_square(b, load(ix.floats, second + row), q)
            c = add_square(c, load(ix.floats, third + row), q)
            d = add_square(d, load(ix.floats, fourth + row), q)
    store(ix.floats, out, a)
    store(ix.floats, out + LANES, b)
    store(ix.floats, out + 2 * LANES, c)
    store(ix.floats, out + 3 * LANES, d)


@kernel
def four_at_most(ix: BareIndex, limit: np.float32, at: int) -> int:
    """Of the 64 sums at place `at`, those that are at most `limit`, as bits."""
    if ix.vector:
        low = at_most(load(ix.floats, at), limit) | at_most(load(ix.floats, at + LANES), limit) << LANES
        high = (
            at_most(load(ix.floats, at + 2 * LANES), limit) | at_most(load(ix.floats, at + 3 * LANES), limit) << LANES
        )
        return int(low | high << 2 * LANES)
    found = 0
    for i in range(4):
        found |= bits_at_most(ix.floats, limit, at + i * LANES) << (i * LANES)
    return found


@kernel
def boxes_by_vectors(ix: BareIndex, boxes: int, limit: np.float32, out: int) -> int:
    width, query, weights, weighted = ix.width, ix.query, ix.weights, ix.weighted
    total = load(ix.floats, boxes)
    zero = np.float32(0.0)
    row = boxes + LANES
    done = 0
    while done < width:
        stop = min(done + AT_ONCE, width)
        for i in range(done, stop):
            off = outside(load(ix.floats, row), load(ix.floats, row + LANES), query[i])
            total = add_weighted(total, off, zero, weights[i]) if weighted else add_square(total, off, zero)
            row += 2 * LANES
        if at_most(total, limit) == 0:
            return 0
        done = stop
    store(ix.floats, out, total)
    found: int = at_most(total, limit)
    return found


@kernel
def tile_by_loops(ix: BareIndex, tile: int, limit: np.float32, out: int) -> int:
    width, query, weights = ix.width, ix.query, ix.weights
    for lane in range(LANES):
        ix.floats[out + lane] = ix.floats[tile + lane]
    found = 0
    for i in range(width):
        for lane in range(LANES):
            off = ix.floats[tile + (1 + i) * LANES + lane] - query[i]
            ix.floats[out + lane] += (weights[i] * off) * off
        if i % AT_ONCE == AT_ONCE - 1 or i == width - 1:
            found = bits_at_most(ix.floats, limit, out)
            if found == 0:
                return 0
    return found


@kernel
def boxes_by_loops(ix: BareIndex, boxes: int, limit: np.float32, out: int) -> int:
    width, query, weights = ix.width, ix.query, ix.weights
    for lane in range(LANES):
        ix.floats[out + lane] = ix.floats[boxes + lane]
    found = 0
    for i in range(width):
        q, w = query[i], weights[i]
        for lane in range(LANES):
            low = ix.floats[boxes + (1 + 2 * i) * LANES + lane] - q
            high = q - ix.floats[boxes + (2 + 2 * i) * LANES + lane]
            off = max(max(low, high), np.float32(0.0))
            ix.floats[out + lane] += (w * off) * off
        if i % AT_ONCE == AT_ONCE - 1 or i == width - 1:
            found = bits_at_most(ix.floats, limit, out)
            if found == 0:
                return 0
    return found


@kernel
def lanes_at_most(ix: BareIndex, limit: np.float32, at: int) -> int:
    """The lanes of the 16 sums at place `at` that hold at most `limit`, as bits."""
    if ix.vector:
        found: int = at_most(load(ix.floats, at), limit)
        return found
    return bits_at_most(ix.floats, limit, at)


@kernel
def bits_at_most(floats: Floats, limit: np.float32, at: int) -> int:
    """`lanes_at_most` by a plain loop."""
    found = 0
    for lane in range(LANES):
        if floats[at + lane] <= limit:
            found |= 1 << lane
    return found
