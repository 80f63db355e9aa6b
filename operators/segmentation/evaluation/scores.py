"""How well a segmentation agrees with annotations (thesis 2.6), and how sure that is over several recordings."""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np

from kinegraph.operators.segmentation.evaluation.found import Found
from kinegraph.operators.segmentation.evaluation.truth import Truth
from kinegraph.stream.chunk import Array, Samples

STEP_S = 1.0 / 120.0
"""Time is looked at in steps of this: the rate at which the thesis's recordings are annotated."""
TOLERANCE_S = 1.0
ROUNDING_S = 1e-6
"""Far below a frame, far above what sums of seconds lose: a boundary that is the tolerance away counts, however its times were computed."""
DRAWS = 10_000


@dataclass(frozen=True, slots=True)
class Scores:
    """Shares from 0 to 1, unless a unit is named; NaN where the annotations do not say it.

    f1, precision, recall  of boundaries within 1 s of an annotated one, one to one, the nearest pairs first
    covering      the annotated segments' best overlap (intersection over union) with one found, weighted by their length
    strict        frames with the label of most of their unit, transitions being a label of their own; cutting often pleases it
    tolerant      the same, frames of transitions counting as right wherever they are
    repetitions   mean |found - counted| repetitions per annotated action; `within_1`: share of actions where that is at most 1;
                  count_error: the mean of the same divided by those counted (RepCount's MAE), of actions with any
    distance_s    from each annotated start and end to the next cut; `overlap`: share of an action in the unit that holds most of it (2.6.4)
    key_place, key_sd  where in its repetition a key point stands, and the circular standard deviation of that, both in shares of it
    """

    f1: float
    precision: float
    recall: float
    covering: float
    strict: float
    tolerant: float
    repetitions: float
    within_1: float
    count_error: float
    distance_s: float
    overlap: float
    key_place: float
    key_sd: float


def score(found: Found, truth: Truth) -> Scores:
    """All scores of one recording."""
    length = max([*truth.end, *found.activities[:, 1], *found.primitives[:, 1]], default=0.0)
    f1, precision, recall = boundary_f1(found.boundaries(), truth.boundaries())
    acts = len(truth.start) > 0
    strict, tolerant = frame_accuracy(found.cuts(), truth, length) if acts else (np.nan, np.nan)
    distance, overlap = distance_and_overlap(found, truth) if acts else (np.nan, np.nan)
    errors, counted = repetition_errors(found, truth)
    place, spread = key_phase(found, truth)
    return Scores(
        *((f1, precision, recall) if acts else (np.nan,) * 3),
        covering(found.boundaries(), truth.boundaries(), length) if acts else np.nan,
        strict,
        tolerant,
        float(np.mean(errors)) if len(errors) else np.nan,
        float(np.mean(errors <= 1)) if len(errors) else np.nan,
        float(np.mean(errors[counted > 0] / counted[counted > 0])) if (counted > 0).any() else np.nan,
        distance,
        overlap,
        place,
        spread,
    )


def boundary_f1(found: Samples, truth: Samples, tolerance_s: float = TOLERANCE_S) -> tuple[float, float, float]:
    """F1, precision and recall of boundaries: each is matched at most once, the nearest pairs first. 1 without any."""
    if not len(found) or not len(truth):
        same = float(len(found) == len(truth))
        return same, same if len(found) == 0 else 0.0, same if len(truth) == 0 else 0.0
    apart = np.abs(found[:, None] - truth[None, :])
    hits = 0
    while apart.min() <= tolerance_s + ROUNDING_S:
        i, j = np.unravel_index(apart.argmin(), apart.shape)
        apart[i, :] = apart[:, j] = np.inf
        hits += 1
    return 2.0 * hits / (len(found) + len(truth)), hits / len(found), hits / len(truth)


def covering(found: Samples, truth: Samples, length_s: float) -> float:
    """The annotated segments' best intersection over union with a found one, weighted by length."""
    made = np.stack([np.append(0.0, found), np.append(found, length_s)], 1)
    total = 0.0
    for start, end in zip(np.append(0.0, truth), np.append(truth, length_s), strict=True):
        shared = np.minimum(end, made[:, 1]) - np.maximum(start, made[:, 0])
        either = np.maximum(end, made[:, 1]) - np.minimum(start, made[:, 0])
        total += (end - start) * max(0.0, float((shared / either).max()))
    return total / length_s if length_s > 0 else np.nan


