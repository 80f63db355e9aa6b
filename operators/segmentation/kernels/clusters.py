"""Exemplars, one per cluster: the first cycle of its kind, kept however long ago it was; which of them are alike."""

from __future__ import annotations

import numpy as np

from kinegraph.operators.segmentation.kernels.cycles import GAIN, advance, columns, travel
from kinegraph.operators.segmentation.kernels.layout import Memory
from kinegraph.stream.kernel import kernel


@kernel
def fit(s: Memory, slot: int, first: int, last: int, whole: bool) -> tuple[float, int]:
    """Mean distance of the cheapest warping path of an exemplar in frames first..last, and where it starts; `whole`: all along them."""
    length = s.exemplar_sizes[slot]
    cost = np.full((2, length), np.inf)
    begin = np.full((2, length), -1, np.int64)
    gain = GAIN * s.radius
    best, start = np.inf, first
    for i in range(first, last + 1):
        columns(s, i, slot, length)
        mean = advance(s.scratch, i, length, first, gain, cost, begin)
        if whole and (i < last or begin[0, length - 1] > first + length // 8):
            continue
        if mean < best:
            best, start = mean, begin[0, length - 1]
    return best, start


@kernel
def recognise(s: Memory, first: int, last: int, length: int) -> tuple[int, int]:
    """The known exemplar that fits best into frames first..last, which hold a cycle of `length` frames, and where; -1: none does."""
    best, found, met = s.radius, -1, first
    for slot in range(s.cluster_numbers.shape[0]):
        size = s.exemplar_sizes[slot]
        if s.cluster_numbers[slot] >= 0 and size * 3 <= length * 4 and length * 3 <= size * 4:
            mean, start = fit(s, slot, first, last, False)
            if mean < best:
                best, found, met = mean, slot, start
    return found, met


@kernel
def keep(s: Memory, first: int, length: int) -> int:
    """`length` frames from `first` on are the exemplar of a new cluster; its slot. Where all are taken, the one not used for longest."""
    slot = 0
    for k in range(s.cluster_numbers.shape[0] - 1, -1, -1):
        if s.cluster_numbers[k] < 0:
            slot = k
    if s.cluster_numbers[slot] >= 0:
        slot = int(np.argmin(s.exemplar_uses))
    for d in range(s.frames.shape[0]):
        for c in range(length):
            s.exemplars[slot, d, c] = s.frames[d, (first + c) % s.times.shape[0]]
    s.exemplar_sizes[slot], s.cluster_numbers[slot] = length, s.next_cluster
    s.leads[slot] = 0.0
    s.travels[slot] = travel(s, first, first + length - 1, length)
    s.next_cluster += 1
    use(s, slot)
    return slot


@kernel
def use(s: Memory, slot: int) -> None:
    s.clock += 1
    s.exemplar_uses[slot] = s.clock


@kernel
def alike(s: Memory, slot: int, first: int, last: int) -> int:
    """Compare frames first..last, of cluster `slot`, with one other exemplar, each in its turn: its slot if both are one; else -1."""
    count = s.cluster_numbers.shape[0]
    for k in range(count):
        other = (s.turn + k) % count
        size, length = s.exemplar_sizes[other], last - first + 1
        if other == slot or s.cluster_numbers[other] < 0 or size > 2 * length or length > 2 * size:
            continue
        s.turn = other + 1
        return other if fit(s, other, first, last, True)[0] <= s.radius else -1
    return -1
