"""The window: a frame comes in, the oldest goes, and the boxes over tiles and groups follow."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.neighbours.layout import GROUP, LANES, LARGEST, BareIndex
from kinegraph.operators.neighbours.seal import begin_sealing, seal_step
from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel


@kernel
def oldest(ix: BareIndex) -> int:
    """The number of the oldest frame in the window (of the next one, if it is empty)."""
    return int(max(ix.since, ix.next - ix.window))


@kernel
def slot_of(ix: BareIndex, frame: int) -> int:
    """Where a frame of the window is kept."""
    block = ix.block
    stands = ix.table[frame // block % ix.blocks]
    return int(ix.places[stands * block + frame % block])


@kernel
def tile_at(ix: BareIndex, tile: int) -> int:
    """The place of a tile in `floats`."""
    return int(ix.tiles_at + tile * (1 + ix.width) * LANES)


@kernel
def prepare(ix: BareIndex, x: Samples) -> bool:
    """Take `x` (width,) as the frame in question, in float32; False where a value is not finite (or beyond LARGEST)."""
    query = ix.query
    good = True
    for i in range(x.shape[0]):
        good = good and abs(x[i]) <= LARGEST
        query[i] = x[i]
    return good


@kernel
def recall(ix: BareIndex) -> bool:
    """Take the newest frame as the frame in question; False if it is missing or bad."""
    newest = ix.next - 1
    if newest < ix.since:
        return False
    slot = slot_of(ix, newest)
    row = tile_at(ix, slot // LANES) + slot % LANES
    for i in range(ix.width):
        ix.query[i] = ix.floats[row + (1 + i) * LANES]
    return bool(ix.floats[row] == 0.0)


@kernel
def insert(ix: BareIndex, good: bool, reach: np.float32) -> None:
    """The frame that was prepared enters, the oldest leaves if the window was full, and a step of sealing is done.

    reach   square of the frame's own radius; or NO_REACH
    A frame that is not `good` takes its turn, and is never a neighbour.
    """
    frame = ix.next
    if frame - ix.since >= ix.window:
        forget(ix, frame - ix.window)
    block = ix.block
    stands = ix.table[frame // block % ix.blocks]
    slot = stands * block + frame % block
    ix.places[slot] = slot
    ix.frames[slot] = frame
    ix.next = frame + 1
    if good:
        settle(ix, slot, reach)
    if ix.pace:
        for _ in range(ix.pace):
            # a little of the sorting with every frame, so that no frame waits for a whole block's
            seal_step(ix)
        if (frame + 1) % block == 0:
            begin_sealing(ix, stands)


@kernel
def settle(ix: BareIndex, slot: int, reach: np.float32) -> None:
    """Put the frame in question into a slot, and widen (or begin) the boxes of its tile and group."""
    width, query = ix.width, ix.query
    tile, lane = slot // LANES, slot % LANES
    group = tile // LANES
    row = tile_at(ix, tile) + lane
    ix.floats[row] = 0.0
    for i in range(width):
        ix.floats[row + (1 + i) * LANES] = query[i]
    stride = (1 + 2 * width) * LANES
    widen(ix, ix.group_boxes_at + group * stride + tile % LANES, ix.alive[tile] == 0)
    widen(ix, ix.top_boxes_at + group // LANES * stride + group % LANES, ix.group_alive[group] == 0)
    ix.reach[slot] = reach
    ix.group_reach[group] = reach if ix.group_alive[group] == 0 else max(reach, ix.group_reach[group])
    ix.alive[tile] += 1
    ix.group_alive[group] += 1


@kernel
def widen(ix: BareIndex, box: int, first: bool) -> None:
    """Make the box at place `box` (a lane of 16) hold the frame in question."""
    width, query = ix.width, ix.query
    if first:
        ix.floats[box] = 0.0
        for i in range(width):
            ix.floats[box + (1 + 2 * i) * LANES] = query[i]
            ix.floats[box + (2 + 2 * i) * LANES] = query[i]
        return
    for i in range(width):
        low, high = box + (1 + 2 * i) * LANES, box + (2 + 2 * i) * LANES
        ix.floats[low] = min(ix.floats[low], query[i])
        ix.floats[high] = max(ix.floats[high], query[i])


@kernel
def forget(ix: BareIndex, frame: int) -> None:
    """A frame leaves: its lane becomes infinite, and so do those of its tile and group with their last frame."""
    slot = slot_of(ix, frame)
    tile, lane = slot // LANES, slot % LANES
    row = tile_at(ix, tile) + lane
    # it was bad, or has left already: counting it again would empty its tile too soon
    if ix.floats[row] == math.inf:
        return
    # the box stays as wide as it was: shrinking it would cost a look at 15 others, and it only makes searches look in vain
    ix.floats[row] = math.inf
    group = slot // GROUP
    stride = (1 + 2 * ix.width) * LANES
    ix.alive[tile] -= 1
    if ix.alive[tile] == 0:
        ix.group_boxes[group * stride + tile % LANES] = math.inf
    ix.group_alive[group] -= 1
    if ix.group_alive[group] == 0:
        ix.top_boxes[group // LANES * stride + group % LANES] = math.inf
