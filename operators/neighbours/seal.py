"""Sealing: a full block of 1024 frames is kd-sorted, a small step with every frame, and swapped in when done.

Frames in order of arrival make tiles that are as small as motion is slow. Sorted like the leaves of a kd-tree (halved at the median of the
feature that spreads most, until 16 are left) they make smaller ones. The frames of the block stay where they are and are searched there,
while their sorted copy grows in the spare block; then the two change places, which is a matter of a few numbers. No step depends on how the
values lie: ranks are found by counting, which takes the same time for all.
"""

from __future__ import annotations

import math

from operators.neighbours.layout import (
    AT_GROUP_REACH,
    AT_GROUPS,
    AT_KEYS,
    AT_REACH,
    AT_TILES,
    AT_TOPS,
    AT_WEIGHTS,
    AXIS,
    BLOCK,
    BLOCKS,
    FROM,
    GROUP,
    IN_ALIVE,
    IN_FRAMES,
    IN_GROUP_ALIVE,
    IN_ORDER,
    IN_PLACES,
    IN_SORTED,
    IN_TABLE,
    LANES,
    NO_REACH,
    PART,
    RANK_WORK,
    SEAL,
    SIZE,
    SPARE,
    SPREAD_WORK,
    STAGE,
    WIDTH,
    Floats,
)
from stream.chunk import Times
from stream.kernel import kernel

SPREAD, RANK, COPY, COVER, SWAP = range(5)


@kernel
def begin_sealing(floats: Floats, books: Times, block: int) -> None:
    """Begin with a block that has just been filled (and end what is under way, which by then is done: see layout's pace)."""
    while books[SEAL] >= 0:
        seal_step(floats, books)
    for i in range(books[BLOCK]):
        books[books[IN_ORDER] + i] = i
    books[SEAL] = block
    books[FROM] = 0
    books[SIZE] = books[BLOCK]
    begin_part(books)


@kernel
def begin_part(books: Times) -> None:
    """Turn to the part of SIZE frames that begins at FROM."""
    books[STAGE] = SPREAD if books[SIZE] > LANES else COPY
    books[PART] = 0
    books[AXIS] = -1


@kernel
def seal_step(floats: Floats, books: Times) -> None:
    """One step of whatever is to be done next."""
    if books[SEAL] < 0:
        return
    if books[STAGE] == SPREAD:
        find_axis(floats, books)
    elif books[STAGE] == RANK:
        rank(floats, books)
    elif books[STAGE] == COPY:
        copy_tile(floats, books)
    elif books[STAGE] == COVER:
        cover_group(floats, books)
    else:
        swap(floats, books)


