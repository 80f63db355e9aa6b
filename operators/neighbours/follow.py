"""The kernels that Python calls: frames are inserted, and asked about, in one call as many as there are.

They take the index as its two arrays, and pass it on bare.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.neighbours.bare import bare_index
from kinegraph.operators.neighbours.candidates import radius_squared
from kinegraph.operators.neighbours.layout import BareIndex, Floats
from kinegraph.operators.neighbours.search import search
from kinegraph.operators.neighbours.vectors import lowest
from kinegraph.operators.neighbours.window import insert, oldest, prepare, recall, slot_of
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.compiler.record import record
from kinegraph.stream.kernel import kernel


@kernel
def take_nearest(ix: BareIndex, frames: Times, distances: Array) -> None:
    """Write the nearest that `search` found into `frames` (k,) int64 and `distances` (k,) float32; -1 and NaN where there are fewer."""
    near, squared, known = ix.near, ix.near_squared, ix.near_count
    for i in range(known):
        frames[i] = near[i]
        distances[i] = math.sqrt(squared[i])
    for i in range(known, frames.shape[0]):
        frames[i] = -1
        distances[i] = math.nan


@record
@dataclass(frozen=True, slots=True)
class FoundWithin:
    """Room for what is found within the radius, a row for each pair.

    who, frames   (m,) int64     the row that found, and the frame that was found
    distances     (m,) float32   how far apart they are
    ways          (m, 2) bool    see `take_marked`
    """

    who: Times
    frames: Times
    distances: Array
    ways: Array

    @staticmethod
    def of(room: int) -> FoundWithin:
        return FoundWithin(
            np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room, np.float32), np.empty((room, 2), np.bool_)
        )  # fmt: skip


@kernel
def take_marked(ix: BareIndex, within: np.float32, made: int, frames: Times, distances: Array, ways: Array) -> int:
    """Write the frames that `search` marked, oldest first, from row `made` on, and unmark them; returns the next row.

    ways (m, 2) bool: whether the frame is within the radius asked for, and whether this one is within the frame's own
    """
    ring = ix.blocks * ix.block
    first = oldest(ix)
    words = ring // 64
    start = first % ring // 64
    for k in range(min(words, ix.window // 64 + 2)):
        word = (start + k) % words
        bits = ix.marks[word]
        ix.marks[word] = 0
        while bits:
            place = word * 64 + lowest(bits)
            bits &= bits - 1
            frame = first + (place - first) % ring
            squared = ix.squared[place]
            frames[made] = frame
            distances[made] = math.sqrt(squared)
            ways[made, 0] = squared <= within
            ways[made, 1] = squared <= ix.reach[slot_of(ix, frame)]
            made += 1
    return made


@kernel
def follow(floats: Floats, books: Times, x: Samples, band: int, radius: float, frames: Times, distances: Array) -> None:
    """Insert each of `x` (n, width) with its `radius` (NaN: no radius), and write its nearest into `frames` and `distances` (n, k)."""
    ix = bare_index(floats, books)
    reach = radius_squared(radius)
    for i in range(x.shape[0]):
        good = prepare(ix, x[i])
        insert(ix, good, reach)
        ix.near_count = 0
        if good and frames.shape[1]:
            search(ix, ix.next - 1, band, frames.shape[1], np.float32(-1.0), False)
        take_nearest(ix, frames[i], distances[i])


@kernel
def follow_within(
    floats: Floats,
    books: Times,
    x: Samples,
    start: int,
    band: int,
    radius: float,
    both: bool,
    frames: Times,
    distances: Array,
    found: FoundWithin,
) -> tuple[int, int]:
    """As `follow`, from row `start` on, and all within the radius as well, for as long as there is room for what one frame can find.

    Returns the row to go on with, and how many were found.
    """
    ix = bare_index(floats, books)
    within = radius_squared(radius)
    made = 0
    i = start
    while i < x.shape[0] and made + ix.window <= found.who.shape[0]:
        good = prepare(ix, x[i])
        insert(ix, good, within)
        ix.near_count = 0
        if good:
            marked = search(ix, ix.next - 1, band, frames.shape[1], within, both)
            if marked:
                after = take_marked(ix, within, made, found.frames, found.distances, found.ways)
                found.who[made:after] = i
                made = after
        take_nearest(ix, frames[i], distances[i])
        i += 1
    return i, made


@kernel
def enter(floats: Floats, books: Times, x: Samples, radius: float) -> None:
    """Insert the frame `x` (width,) with its own `radius`."""
    ix = bare_index(floats, books)
    good = prepare(ix, x)
    insert(ix, good, radius_squared(radius))


@kernel
def ask_nearest(floats: Floats, books: Times, x: Samples, at: int, band: int, frames: Times, distances: Array) -> int:
    """Write the nearest of `x` (width,), or, if it is empty, of the newest frame, into `frames` and `distances` (k,); returns how many."""
    ix = bare_index(floats, books)
    ix.near_count = 0
    if prepare(ix, x) if len(x) else recall(ix):
        search(ix, at, band, frames.shape[0], np.float32(-1.0), False)
    take_nearest(ix, frames, distances)
    return int(ix.near_count)


@kernel
def ask_within(floats: Floats, books: Times, x: Samples, at: int, band: int, radius: float, both: bool) -> int:
    """Mark all within a radius of `x` (width,), or, if it is empty, of the newest frame, for `tell_within` to report; returns how many."""
    ix = bare_index(floats, books)
    good = prepare(ix, x) if len(x) else recall(ix)
    return search(ix, at, band, 0, radius_squared(radius), both) if good else 0


@kernel
def tell_within(floats: Floats, books: Times, radius: float, frames: Times, distances: Array, ways: Array) -> None:
    """Write those that `ask_within` marked: see take_marked."""
    take_marked(bare_index(floats, books), radius_squared(radius), 0, frames, distances, ways)


@kernel
def slot_in(floats: Floats, books: Times, frame: int) -> int:
    """Where a frame of the window is kept: see slot_of."""
    return slot_of(bare_index(floats, books), frame)
