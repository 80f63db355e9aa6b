"""Where everything stands in the two flat arrays that an index is: `floats` (float32) and `books` (int64).

Kernels take these two arrays and nothing else, as every array in a call costs time, and as a snapshot is then a copy of both. Within
kernels they are bare (see lanes.py): only those that Python calls, in follow.py, know them as arrays. `books` begins with the numbers named
here; those that begin with AT_ are places in `floats`, those with IN_ places in `books`.

A frame lives in a slot: lane `slot % 16` of tile `slot // 16`. Tiles hold one row of 16 lanes per feature, behind a row that is 0 in lanes
that hold a living frame and infinite in all others; a distance is summed up from there. 16 tiles are a group, 16 groups a top; a box over
each tile stands in its group, a box over each group in its top, again 16 lanes wide: the row of 0 or infinity, then lowest and highest of
each feature. Slots belong to blocks: 1024 frames where full blocks are sealed, else one group.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stream.chunk import Times

Floats: TypeAlias = NDArray[np.float32]

LANES = 16
FOUR = 4 * LANES
GROUP = LANES * LANES
SEALED_BLOCK = 1024
SEAL_FROM = 8192
"""Windows of at least so many frames have their full blocks sealed; in shorter ones it does not pay."""
SCAN_UP_TO = 20_000
"""Windows of at most so many numbers (frames times 1 + width) are looked through from end to end: measured, sooner than by boxes."""
COUNTED = 96
"""Up to so many candidates are put in order by counting, for each, those that are nearer: no branches, so faster than a sort."""

LARGEST = 1e18
"""Features beyond this size (either sign) are not finite for us: sums of squares then stay in float32's range, or overflow to infinity."""

NO_REACH = -1.0

FARTHEST = np.float32(np.finfo(np.float32).max)
"""No limit: everything but infinity, which is what lanes without a living frame hold."""

