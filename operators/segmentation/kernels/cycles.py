"""The first cycle of an activity, by the lag at which it comes back to itself; and its later ones, by warping paths along the first."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.segmentation.kernels.distances import scaled
from kinegraph.operators.segmentation.kernels.layout import (
    Memory,
)
from kinegraph.operators.segmentation.kernels.rest import reported_at_rest
from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

DIP = 0.6
"""A cycle's lag is where the mean distance falls to this share of the largest one at a shorter lag, and to the radius."""
RETURNS = 0.75
"""With this share in place of DIP, and TRUSTS radii, there is no cycle to count, but motion that comes back: an activity of its own."""
SEEN = 0.7
"""This much of the second cycle must have been seen."""
LEAVES = 0.8
"""The largest mean distance at a shorter lag must be at least this share of the radius: who hardly moves has no cycle."""
GAIN = 0.3
"""What a path's step costs is its distance less this share of the radius; without it paths would shrink to their cheapest part."""
TRUSTS = 1.25
"""A known cycle's repetition may lie this many radii away on average, and so may motion that comes back."""
SURE, STRAYS, SAME = 3, 4.0, 0.4
"""Once SURE repetitions have been told, the next may lie STRAYS times as far from the exemplar as they do, or SAME radii: an activity's own
radius. Half a knee's raise lies within the radius of a squat, but eight times as far from it as one squat from another."""
FAR = 100.0
"""This many radii apart are frames that have too few features in common, where a mean is taken."""
LONGEST = 2
"""Paths advance by slopes from 1 / LONGEST to LONGEST, on the whole."""


@kernel
def sum_up(s: Memory, i: int) -> None:
    """Frame `i`'s distances at each lag, back to `origin`, added to those of the frames before it."""
    row, sums, before = s.rows[i % s.rows.shape[0]], s.sums[i % s.sums.shape[0]], s.sums[(i - 1) % s.sums.shape[0]]
    for k in range(1, s.max_lag + 1):
        if k > i - s.origin:
            sums[k] = 0.0
        else:
            sums[k] = before[k] + (row[k] if row[k] < math.inf else FAR * s.radius)


@kernel
def last_cycle(s: Memory, i: int, k: int) -> float:
    """Mean distance of the newest frames to those `k` before them: of as many as a cycle has, or opens an activity, back to `origin`."""
    n = min(max(k, s.mass), i - s.origin + 1 - k)
    total = s.sums[i % s.sums.shape[0], k] - s.sums[(i - n) % s.sums.shape[0], k]
    return float(total / n)


@kernel
def cycle_length(s: Memory, i: int, last_chance: bool) -> int:
    """The cycle's length by what the newest frames, up to `i`, have in common with those before them; 0: none. Notes in `has_returned`
    whether they come back at all, if not as closely as for a cycle.
    """
    last = longest_lag(s, i - s.origin + 1)
    for k in range(1, last + 1):
        s.scratch[k] = last_cycle(s, i, k)
    length, returned = first_dip(s, last, 0 if last_chance else last)
    if returned:
        s.has_returned = True
    return length


@kernel
def longest_lag(s: Memory, seen: int) -> int:
    """The longest lag that `seen` frames say something about."""
    last = 0
    for k in range(1, s.max_lag + 1):
        if seen - k < SEEN * max(k, s.mass):
            break
        last = k
    return last


