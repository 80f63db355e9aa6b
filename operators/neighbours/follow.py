"""The kernels that Python calls: frames are inserted, and asked about, in one call as many as there are.

They take the index as its two arrays, and hand it on bare.
"""

from __future__ import annotations

import math

import numpy as np

from operators.neighbours.candidates import radius_squared
from operators.neighbours.lanes import bare, lowest
from operators.neighbours.layout import (
    AT_NEAR,
    AT_REACH,
    AT_SQUARED,
    BLOCK,
    BLOCKS,
    IN_MARKS,
    IN_NEAR,
    NEAR,
    NEXT,
    WINDOW,
    Floats,
)
from operators.neighbours.search import search
from operators.neighbours.window import insert, oldest, prepare, recall, slot_of
from stream.chunk import Array, Samples, Times
from stream.kernel import kernel


@kernel
def take_nearest(floats: Floats, books: Times, frames: Times, distances: Array) -> None:
    """Write the nearest that `search` found into `frames` (k,) int64 and `distances` (k,) float32; -1 and NaN where there are fewer."""
    near, squared, known = books[IN_NEAR], books[AT_NEAR], books[NEAR]
    for i in range(known):
        frames[i] = books[near + i]
        distances[i] = math.sqrt(floats[squared + i])
    for i in range(known, frames.shape[0]):
        frames[i] = -1
        distances[i] = math.nan


@kernel
def take_marked(
    floats: Floats, books: Times, within: np.float32, made: int, frames: Times, distances: Array, ways: Array
) -> int:
    """Write the frames that `search` marked, oldest first, from row `made` on, and unmark them; returns the next row.

    ways (m, 2) bool: whether the frame is within the radius asked for, and whether this one is within the frame's own
    """
    ring = books[BLOCKS] * books[BLOCK]
    first = oldest(books)
    words = ring // 64
    start = first % ring // 64
    for k in range(min(words, books[WINDOW] // 64 + 2)):
        word = (start + k) % words
        bits = books[books[IN_MARKS] + word]
        books[books[IN_MARKS] + word] = 0
        while bits:
            place = word * 64 + lowest(bits)
            bits &= bits - 1
            frame = first + (place - first) % ring
            squared = floats[books[AT_SQUARED] + place]
            frames[made] = frame
            distances[made] = math.sqrt(squared)
            ways[made, 0] = squared <= within
            ways[made, 1] = squared <= floats[books[AT_REACH] + slot_of(books, frame)]
            made += 1
    return made


@kernel
def follow(floats: Floats, books: Times, x: Samples, band: int, radius: float, frames: Times, distances: Array) -> None:
    """Insert each of `x` (n, width) with its `radius` (NaN: none), and write its nearest into `frames` and `distances` (n, k)."""
    f, b = bare(floats), bare(books)
    reach = radius_squared(radius)
    for i in range(x.shape[0]):
        good = prepare(f, b, x[i])
        insert(f, b, good, reach)
        b[NEAR] = 0
        if good and frames.shape[1]:
            search(f, b, b[NEXT] - 1, band, frames.shape[1], np.float32(-1.0), False)
        take_nearest(f, b, frames[i], distances[i])


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
    who: Times,
    found: Times,
    found_distances: Array,
    ways: Array,
) -> tuple[int, int]:
    """As `follow`, from row `start` on, and all within the radius as well, for as long as there is room for what one frame can find.

    who              (m,)     the row of `x` that found
    found, found_distances, ways  (m,), (m,), (m, 2)  see take_marked
    Returns the row to go on with, and how many were found.
    """
    f, b = bare(floats), bare(books)
    within = radius_squared(radius)
    made = 0
    i = start
    while i < x.shape[0] and made + b[WINDOW] <= who.shape[0]:
        good = prepare(f, b, x[i])
        insert(f, b, good, within)
        b[NEAR] = 0
        if good:
            marked = search(f, b, b[NEXT] - 1, band, frames.shape[1], within, both)
            if marked:
                after = take_marked(f, b, within, made, found, found_distances, ways)
                who[made:after] = i
                made = after
        take_nearest(f, b, frames[i], distances[i])
        i += 1
    return i, made


@kernel
def enter(floats: Floats, books: Times, x: Samples, radius: float) -> None:
    """Insert the frame `x` (width,) with its own `radius`."""
    f, b = bare(floats), bare(books)
    good = prepare(f, b, x)
    insert(f, b, good, radius_squared(radius))


@kernel
def ask_nearest(floats: Floats, books: Times, x: Samples, at: int, band: int, frames: Times, distances: Array) -> int:
    """Write the nearest of `x` (width,), or, if it is empty, of the newest frame, into `frames` and `distances` (k,); returns how many."""
    f, b = bare(floats), bare(books)
    b[NEAR] = 0
    if prepare(f, b, x) if len(x) else recall(f, b):
        search(f, b, at, band, frames.shape[0], np.float32(-1.0), False)
    take_nearest(f, b, frames, distances)
    return int(b[NEAR])


@kernel
def ask_within(floats: Floats, books: Times, x: Samples, at: int, band: int, radius: float, both: bool) -> int:
    """Mark all within a radius of `x` (width,), or, if it is empty, of the newest frame, to be told by `tell_within`; returns how many."""
    f, b = bare(floats), bare(books)
    good = prepare(f, b, x) if len(x) else recall(f, b)
    return search(f, b, at, band, 0, radius_squared(radius), both) if good else 0


@kernel
def tell_within(floats: Floats, books: Times, radius: float, frames: Times, distances: Array, ways: Array) -> None:
    """Write those that `ask_within` marked: see take_marked."""
    take_marked(bare(floats), bare(books), radius_squared(radius), 0, frames, distances, ways)