@kernel
def member(books: Times, i: int) -> int:
    """The place of the lane's first number of the i-th frame, in the order reached so far, of the block that is being sealed."""
    slot = books[SEAL] * books[BLOCK] + books[books[IN_ORDER] + i]
    return int(books[AT_TILES] + slot // LANES * (1 + books[WIDTH]) * LANES + slot % LANES)


@kernel
def find_axis(floats: Floats, books: Times) -> None:
    """Which feature spreads most within the part: a few features in each step. Then its values become the keys."""
    width, start, size, keys = books[WIDTH], books[FROM], books[SIZE], books[AT_KEYS]
    stop = min(width, books[PART] + max(1, SPREAD_WORK // size))
    for feature in range(books[PART], stop):
        low, high = math.inf, -math.inf
        for i in range(start, start + size):
            at = member(books, i)
            if floats[at] == 0.0:
                value = floats[at + (1 + feature) * LANES]
                low, high = min(low, value), max(high, value)
        spread = floats[books[AT_WEIGHTS] + feature] * (high - low) * (high - low) if high >= low else 0.0
        if books[AXIS] < 0 or spread > floats[keys]:
            floats[keys] = spread
            books[AXIS] = feature
    books[PART] = stop
    if stop == width:
        for i in range(size):
            at = member(books, start + i)
            floats[keys + i] = floats[at + (1 + books[AXIS]) * LANES] if floats[at] == 0.0 else math.inf
        books[STAGE] = RANK
        books[PART] = 0


@kernel
def rank(floats: Floats, books: Times) -> None:
    """Where some of the part's frames belong in order of their keys, equal ones as they were; at the end, on to the next part."""
    start, size = books[FROM], books[SIZE]
    keys = books[AT_KEYS]
    stop = min(size, books[PART] + max(1, RANK_WORK // size))
    for i in range(books[PART], stop):
        key = floats[keys + i]
        before = 0
        for j in range(i):
            before += floats[keys + j] <= key
        for j in range(i + 1, size):
            before += floats[keys + j] < key
        books[books[IN_SORTED] + start + before] = books[books[IN_ORDER] + start + i]
    books[PART] = stop
    if stop < size:
        return
    for i in range(start, start + size):
        books[books[IN_ORDER] + i] = books[books[IN_SORTED] + i]
    books[FROM] = start + size
    if books[FROM] == books[BLOCK]:
        books[FROM] = 0
        books[SIZE] = size // 2
    begin_part(books)


@kernel
def copy_tile(floats: Floats, books: Times) -> None:
    """The next tile of the spare block, and its box."""
    width, block, spare = books[WIDTH], books[BLOCK], books[SPARE]
    tile = spare * block // LANES + books[PART]
    to = books[AT_TILES] + tile * (1 + width) * LANES
    alive = 0
    for lane in range(LANES):
        i = books[PART] * LANES + lane
        at = member(books, i)
        slot = tile * LANES + lane
        offset = books[books[IN_ORDER] + i]
        old = books[SEAL] * block + offset
        books[books[IN_FRAMES] + slot] = books[books[IN_FRAMES] + old]
        books[books[IN_PLACES] + spare * block + offset] = slot
        floats[books[AT_REACH] + slot] = floats[books[AT_REACH] + old]
        for row in range(1 + width):
            floats[to + row * LANES + lane] = floats[at + row * LANES]
        alive += floats[at] == 0.0
    books[books[IN_ALIVE] + tile] = alive
    box = books[AT_GROUPS] + tile // LANES * (1 + 2 * width) * LANES + tile % LANES
    floats[box] = 0.0 if alive else math.inf
    for feature in range(width):
        low, high = math.inf, -math.inf
        for lane in range(LANES):
            if floats[to + lane] == 0.0:
                value = floats[to + (1 + feature) * LANES + lane]
                low, high = min(low, value), max(high, value)
        floats[box + (1 + 2 * feature) * LANES] = low if alive else 0.0
        floats[box + (2 + 2 * feature) * LANES] = high if alive else 0.0
    books[PART] += 1
    if books[PART] * LANES == block:
        books[STAGE] = COVER
        books[PART] = 0


@kernel
def cover_group(floats: Floats, books: Times) -> None:
    """The box over the next group of the spare block. Its lane stays infinite until the swap, so that nobody looks into it."""
    width = books[WIDTH]
    rows = (1 + 2 * width) * LANES
    group = books[SPARE] * books[BLOCK] // GROUP + books[PART]
    tiles = books[AT_GROUPS] + group * rows
    box = books[AT_TOPS] + group // LANES * rows + group % LANES
    alive = 0
    for tile in range(LANES):
        alive += books[books[IN_ALIVE] + group * LANES + tile]
    books[books[IN_GROUP_ALIVE] + group] = alive
    for feature in range(width):
        low, high = math.inf, -math.inf
        for tile in range(LANES):
            if floats[tiles + tile] == 0.0:
                low = min(low, floats[tiles + (1 + 2 * feature) * LANES + tile])
                high = max(high, floats[tiles + (2 + 2 * feature) * LANES + tile])
        floats[box + (1 + 2 * feature) * LANES] = low if alive else 0.0
        floats[box + (2 + 2 * feature) * LANES] = high if alive else 0.0
    farthest = NO_REACH
    for slot in range(group * GROUP, (group + 1) * GROUP):
        if floats[books[AT_TILES] + slot // LANES * (1 + width) * LANES + slot % LANES] == 0.0:
            farthest = max(farthest, floats[books[AT_REACH] + slot])
    floats[books[AT_GROUP_REACH] + group] = farthest
    books[PART] += 1
    if books[PART] * GROUP == books[BLOCK]:
        books[STAGE] = SWAP


@kernel
def swap(floats: Floats, books: Times) -> None:
    """The sorted copy takes the block's place; the block becomes the spare one."""
    groups = books[BLOCK] // GROUP
    rows = (1 + 2 * books[WIDTH]) * LANES
    for k in range(groups):
        new, old = books[SPARE] * groups + k, books[SEAL] * groups + k
        if books[books[IN_GROUP_ALIVE] + new]:
            floats[books[AT_TOPS] + new // LANES * rows + new % LANES] = 0.0
        floats[books[AT_TOPS] + old // LANES * rows + old % LANES] = math.inf
        floats[books[AT_GROUP_REACH] + old] = NO_REACH
    for i in range(books[BLOCKS]):
        if books[books[IN_TABLE] + i] == books[SEAL]:
            books[books[IN_TABLE] + i] = books[SPARE]
    books[SPARE], books[SEAL] = books[SEAL], -1
