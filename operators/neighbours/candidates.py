"""Frames that may be among the nearest, or are within a radius: gathered lane by lane, sifted, and put in order."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.neighbours.layout import COUNTED, FARTHEST, LANES, BareIndex
from kinegraph.operators.neighbours.vectors import (
    array_of,
    bits_of,
    count_above,
    lowest,
    none_counted,
    number_of,
    store_counts,
)
from kinegraph.operators.neighbours.window import oldest
from kinegraph.stream.kernel import kernel

NOTHING = np.float32(-1.0)
"""A limit that no distance keeps."""


@kernel
def gather(
    ix: BareIndex,
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
    marked, found, room = 0, ix.found, ix.room
    keys, first = ix.keys, oldest(ix)
    while lanes:
        lane = lowest(lanes)
        lanes &= lanes - 1
        frame = ix.frames[slot + lane]
        if abs(frame - at) <= band:
            continue
        squared = ix.floats[sums + lane]
        if squared <= limit:
            keys[found] = bits_of(squared) << 32 | (frame - first)
            found += 1
            if found == room:
                ix.found = found
                sift(ix, k)
                found = ix.found
                limit = number_of(keys[k - 1] >> 32)
        if squared <= within or (both and squared <= ix.reach[slot + lane]):
            place = frame % (ix.blocks * ix.block)
            ix.squared[place] = squared
            ix.marks[place // 64] |= 1 << (place % 64)
            marked += 1
    ix.found = found
    return limit, marked


@kernel
def sift(ix: BareIndex, k: int) -> None:
    """Keep the k smallest of all candidates' keys, of which there are more, the largest of these at place k - 1 (Hoare's quickselect)."""
    keys = ix.keys
    low, high = 0, ix.found - 1
    wanted = k - 1
    while low < high:
        pivot = keys[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while keys[i] < pivot:
                i += 1
            while keys[j] > pivot:
                j -= 1
            if i <= j:
                keys[i], keys[j] = keys[j], keys[i]
                i += 1
                j -= 1
        if wanted <= j:
            high = j
        elif wanted >= i:
            low = i
        else:
            break
    ix.found = k


@kernel
def put_in_order(ix: BareIndex, k: int) -> None:
    """The k smallest keys become the list of the nearest."""
    if ix.found > COUNTED and ix.found > k:
        sift(ix, k)
    count, keys, ranks = ix.found, ix.keys, ix.ranks
    rank(ix, count)
    ix.near_count = min(count, k)
    first, frames, squared = oldest(ix), ix.near, ix.near_squared
    for i in range(count):
        key, place = keys[i], ranks[i]
        squared[place] = number_of(key >> 32)
        frames[place] = first + (key & 0xFFFFFFFF)


@kernel
def rank(ix: BareIndex, count: int) -> None:
    """The places of the candidates' keys in their order: few by counting, for each, those that are smaller; many by being sorted."""
    keys, ranks = ix.keys, ix.ranks
    if count > COUNTED:
        array_of(keys, count).sort()
        for i in range(count):
            ranks[i] = i
    elif ix.vector:
        for i in range(0, count, LANES):
            smaller = none_counted()
            for j in range(count):
                smaller = count_above(smaller, keys, i, keys[j])
            store_counts(ranks, i, smaller)
    else:
        for i in range(count):
            smaller = 0
            for j in range(count):
                smaller += keys[j] < keys[i]
            ranks[i] = smaller


@kernel
def radius_squared(radius: float) -> np.float32:
    """The largest d2 with a root, rounded to float32, of at most the radius in float32: so d <= r holds for what is reported.

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
