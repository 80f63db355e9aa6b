"""The layout of the two flat arrays that an index is: `floats` (float32) and `books` (int64).

A snapshot is a copy of both, and Python calls a kernel with both and nothing else, as every array in a call costs time. Kernels see them
as one `BareIndex`, in which every number and every array has a name. To add one, name it there, and for an array give its length in
`allocate`; nothing else has to know.

A frame lives in a slot: lane `slot % 16` of tile `slot // 16`. Tiles hold one row of 16 lanes per feature, behind a row that is 0 in lanes
that hold a living frame and infinite in all others; a distance is summed up from there. 16 tiles are a group, 16 groups a top; a box over
each tile stands in its group, a box over each group in its top, again 16 lanes wide: the row of 0 or infinity, then lowest and highest of
each feature. Slots belong to blocks: 1024 frames where full blocks are sealed, else one group.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Times

Floats: TypeAlias = NDArray[np.float32]

LANES = 16
FOUR = 4 * LANES
GROUP = LANES * LANES
SEALED_BLOCK = 1024
SEAL_FROM = 8192
"""Windows of at least this many frames have their full blocks sealed; in shorter ones it does not pay."""
SCAN_UP_TO = 20_000
"""Windows of at most this many numbers (frames times 1 + width) are looked through from end to end: measured, sooner than by boxes."""
COUNTED = 96
"""Up to this many candidates are put in order by counting, for each, those that are nearer: no branches, so faster than a sort."""

LARGEST = 1e18
"""Features beyond this size (either sign) are not finite for us: sums of squares then stay in float32's range, or overflow to infinity."""

NO_REACH = -1.0

FARTHEST = np.float32(np.finfo(np.float32).max)
"""No limit: everything but infinity, which is what lanes without a living frame hold."""


class BareIndex:
    """An index as kernels see it (bare.py): numbers that stand at the beginning of `books`, and the arrays that it consists of.

    For a number there is a place in the head of `books`, in the order given here, for an array the number of where it begins.
    """

    floats: Floats
    books: Times

    width: int  # features
    window: int  # frames
    most: int  # the largest k
    block: int  # frames in a block
    blocks: int  # how many blocks take turns; a sealed index has one more, the spare
    slots: int
    groups: int
    tops: int
    vector: int  # whether vectors are used, or plain loops
    weighted: int  # whether any weight differs from 1
    scanned: int  # whether queries look through the whole window (scan.py)
    room: int  # for how many candidates there is room

    weights: Floats  # (width,)
    query: Floats  # (width,) the frame that is inserted or asked about
    scratch: Floats  # (3, 16) sums of a top, a group, a tile
    values: Floats  # (block,) the feature by which a part of a block is being sorted
    near_squared: Floats  # (many,) squared distances of the nearest, in order; many: most, at least COUNTED
    warm_sums: Floats  # (most + 3, 16) the sums of the tiles that were looked into first
    squared: Floats  # (blocks * block,) squared distance of a frame that was marked (scan.py: of any), by its number modulo that length
    reach: Floats  # (slots,) square of every frame's own radius, or -1
    group_reach: Floats  # (groups,) the largest of each group
    tiles: Floats  # (tiles, 1 + width, 16)
    group_boxes: Floats  # (groups, 1 + 2 width, 16)
    top_boxes: Floats  # (tops, 1 + 2 width, 16)

    frames: Times  # (slots,) which frame a slot holds
    places: Times  # (slots,) the slot of each frame of a block
    alive: Times  # (tiles,) living frames in each
    group_alive: Times  # (groups,)
    table: Times  # (blocks,) which block stands where
    order: Times  # (block,) the frames of the block that is being sealed, in the order reached so far
    sorted: Times  # (block,) the order that comes next
    near: Times  # (many,) the frames of the nearest, in order
    ranks: Times  # (many,) the candidates' places in their order
    keys: Times  # (room,) candidates: the bits of d2, then the number counted from the oldest
    warm: Times  # (most,) the nearest of the query before
    sums: Times  # (tiles,) where in floats the sums of a tile that was looked into first stand
    seen: Times  # (tiles,) the last query that looked into a tile
    marks: Times  # (blocks * block / 64,) a bit for each frame that was found within the radius

    next: int  # the number of the next frame, counted from 0
    since: int  # that of the first one since all were forgotten
    near_count: int  # how many of the nearest are known
    found: int  # how many candidates there are
    warm_count: int  # how many were nearest to the query before
    warm_frame: int  # and to which frame
    queries: int  # counts them
    plain: int  # for how many more queries the boxes are left aside
    spare: int  # the spare block; -1: blocks are not sealed
    sealing: int  # the block that is being sealed, or -1
    stage: int  # what is being done with it (seal.py)
    part_size: int  # frames in the part of it that is being sorted
    part_from: int  # the first of them
    part_done: int  # how far the stage has come in it
    axis: int  # the feature that spreads most so far
    pace: int  # steps of sealing done with every frame

    scratch_at: int  # places in floats, for what is passed on as a place there
    warm_sums_at: int
    squared_at: int
    tiles_at: int
    group_boxes_at: int
    top_boxes_at: int


