"""Gender of people left out: how many steps are right, and how many people by a vote; with what was tried to raise it."""

from __future__ import annotations

import numpy as np

from operators.steps.commands.validation import SETS, Labelled, forest
from operators.steps.step_kernel import chosen
from stream.chunk import Array, Samples
from stream.plain import say

SEEDS = (1, 2, 3)
TREES = 60


def alike(persons: Array, labels: Array) -> Samples:
    """Weights (n,) by which every class counts as much, and in it every person."""
    weights = np.empty(len(labels))
    for label in np.unique(labels):
        of = labels == label
        people, count = np.unique(persons[of], return_counts=True)
        weights[of] = 1.0 / (len(people) * count[np.searchsorted(people, persons[of])])
    return weights * len(labels) / weights.sum()


def left_out(given: Labelled, features: str, *, weighted: bool, seed: int) -> Samples:
    """Probabilities (n, k) of every step by a forest that has seen nothing of its person."""
    x, classes = given.features[:, chosen(features)], np.unique(given.labels)
    out = np.zeros((len(x), len(classes)))
    for person in np.unique(given.persons):
        left = given.persons == person
        weights = alike(given.persons[~left], given.labels[~left]) if weighted else None
        out[left] = forest(TREES, seed).fit(x[~left], given.labels[~left], sample_weight=weights).predict_proba(x[left])
    return out


def votes(given: Labelled, title: str) -> None:
    """The rate of steps that are right, the mean of three forests'; people right by most of their steps, and by their mean probability."""
    classes, people = np.unique(given.labels), np.unique(given.persons)
    for features in SETS:
        for weighted in (False, True):
            rates, most, mean = list[float](), list[int](), list[int]()
            for seed in SEEDS:
                p = left_out(given, features, weighted=weighted, seed=seed)
                right = classes[p.argmax(axis=1)] == given.labels
                rates.append(float(right.mean()))
                most.append(sum(bool(right[given.persons == who].mean() > 0.5) for who in people))
                means = [
                    (p[given.persons == who].mean(axis=0), given.labels[given.persons == who][0]) for who in people
                ]
                mean.append(sum(bool(classes[m.argmax()] == label) for m, label in means))
            say(
                f"| {title} | {features.replace('_', ' ')} | {'alike' if weighted else 'as they are'} | {np.mean(rates):.3f} | "
                f"{', '.join(map(str, most))} | {', '.join(map(str, mean))} | {len(people)} |"
            )
