"""What bench.pose_feet and bench.pose_seated count: feet that slide and leap by known amounts, poses that are wrong by known angles."""

from __future__ import annotations

import numpy as np
import pytest

from bench.pose_feet import FEET, foot_steps
from bench.pose_seated import UPPER, errors, fastest
from kinegraph.stream.domain.humanoid import BONES, usual_body

TREE = usual_body()
REST = np.concatenate([TREE.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))])


def test_slides_and_leaps_of_feet_are_those_that_were_made() -> None:
    true = np.repeat(TREE.at_rest[None], 40, axis=0)
    true[30:, FEET[0], 2] += 0.1 * np.arange(10)  # the left foot walks away
    made, stands = true.copy(), np.ones((40, 2))
    made[10:, FEET[1], 0] += 0.002
    made[30:, FEET[0], 2] += 0.015
    stands[30:, 0] = 0
    feet = foot_steps(made, stands, true)
    assert feet.slides[feet.stands].max() == pytest.approx(0.002)
    assert feet.released.sum() == 1 and feet.leaps[feet.released] == pytest.approx(0.015)
    assert feet.truly[:, 1].all() and feet.truly[:30, 0].all() and not feet.truly[30:, 0].any()


def test_errors_of_the_upper_half_are_those_that_were_made() -> None:
    poses = np.repeat(REST[None], 3, axis=0)
    for bone, angle in (("LeftUpperLeg", 1.0), ("Head", 0.3)):
        at = 3 + 4 * BONES.index(bone)
        poses[1:, at], poses[1:, at + 1] = np.cos(angle / 2), np.sin(angle / 2)
    poses[:, 0] += 5.0  # hips elsewhere: places count from them
    cm, deg = errors(TREE, poses[1:2], REST[None])
    assert cm == pytest.approx(0.0, abs=1e-9) and deg == pytest.approx(np.degrees(0.3) / len(UPPER), rel=1e-6)
    assert fastest(TREE, poses) == pytest.approx(30.0, rel=1e-6)
