"""Aligned cluster analysis: cuts a recording so that its segments, compared by dynamic time alignment, fall into k tight clusters.

A contender for the benches, whole recordings only. Source: Zhou, De la Torre and Hodgins, "Aligned cluster analysis for temporal
segmentation of human motion" (2008): dynamic time alignment kernel, kernel k-means, dynamic programming over cuts, in turn until nothing
gets better. Departures: it begins with equal segments and several random labellings, of which the best end is kept; frames are thinned
evenly, not by k-means; segments are aligned backwards, from their ends. The hierarchy of HACA, which first cuts finer, is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

TURNS = 30
"""It has settled long before."""


@dataclass(frozen=True, slots=True)
class AlignedClusters:
    """starts (s,), ends (s,), cluster (s,) of each segment, and the energy: the sum of squared distances to the clusters' middles."""

    starts: Times
    ends: Times
    cluster: Times
    energy: float


def aligned_clusters(
    x: Samples, clusters: int, least: int, most: int, tries: int = 5, seed: int = 0
) -> AlignedClusters:
    """Cut `x` (n, d) into segments of `least` to `most` frames in this many clusters."""
    alike = frame_kernel(x)
    rng = np.random.default_rng(seed)
    best: AlignedClusters | None = None
    for _ in range(tries):
        starts = np.arange(0, len(x) - least + 1, (least + most) // 2)
        ends = np.append(starts[1:], len(x))
        label = rng.integers(clusters, size=len(starts))
        label[: min(clusters, len(starts))] = rng.permutation(min(clusters, len(starts)))
        made = settle(alike, AlignedClusters(starts, ends, label, math.inf), clusters, least, most)
        if best is None or made.energy < best.energy:
            best = made
    assert best is not None
    return best


def frame_kernel(x: Samples) -> Samples:
    """(n, n) Gaussian of the distances between frames; its width is their mean."""
    squares = (x**2).sum(1)
    far = np.maximum(squares[:, None] + squares - 2.0 * x @ x.T, 0.0)
    made: Samples = np.exp(-far / (2.0 * np.sqrt(far).mean() ** 2))
    return made


def settle(alike: Samples, now: AlignedClusters, clusters: int, least: int, most: int) -> AlignedClusters:
    """Cut by the clusters that are, and label what was cut, in turn, until the energy falls no more."""
    for _ in range(TURNS):
        label = k_means(alike, now, clusters)
        spread, count = inner(alike, now.starts, now.ends, label, clusters)
        starts, ends, cluster, energy = recut(alike, now.starts, now.ends, label, spread, count, least, most)
        then = AlignedClusters(starts, ends, cluster, energy)
        if energy >= now.energy - 1e-9:
            return now
        now = then
    return now


def k_means(alike: Samples, now: AlignedClusters, clusters: int) -> Times:
    """Kernel k-means of the segments, from the labels that are."""
    pairs = pairwise_alignment(alike, now.starts, now.ends)
    label = now.cluster.copy()
    for _ in range(TURNS):
        member = np.eye(clusters)[label]
        count = member.sum(0)
        inside = np.einsum("ic,ij,jc->c", member, pairs, member)
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.where(count > 0, -2.0 * pairs @ member / count + inside / count**2, np.inf)
        then = far.argmin(1)
        if (then == label).all():
            break
        label = then
    return label


@kernel
def pairwise_alignment(alike: Samples, starts: Times, ends: Times) -> Samples:
    """(s, s) the alignment kernel of every pair of segments, 1 of each with itself."""
    count = starts.shape[0]
    longest = (ends - starts).max()
    room, out, made = np.zeros((2, longest + 1)), np.zeros(longest + 1), np.ones((count, count))
    for i in range(count):
        for j in range(i):
            align_back(alike, ends[i], ends[i] - starts[i], starts[j], ends[j], room, out)
            made[i, j] = out[ends[i] - starts[i]]
            made[j, i] = made[i, j]
    return made


@kernel
def align_back(alike: Samples, end: int, most: int, start: int, stop: int, room: Samples, out: Samples) -> None:
    """The alignment kernel of the `n` frames before `end`, for every n up to `most`, with the frames `start` to `stop`, into `out[n]`.

    It is the kernel of both played backwards: so one pass gives all n.
    """
    width = stop - start
    before, now = room[0], room[1]
    for n in range(1, most + 1):
        i = end - n
        for m in range(1, width + 1):
            k = alike[i, stop - m]
            if n == 1 and m == 1:
                now[m] = 2.0 * k
            elif n == 1:
                now[m] = now[m - 1] + k
            elif m == 1:
                now[m] = before[m] + k
            else:
                now[m] = max(before[m] + k, now[m - 1] + k, before[m - 1] + 2.0 * k)
        out[n] = now[width] / (n + width)
        before, now = now, before


@kernel
def inner(alike: Samples, starts: Times, ends: Times, label: Times, clusters: int) -> tuple[Samples, Times]:
    """Of each cluster the mean kernel between its members, and how many there are."""
    pairs = pairwise_alignment(alike, starts, ends)
    spread, count = np.zeros(clusters), np.zeros(clusters, np.int64)
    for i in range(label.shape[0]):
        count[label[i]] += 1
        for j in range(label.shape[0]):
            if label[i] == label[j]:
                spread[label[i]] += pairs[i, j]
    for c in range(clusters):
        spread[c] /= max(1, count[c]) ** 2
    return spread, count


@kernel
def recut(
    alike: Samples, starts: Times, ends: Times, label: Times, spread: Samples, count: Times, least: int, most: int
) -> tuple[Times, Times, Times, float]:
    """The cuts, of all with segments of `least` to `most` frames, with segments nearest to the clusters; and the sum of distances."""
    frames, clusters = alike.shape[0], spread.shape[0]
    longest = (ends - starts).max()
    room, one, sums = np.zeros((2, longest + 1)), np.zeros(most + 1), np.zeros((clusters, most + 1))
    total = np.full(frames + 1, np.inf)
    total[0] = 0.0
    took, chose = np.zeros(frames + 1, np.int64), np.zeros(frames + 1, np.int64)
    for end in range(least, frames + 1):
        reach = min(most, end)
        sums[:] = 0.0
        for j in range(starts.shape[0]):
            align_back(alike, end, reach, starts[j], ends[j], room, one)
            for n in range(1, reach + 1):
                sums[label[j], n] += one[n]
        for n in range(least, reach + 1):
            for c in range(clusters):
                if count[c] == 0:
                    continue
                far = 1.0 - 2.0 * sums[c, n] / count[c] + spread[c]
                if total[end - n] + far < total[end]:
                    total[end], took[end], chose[end] = total[end - n] + far, n, c
    at, segments = frames, 0
    while at > 0:
        at -= took[at]
        segments += 1
    made = np.zeros((3, segments), np.int64)
    at = frames
    for k in range(segments - 1, -1, -1):
        made[0, k], made[1, k], made[2, k] = at - took[at], at, chose[at]
        at -= took[at]
    return made[0], made[1], made[2], total[frames]
