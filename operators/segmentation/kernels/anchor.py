"""Where an activity's repetitions begin, once their cycle is known: its start, and the phase that they are cut at."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.segmentation.kernels.cycles import begin_tracking, release, slack, track
from kinegraph.operators.segmentation.kernels.distances import between
from kinegraph.operators.segmentation.kernels.layout import (
    Memory,
)
from kinegraph.operators.segmentation.kernels.rest import at_rest, reported_at_rest
from kinegraph.stream.kernel import kernel

HOLE = 8
"""Frames without a neighbour one cycle later, for up to a HOLE-th of a cycle, do not end what comes back."""


@kernel
def lead_in(s: Memory, start: int, length: int) -> int:
    """The first of the frames before `start` that come back about a cycle of `length` frames later, as those after it do.

    When the activity began, what they come back to had not been seen yet. In one that goes on, only a rest says where motion began: `start`
    itself, unless they lead back to one.
    """
    first, hole = start, max(s.quiet, length // HOLE)
    shortest, longest = max(1, 2 * length // 3), min(s.max_lag, 3 * length // 2)
    least = max(s.seed, s.opened - 2 * s.max_lag)
    if s.is_start_final:
        least = max(least, s.pieces_from, start - s.max_lag)
    i = start - 1
    while i >= least and first - i <= hole:
        if s.is_start_final and reported_at_rest(s, i):
            return int(first)
        if s.near[i % s.near.shape[0]] != 2 and not at_rest(s, i):
            for k in range(shortest, min(longest, s.next_frame - 1 - i) + 1):
                if s.rows[(i + k) % s.rows.shape[0], k] <= s.radius:
                    first = i
                    break
        i -= 1
    return int(start if s.is_start_final else first)


@kernel
def in_phase(s: Memory, start: int, first: int, last: int) -> int:
    """Which of the frames first..last is at the phase that `start` is at: no part of a repetition is left over at the head."""
    if start >= first:
        return first
    n = max(1, (last - first) // HOLE)
    best, found = math.inf, first
    for j in range(first, last + 1):
        total = 0.0
        for c in range(n):
            total += between(s, start + c, j + c)
        if total < best:
            best, found = total, j
    return found


@kernel
def first_whole(start: int, met: int, length: int) -> int:
    """From where on a repetition of a known cycle of `length` frames may begin, in motion that starts at `start` and is met at `met`.

    What starts in the middle of a cycle begins with its rest, which is no repetition, though a path might be bent to it.
    """
    head = (met - start) % length
    if 4 * head > 3 * length:
        return start
    return max(start, start + head - length // HOLE)


@kernel
def look_back(s: Memory, i: int, start: int) -> int:
    """Where the repetitions up to frame `i` begin, once their cycle is known: those just before `start` belong to them."""
    first = max(s.pieces_from if s.is_start_final else s.unreported, start - s.max_lag)
    if first >= start:
        return start
    starts, ends, count = np.empty(2 * s.max_lag, np.int64), np.empty(2 * s.max_lag, np.int64), 0
    begin_tracking(s, first)
    for j in range(first, i + 1):
        if track(s, j):
            starts[count], ends[count] = s.best_start, s.best_end
            count += 1
            release(s)
    for k in range(count - 1, -1, -1):
        if starts[k] < start and ends[k] + slack(s.length) >= start:
            start = starts[k]
    return start
