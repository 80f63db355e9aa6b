"""Head rotation from nose, ears and shoulders: which way somebody looks goes into the pose, and from it to the outlets."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.pose.landmarks import BONE_OF, FROM_BONE, NAMES, USUAL
from kinegraph.operators.pose.operator import WholePose
from kinegraph.operators.pose.solve_kernel import place_marks
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.operator import grid
from tests.avatar.test_whole_pose import POSES, RATE, TREE

FACE = ("nose", "ear_l", "ear_r")
HEAD = BONES.index("Head")


def looking(turned_rad: Samples, nodded_rad: float) -> Samples:
    """Somebody who stands and turns the head to the left by angles (n,), nodding besides: poses (n, 91)."""
    poses = np.repeat(POSES[:1], len(turned_rad), axis=0)
    for i, angle in enumerate(turned_rad):
        c, s, a, b = np.cos(angle / 2), np.sin(angle / 2), np.cos(nodded_rad / 2), np.sin(nodded_rad / 2)
        poses[i, 3 + 4 * HEAD : 7 + 4 * HEAD] = c * a, c * b, s * a, -s * b
    return poses


def nose_of(poses: Samples) -> Samples:
    """Where the nose points in the world (n, 3): the head's own z axis."""
    w, x, y, z = joints_of(TREE, poses)[0][:, HEAD].T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


@pytest.mark.parametrize("nod", [0.0, 0.3, -0.3])
def test_the_head_turns_as_nose_and_ears_do(nod: float) -> None:
    angles = np.concatenate([np.zeros(45), np.linspace(0.0, 0.9, 30), np.full(15, 0.9), np.linspace(0.9, -0.9, 60)])
    truth = looking(angles, 0.0)
    truth[45:] = looking(angles[45:], nod)
    turns, joints = joints_of(TREE, truth)
    names = (*USUAL, *FACE)
    present = np.isin(np.array(NAMES), names)
    marks = np.zeros((len(truth), len(NAMES), 3))
    for i in range(len(truth)):
        place_marks(FROM_BONE, BONE_OF, turns[i], joints[i], present, marks[i])
    marks = marks[:, [NAMES.index(name) for name in names]]
    operator = WholePose()
    operator.open({"in": StreamSpec((len(names), 3), rate_hz=RATE, channels=names, units=("m",))})
    made = operator.process("in", Chunk(grid(RATE, len(marks)), marks.reshape(len(marks), -1), 0))
    poses = next(chunk.data for port, chunk in made if port == "pose")
    off = np.degrees(np.arccos(np.clip((nose_of(poses) * nose_of(truth)).sum(axis=1), -1.0, 1.0)))
    assert off[60:].max() < 15.0, off[60:].max()
