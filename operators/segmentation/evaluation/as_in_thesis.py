"""The thesis's own measures of a segmentation (2.6.1 to 2.6.4), so that its printed values and ours are of one kind."""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import combinations

import numpy as np

from kinegraph.operators.segmentation.evaluation.found import Found
from kinegraph.operators.segmentation.evaluation.scores import STEP_S
from kinegraph.operators.segmentation.evaluation.truth import Truth
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.kernel import kernel

RATE_HZ = 30.0
"""The rate of the thesis's recordings: its distances are in such frames."""
PAIRS = 40
"""The most pairs of one cluster that are compared."""
PASSING = -2
"""The group of primitives that were found to be transitions."""


@dataclass(frozen=True, slots=True)
class ThesisScores:
    """Shares from 0 to 1, unless a unit is named; NaN where the annotations or the recording do not hold what is needed.

    strict, tolerant  frames that have the label of most frames of their cluster; tolerant: or that lie in an annotated transition (2.6.1).
                      Primitives without a cluster are judged by their activity
    matched           frames that are right where each label may have one cluster only, matched as well as possible
    clusters          how many clusters have at least two repetitions
    variance, variance_sd  eq. 2.5 as a mean: the warped distance of two repetitions of a cluster, by the length of the first, in the
                      unit of the features and per feature; mean and standard deviation over clusters
    distance, distance_sd  frames of 1/30 s from an annotated start or end to the next cut (2.6.4)
    overlap, overlap_sd    share of an annotated action in the unit that holds most of it
    key_place, key_sd      where in its repetition a key point is, and the standard deviation of that (2.6.3)
    """

    strict: float
    tolerant: float
    matched: float
    clusters: float
    variance: float
    variance_sd: float
    distance: float
    distance_sd: float
    overlap: float
    overlap_sd: float
    key_place: float
    key_sd: float


def thesis_scores(found: Found, truth: Truth) -> ThesisScores:
    """All measures of one recording."""
    acts = len(truth.start) > 0
    accuracy = class_accuracy(found, truth) if acts else (np.nan, np.nan, np.nan)
    spread = variances(found)
    far, shared = distances_and_overlaps(found, truth) if acts else (np.empty(0), np.empty(0))
    return ThesisScores(
        *accuracy, float(len(spread)), *_mean_sd(spread), *_mean_sd(far), *_mean_sd(shared), *_mean_sd(key_places(found, truth))
    )  # fmt: skip


def class_accuracy(found: Found, truth: Truth) -> tuple[float, float, float]:
    """Strict, tolerant and matched share of frames."""
    from scipy.optimize import linear_sum_assignment

    length = max([*truth.end, *found.activities[:, 1], *found.primitives[:, 1]], default=0.0)
    labels = truth.labels(STEP_S * (np.arange(round(length / STEP_S)) + 0.5))
    group = groups(found, len(labels))
    table = np.array(
        [
            [int(((group == g) & (labels == c)).sum()) for c in (-1, *range(len(set(truth.label))))]
            for g in np.unique(group)
        ]
    )
    most = table.argmax(axis=1)
    strict = table[np.arange(len(table)), most].sum()
    tolerant = strict + table[most > 0, 0].sum()
    matched = table[linear_sum_assignment(table, maximize=True)].sum()
    return tuple(float(right) / len(labels) for right in (strict, tolerant, matched))  # type: ignore[return-value]


def groups(found: Found, frames: int) -> Array:
    """The group that each frame (of STEP_S) is judged with: its cluster; without one its activity; transitions are one group."""
    made = np.full(frames, PASSING)
    clusters = int(found.cluster.max(initial=-1)) + 1
    for k, (start, end) in enumerate(found.activities):
        made[round(start / STEP_S) : round(end / STEP_S)] = PASSING if found.transition[k] else clusters + k
    for cluster, (start, end) in zip(found.cluster, found.primitives, strict=True):
        if cluster >= 0:
            made[round(start / STEP_S) : round(end / STEP_S)] = cluster
    return made


@kernel
def warped(a: Samples, b: Samples) -> float:
    """The cheapest sum of distances along a warping path from the first frames of `a` (n, c) and `b` (m, c) to the last, over n."""
    n, m = a.shape[0], b.shape[0]
    cost = np.full((n + 1, m + 1), np.inf)
    cost[0, 0] = 0.0
    for i in range(n):
        for j in range(m):
            square = 0.0
            for c in range(a.shape[1]):
                square += (a[i, c] - b[j, c]) ** 2
            before = min(cost[i, j], cost[i, j + 1], cost[i + 1, j])
            cost[i + 1, j + 1] = before + np.sqrt(square)
    return float(cost[n, m] / n)


def pairs(found: Found) -> dict[int, list[tuple[int, int]]]:
    """Repetitions of one cluster, two by two: of each cluster at most PAIRS, evenly chosen."""
    made = {}
    for cluster in np.unique(found.cluster[(found.repetition > 0) & (found.cluster >= 0)]):
        own = list(combinations(np.flatnonzero((found.cluster == cluster) & (found.repetition > 0)).tolist(), 2))
        if own:
            made[int(cluster)] = own[:: -(-len(own) // PAIRS)]
    return made


def variances(found: Found) -> Array:
    """Eq. 2.5 of each cluster with two repetitions or more, per feature; empty without recorded features."""
    if not len(found.features):
        return np.empty(0)
    first, last = found.own if found.own[1] else (0, found.features.shape[1])
    own = np.ascontiguousarray(found.features[:, first:last], np.float64)
    at = [own[(found.time >= a) & (found.time < b)] for a, b in found.primitives]
    means = [
        np.mean([warped(at[i], at[j]) for i, j in chosen if len(at[i]) and len(at[j])])
        for chosen in pairs(found).values()
    ]
    found_means: Array = np.asarray(means, np.float64) / np.sqrt(last - first)
    return found_means


def distances_and_overlaps(found: Found, truth: Truth) -> tuple[Array, Array]:
    """Of every annotated start and end the frames to the next cut, and of every action its largest share in one unit."""
    cuts = found.cuts()
    marks = np.concatenate([truth.start, truth.end])
    far = np.abs(marks[:, None] - cuts[None, :]).min(axis=1) * RATE_HZ if len(cuts) else np.empty(0)
    edges = np.unique(np.concatenate([found.activities.ravel(), found.primitives.ravel()]))
    shared = [
        max(0.0, float((np.minimum(end, edges[1:]) - np.maximum(start, edges[:-1])).max(initial=0.0))) / (end - start)
        for start, end in zip(truth.start, truth.end, strict=True)
    ]
    return far, np.array(shared)


def key_places(found: Found, truth: Truth) -> Array:
    """Where in its repetition each key point is, 0 to 1."""
    spans = found.repetitions()
    return np.array([(k - a) / (b - a) for k in truth.keys for a, b in spans if a <= k < b])


def thesis_means(scores: list[ThesisScores]) -> dict[str, float]:
    """The mean of each measure over the recordings that have it."""
    made = {}
    for field in fields(ThesisScores):
        values = np.array([getattr(one, field.name) for one in scores])
        known = values[np.isfinite(values)]
        made[field.name] = float(known.mean()) if len(known) else np.nan
    return made


def _mean_sd(values: Array) -> tuple[float, float]:
    return (float(values.mean()), float(values.std())) if len(values) else (np.nan, np.nan)