def _head() -> list[tuple[str, type[np.int64]]]:
    kinds = {name: kind for name, kind in BareIndex.__annotations__.items() if name not in ("floats", "books")}
    named = [name if kind == "int" else f"{name}_at" for name, kind in kinds.items()]
    return [(name, np.int64) for name in dict.fromkeys(named)]


HEAD = np.dtype(_head())
"""The beginning of `books`, from Python."""
HEAD_LENGTH = len(HEAD.names or ())


@dataclass(slots=True)
class IndexState:
    """An index; see this module for what stands where."""

    floats: Floats
    books: Times

    @property
    def head(self) -> Any:
        """The numbers at the beginning of `books`, by name: read and written."""
        return self.books[:HEAD_LENGTH].view(HEAD)[0]

    def floats_at(self, place: str, count: int) -> Floats:
        """`count` of the floats, from a place that the head names: a view."""
        start = int(self.head[place])
        return self.floats[start : start + count]


def allocate(width: int, window: int, most: int, *, vector: bool = True) -> IndexState:
    """An empty index for frames of `width` features, a window of `window` frames, and up to `most` nearest."""
    sealed = window >= SEAL_FROM
    block = SEALED_BLOCK if sealed else GROUP
    blocks = -(-(window + block - 1) // block)
    groups = (blocks + sealed) * block // GROUP
    slots, tiles, tops, ring = groups * GROUP, groups * LANES, -(-groups // LANES), blocks * block
    rows, many, room = 1 + 2 * width, max(most, COUNTED), 3 * most + 64
    head = {
        "width": width, "window": window, "most": most, "block": block, "blocks": blocks, "slots": slots,
        "groups": groups, "tops": tops, "vector": vector, "spare": blocks if sealed else -1, "sealing": -1, "warm_frame": -1,
        "pace": _pace(width) if sealed else 0, "scanned": not sealed and window * (1 + width) <= SCAN_UP_TO, "room": room,
    }  # fmt: skip
    floats = {
        "weights_at": width, "query_at": width, "scratch_at": 3 * LANES, "values_at": block, "near_squared_at": many,
        "warm_sums_at": (most + 3) * LANES, "squared_at": ring, "reach_at": slots, "group_reach_at": groups,
        "tiles_at": tiles * (1 + width) * LANES, "group_boxes_at": groups * rows * LANES, "top_boxes_at": tops * rows * LANES,
    }  # fmt: skip
    books = {
        "frames_at": slots, "places_at": slots, "alive_at": tiles, "group_alive_at": groups, "table_at": blocks,
        "order_at": block, "sorted_at": block, "near_at": many, "ranks_at": many, "keys_at": room, "warm_at": most,
        "sums_at": tiles, "seen_at": tiles, "marks_at": ring // 64,
    }  # fmt: skip
    places, float_count = _lay_out(floats, 0)
    more, book_count = _lay_out(books, -(-HEAD_LENGTH // LANES) * LANES)
    state = IndexState(_aligned(float_count), np.zeros(book_count, np.int64))
    for name, value in {**head, **places, **more}.items():
        state.head[name] = value
    _begin(state)
    return state


def clear(state: IndexState) -> None:
    """Forget all frames, but not how many there were, nor the weights."""
    head = state.head
    count, weighted, width = head["next"], head["weighted"], int(head["width"])
    weights = state.floats_at("weights_at", width).copy()
    fresh = allocate(width, int(head["window"]), int(head["most"]), vector=bool(head["vector"]))
    state.floats[:], state.books[:] = fresh.floats, fresh.books
    state.floats_at("weights_at", width)[:] = weights
    head["next"] = head["since"] = count
    head["weighted"] = weighted


def _begin(state: IndexState) -> None:
    """All lanes are dead, all weights 1."""
    width, slots, groups, tops, blocks = (int(state.head[n]) for n in ("width", "slots", "groups", "tops", "blocks"))
    state.floats_at("weights_at", width)[:] = 1.0
    for name, count, rows in (
        ("tiles_at", slots // LANES, 1 + width),
        ("group_boxes_at", groups, 1 + 2 * width),
        ("top_boxes_at", tops, 1 + 2 * width),
    ):
        state.floats_at(name, count * rows * LANES).reshape(count, rows, LANES)[:, 0] = np.inf
    state.floats_at("reach_at", slots)[:] = NO_REACH
    state.floats_at("group_reach_at", groups)[:] = NO_REACH
    table = state.head["table_at"]
    state.books[table : table + blocks] = np.arange(blocks)


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
