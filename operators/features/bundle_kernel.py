"""Feature bundling, one frame: towards where its neighbours are densest, across its direction of movement (thesis 2.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kinegraph.operators.features.eigen import symmetric_eigen
from kinegraph.operators.neighbours.bare import bare_index
from kinegraph.operators.neighbours.candidates import NOTHING
from kinegraph.operators.neighbours.layout import LANES, BareIndex, Floats
from kinegraph.operators.neighbours.search import search
from kinegraph.operators.neighbours.window import insert, prepare, slot_of, tile_at
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.compiler.record import numbers_of, record
from kinegraph.stream.data.finite import finite
from kinegraph.stream.kernel import kernel

CLIMB = 200
"""The most steps of an ascent; some 20 are usual."""
STILL = 1e-6
"""An ascent ends with a step shorter than this, in standard deviations."""


class BundleNumbers:
    k: int
    variance: float
    ahead: int
    furthest: int
    frames: int
    unmade: int


@record
@dataclass(slots=True)
class BundleMemory(BundleNumbers):
    """
    k, variance  how many neighbours, and the share of their variance that is kept
    ahead        a frame is bundled once this many have come after it
    furthest     frames further apart in time than this (ns) do not follow one another
    frames       since the last break;  unmade: how many before them do not come out
    recent       (ahead + 3, d)  the newest frames, by their number since the last break modulo that length
    past         (2, ahead + 1)  stamps of the newest frames, and how many are lost before each
    ways         (3, d)  ways[0]: the direction of movement, any length, 0 if unknown; the rest is room
    pull (d, k), gram (k, k), basis (k, k), values to here (k,)  room, which remembers nothing
    """

    numbers: Array
    recent: Samples
    past: Times
    ways: Samples
    pull: Samples
    gram: Samples
    basis: Samples
    values: Samples
    rest: Samples
    weights: Samples
    aside: Samples
    here: Samples


NUMBERS = numbers_of(BundleNumbers)


@kernel
def bundle(ix: BareIndex, at: int, s: BundleMemory, frame: Samples, out: Samples) -> int:
    """Write the bundled `frame` (d,), which is number `at` of the index, into `out` (d,); returns how many steps that took.

    The neighbours less the frame lose what lies along the direction. Of their principal components, found from the k x k matrix of
    products, as many are kept as hold `variance`; in these, each over its standard deviation, the density is a sum of Gaussians with
    Scott's bandwidth k^(-1 / (dimensions + 4)), and mean shift climbs from the frame to the next maximum. What lies outside of the
    kept components becomes the neighbours' mean. So the frame stays where it is along its way, and moves only across.
    """
    k, ways, pull, basis = s.k, s.ways, s.pull, s.basis
    values, weights, aside, here = s.values, s.weights, s.aside, s.here
    prepare(ix, frame)
    search(ix, at, 0, k, NOTHING, False)
    count = ix.near_count
    d = frame.shape[0]
    if count < 3:
        for i in range(d):
            out[i] = frame[i]
        return 0
    gather_across(ix, count, frame, ways, pull)
    products(pull, count, ways[1], s.gram, aside)
    symmetric_eigen(s.gram, count, values, s.rest, basis)
    kept = principal(count, s.variance, values, basis)
    for c in range(kept):
        total = 0.0
        for j in range(count):
            total += basis[c, j] * aside[j]
        here[c] = -math.sqrt(count - 1.0) * total / values[c]
        for j in range(count):
            basis[c, j] *= math.sqrt(count - 1.0)
    steps = climb(count, kept, basis, weights, here)
    for j in range(count):
        weight = 0.0
        for c in range(kept):
            weight += here[c] * basis[c, j]
        weights[j] = weight / (count - 1.0)
    for i in range(d):
        total = ways[1, i]
        for j in range(count):
            total += weights[j] * pull[i, j]
        out[i] = frame[i] + total
    return steps


@kernel
def gather_across(ix: BareIndex, count: int, frame: Samples, ways: Samples, pull: Samples) -> None:
    """The nearest that were found, less the frame, what lies along `ways[0]`, and their mean: columns of `pull`; mean in `ways[1]`."""
    d = frame.shape[0]
    for j in range(count):
        slot = slot_of(ix, ix.near[j])
        row = tile_at(ix, slot // LANES) + slot % LANES
        for i in range(d):
            pull[i, j] = ix.floats[row + (1 + i) * LANES] - frame[i]
    length = 0.0
    for i in range(d):
        length += ways[0, i] * ways[0, i]
    ways[2, :count] = 0.0
    if length > 0.0:
        for i in range(d):
            for j in range(count):
                ways[2, j] += ways[0, i] * pull[i, j]
    for i in range(d):
        share = ways[0, i] / length if length > 0.0 else 0.0
        total = 0.0
        for j in range(count):
            pull[i, j] -= share * ways[2, j]
            total += pull[i, j]
        ways[1, i] = total / count
        for j in range(count):
            pull[i, j] -= ways[1, i]


@kernel
def products(pull: Samples, count: int, mean: Samples, gram: Samples, aside: Samples) -> None:
    """Products of the first `count` columns of `pull` (d, k) with one another, into `gram`, and with the mean, into `aside`."""
    for a in range(count):
        aside[a] = 0.0
        for b in range(count):
            gram[a, b] = 0.0
    for i in range(pull.shape[0]):
        for a in range(count):
            for b in range(count):
                gram[a, b] += pull[i, a] * pull[i, b]
            aside[a] += pull[i, a] * mean[i]


@kernel
def principal(count: int, variance: float, values: Samples, basis: Samples) -> int:
    """Put the largest components first, until they hold this share of the variance; returns how many. Rows of `basis` follow."""
    whole = 0.0
    for c in range(count):
        values[c] = max(values[c], 0.0)
        whole += values[c]
    held, kept = 0.0, 0
    while kept < count - 1 and held < variance * whole:
        best = kept
        for c in range(kept + 1, count):
            if values[c] > values[best]:
                best = c
        values[kept], values[best] = values[best], values[kept]
        for j in range(count):
            basis[kept, j], basis[best, j] = basis[best, j], basis[kept, j]
        held += values[kept]
        kept += 1
    return kept


@kernel
def climb(count: int, kept: int, points: Samples, weights: Samples, here: Samples) -> int:
    """Mean shift from `here` to a maximum of the density of `points` (kept, count), each dimension of standard deviation 1."""
    wide = count ** (-2.0 / (kept + 4.0))
    for step in range(CLIMB):
        for j in range(count):
            weights[j] = 0.0
        for c in range(kept):
            for j in range(count):
                apart = points[c, j] - here[c]
                weights[j] += apart * apart
        nearest = math.inf
        for j in range(count):
            nearest = min(nearest, weights[j])
        total = 0.0
        for j in range(count):
            weights[j] = math.exp((nearest - weights[j]) / (2.0 * wide))
            total += weights[j]
        moved = 0.0
        for c in range(kept):
            there = 0.0
            for j in range(count):
                there += weights[j] * points[c, j]
            there /= total
            moved += (there - here[c]) ** 2
            here[c] = there
        if moved < STILL * STILL:
            return step + 1
    return CLIMB


@kernel
def bundle_frames(
    floats: Floats, books: Times, s: BundleMemory, x: Samples, time: Times, lost: int, out: Samples, when: Times
) -> int:
    """Insert each of `x` (n, d), and bundle the one that came `ahead` frames before it; returns how many rows of `out` were made.

    lost     how many are lost before the first
    when     (2, n)  stamp of each row made, and how many are lost before it
    """
    ix = bare_index(floats, books)
    recent, past, ways, ahead = s.recent, s.past, s.ways, s.ahead
    ring, d = recent.shape[0], recent.shape[1]
    made = 0
    for i in range(x.shape[0]):
        if s.frames and time[i] - past[0, ahead] > s.furthest:
            s.frames = 0
            s.unmade = -1
        for a in range(ahead):
            past[0, a], past[1, a] = past[0, a + 1], past[1, a + 1]
        past[0, ahead] = time[i]
        past[1, ahead] = lost if i == 0 else 0
        newest = s.frames
        for c in range(d):
            recent[newest % ring, c] = x[i, c]
        good = prepare(ix, x[i])
        insert(ix, good, NOTHING)
        s.frames += 1
        if newest < ahead:
            continue
        number = newest - ahead
        frame = recent[number % ring]
        when[0, made] = past[0, 0]
        when[1, made] = -1 if s.unmade < 0 or past[1, 0] < 0 else s.unmade + past[1, 0]
        s.unmade = 0
        fine = number >= 2
        if fine:
            before, behind = recent[(number - 1) % ring], recent[(number - 2) % ring]
            after, beyond = recent[(number + 1) % ring], recent[(number + 2) % ring]
            for c in range(d):
                ways[0, c] = 8.0 * (after[c] - before[c]) - (beyond[c] - behind[c])
                fine = fine and abs(ways[0, c]) < math.inf and abs(frame[c]) < math.inf
        if fine:
            bundle(ix, ix.next - 1 - ahead, s, frame, out[made])
        else:
            for c in range(d):
                out[made, c] = finite(frame[c])
        made += 1
    return made
