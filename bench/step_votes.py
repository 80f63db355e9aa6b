"""Gender of people left out: how many steps are right, and how many people by a vote; with what was tried to raise it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kinegraph.operators.steps.commands.validation import SETS, Labelled, leave_out
from kinegraph.operators.steps.step_kernel import chosen
from kinegraph.stream.text.safe_text import say

SEEDS = (1, 2, 3)
TREES = 60


def votes(given: Labelled, title: str) -> None:
    """The rate of steps that are right, the mean of three forests'; people right by most of their steps, and by their mean probability."""
    classes, people = np.unique(given.labels), np.unique(given.persons)
    for features in SETS:
        for weighted in (False, True):
            rates, most, mean = list[float](), list[int](), list[int]()
            for seed in SEEDS:
                p = leave_out(replace(given, alike=weighted), chosen(features), TREES, seed=seed)
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