NAMES = [
    "WIDTH", "WINDOW", "MOST", "BLOCK", "BLOCKS", "SLOTS", "GROUPS", "TOPS", "VECTOR", "WEIGHTED", "SCANNED", "ROOM",
    "AT_WEIGHTS", "AT_QUERY", "AT_SCRATCH", "AT_KEYS", "AT_NEAR", "AT_WARM", "AT_SQUARED", "AT_REACH",
    "AT_GROUP_REACH", "AT_TILES", "AT_GROUPS", "AT_TOPS",
    "IN_FRAMES", "IN_PLACES", "IN_ALIVE", "IN_GROUP_ALIVE", "IN_TABLE", "IN_ORDER", "IN_SORTED", "IN_NEAR", "IN_RANKS",
    "IN_KEYS", "IN_WARM", "IN_SUMS", "IN_SEEN", "IN_MARKS",
    "NEXT", "SINCE", "NEAR", "FOUND", "WARM", "WARM_AT", "QUERIES", "PLAIN", "SPARE", "SEAL", "STAGE",
    "SIZE", "FROM", "PART", "AXIS", "PACE",
]  # fmt: skip
(
    WIDTH, WINDOW, MOST, BLOCK, BLOCKS, SLOTS, GROUPS, TOPS, VECTOR, WEIGHTED, SCANNED, ROOM,
    AT_WEIGHTS, AT_QUERY, AT_SCRATCH, AT_KEYS, AT_NEAR, AT_WARM, AT_SQUARED, AT_REACH, AT_GROUP_REACH, AT_TILES, AT_GROUPS, AT_TOPS,
    IN_FRAMES, IN_PLACES, IN_ALIVE, IN_GROUP_ALIVE, IN_TABLE, IN_ORDER, IN_SORTED,
    IN_NEAR, IN_RANKS, IN_KEYS, IN_WARM, IN_SUMS, IN_SEEN, IN_MARKS,
    NEXT, SINCE, NEAR, FOUND, WARM, WARM_AT, QUERIES, PLAIN, SPARE, SEAL, STAGE, SIZE, FROM, PART, AXIS, PACE,
) = range(len(NAMES))  # fmt: skip
"""
WIDTH, WINDOW, MOST      features, frames in the window, the largest k
BLOCK, BLOCKS            frames in a block, and how many blocks take turns (a sealed index has one more, the spare)
SLOTS, GROUPS, TOPS      how many there are
VECTOR, WEIGHTED         whether the vector path is used; whether any weight differs from 1
SCANNED, ROOM            whether queries look through the whole window (scan.py); how many candidates there is room for
AT_WEIGHTS, AT_QUERY     (width,)         the weights; the frame that is inserted or asked about
AT_SCRATCH               (3, 16)          sums of a top, a group, a tile
AT_KEYS                  (block,)         the feature by which a part of a block is being sorted
AT_NEAR, IN_NEAR         (many,)          squared distances and frames of the nearest, in order; many: most, at least COUNTED
IN_KEYS, IN_RANKS        (room,), (many,) candidates, FOUND of them: the bits of d2, then the number counted from the oldest; their order
AT_WARM, IN_SUMS         (most + 3, 16), (tiles,)  the sums of the tiles that were looked into first; where there those of each tile stand
AT_SQUARED               (blocks * block,)   squared distance of a frame that was marked (scan.py: of any), by its number modulo that length
AT_REACH, AT_GROUP_REACH (slots,), (groups,) square of every frame's own radius, -1: none; the largest of each group
AT_TILES                 (tiles, 1 + width, 16)
AT_GROUPS, AT_TOPS       (.., 1 + 2 width, 16)
IN_FRAMES, IN_PLACES     (slots,)         which frame a slot holds; the slot of each frame of a block
IN_ALIVE, IN_GROUP_ALIVE (tiles,), (groups,)  living frames in each
IN_TABLE                 (blocks,)        which block stands where
IN_ORDER, IN_SORTED      (block,)         the frames of the block that is being sealed, in the order reached so far
IN_WARM                  (most,)          the nearest of the query before; WARM how many, WARM_AT for which frame
IN_SEEN                  (tiles,)         the last query that looked into a tile; QUERIES counts them
IN_MARKS                 (blocks * block / 64,)  a bit for each frame that was found within the radius
NEXT, SINCE              the number of the next frame, counted from 0; and of the first one since all were forgotten
NEAR                     how many of the nearest are known
PLAIN                    for how many more queries the boxes are left aside
SPARE, SEAL, ..., PACE   the spare block, the block being sealed (-1: none), how far that is, and the steps done with every frame
"""


@dataclass(slots=True)
class IndexState:
    """An index; see this module for what stands where."""

    floats: Floats
    books: Times


