"""Sealing: a full block of 1024 frames is kd-sorted, a small step with every frame, and swapped in when done.

Frames in order of arrival make tiles that are as small as motion is slow. Sorted like the leaves of a kd-tree (halved at the median of the
feature that spreads most, until 16 are left) they make smaller ones. The frames of the block stay where they are and are searched there,
while their sorted copy grows in the spare block; then the two change places, which is a matter of a few numbers. No step depends on how the
values lie: ranks are found by counting, which takes the same time for all.
"""

from __future__ import annotations

import math

from kinegraph.operators.neighbours.layout import GROUP, LANES, NO_REACH, RANK_WORK, SPREAD_WORK, BareIndex
from kinegraph.stream.kernel import kernel

SPREAD, RANK, COPY, COVER, SWAP = range(5)


@kernel
def begin_sealing(ix: BareIndex, block: int) -> None:
    """Begin with a block that has just been filled (and end what is under way, which by then is done: see layout's pace)."""
    # normally over by now; a block that fills faster than the pace must not overwrite one under way
    while ix.sealing >= 0:
        seal_step(ix)
    for i in range(ix.block):
        ix.order[i] = i
    ix.sealing = block
    ix.part_from = 0
    ix.part_size = ix.block
    begin_part(ix)


@kernel
def begin_part(ix: BareIndex) -> None:
    """Turn to the part of SIZE frames that begins at FROM."""
    ix.stage = SPREAD if ix.part_size > LANES else COPY
    ix.part_done = 0
    ix.axis = -1


@kernel
def seal_step(ix: BareIndex) -> None:
    """One step of whatever is to be done next."""
    if ix.sealing < 0:
        return
    if ix.stage == SPREAD:
        find_axis(ix)
    elif ix.stage == RANK:
        rank(ix)
    elif ix.stage == COPY:
        copy_tile(ix)
    elif ix.stage == COVER:
        cover_group(ix)
    else:
        swap(ix)


