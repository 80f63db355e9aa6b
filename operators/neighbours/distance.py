"""Squared distances to the 16 lanes of a tile, or to 16 boxes, on two paths that give the same bits: vectors, and plain loops.

The rule for every distance: with x, q and w in float32, d2 = 0 + (w1 (x1 - q1)) (x1 - q1) + (w2 (x2 - q2)) (x2 - q2) + ..., each
operation rounded to float32, in the order of the features. The distance to a box is summed in the same order from how far q lies outside of
it. As rounding never changes the order of two numbers, no frame's d2 is below that of a box that holds it: boxes prune without any
allowance, and the answer is that of a plain loop over all frames.
"""

from __future__ import annotations

import numpy as np

from operators.neighbours.lanes import add_square, add_weighted, at_most, load, outside, store
from operators.neighbours.layout import AT_QUERY, AT_WEIGHTS, FARTHEST, LANES, VECTOR, WEIGHTED, WIDTH, Floats
from stream.chunk import Times
from stream.kernel import kernel

AT_ONCE = 8
"""After so many features it is asked whether any lane can still qualify."""


@kernel
def tile_distances(floats: Floats, books: Times, tile: int, limit: np.float32, out: int) -> int:
    """The lanes of the tile at place `tile` that are within d2 <= `limit`, as bits, and the 16 sums at place `out`, if there are any."""
    if books[VECTOR]:
        return tile_by_vectors(floats, books, tile, limit, out)
    return tile_by_loops(floats, books, tile, limit, out)


@kernel
def box_distances(floats: Floats, books: Times, boxes: int, limit: np.float32, out: int) -> int:
    """As `tile_distances`, of 16 boxes."""
    if books[VECTOR]:
        return boxes_by_vectors(floats, books, boxes, limit, out)
    return boxes_by_loops(floats, books, boxes, limit, out)


@kernel
def tile_by_vectors(floats: Floats, books: Times, tile: int, limit: np.float32, out: int) -> int:
    width, query, weights, weighted = books[WIDTH], books[AT_QUERY], books[AT_WEIGHTS], books[WEIGHTED]
    total = load(floats, tile)
    row = tile + LANES
    done = 0
    while done < width:
        stop = min(done + AT_ONCE, width)
        if weighted:
            for i in range(done, stop):
                total = add_weighted(total, load(floats, row), floats[query + i], floats[weights + i])
                row += LANES
        else:
            for i in range(done, stop):
                total = add_square(total, load(floats, row), floats[query + i])
                row += LANES
        if at_most(total, limit) == 0:
            return 0
        done = stop
    store(floats, out, total)
    found: int = at_most(total, limit)
    return found


@kernel
def four_distances(floats: Floats, books: Times, first: int, second: int, third: int, fourth: int, out: int) -> None:
    """All sums of four tiles, at place `out`; infinite where no frame lives. With vectors side by side: no sum waits for another's."""
    if not books[VECTOR]:
        for i, tile in enumerate((first, second, third, fourth)):
            tile_by_loops(floats, books, tile, FARTHEST, out + i * LANES)
        return
    width, query, weights = books[WIDTH], books[AT_QUERY], books[AT_WEIGHTS]
    a, b, c, d = load(floats, first), load(floats, second), load(floats, third), load(floats, fourth)
    if books[WEIGHTED]:
        for i in range(width):
            q, w, row = floats[query + i], floats[weights + i], (1 + i) * LANES
            a = add_weighted(a, load(floats, first + row), q, w)
            b = add_weighted(b, load(floats, second + row), q, w)
            c = add_weighted(c, load(floats, third + row), q, w)
            d = add_weighted(d, load(floats, fourth + row), q, w)
    else:
        for i in range(width):
            q, row = floats[query + i], (1 + i) * LANES
            a = add_square(a, load(floats, first + row), q)
            b = add_square(b, load(floats, second + row), q)
            c = add_square(c, load(floats, third + row), q)
            d = add_square(d, load(floats, fourth + row), q)
    store(floats, out, a)
    store(floats, out + LANES, b)
    store(floats, out + 2 * LANES, c)
    store(floats, out + 3 * LANES, d)


@kernel
def four_at_most(floats: Floats, books: Times, limit: np.float32, at: int) -> int:
    """Of the 64 sums at place `at`, those that are at most `limit`, as bits."""
    if books[VECTOR]:
        low = at_most(load(floats, at), limit) | at_most(load(floats, at + LANES), limit) << LANES
        high = at_most(load(floats, at + 2 * LANES), limit) | at_most(load(floats, at + 3 * LANES), limit) << LANES
        return int(low | high << 2 * LANES)
    found = 0
    for i in range(4):
        found |= bits_at_most(floats, limit, at + i * LANES) << (i * LANES)
    return found


@kernel
def boxes_by_vectors(floats: Floats, books: Times, boxes: int, limit: np.float32, out: int) -> int:
    width, query, weights, weighted = books[WIDTH], books[AT_QUERY], books[AT_WEIGHTS], books[WEIGHTED]
    total = load(floats, boxes)
    zero = np.float32(0.0)
    row = boxes + LANES
    done = 0
    while done < width:
        stop = min(done + AT_ONCE, width)
        for i in range(done, stop):
            off = outside(load(floats, row), load(floats, row + LANES), floats[query + i])
            total = add_weighted(total, off, zero, floats[weights + i]) if weighted else add_square(total, off, zero)
            row += 2 * LANES
        if at_most(total, limit) == 0:
            return 0
        done = stop
    store(floats, out, total)
    found: int = at_most(total, limit)
    return found


@kernel
def tile_by_loops(floats: Floats, books: Times, tile: int, limit: np.float32, out: int) -> int:
    width, query, weights = books[WIDTH], books[AT_QUERY], books[AT_WEIGHTS]
    for lane in range(LANES):
        floats[out + lane] = floats[tile + lane]
    found = 0
    for i in range(width):
        for lane in range(LANES):
            off = floats[tile + (1 + i) * LANES + lane] - floats[query + i]
            floats[out + lane] += (floats[weights + i] * off) * off
        if i % AT_ONCE == AT_ONCE - 1 or i == width - 1:
            found = bits_at_most(floats, limit, out)
            if found == 0:
                return 0
    return found


@kernel
def boxes_by_loops(floats: Floats, books: Times, boxes: int, limit: np.float32, out: int) -> int:
    width, query, weights = books[WIDTH], books[AT_QUERY], books[AT_WEIGHTS]
    for lane in range(LANES):
        floats[out + lane] = floats[boxes + lane]
    found = 0
    for i in range(width):
        q, w = floats[query + i], floats[weights + i]
        for lane in range(LANES):
            low = floats[boxes + (1 + 2 * i) * LANES + lane] - q
            high = q - floats[boxes + (2 + 2 * i) * LANES + lane]
            off = max(max(low, high), np.float32(0.0))
            floats[out + lane] += (w * off) * off
        if i % AT_ONCE == AT_ONCE - 1 or i == width - 1:
            found = bits_at_most(floats, limit, out)
            if found == 0:
                return 0
    return found


@kernel
def lanes_at_most(floats: Floats, books: Times, limit: np.float32, at: int) -> int:
    """The lanes of the 16 sums at place `at` that hold at most `limit`, as bits."""
    if books[VECTOR]:
        found: int = at_most(load(floats, at), limit)
        return found
    return bits_at_most(floats, limit, at)


@kernel
def bits_at_most(floats: Floats, limit: np.float32, at: int) -> int:
    """`lanes_at_most` by a plain loop."""
    found = 0
    for lane in range(LANES):
        if floats[at + lane] <= limit:
            found |= 1 << lane
    return found