def frame_accuracy(cuts: Samples, truth: Truth, length_s: float) -> tuple[float, float]:
    """Strict and tolerant share of frames that agree with most of their unit (2.6.1)."""
    labels = truth.labels(STEP_S * (np.arange(round(length_s / STEP_S), dtype=np.float64) + 0.5))
    edges = np.concatenate([[0], np.unique(np.round(cuts / STEP_S).astype(int)), [len(labels)]])
    strict = tolerant = 0
    for first, last in pairwise(edges):
        unit = labels[first:last]
        if len(unit):
            values, counts = np.unique(unit, return_counts=True)
            most = values[counts.argmax()]
            strict += int(counts.max())
            tolerant += int(((unit == most) | (unit == -1)).sum())
    return strict / max(1, len(labels)), tolerant / max(1, len(labels))


def repetition_errors(found: Found, truth: Truth) -> tuple[Array, Array]:
    """|found - counted| per annotated action, or of the whole where only key points are annotated; and how many were counted."""
    middle = found.repetitions().mean(axis=1)
    if len(truth.keys) and not np.isfinite(truth.repetitions).any():
        return np.array([abs(len(middle) - len(truth.keys))]), np.array([len(truth.keys)])
    errors, counts = [], []
    for i, counted in enumerate(truth.repetitions):
        if np.isfinite(counted):
            first = -np.inf if i == 0 else (truth.end[i - 1] + truth.start[i]) / 2.0
            last = np.inf if i == len(truth.start) - 1 else (truth.end[i] + truth.start[i + 1]) / 2.0
            errors.append(abs(int(((middle >= first) & (middle < last)).sum()) - counted))
            counts.append(counted)
    return np.array(errors), np.array(counts)


def distance_and_overlap(found: Found, truth: Truth) -> tuple[float, float]:
    """Mean distance (s) from annotated starts and ends to the next cut, and mean largest share of an action in one unit (2.6.4)."""
    cuts = found.cuts()
    marks = np.concatenate([truth.start, truth.end])
    distance = float(np.abs(marks[:, None] - cuts[None, :]).min(axis=1).mean()) if len(cuts) else np.nan
    edges = np.unique(np.concatenate([found.activities.ravel(), found.primitives.ravel()]))
    shares = []
    for start, end in zip(truth.start, truth.end, strict=True):
        shared = np.minimum(end, edges[1:]) - np.maximum(start, edges[:-1])
        shares.append(max(0.0, float(shared.max(initial=0.0))) / (end - start))
    return distance, float(np.mean(shares))


def key_phase(found: Found, truth: Truth) -> tuple[float, float]:
    """The circular mean of the key points' places in their repetitions, and its circular standard deviation, in shares of a repetition."""
    spans = found.repetitions()
    places = [(key - start) / (end - start) for key in truth.keys for start, end in spans if start <= key < end]
    if not places:
        return np.nan, np.nan
    mean = np.exp(2j * np.pi * np.array(places)).mean()
    return float(np.angle(mean) / (2 * np.pi) % 1.0), float(
        np.sqrt(max(0.0, -2.0 * np.log(max(abs(mean), 1e-12)))) / (2 * np.pi)
    )


def intervals(scores: list[Scores], seed: int = 0) -> dict[str, tuple[float, float, float]]:
    """Per score: the mean over recordings, and its 95 % interval when recordings are drawn again and again (NaN for one recording)."""
    made = {}
    for field in fields(Scores):
        values = np.array([getattr(one, field.name) for one in scores])
        values = values[np.isfinite(values)]
        low = high = np.nan
        if len(values) > 1:
            drawn = np.random.default_rng(seed).integers(0, len(values), (DRAWS, len(values)))
            low, high = np.quantile(values[drawn].mean(axis=1), [0.025, 0.975])
        made[field.name] = (float(values.mean()) if len(values) else np.nan, float(low), float(high))
    return made
