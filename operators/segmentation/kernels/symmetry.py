"""How a movement and its mirror image go together: both sides at once, one after the other, or not at all (thesis 2.4, S1 to S3)."""

from __future__ import annotations

import math

from kinegraph.operators.segmentation.kernels.cycles import TRUSTS
from kinegraph.operators.segmentation.kernels.layout import Memory
from kinegraph.stream.kernel import kernel

UNKNOWN, AT_ONCE, IN_TURN, NOT = range(4)
"""What is reported as an activity's symmetry; 1 to 3 are S1 to S3."""
CLOSER = 0.6
"""Sides take turns where the second step is this much nearer to the first one's mirror image than the cycle is to its own."""


@kernel
def symmetry(s: Memory, slot: int, first: int, stop: int) -> tuple[int, int]:
    """The symmetry of the cycle first..stop-1 of an exemplar's kind, and where the second step begins if the sides take turns, else -1.

    The first time they do in such a cycle, the steps must lie as near to each other as a repetition to its exemplar.
    """
    if not s.mirrored.shape[0]:
        return UNKNOWN, -1
    at_once, radius = to_mirror(s, first, stop), s.radius
    if math.isnan(at_once):
        return UNKNOWN, -1
    half = second_step(s, first, stop)
    if half >= 0 and (s.leads[slot] != 0.0 or to_other_step(s, first, half, stop) <= TRUSTS * radius):
        return IN_TURN, half
    return AT_ONCE if at_once <= radius else NOT, -1


@kernel
def leader(s: Memory, slot: int, first: int, half: int, stop: int) -> int:
    """Whose step is the first, by all cycles of its kind so far: 1, if the first of each pair moves more in it than in the other."""
    s.leads[slot] += moves(s, first + 1, half) - moves(s, half, stop)
    return 1 if s.leads[slot] >= 0.0 else 2


@kernel
def second_step(s: Memory, first: int, stop: int) -> int:
    """The frame from which on the cycle first..stop-1 is the mirror image of what it was until then; -1: it is not.

    Neither step is more than twice as long as the other, as nowhere else; both run evenly.
    """
    third = (stop - first + 2) // 3
    best, half = CLOSER * to_mirror(s, first, stop), -1
    for middle in range(first + max(1, third), stop - third + 1):
        mean = to_other_step(s, first, middle, stop)
        if mean < best:
            best, half = mean, middle
    return half


@kernel
def apart(s: Memory, i: int, j: int) -> float:
    """Distance of frame `i` to the mirror image of frame `j`."""
    i, j = i % s.times.shape[0], j % s.mirrored.shape[0]
    total, common = 0.0, 0.0
    for d in range(s.frames.shape[0]):
        far = s.frames[d, i] - s.mirrored[j, d]
        if not math.isnan(far):
            total += far * far
            common += 1.0
    return math.sqrt(total / common) if common else math.nan


@kernel
def to_mirror(s: Memory, first: int, stop: int) -> float:
    """Mean distance of frames first..stop-1 to their own mirror images."""
    total = 0.0
    for i in range(first, stop):
        total += apart(s, i, i)
    return float(total / (stop - first))


@kernel
def to_other_step(s: Memory, first: int, middle: int, stop: int) -> float:
    """Mean distance of the step first..middle-1 to the mirror image of the step middle..stop-1, both run through evenly."""
    n, total = (stop - first) // 2, 0.0
    for c in range(n):
        total += apart(s, first + c * (middle - first) // n, middle + c * (stop - middle) // n)
    return float(total / n)


@kernel
def moves(s: Memory, first: int, stop: int) -> float:
    """How much more the first of each pair moves than the second in frames first..stop-1: squared steps, summed."""
    ring, total = s.times.shape[0], 0.0
    for i in range(first, stop):
        for d in range(s.firsts.shape[0]):
            if not s.firsts[d]:
                continue
            own = s.frames[d, i % ring] - s.frames[d, (i - 1) % ring]
            other = s.mirrored[i % ring, d] - s.mirrored[(i - 1) % ring, d]
            more = own * own - other * other
            total += more if not math.isnan(more) else 0.0
    return total
