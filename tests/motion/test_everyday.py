"""What people do before a camera besides exercise."""

from __future__ import annotations

import numpy as np

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
    time = grid(RATE, len(joints))
    operator = naming.NameRepetitions()
    place = StreamSpec(joints.shape[1:], channels=JOINTS, units=("m",))
    operator.open({"in": series.spec, "place": place, "primitive": StreamSpec((), PRIMITIVE)})
    operator.process("place", Chunk(time, joints, int(time[-1])))
    operator.process("in", Chunk(series.stamps, series.data, int(series.stamps[-1])))
    ((_, made),) = operator.process("primitive", Chunk(primitives["end"], primitives, int(time[-1])))
    middle = (made.data["onset"] + made.data["end"]) / 2 / NS
    squats = (middle > person.done[2].start) & (middle < person.done[2].end)
    assert (made.data["name"][middle < walk.end] == rows.WALKING).sum() >= 5
    assert squats.sum() >= 5 and not (made.data["name"][squats] == naming.WALKING).any()