@kernel
def member(ix: BareIndex, i: int) -> int:
    """The place of the lane's first number of the i-th frame, in the order reached so far, of the block that is being sealed."""
    slot = ix.sealing * ix.block + ix.order[i]
    return int(ix.tiles_at + slot // LANES * (1 + ix.width) * LANES + slot % LANES)


@kernel
def find_axis(ix: BareIndex) -> None:
    """Which feature spreads most within the part: a few features in each step. Then its values become the keys."""
    width, start, size, keys = ix.width, ix.part_from, ix.part_size, ix.values
    # so many features that a step costs the same whatever the part's size: no frame pays for a whole sort
    stop = min(width, ix.part_done + max(1, SPREAD_WORK // size))
    for feature in range(ix.part_done, stop):
        low, high = math.inf, -math.inf
        for i in range(start, start + size):
            at = member(ix, i)
            if ix.floats[at] == 0.0:
                value = ix.floats[at + (1 + feature) * LANES]
                low, high = min(low, value), max(high, value)
        spread = ix.weights[feature] * (high - low) * (high - low) if high >= low else 0.0
        if ix.axis < 0 or spread > keys[0]:
            keys[0] = spread
            ix.axis = feature
    ix.part_done = stop
    if stop == width:
        for i in range(size):
            at = member(ix, start + i)
            keys[i] = ix.floats[at + (1 + ix.axis) * LANES] if ix.floats[at] == 0.0 else math.inf
        ix.stage = RANK
        ix.part_done = 0


@kernel
def rank(ix: BareIndex) -> None:
    """Where some of the part's frames belong in order of their keys, equal ones as they were; at the end, on to the next part."""
    start, size = ix.part_from, ix.part_size
    keys = ix.values
    stop = min(size, ix.part_done + max(1, RANK_WORK // size))
    # ranking by counting is quadratic, but needs no memory and can be left and taken up at any frame
    for i in range(ix.part_done, stop):
        key = keys[i]
        before = 0
        # <= before and < after it: equal keys keep their order, so results do not depend on the pace
        for j in range(i):
            before += keys[j] <= key
        for j in range(i + 1, size):
            before += keys[j] < key
        ix.sorted[start + before] = ix.order[start + i]
    ix.part_done = stop
    if stop < size:
        return
    for i in range(start, start + size):
        ix.order[i] = ix.sorted[i]
    ix.part_from = start + size
    if ix.part_from == ix.block:
        ix.part_from = 0
        ix.part_size = size // 2
    begin_part(ix)


@kernel
def copy_tile(ix: BareIndex) -> None:
    """The next tile of the spare block, and its box."""
    width, block, spare = ix.width, ix.block, ix.spare
    tile = spare * block // LANES + ix.part_done
    to = ix.tiles_at + tile * (1 + width) * LANES
    alive = 0
    for lane in range(LANES):
        i = ix.part_done * LANES + lane
        at = member(ix, i)
        slot = tile * LANES + lane
        offset = ix.order[i]
        old = ix.sealing * block + offset
        ix.frames[slot] = ix.frames[old]
        ix.places[spare * block + offset] = slot
        ix.reach[slot] = ix.reach[old]
        for row in range(1 + width):
            ix.floats[to + row * LANES + lane] = ix.floats[at + row * LANES]
        alive += ix.floats[at] == 0.0
    ix.alive[tile] = alive
    box = ix.group_boxes_at + tile // LANES * (1 + 2 * width) * LANES + tile % LANES
    # an infinite first row puts a box without living frames beyond every limit: search needs no second test
    ix.floats[box] = 0.0 if alive else math.inf
    for feature in range(width):
        low, high = math.inf, -math.inf
        for lane in range(LANES):
            if ix.floats[to + lane] == 0.0:
                value = ix.floats[to + (1 + feature) * LANES + lane]
                low, high = min(low, value), max(high, value)
        ix.floats[box + (1 + 2 * feature) * LANES] = low if alive else 0.0
        ix.floats[box + (2 + 2 * feature) * LANES] = high if alive else 0.0
    ix.part_done += 1
    if ix.part_done * LANES == block:
        ix.stage = COVER
        ix.part_done = 0


@kernel
def cover_group(ix: BareIndex) -> None:
    """The box over the next group of the spare block. Its lane stays infinite until the swap, so no search enters it."""
    width = ix.width
    rows = (1 + 2 * width) * LANES
    group = ix.spare * ix.block // GROUP + ix.part_done
    tiles = ix.group_boxes_at + group * rows
    box = ix.top_boxes_at + group // LANES * rows + group % LANES
    alive = 0
    for tile in range(LANES):
        alive += ix.alive[group * LANES + tile]
    ix.group_alive[group] = alive
    for feature in range(width):
        low, high = math.inf, -math.inf
        for tile in range(LANES):
            if ix.floats[tiles + tile] == 0.0:
                low = min(low, ix.floats[tiles + (1 + 2 * feature) * LANES + tile])
                high = max(high, ix.floats[tiles + (2 + 2 * feature) * LANES + tile])
        ix.floats[box + (1 + 2 * feature) * LANES] = low if alive else 0.0
        ix.floats[box + (2 + 2 * feature) * LANES] = high if alive else 0.0
    farthest = NO_REACH
    for slot in range(group * GROUP, (group + 1) * GROUP):
        if ix.tiles[slot // LANES * (1 + width) * LANES + slot % LANES] == 0.0:
            farthest = max(farthest, ix.reach[slot])
    ix.group_reach[group] = farthest
    ix.part_done += 1
    if ix.part_done * GROUP == ix.block:
        ix.stage = SWAP


@kernel
def swap(ix: BareIndex) -> None:
    """The sorted copy takes the block's place; the block becomes the spare one."""
    groups = ix.block // GROUP
    rows = (1 + 2 * ix.width) * LANES
    for k in range(groups):
        new, old = ix.spare * groups + k, ix.sealing * groups + k
        # only now do searches see the copy; until here its lanes were infinite, and the old block answered
        if ix.group_alive[new]:
            ix.top_boxes[new // LANES * rows + new % LANES] = 0.0
        ix.top_boxes[old // LANES * rows + old % LANES] = math.inf
        ix.group_reach[old] = NO_REACH
    for i in range(ix.blocks):
        if ix.table[i] == ix.sealing:
            ix.table[i] = ix.spare
    ix.spare, ix.sealing = ix.sealing, -1
