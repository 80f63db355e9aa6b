"""Skeletons, poses and meshes: what their specs say, and that it survives a recording."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinegraph.stream.chunk import Samples, StreamSpec
from kinegraph.stream.domain.mesh import Topology
from kinegraph.stream.domain.skeleton import JointTree, joints_of, local_poses
from kinegraph.stream.errors import InputError

pytestmark = pytest.mark.quick

RNG = np.random.default_rng(18)
PARENTS = np.array([-1, 0, 1, 1, 3, 0])
TREE = JointTree(("Hips", "Spine", "Head", "LeftArm", "LeftHand", "LeftFoot"), PARENTS, RNG.normal(size=(6, 3)))
CUBE = np.array([[0, 1, 2], [2, 1, 3], [0, 2, 4]])


def some_poses(n: int) -> Samples:
    quaternions = Rotation.random(n * 6, rng=5).as_quat(scalar_first=True).reshape(n, 24)
    return np.hstack([RNG.normal(size=(n, 3)), quaternions])


def test_joints_are_where_matrices_put_them() -> None:
    poses = some_poses(20)
    turns, joints = joints_of(TREE, poses)
    for i, pose in enumerate(poses):
        world: list[Rotation] = []
        places: list[Samples] = []
        for j, parent in enumerate(PARENTS):
            own = Rotation.from_quat(pose[3 + 4 * j : 7 + 4 * j], scalar_first=True)
            world.append(world[parent] * own if parent >= 0 else own)
            places.append(places[parent] + world[parent].apply(TREE.offsets[j]) if parent >= 0 else pose[:3])
        assert np.allclose(joints[i], places)
        assert all(
            (world[j].inv() * Rotation.from_quat(turns[i, j], scalar_first=True)).magnitude() < 1e-7 for j in range(6)
        )


def test_bone_lengths_are_those_of_the_skeleton_in_every_pose() -> None:
    _, joints = joints_of(TREE, some_poses(50))
    lengths = np.linalg.norm(joints[:, 1:] - joints[:, PARENTS[1:]], axis=-1)
    assert np.allclose(lengths, np.linalg.norm(TREE.offsets[1:], axis=1))


def test_world_rotations_become_the_pose_that_they_came_from_without_leaps() -> None:
    poses = some_poses(2)
    turns, joints = joints_of(TREE, poses)
    again = local_poses(TREE, joints[:, 0], turns)
    assert np.allclose(joints_of(TREE, again)[1], joints)
    flipped = np.repeat(turns[:1], 4, axis=0) * np.array([1.0, -1.0, 1.0, -1.0])[:, None, None]
    still = local_poses(TREE, np.repeat(joints[:1, 0], 4, axis=0), flipped)
    assert np.allclose(np.diff(still, axis=0), 0.0)


def test_a_spec_says_which_skeleton_it_is() -> None:
    spec = StreamSpec.from_json(TREE.spec(30.0, meta={"subject": "A"}).to_json())
    found = JointTree.of(spec)
    assert found.joints == TREE.joints and np.allclose(found.offsets, TREE.offsets) and (found.parents == PARENTS).all()
    assert spec.meta["subject"] == "A" and spec.channels[3:5] == ("Hips.w", "Hips.x") and spec.unit_of("root.z") == "m"


@pytest.mark.parametrize(
    ("spec", "why"),
    [
        (StreamSpec((27,)), "skeleton"),
        (StreamSpec((26,), meta={"skeleton": TREE.facts()}), "27 numbers"),
        (StreamSpec((27,), meta={"skeleton": {**TREE.facts(), "parents": [0, 0, 1, 1, 3, 0]}}), "root comes first"),
        (StreamSpec((27,), meta={"skeleton": {**TREE.facts(), "joints": ["A"] * 6}}), "names of their own"),
        (StreamSpec((27,), meta={"skeleton": [1]}), "poses"),
    ],
)
def test_what_is_no_pose_is_refused(spec: StreamSpec, why: str) -> None:
    with pytest.raises(InputError, match=why):
        JointTree.of(spec)


def test_a_spec_says_which_mesh_it_is() -> None:
    mesh = Topology(5, CUBE, "cube")
    found = Topology.of(StreamSpec.from_json(mesh.spec(30.0).to_json()))
    assert (found.faces == CUBE).all() and found.name == "cube" and found.hash == mesh.hash
    assert mesh.hash != Topology(6, CUBE).hash != Topology(5, CUBE[::-1]).hash


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"triangles": 4}, "bytes of triangles"),
        ({"triangles": 2}, "bytes of triangles"),
        ({"triangles": 10**9}, "triangles"),
        ({"faces": "!!"}, "cannot be read"),
        ({"topology": "0" * 16}, "hash"),
    ],
)
def test_a_damaged_mesh_is_refused(changes: dict[str, object], why: str) -> None:
    spec = Topology(5, CUBE).spec(30.0)
    with pytest.raises(InputError, match=why):
        Topology.of(spec.derive(meta={"mesh": {**spec.meta["mesh"], **changes}}))


def test_a_triangle_of_vertices_that_are_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match="names vertex 4; there are 4"):
        Topology(4, CUBE)


@pytest.mark.parametrize(
    ("parents", "offsets"),
    [
        (PARENTS[:-1], TREE.offsets),
        (PARENTS, TREE.offsets[:-1]),
        (PARENTS, TREE.offsets[:, :2]),
        (PARENTS, np.where(np.arange(18).reshape(6, 3) == 7, np.nan, TREE.offsets)),
    ],
)
def test_every_joint_needs_a_parent_and_a_finite_offset(parents: Any, offsets: Any) -> None:
    with pytest.raises(ValueError, match=r"6 joints need 6 parents and \(6, 3\) finite offsets"):
        JointTree(TREE.joints, parents, offsets)
