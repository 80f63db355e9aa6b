"""Gestures from a resting pose, where no cycle is found: out of it, as far as others, and back to it."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.segmentation.kernels.corrections import tell_span
from kinegraph.operators.segmentation.kernels.distances import between
from kinegraph.operators.segmentation.kernels.events import stamp, tell
from kinegraph.operators.segmentation.kernels.layout import (
    PRIMITIVE_EVENT,
    Memory,
)
from kinegraph.stream.chunk import Times
from kinegraph.stream.kernel import kernel

STANDS = 0.75
"""A resting pose lies at most this many radii from the frames of the `quiet` before it, on the mean."""
EXTENT = 2.0
"""An excursion goes at least this many radii away from it."""
HOME = 0.4
"""It begins and ends where its distance has fallen to this share of its largest."""
LIKE_IT = 0.5
"""Excursions are alike if neither goes less than this share as far as the other; their farthest frames lie no further apart than that."""
MOST = 128
"""What goes out and back more often within a few of the longest cycles is no gesture: none of it counts."""


@kernel
def excursions(s: Memory, first: int, last: int, radius: float) -> Times:
    """Those whose farthest frame is one of first..last: first and last frame of each (n, 2), cut to first..last.

    Only those count to which another one is alike, of all that are seen up to `max_lag` before `first` and after `last`.
    """
    start = max(s.since, first - s.max_lag, s.next_frame - 3 * s.max_lag - s.firm)
    stop = min(s.next_frame, last + 1 + s.max_lag)
    pose = resting_pose(s, max(first, start + s.quiet), last, radius)
    found = outings(s, start, stop, pose, radius)
    chosen, n = np.empty((len(found), 2), np.int64), 0
    if len(found) > MOST:
        return chosen[:0]
    for k in range(len(found)):
        onset, end = max(found[k, 0], first), min(found[k, 2], last)
        mine = first <= found[k, 1] <= last and 2 * (end + 1 - onset) > found[k, 2] + 1 - found[k, 0]
        if mine and any_like(s, found, k, pose):
            chosen[n, 0], chosen[n, 1] = onset, end
            n += 1
    return chosen[:n]


@kernel
def resting_pose(s: Memory, first: int, last: int, radius: float) -> int:
    """Of the frames first..last the one that lies nearest to those of the `quiet` before it; -1: none stands still."""
    quiet, least, pose = s.quiet, STANDS * radius, -1
    for i in range(first, last + 1):
        total = 0.0
        for k in range(1, quiet + 1):
            total += s.rows[i % s.rows.shape[0], k]
        if total / quiet < least:
            least, pose = total / quiet, i
    return int(pose)


@kernel
def outings(s: Memory, start: int, stop: int, pose: int, radius: float) -> Times:
    """Excursions in the frames start..stop-1 from frame `pose`: first, farthest and last frame (n, 3)."""
    found, n = np.empty((max(0, stop - start), 3), np.int64), 0
    if pose < 0:
        return found[:0]
    nearest, least, farthest, most = start, math.inf, -1, 0.0
    for i in range(start, stop):
        far = between(s, i, pose)
        if far == math.inf:
            continue
        if farthest < 0:
            if far <= least:
                nearest, least = i, far
            elif far >= EXTENT * radius and least <= HOME * far:
                farthest, most = i, far
        elif far > most:
            farthest, most = i, far
        elif far <= HOME * most:
            found[n, 0], found[n, 1], found[n, 2] = nearest, farthest, i
            n += 1
            nearest, least, farthest = i, far, -1
    return found[:n]


@kernel
def any_like(s: Memory, found: Times, k: int, pose: int) -> bool:
    """Whether one of the other excursions from `pose` goes about as far as number `k`, and to about the same place."""
    own = between(s, found[k, 1], pose)
    for j in range(len(found)):
        if j != k:
            other = between(s, found[j, 1], pose)
            less, more = min(own, other), max(own, other)
            if less >= LIKE_IT * more and between(s, found[k, 1], found[j, 1]) <= LIKE_IT * less:
                return True
    return False


@kernel
def tell_excursions(s: Memory, last: int, activity: int, told: int, radius: float) -> int:
    """Report the excursions among the frames `pieces_from`..last of an activity, and the parts between them; how many there are.

    The numbers of its repetitions go on after `told`.
    """
    found = excursions(s, s.pieces_from, last, radius)
    for k in range(len(found)):
        onset, end = max(found[k, 0], s.pieces_from), found[k, 1]
        if onset > s.pieces_from:
            tell(s, PRIMITIVE_EVENT, s.pieces_at, stamp(s, onset - 1), activity, 0, -1, 0)
            go_on(s, onset)
        tell_span(s, s.pieces_at, stamp(s, end), activity, told + k + 1)
        tell(s, PRIMITIVE_EVENT, s.pieces_at, stamp(s, end), activity, told + k + 1, -1, 0)
        go_on(s, end + 1)
    return len(found)


@kernel
def go_on(s: Memory, first: int) -> None:
    """Primitives are reported up to the frame before `first`."""
    s.reported_to = stamp(s, first - 1)
    s.pieces_from, s.pieces_at = first, s.times[first % s.times.shape[0]]
