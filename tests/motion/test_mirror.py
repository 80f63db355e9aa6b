"""Mirrored features, declared, or taken from a pose."""

import numpy as np
import pytest

from kinegraph.operators.features.mirror import Mirror
from kinegraph.operators.features.pose import Pose
from kinegraph.operators.features.stack import Stack
from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import grid

ANGLES = StreamSpec((5,), rate_hz=30.0, channels=("arm_l.x", "arm_l.z", "arm_r.x", "arm_r.z", "head.z"), units=("deg",))


def mirror(operator, spec, data):
    made = operator.open({"in": spec})["out"]
    return made, operator.process("in", Chunk(grid(30.0, len(data)), data, FOREVER)).data


def test_pairs_change_places_and_what_points_sideways_its_sign():
    data = np.arange(10.0).reshape(2, 5)
    spec, made = mirror(Mirror(swap=(("arm_l", "arm_r"),), negate=("*.z",), sides=True), ANGLES, data)
    assert made[0].tolist() == [2.0, -3.0, 0.0, -1.0, -4.0]
    assert spec.channels == ANGLES.channels and spec.meta["sides"] == "LR"
    assert spec.meta["firsts"] == ["arm_l.x", "arm_l.z"]
    again = mirror(Mirror(swap=(("arm_l", "arm_r"),), negate=("*.z",)), ANGLES, made)
    assert np.array_equal(again[1], data) and again[0].meta["sides"] == "AB"


def test_a_pose_of_the_mirrored_body_is_the_mirrored_pose_also_stacked():
    names = ("hip_l", "hip_r", "ankle_l", "ankle_r", "wrist_l", "wrist_r", "head")
    body = np.random.default_rng(1).normal(size=(60, 7, 3)).cumsum(axis=0)
    other = body[:, [1, 0, 3, 2, 5, 4, 6]] * (-1.0, 1.0, 1.0)

    def features(points):
        pose, stack = Pose(), Stack(offsets=(-4, 0, 4))
        spec = pose.open({"in": StreamSpec((7, 3), rate_hz=30.0, channels=names, units=("m",))})["out"]
        spec = stack.open({"in": spec})["out"]
        chunk = pose.process("in", Chunk(grid(30.0, 60), points.reshape(60, -1), FOREVER))
        return spec, stack.process("in", chunk)[0][1].data

    spec, plain = features(body)
    out, made = mirror(Mirror(), spec, plain)
    assert np.allclose(made, features(other)[1]) and out.meta["sides"] == "LR"


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "says nothing about its sides"),
        ({"swap": (("arm_l", "arm"),)}, "there is no 'arm.x'"),
        ({"swap": (("leg_l", "leg_r"),)}, "did you mean|valid are"),
        ({"swap": (("arm_l", "arm_r"), ("arm_r.x", "head.z"))}, "no other pair"),
        ({"negate": ("*.y",)}, "the end of a channel"),
    ],
)
def test_what_cannot_be_swapped_is_named(parameters, message):
    with pytest.raises(ParameterError, match=message):
        Mirror(**parameters).open({"in": ANGLES})
