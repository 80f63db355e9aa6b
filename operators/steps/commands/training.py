"""A step model from labelled steps, with what it is worth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.operators.steps.commands.enrolment import Enrolment, enrolment
from kinegraph.operators.steps.commands.validation import SETS, Labelled, Trust, fitted, trust, uncertain_below
from kinegraph.operators.steps.forest import Forest, StepModel
from kinegraph.operators.steps.step_kernel import chosen

PERSON = "person"


@dataclass(frozen=True, slots=True)
class StepTraining:
    """model; tried: each set of features on people left out; enrolled: instead, where the target is the person."""

    model: StepModel
    tried: list[Trust]
    enrolled: Enrolment | None


def learned(
    given: Labelled, meta: dict[str, Any], target: str, features: str, trees: int, shuffles: int, sure: float
) -> StepTraining:
    """Train on all steps, after trying it on people left out. `meta`: of the steps' stream; `sure`: as `uncertain_below` wants it."""
    import sklearn

    people, classes = np.unique(given.persons), np.unique(given.labels)
    header = {
        "target": target, "site": meta["site"], "axes": meta["axes"], "features": features, "rate_hz": meta["imu_rate_hz"],
        "channels": meta["imu_channels"], "subjects": len(people), "steps": len(given.labels), "trees": trees,
        "alike": given.alike, "scikit_learn": sklearn.__version__,
    }  # fmt: skip
    tried, enrolled = list[Trust](), None
    if target == PERSON:
        enrolled = enrolment(given, features, trees)
        header |= _of_enrolment(enrolled)
    else:
        tried = [trust(given, name, trees, shuffles) for name in (SETS if meta["angular_velocity"] else SETS[:1])]
        (own,) = [t for t in tried if t.features == features]
        header |= _of_trust(own, given, classes[own.probability.argmax(axis=1)], sure)
    columns = chosen(features)
    trained = fitted(given, np.ones(len(given.labels), bool), columns, trees, given.labels)
    model = StepModel(Forest.of(trained), [str(c) for c in classes], np.array(columns), header)
    return StepTraining(model, tried, enrolled)


def _of_enrolment(found: Enrolment) -> dict[str, Any]:
    return {
        "uncertain_below": found.threshold, "accuracy": {"walks": found.known},
        "open_set": {"false_accept": found.false_accept, "false_reject": found.false_reject},
    }  # fmt: skip


def _of_trust(own: Trust, given: Labelled, answers: Any, sure: float) -> dict[str, Any]:
    """What a model's header says of what it is worth; "uncertain" at every step where that is no better than guessing."""
    guessing = own.verdict != "better than guessing"
    threshold = 1.01 if guessing else uncertain_below(own.probability, answers == given.labels, sure)
    accuracy = {
        "random_split": own.random,
        "subject_wise": own.subjects,
        "majority": own.majority,
        "chance": own.chance,
    }
    return {"uncertain_below": threshold, "verdict": own.verdict, "accuracy": accuracy}
