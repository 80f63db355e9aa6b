"""What bundling features does to a segmentation: boundary F1, and how far apart repetitions of one cluster are (thesis 2.6.1, eq. 2.5)."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np

from bench import batch
from bench.motion import Series, poses, segment
from bench.report import Goal, Section
from kinegraph.operators.features.bundle import Bundle
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.segmentation.evaluation.found import Found
from kinegraph.operators.segmentation.evaluation.scores import score
from kinegraph.stream.chunk import NS, Array, Samples
from kinegraph.stream.kernel import kernel

PAIRS = 40
"""The most pairs of one cluster that are looked at."""


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


def pairs(found: Found) -> list[tuple[int, int]]:
    """Repetitions of one cluster, two by two: of each cluster at most PAIRS, evenly chosen."""
    chosen = []
    for cluster in np.unique(found.cluster[(found.repetition > 0) & (found.cluster >= 0)]):
        own = list(combinations(np.flatnonzero((found.cluster == cluster) & (found.repetition > 0)), 2))
        chosen += own[:: -(-len(own) // PAIRS)] if own else []
    return chosen


def apart(features: Series, found: Found, chosen: list[tuple[int, int]]) -> Array:
    """The DTW distance of each pair, by the length of the first (eq. 2.5)."""
    at = [features.data[(features.stamps >= a * NS) & (features.stamps < b * NS)] for a, b in found.primitives]
    return np.array([warped(at[i], at[j]) for i, j in chosen if len(at[i]) and len(at[j])])


def bundling(folder: Path) -> Section:
    """Raw features, features bundled when they are stacked, or before; and bundled in batch, as the thesis does."""
    made: dict[str, list[list[float]]] = {}
    for kind, _, pose, truth in poses(folder):
        raw = pose.through(Stack())
        late, early = pose.through(Stack(), Bundle()), pose.through(Bundle(), Stack())
        whole = Series(raw.spec, raw.stamps, batch.bundled(raw.data))
        found = segment(raw)
        chosen = pairs(found)
        before = apart(raw, found, chosen)
        ratios = [float((apart(one, found, chosen) / before).mean()) for one in (late, early, whole)]
        f1 = [score(found, truth).f1, *(score(segment(one), truth).f1 for one in (late, early))]
        for group in (kind, "all"):
            made.setdefault(group, []).append([*f1, *ratios])
    rows = [[kind, *(f"{v:.3f}" for v in np.mean(values, axis=0))] for kind, values in made.items()]
    ratio = float(np.mean(made["all"], axis=0)[3])
    head = ["", "F1, raw", "bundled", "bundled, then stacked", "DTW, bundled", "bundled, then stacked", "in batch"]
    note = (
        "DTW: the distance of two repetitions of one cluster (of the segmentation of raw features; at most "
        f"{PAIRS} pairs of each), in bundled features over that in raw ones, mean over pairs."
    )
    goals = [Goal("bundling: DTW distance within clusters, bundled over raw", ratio, 0.8, "")]
    return Section("Bundled features", head, rows, [note], goals)
