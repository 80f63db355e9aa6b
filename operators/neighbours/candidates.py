"""Frames that may be among the nearest, or are within a radius: gathered lane by lane, sifted, and put in order."""

from __future__ import annotations

import math

import numpy as np

from operators.neighbours.lanes import array_of, bits_of, count_above, lowest, none_counted, number_of, store_counts
from operators.neighbours.layout import (
    AT_NEAR,
    AT_REACH,
    AT_SQUARED,
    BLOCK,
    BLOCKS,
    COUNTED,
    FARTHEST,
    FOUND,
    IN_FRAMES,
    IN_KEYS,
    IN_MARKS,
    IN_NEAR,
    IN_RANKS,
    LANES,
    NEAR,
    ROOM,
    VECTOR,
    Floats,
)
from operators.neighbours.window import oldest
from stream.chunk import Times
from stream.kernel import kernel

NOTHING = np.float32(-1.0)
"""A limit that no distance keeps."""


@kernel
def gather(
    floats: Floats,
    books: Times,
    limit: np.float32,
    slot: int,
    lanes: int,
    sums: int,
    at: int,
    band: int,
    k: int,
    within: np.float32,
    both: bool,
) -> tuple[np.float32, int]:
    """Keep the frames in some lanes from `slot` on as candidates for the nearest (d2 <= `limit`), and mark those within a radius."""
    marked, found, room = 0, books[FOUND], books[ROOM]
    frames, keys, first = books[IN_FRAMES] + slot, books[IN_KEYS], oldest(books)
    reaches = books[AT_REACH] + slot
    while lanes:
        lane = lowest(lanes)
        lanes &= lanes - 1
        frame = books[frames + lane]
        if abs(frame - at) <= band:
            continue
        squared = floats[sums + lane]
        if squared <= limit:
            books[keys + found] = bits_of(squared) << 32 | (frame - first)
            found += 1
            if found == room:
                books[FOUND] = found
                sift(books, k)
                found = books[FOUND]
                limit = number_of(books[keys + k - 1] >> 32)
        if squared <= within or (both and squared <= floats[reaches + lane]):
            place = frame % (books[BLOCKS] * books[BLOCK])
            floats[books[AT_SQUARED] + place] = squared
            books[books[IN_MARKS] + place // 64] |= 1 << (place % 64)
            marked += 1
    books[FOUND] = found
    return limit, marked


@kernel
def sift(books: Times, k: int) -> None:
    """Keep the k smallest of all candidates' keys, of which there are more, the largest of these at place k - 1 (Hoare's quickselect)."""
    keys = books[IN_KEYS]
    low, high = keys, keys + books[FOUND] - 1
    wanted = keys + k - 1
    while low < high:
        pivot = books[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while books[i] < pivot:
                i += 1
            while books[j] > pivot:
                j -= 1
            if i <= j:
                books[i], books[j] = books[j], books[i]
                i += 1
                j -= 1
        if wanted <= j:
            high = j
        elif wanted >= i:
            low = i
        else:
            break
    books[FOUND] = k


@kernel
def put_in_order(floats: Floats, books: Times, k: int) -> None:
    """The k smallest keys become the list of the nearest."""
    if books[FOUND] > COUNTED and books[FOUND] > k:
        sift(books, k)
    count, keys, ranks = books[FOUND], books[IN_KEYS], books[IN_RANKS]
    rank(books, keys, count, ranks)
    books[NEAR] = min(count, k)
    first, frames, squared = oldest(books), books[IN_NEAR], books[AT_NEAR]
    for i in range(count):
        key, place = books[keys + i], books[ranks + i]
        floats[squared + place] = number_of(key >> 32)
        books[frames + place] = first + (key & 0xFFFFFFFF)


@kernel
def rank(books: Times, keys: int, count: int, ranks: int) -> None:
    """The places of keys in their order: few by counting, for each, those that are smaller; many by being sorted."""
    if count > COUNTED:
        array_of(books, keys + count)[keys:].sort()
        for i in range(count):
            books[ranks + i] = i
    elif books[VECTOR]:
        for i in range(0, count, LANES):
            smaller = none_counted()
            for j in range(count):
                smaller = count_above(smaller, books, keys + i, books[keys + j])
            store_counts(books, ranks + i, smaller)
    else:
        for i in range(count):
            smaller = 0
            for j in range(count):
                smaller += books[keys + j] < books[keys + i]
            books[ranks + i] = smaller


@kernel
def radius_squared(radius: float) -> np.float32:
    """The largest d2 whose root, rounded to float32, is at most the radius in float32: so d <= r holds for what is reported.

    Negative for no radius: NaN, or below 0.
    """
    if not radius >= 0.0:
        return np.float32(-1.0)
    if radius * radius >= FARTHEST:
        return FARTHEST
    r = np.float32(radius)
    squared = r * r
    while squared < FARTHEST and math.sqrt(np.nextafter(squared, FARTHEST)) <= r:
        squared = np.nextafter(squared, FARTHEST)
    while math.sqrt(squared) > r:
        squared = np.nextafter(squared, np.float32(-1.0))
    return squared
