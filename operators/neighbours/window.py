"""The window: a frame comes in, the oldest goes, and the boxes over tiles and groups follow."""

from __future__ import annotations

import math

import numpy as np

from operators.neighbours.layout import (
    AT_GROUP_REACH,
    AT_GROUPS,
    AT_QUERY,
    AT_REACH,
    AT_TILES,
    AT_TOPS,
    BLOCK,
    BLOCKS,
    GROUP,
    IN_ALIVE,
    IN_FRAMES,
    IN_GROUP_ALIVE,
    IN_PLACES,
    IN_TABLE,
    LANES,
    LARGEST,
    NEXT,
    PACE,
    SINCE,
    WIDTH,
    WINDOW,
    Floats,
)
from operators.neighbours.seal import begin_sealing, seal_step
from stream.chunk import Samples, Times
from stream.kernel import kernel


@kernel
def oldest(books: Times) -> int:
    """The number of the oldest frame in the window (of the next one, if it is empty)."""
    return int(max(books[SINCE], books[NEXT] - books[WINDOW]))


@kernel
def slot_of(books: Times, frame: int) -> int:
    """Where a frame of the window is kept."""
    block = books[BLOCK]
    stands = books[books[IN_TABLE] + frame // block % books[BLOCKS]]
    return int(books[books[IN_PLACES] + stands * block + frame % block])


@kernel
def tile_at(books: Times, tile: int) -> int:
    """The place of a tile in `floats`."""
    return int(books[AT_TILES] + tile * (1 + books[WIDTH]) * LANES)


@kernel
def prepare(floats: Floats, books: Times, x: Samples) -> bool:
    """Take `x` (width,) as the frame in question, in float32; False where a value is not finite (or beyond LARGEST)."""
    query = books[AT_QUERY]
    good = True
    for i in range(x.shape[0]):
        good = good and abs(x[i]) <= LARGEST
        floats[query + i] = x[i]
    return good


@kernel
def recall(floats: Floats, books: Times) -> bool:
    """Take the newest frame as the frame in question; False where there is none, or where it is bad."""
    newest = books[NEXT] - 1
    if newest < books[SINCE]:
        return False
    slot = slot_of(books, newest)
    row = tile_at(books, slot // LANES) + slot % LANES
    for i in range(books[WIDTH]):
        floats[books[AT_QUERY] + i] = floats[row + (1 + i) * LANES]
    return bool(floats[row] == 0.0)


@kernel
def insert(floats: Floats, books: Times, good: bool, reach: np.float32) -> None:
    """The frame that was prepared enters, the oldest leaves if the window was full, and a step of sealing is done.

    reach   square of the frame's own radius; NO_REACH: it has none
    A frame that is not `good` takes its turn, and is nobody's neighbour.
    """
    frame = books[NEXT]
    if frame - books[SINCE] >= books[WINDOW]:
        forget(floats, books, frame - books[WINDOW])
    block = books[BLOCK]
    stands = books[books[IN_TABLE] + frame // block % books[BLOCKS]]
    slot = stands * block + frame % block
    books[books[IN_PLACES] + slot] = slot
    books[books[IN_FRAMES] + slot] = frame
    books[NEXT] = frame + 1
    if good:
        settle(floats, books, slot, reach)
    if books[PACE]:
        for _ in range(books[PACE]):
            seal_step(floats, books)
        if (frame + 1) % block == 0:
            begin_sealing(floats, books, stands)


@kernel
def settle(floats: Floats, books: Times, slot: int, reach: np.float32) -> None:
    """Put the frame in question into a slot, and widen (or begin) the boxes of its tile and group."""
    width, query = books[WIDTH], books[AT_QUERY]
    tile, lane = slot // LANES, slot % LANES
    group = tile // LANES
    row = tile_at(books, tile) + lane
    floats[row] = 0.0
    for i in range(width):
        floats[row + (1 + i) * LANES] = floats[query + i]
    alive, group_alive = books[IN_ALIVE] + tile, books[IN_GROUP_ALIVE] + group
    stride = (1 + 2 * width) * LANES
    widen(floats, books, books[AT_GROUPS] + group * stride + tile % LANES, books[alive] == 0)
    widen(floats, books, books[AT_TOPS] + group // LANES * stride + group % LANES, books[group_alive] == 0)
    floats[books[AT_REACH] + slot] = reach
    farthest = books[AT_GROUP_REACH] + group
    floats[farthest] = reach if books[group_alive] == 0 else max(reach, floats[farthest])
    books[alive] += 1
    books[group_alive] += 1


@kernel
def widen(floats: Floats, books: Times, box: int, first: bool) -> None:
    """Make the box at place `box` (a lane of 16) hold the frame in question."""
    width, query = books[WIDTH], books[AT_QUERY]
    if first:
        floats[box] = 0.0
        for i in range(width):
            floats[box + (1 + 2 * i) * LANES] = floats[query + i]
            floats[box + (2 + 2 * i) * LANES] = floats[query + i]
        return
    for i in range(width):
        low, high = box + (1 + 2 * i) * LANES, box + (2 + 2 * i) * LANES
        floats[low] = min(floats[low], floats[query + i])
        floats[high] = max(floats[high], floats[query + i])


@kernel
def forget(floats: Floats, books: Times, frame: int) -> None:
    """A frame leaves: its lane becomes infinite, and so do those of its tile and group with their last frame."""
    slot = slot_of(books, frame)
    tile, lane = slot // LANES, slot % LANES
    row = tile_at(books, tile) + lane
    if floats[row] == math.inf:
        return
    floats[row] = math.inf
    group = slot // GROUP
    alive, group_alive = books[IN_ALIVE] + tile, books[IN_GROUP_ALIVE] + group
    stride = (1 + 2 * books[WIDTH]) * LANES
    books[alive] -= 1
    if books[alive] == 0:
        floats[books[AT_GROUPS] + group * stride + tile % LANES] = math.inf
    books[group_alive] -= 1
    if books[group_alive] == 0:
        floats[books[AT_TOPS] + group // LANES * stride + group % LANES] = math.inf
