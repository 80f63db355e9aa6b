"""Rotations of the whole pose against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from kinegraph.operators.pose.rotation_kernel import from_matrix, from_six, part_way
from kinegraph.stream.chunk import Samples


def quaternion(rotation: Rotation) -> Samples:
    """(4,) w, x, y, z."""
    made: Samples = np.roll(rotation.as_quat(), 1)
    return made


def same(one: Samples, other: Samples) -> bool:
    """Whether two quaternions are the same rotation."""
    return bool(abs(abs(one @ other) - 1.0) < 1e-12)


@pytest.mark.parametrize("degrees", [3.0, 90.0, 179.0])
@pytest.mark.parametrize("axis", range(3))
def test_a_matrix_and_two_of_its_columns_give_its_quaternion(axis: int, degrees: float) -> None:
    """Turns of nearly 180 degrees about each axis reach every way in which a quaternion is found."""
    rotation = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)[axis]) * Rotation.from_rotvec([0.02, 0.03, -0.01])
    matrix, out = rotation.as_matrix(), np.empty(4)
    a, b, c, d, e, f, g, h, i = matrix.ravel().tolist()
    from_matrix(a, b, c, d, e, f, g, h, i, out)
    assert same(out, quaternion(rotation))
    from_six(matrix[:, :2].T.ravel().copy(), out)
    assert same(out, quaternion(rotation))


@pytest.mark.parametrize("share", [0.0, 0.25, 0.9])
def test_part_of_the_way_is_on_the_shortest_one(share: float) -> None:
    ends = Rotation.from_rotvec([[0.1, 0.2, 0.3], [1.4, -0.2, 0.5]])
    p, q, out = quaternion(ends[0]), quaternion(ends[1]), np.empty(4)
    for sign in (1.0, -1.0):
        part_way(p, sign * q, share, out)
        assert same(out, quaternion(Slerp([0.0, 1.0], ends)(share)))
