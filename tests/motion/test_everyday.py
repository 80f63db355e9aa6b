"""What people do before a camera besides exercise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bench.generalise import seen_by_camera
from bench.motion import RATE, events
from kinegraph.devices.people.exerciser import JOINTS
from kinegraph.devices.reports.training import rows
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.names import naming
from kinegraph.operators.segmentation.outputs import PRIMITIVE
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.operator import grid
from tests.support.everyday_made import Person


def found(person: Person, noise_mm: float = 2.0) -> dict[str, Any]:
    return events(seen_by_camera(person, noise_mm), Segment())


def counted(made: dict[str, Any], start: float, end: float) -> int:
    """Repetitions between two times (s)."""
    parts = made["primitive"][made["primitive"]["repetition"] > 0]
    middle = (parts["onset"] + parts["end"]) / 2 / NS
    return int(((middle > start - 0.7) & (middle < end + 0.7)).sum())


@pytest.mark.parametrize("pause_s", [5.0, 30.0])
def test_a_small_exercise_after_a_large_one_is_counted(pause_s: float) -> None:
    """It passed for rest, as it was little of what the liveliest second did; and all of it lay within the radius of the large one."""
    person = Person(3)
    person.stand(3.0)
    person.exercise("arm raises", 9)
    person.stand(pause_s)
    person.exercise("wrist to shoulder, one arm", 9)
    person.stand(4.0)
    made, small = found(person), person.done[-2]
    assert counted(made, small.start, small.end) == 9


def test_a_longer_rest_ends_an_exercise_and_is_a_segment_of_its_own() -> None:
    person = Person(4)
    person.stand(2.0)
    person.exercise("squats", 6)
    person.stand(6.0)
    person.talk(8.0)
    person.stand(2.0)
    made, rest = found(person), person.done[2]
    acts = made["activity"]
    near = np.abs(acts["onset"] / NS - rest.start) < 1.0
    assert near.sum() == 1 and np.abs(acts["end"][near] / NS - rest.end) < 1.0
    assert not acts["repeats"][near][0] and not acts["transition"][near][0]
    assert counted(made, person.done[1].start, person.done[1].end) == 6


def test_who_rests_between_repetitions_does_one_exercise() -> None:
    person = Person(5)
    person.stand(3.0)
    person.exercise("squats", 8, pauses=6.0)
    person.stand(4.0)
    acts = found(person)["activity"]
    assert acts["repetitions"][acts["repeats"]].tolist() == [8]


@pytest.mark.parametrize("noise_mm", [1.0, 6.0])
def test_standing_is_not_counted(noise_mm: float) -> None:
    person = Person(7)
    person.stand(45.0)
    assert not (found(person, noise_mm)["primitive"]["repetition"] > 0).any()


def test_walking_is_named_by_the_way_that_it_takes_somebody() -> None:
    """And left out of the training report, which knows it by the same word."""
    person = Person(8)
    person.walk(12.0)
    person.stand(4.0)
    person.exercise("squats", 6)
    person.stand(3.0)
    series, walk = seen_by_camera(person, 2.0), person.done[0]
    primitives = events(series, Segment())["primitive"]
    joints = person.joints(2.0)
    joints[5, 3] = np.nan
    time = grid(RATE, len(joints), 0)
    operator = naming.NameRepetitions()
    place = StreamSpec(joints.shape[1:], channels=JOINTS, units=("m",))
    operator.open({"in": series.spec, "place": place, "primitive": StreamSpec((), PRIMITIVE)})
    operator.process("place", Chunk(time, joints, int(time[-1])))
    operator.process("in", Chunk(series.stamps, series.data, int(series.stamps[-1])))
    ((_, made),) = operator.process("primitive", Chunk(primitives["end"], primitives, int(time[-1])))
    middle = (made.data["onset"] + made.data["end"]) / 2 / NS
    squats = (middle > person.done[2].start) & (middle < person.done[2].end)
    assert (made.data["name"][middle < walk.end] == rows.WALKING).sum() >= 5
    assert squats.sum() == 6 and not (made.data["name"][squats] == naming.WALKING).any()