@kernel
def first_dip(s: Memory, last: int, later: int) -> tuple[int, bool]:
    """The shortest lag at which frames come back to themselves (as YIN finds a pitch, on distances; 0: none), and whether they do at all.

    Mean distances at the lags 1..last are in `scratch`. The lag must be the lowest among those about as long, of which as many that are
    longer must be known, but no more than `later`.
    """
    largest, returned, radius, means = 0.0, False, s.radius, s.scratch
    for k in range(1, last + 1):
        mean = means[k]
        if k >= s.band and largest >= LEAVES * radius and mean < RETURNS * largest and mean <= TRUSTS * radius:
            returned = True
            wide = max(2, k // 5)
            lowest = mean < DIP * largest and mean <= radius
            if lowest and k + min(wide, later) > last:
                return 0, True
            for j in range(k - wide, min(k + wide, last) + 1):
                lowest = lowest and means[j] >= mean
            if lowest:
                return k, True
        largest = max(largest, mean)
    return 0, returned


@kernel
def columns(s: Memory, i: int, slot: int, length: int) -> None:
    """Distances of frame `i` to the exemplar's frames, into `scratch`."""
    out, common = s.scratch, s.common
    ring = s.times.shape[0]
    for c in range(length):
        out[c] = common[c] = 0.0
    for d in range(s.frames.shape[0]):
        v = s.frames[d, i % ring]
        line = s.exemplars[slot, d]
        for c in range(length):
            apart = v - line[c]
            if not math.isnan(apart):
                out[c] += apart * apart
                common[c] += 1.0
    for c in range(length):
        out[c] = scaled(s, out[c], common[c])
        if out[c] == math.inf:
            out[c] = FAR * s.radius


@kernel
def advance(apart: Samples, i: int, length: int, free: int, gain: float, cost: Samples, begin: Times) -> float:
    """One frame of the dynamic programme: the cheapest warping paths that end at frame `i`, at each column of an exemplar.

    Paths start at column 0, at frame `free` or later, and go by steps (1,1), weight 2, (1,0) and (0,1), weight 1. cost, begin (2, columns):
    row 0 of the frame before, row 1 of this one; both are moved on. Returns the mean distance of the path that has come to the last
    column, infinity if there is none within the slopes; it began at begin[0, length - 1].
    """
    for c in range(length):
        step = apart[c] - gain
        best, start = math.inf, -1
        if c == 0:
            if i >= free:
                best, start = 2.0 * step, i
        else:
            if cost[0, c - 1] + 2.0 * step < best:
                best, start = cost[0, c - 1] + 2.0 * step, begin[0, c - 1]
            if cost[1, c - 1] + step < best:
                best, start = cost[1, c - 1] + step, begin[1, c - 1]
            if cost[0, c] + step < best:
                best, start = cost[0, c] + step, begin[0, c]
        if start < free or i - start >= LONGEST * length:
            best, start = math.inf, -1
        cost[1, c], begin[1, c] = best, start
    for c in range(length):
        cost[0, c], begin[0, c] = cost[1, c], begin[1, c]
    frames = i - begin[0, length - 1] + 1
    if cost[0, length - 1] == math.inf or frames * LONGEST < length:
        return math.inf
    return float(cost[0, length - 1] / (frames + length) + gain)


@kernel
def begin_tracking(s: Memory, free: int) -> None:
    """Nothing known of the exemplar's paths; they may start at frame `free`."""
    s.cost[:] = np.inf
    s.begin[:] = -1
    s.free = free
    s.best_start = s.best_end = -1
    s.best = np.inf


@kernel
def patience(length: int) -> int:
    """For how many frames a complete path waits for a cheaper one before it is accepted."""
    return max(3, length // 4)


@kernel
def slack(length: int) -> int:
    """The longest pause between two repetitions that counts as part of the first."""
    return length // 2


@kernel
def travel(s: Memory, first: int, last: int, length: int) -> float:
    """How far frames first..last move, from stride to stride, of which a cycle of `length` frames has eight."""
    stride, total = max(1, length // 8), 0.0
    for i in range(first + stride, last + 1, stride):
        far = s.rows[i % s.rows.shape[0], stride]
        total += far if far < math.inf else 0.0
    return total


@kernel
def trusted(s: Memory) -> float:
    """How far a repetition may lie from its exemplar: TRUSTS radii, and as soon as SURE have shown how far theirs do, STRAYS times that."""
    radius = s.radius
    if s.like_count < SURE:
        return float(TRUSTS * radius)
    return float(min(TRUSTS * radius, max(STRAYS * s.farthest, SAME * radius)))


@kernel
def track(s: Memory, i: int) -> bool:
    """Follow the exemplar's paths to frame `i`; True if the best one (`best_start` to `best_end`) is now accepted. None begins at rest."""
    length = s.length
    for c in range(length):
        if s.begin[0, c] >= 0 and reported_at_rest(s, s.begin[0, c]):
            s.cost[0, c], s.begin[0, c] = math.inf, -1
    columns(s, i, s.slot, length)
    radius = s.radius
    mean = advance(s.scratch, i, length, s.free, GAIN * radius, s.cost, s.begin)
    better = mean <= trusted(s) and mean < s.best
    if better and travel(s, s.begin[0, length - 1], i, length) >= s.travel_share * s.travels[s.slot]:
        s.best = mean
        s.best_start, s.best_end = s.begin[0, length - 1], i
    return bool(s.best_end >= 0 and i - s.best_end >= patience(length))


@kernel
def release(s: Memory) -> None:
    """The best path is accepted: the next one starts about where it ended."""
    s.free = s.best_end + 1 - patience(s.length) // 2
    for c in range(s.length):
        if s.begin[0, c] < s.free:
            s.cost[0, c], s.begin[0, c] = np.inf, -1
    s.best_start = s.best_end = -1
    s.best = np.inf
