"""`python -m tests.walking_model`: the model of two manners of simulated walking that comes with the step classifier; a test compares."""

from __future__ import annotations

from typing import Any

import numpy as np

from kinegraph.devices.people.walking_back import MANNERS, Back
from kinegraph.operators.steps.classifier import SHIPPED
from kinegraph.operators.steps.commands.training import learned
from kinegraph.operators.steps.commands.validation import Labelled
from kinegraph.operators.steps.forest import StepModel
from kinegraph.operators.steps.steps import Steps
from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec
from kinegraph.stream.operator import grid

PEOPLE, SECONDS, TREES = 24, 24, 12
SPEC = StreamSpec(
    (6,),
    rate_hz=100.0,
    channels=("ax", "ay", "az", "gx", "gy", "gz"),
    units=("m/s2",) * 3 + ("rad/s",) * 3,
)


def steps_of(manner: str, person: int, seconds: int = SECONDS) -> tuple[Array, StreamSpec]:
    """The walking steps of a simulated person, and the stream's spec."""
    measured = Back(manner, person).measure(np.arange(seconds * 100))  # type: ignore[arg-type]
    data = np.concatenate([measured["acceleration"], measured["angular_velocity"]], 1).astype(np.float32).astype(float)
    finder = Steps()
    spec = finder.open({"in": SPEC})["steps"]
    rows = finder.process("in", Chunk(grid(100.0, len(data)), data, len(data) * NS // 100)).data
    return rows[rows["kind"] == "walk"], spec


def labelled(people: range) -> tuple[Labelled, dict[str, Any]]:
    """Steps of these people, who walk in one manner or the other by turns."""
    manners = list(MANNERS)
    walks = [(f"person {p}", manners[p % 2], *steps_of(manners[p % 2], p)) for p in people]
    labels, persons = (np.concatenate([[walk[k]] * len(walk[2]) for walk in walks]) for k in (1, 0))
    features = np.concatenate([walk[2]["features"] for walk in walks])
    return Labelled(features, labels, persons, persons), walks[0][3].meta


def made() -> StepModel:
    given, meta = labelled(range(PEOPLE))
    return learned(given, meta, "manner", "both", TREES, 19, 0.9).model


if __name__ == "__main__":
    made().write(SHIPPED)
