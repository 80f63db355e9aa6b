"""Skeletons, poses and meshes: what their specs say, and that it survives a recording."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinegraph.stream.chunk import Samples, StreamSpec
from kinegraph.stream.domain.humanoid import BONES, find_bones, to_humanoid, usual_body
from kinegraph.stream.domain.mesh import Topology
from kinegraph.stream.domain.skeleton import JointTree, joints_of, local_poses
from kinegraph.stream.errors import InputError, KinegraphError

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


def along_x(names: dict[str, str] | None = None) -> tuple[JointTree, Samples]:
    """Somebody who waves, with a skeleton whose bones lie along x at rest, as in files of 3ds Max and Unreal; and the poses (40, 91)."""
    body, poses = (
        usual_body(),
        np.tile(np.concatenate([usual_body().offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], 22)]), (40, 1)),
    )
    angle = 0.5 * np.linspace(0.0, 1.2, 40)
    for bone, axis in (("LeftUpperArm", 3), ("RightUpperArm", 3), ("LeftUpperLeg", 1), ("Spine", 2)):
        at = 3 + 4 * BONES.index(bone)
        poses[:, at], poses[:, at + axis] = np.cos(angle), np.sin(angle)
    turns, joints = joints_of(body, poses)
    own = np.empty((len(BONES), 4))
    for b, bone in enumerate(BONES):
        child = next((c for c in range(b + 1, len(BONES)) if body.parents[c] == b), -1)
        way = body.offsets[child] if child >= 0 else body.offsets[b]
        x = (np.array([0.0, 1.0, 0.0]) if bone == "Hips" else way) / (1.0 if bone == "Hips" else np.linalg.norm(way))
        z = np.array([0.0, 0.0, 1.0]) if abs(x[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
        y = np.cross(z, x) / np.linalg.norm(np.cross(z, x))
        own[b] = Rotation.from_matrix(np.array([x, y, np.cross(x, y)]).T).as_quat(scalar_first=True)
    rest = Rotation.from_quat(own, scalar_first=True)
    offsets = body.offsets.copy()
    for b in range(1, len(BONES)):
        offsets[b] = rest[int(body.parents[b])].inv().apply(body.offsets[b])
    turned = np.stack([(Rotation.from_quat(t, scalar_first=True) * rest).as_quat(scalar_first=True) for t in turns])
    renamed = tuple((names or {}).get(bone, bone) for bone in BONES)
    tree = JointTree(renamed, body.parents, offsets)
    return tree, local_poses(tree, joints[:, 0], turned)


def test_a_skeleton_whose_bones_lie_along_x_at_rest_becomes_a_body() -> None:
    tree, poses = along_x()
    body, made = to_humanoid(tree, poses)
    turns, joints = joints_of(body, made)
    assert np.allclose(joints, joints_of(tree, poses)[1], atol=1e-6)
    rest = body.at_rest
    assert rest[BONES.index("Head"), 1] - rest[0, 1] > 0.5, "the head is above the hips"
    assert rest[BONES.index("LeftHand"), 0] > 0.5 and rest[BONES.index("LeftFoot"), 1] < rest[0, 1] - 0.7
    assert (np.abs(turns[0] @ [1.0, 0.0, 0.0, 0.0]) > np.cos(np.radians(20) / 2))[:12].all(), "which stands upright"


def test_a_skeleton_without_a_trunk_is_refused() -> None:
    body = usual_body()
    offsets = body.offsets.copy()
    offsets[[BONES.index(bone) for bone in ("Spine", "Chest", "UpperChest", "Neck")]] = 0.0
    with pytest.raises(KinegraphError, match="no trunk"):
        to_humanoid(JointTree(BONES, body.parents, offsets), np.zeros((0, 91)))


@pytest.mark.parametrize("form", ["{bone}_{s}", "Bip01 {S} {bone}", "{bone}.{S}"])
def test_sides_of_bones_may_be_behind_their_names(form: str) -> None:
    names = [
        form.format(bone=bone.removeprefix("Left").removeprefix("Right"), s=bone[0].lower(), S=bone[0])
        if bone.startswith(("Left", "Right"))
        else bone
        for bone in BONES
    ]
    assert find_bones(names) == dict(zip(BONES, names, strict=True))