def allocate(width: int, window: int, most: int, *, vector: bool = True) -> IndexState:
    """An empty index for frames of `width` features, a window of `window` frames, and up to `most` nearest."""
    sealed = window >= SEAL_FROM
    block = SEALED_BLOCK if sealed else GROUP
    blocks = -(-(window + block - 1) // block)
    groups = (blocks + sealed) * block // GROUP
    slots, tiles, tops, ring = groups * GROUP, groups * LANES, -(-groups // LANES), blocks * block
    rows, many, room = 1 + 2 * width, max(most, COUNTED), 3 * most + 64
    head = {
        "WIDTH": width, "WINDOW": window, "MOST": most, "BLOCK": block, "BLOCKS": blocks, "SLOTS": slots,
        "GROUPS": groups, "TOPS": tops, "VECTOR": vector, "SPARE": blocks if sealed else -1, "SEAL": -1, "WARM_AT": -1,
        "PACE": _pace(width) if sealed else 0, "SCANNED": not sealed and window * (1 + width) <= SCAN_UP_TO, "ROOM": room,
    }  # fmt: skip
    floats = {
        "AT_WEIGHTS": width, "AT_QUERY": width, "AT_SCRATCH": 3 * LANES, "AT_KEYS": block, "AT_NEAR": many, "AT_WARM": (most + 3) * LANES,
        "AT_SQUARED": ring, "AT_REACH": slots, "AT_GROUP_REACH": groups,
        "AT_TILES": tiles * (1 + width) * LANES, "AT_GROUPS": groups * rows * LANES, "AT_TOPS": tops * rows * LANES,
    }  # fmt: skip
    books = {
        "IN_FRAMES": slots, "IN_PLACES": slots, "IN_ALIVE": tiles, "IN_GROUP_ALIVE": groups, "IN_TABLE": blocks,
        "IN_ORDER": block, "IN_SORTED": block, "IN_NEAR": many, "IN_RANKS": many, "IN_KEYS": room, "IN_WARM": most,
        "IN_SUMS": tiles, "IN_SEEN": tiles, "IN_MARKS": ring // 64,
    }  # fmt: skip
    places, float_count = _lay_out(floats, 0)
    more, book_count = _lay_out(books, -(-len(NAMES) // LANES) * LANES)
    state = IndexState(_aligned(float_count), np.zeros(book_count, np.int64))
    for name, value in {**head, **places, **more}.items():
        state.books[NAMES.index(name)] = value
    _begin(state)
    return state


def clear(state: IndexState) -> None:
    """Forget all frames, but not how many there were, nor the weights."""
    b = state.books
    count, weighted = int(b[NEXT]), int(b[WEIGHTED])
    weights = state.floats[b[AT_WEIGHTS] : b[AT_WEIGHTS] + b[WIDTH]].copy()
    fresh = allocate(int(b[WIDTH]), int(b[WINDOW]), int(b[MOST]), vector=bool(b[VECTOR]))
    state.floats[:], state.books[:] = fresh.floats, fresh.books
    state.floats[b[AT_WEIGHTS] : b[AT_WEIGHTS] + b[WIDTH]] = weights
    b[NEXT] = b[SINCE] = count
    b[WEIGHTED] = weighted


def _begin(state: IndexState) -> None:
    """All lanes are dead, all weights 1."""
    f, b = state.floats, state.books
    width, tiles = int(b[WIDTH]), int(b[SLOTS]) // LANES
    f[b[AT_WEIGHTS] : b[AT_WEIGHTS] + width] = 1.0
    for place, count, rows in (
        (b[AT_TILES], tiles, 1 + width),
        (b[AT_GROUPS], int(b[GROUPS]), 1 + 2 * width),
        (b[AT_TOPS], int(b[TOPS]), 1 + 2 * width),
    ):
        f[place : place + count * rows * LANES].reshape(count, rows, LANES)[:, 0] = np.inf
    f[b[AT_REACH] : b[AT_REACH] + b[SLOTS]] = NO_REACH
    f[b[AT_GROUP_REACH] : b[AT_GROUP_REACH] + b[GROUPS]] = NO_REACH
    b[b[IN_TABLE] : b[IN_TABLE] + b[BLOCKS]] = np.arange(b[BLOCKS])


def _lay_out(sizes: dict[str, int], start: int) -> tuple[dict[str, int], int]:
    """Places one after another, each at the beginning of 16 numbers; and where the last one ends."""
    places, end = {}, start
    for name, size in sizes.items():
        places[name] = end
        end += -(-size // LANES) * LANES
    return places, end


def _aligned(count: int) -> Floats:
    """Zeros that begin at a multiple of 64 bytes: faster, and nothing depends on it."""
    room = np.zeros(count + LANES, np.float32)
    first = -room.ctypes.data % 64 // 4
    return room[first : first + count]


SPREAD_WORK, RANK_WORK = 512, 16384
"""What one step of sealing does: how many values it looks through, how many pairs it compares."""


def _pace(width: int) -> int:
    """How many steps must be done with every frame so that a block is sealed well before the next one is full; see seal.py."""
    steps, size = 0, SEALED_BLOCK
    while size > LANES:
        spread = -(-width // max(1, SPREAD_WORK // size))
        rank = -(-size // max(1, RANK_WORK // size))
        steps += SEALED_BLOCK // size * (spread + rank)
        size //= 2
    steps += SEALED_BLOCK // LANES + SEALED_BLOCK // GROUP + 1
    return -(-steps // (SEALED_BLOCK - 24))
