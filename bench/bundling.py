"""What bundling features does to a segmentation: boundary F1, and how far apart repetitions of one cluster are (thesis 2.6.1, eq. 2.5)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench import batch
from bench.motion import Series, poses, segment
from bench.report import Goal, Section
from kinegraph.operators.features.bundle import Bundle
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.segmentation.evaluation.as_in_thesis import PAIRS, pairs, warped
from kinegraph.operators.segmentation.evaluation.found import Found
from kinegraph.operators.segmentation.evaluation.scores import score
from kinegraph.stream.chunk import NS, Array


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
        chosen = [pair for own in pairs(found).values() for pair in own]
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
