"""configs/step_biometrics.yaml: steps from one inertial sensor, what the person does, and which of two manners of walking it is.

Recordings: a phone in the pockets of two people who stand up, walk, turn and sit down again (GeoTec; CC BY 4.0). The shipped model judges
sensors at the lower back alone, so that the pocket is replayed without it; the judgement is tried on a simulated back.
Truth: the annotators' labels; the step frequency by scipy's spectrum; every heel contact of the simulated walk.
"""

from __future__ import annotations

from functools import cache
from io import StringIO
from typing import Literal

import numpy as np
import pytest
from ruamel.yaml import YAML

import kinegraph as kg
from kinegraph.devices.people.walking_back import Back
from kinegraph.stream.chunk import NS
from tests.replay.replaying import TURNING, WALKING, pocket_walks, signal, steps_per_s

AXES = ("ax", "ay", "az", "gx", "gy", "gz")
UNITS = ("m/s2",) * 3 + ("rad/s",) * 3


@cache
def pocket(person: str) -> kg.Results:
    written, text = YAML(), StringIO()
    graph = written.load(kg.load("step_biometrics").to_yaml())
    graph["nodes"]["walk.steps"]["site"] = "pocket"
    for judged in ("who", "screen"):
        del graph["nodes"][f"walk.{judged}"]
    graph["record"] = ["walk.steps.steps", "walk.activity.activity"]
    del graph["page"], graph["settings"]
    written.dump(graph, text)
    seconds, imu, _ = pocket_walks(person)
    return kg.Graph.from_yaml(text.getvalue()).run({"walker.imu": signal(imu, None, AXES, UNITS, time_s=seconds)})


@cache
def back(manner: Literal["brisk", "shuffling"]) -> kg.Results:
    imu = Back(manner, 101).measure(np.arange(2500))
    data = np.hstack([imu["acceleration"], imu["angular_velocity"]])
    return kg.load("step_biometrics").run(
        {"walker.imu": signal(data, 100.0, AXES, UNITS)},
        keep=["walk.steps.steps", "walk.who.judgement", "walk.activity.activity"],
    )


@pytest.mark.parametrize("person", ["s01", "s04"])
def test_while_somebody_walks_there_are_as_many_steps_as_the_spectrum_says(person: str) -> None:
    seconds, _, labels = pocket_walks(person)
    at = np.searchsorted(seconds, pocket(person)["walk.steps.steps"].data["end"] / NS)
    walked_s = np.diff(seconds, append=seconds[-1])[labels == WALKING].sum()
    assert (labels[at] == WALKING).sum() == pytest.approx(steps_per_s(person) * walked_s, rel=0.1)


@pytest.mark.parametrize("person", ["s01", "s04"])
def test_most_steps_lie_where_the_annotators_saw_walking(person: str) -> None:
    """A pocket's jolts when somebody sits down are taken for steps, too."""
    seconds, _, labels = pocket_walks(person)
    at = np.searchsorted(seconds, pocket(person)["walk.steps.steps"].data["end"] / NS)
    afoot = np.isin(labels, (WALKING, TURNING))
    assert afoot[at].mean() > 0.7 > 1.1 * afoot.mean()


def test_every_heel_contact_of_a_simulated_walk_is_a_step() -> None:
    contacts = Back("brisk", 101).steps(0, 2500) / 100.0
    found = back("brisk")["walk.steps.steps"].data["end"] / NS
    late = found[np.abs(found[:, None] - contacts).argmin(axis=0)] - contacts
    assert np.abs(late).max() < 0.25 and late.std() < 0.03  # where in a step a back's jolt comes is each person's own
    assert len(found) == pytest.approx(len(contacts), abs=4)  # the first and last are still slow


@pytest.mark.parametrize("manner", ["brisk", "shuffling"])
def test_the_manner_of_a_person_whom_the_model_never_saw_is_judged_right(manner: Literal["brisk", "shuffling"]) -> None:
    assert back(manner)["walk.who.judgement"].data[-1]["decided"] == manner
