"""Skeletons and poses: what a `pose` stream says in its spec, and where its joints are.

A sample of a pose is one row: the root's position (x, y, z in metres), then a unit quaternion (w, x, y, z) for every joint, its rotation
relative to its parent. At rest all quaternions are (1, 0, 0, 0), and every joint lies at its offset from its parent. Axes are right-handed:
y up; a body at rest faces z, and x points to its left.

The spec's `meta["skeleton"]` holds `joints` (names), `parents` (the number of each joint's parent, lower than its own; -1 for the root,
which comes first) and `offsets_m` (joints, 3). These are all the bone lengths that a pose has; measured positions travel as markers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.domain.axes import BODY
from kinegraph.stream.errors import InputError
from kinegraph.stream.kernel import kernel

ROOT = ("root.x", "root.y", "root.z")


@dataclass(frozen=True, slots=True)
class JointTree:
    """A skeleton at rest.

    joints    names
    parents   (joints,) the number of each joint's parent, lower than its own; -1 for the first
    offsets   (joints, 3) m: from the parent to the joint at rest; the root's is where it stands at rest
    """

    joints: tuple[str, ...]
    parents: Times
    offsets: Samples

    def __post_init__(self) -> None:
        n = len(self.joints)
        object.__setattr__(self, "parents", np.ascontiguousarray(self.parents, np.int64))
        object.__setattr__(self, "offsets", np.ascontiguousarray(self.offsets, np.float64))
        if not n or len(set(self.joints)) != n:
            raise ValueError("a skeleton needs joints with names of their own")
        if self.parents.shape != (n,) or self.offsets.shape != (n, 3) or not np.isfinite(self.offsets).all():
            raise ValueError(f"{n} joints need {n} parents and ({n}, 3) finite offsets")
        if self.parents[0] != -1 or not all(0 <= self.parents[j] < j for j in range(1, n)):
            raise ValueError("the root comes first, and every other joint after its parent")

    @property
    def width(self) -> int:
        """Numbers in a pose."""
        return 3 + 4 * len(self.joints)

    @property
    def at_rest(self) -> Samples:
        """Where the joints are at rest, (joints, 3) m."""
        made = self.offsets.copy()
        for j in range(1, len(made)):
            made[j] += made[self.parents[j]]
        return made

    def spec(self, rate_hz: float | None, **changes: Any) -> StreamSpec:
        """The spec of a stream of this skeleton's poses; `meta` among the changes is kept beside the skeleton."""
        meta = {**changes.pop("meta", {}), "skeleton": self.facts(), "axes": BODY.facts()}
        channels = (*ROOT, *(f"{joint}.{axis}" for joint in self.joints for axis in "wxyz"))
        units = ("m", "m", "m", *("" for _ in channels[3:]))
        return StreamSpec((self.width,), rate_hz=rate_hz, channels=channels, units=units, meta=meta, **changes)

    def facts(self) -> dict[str, Any]:
        """What a spec says of this skeleton in its `meta`."""
        return {
            "joints": list(self.joints),
            "parents": self.parents.tolist(),
            "offsets_m": np.round(self.offsets, 9).tolist(),
        }

    @staticmethod
    def of(spec: StreamSpec, port: str = "in") -> JointTree:
        """The skeleton of a stream of poses. Raises InputError for any other stream."""
        try:
            tree = JointTree.from_facts(spec.meta["skeleton"])
            if spec.shape != (tree.width,) or spec.is_event:
                raise ValueError(f"{len(tree.joints)} joints need rows of {tree.width} numbers")
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            accepts = "a stream of poses: rows of a root position and quaternions, with a skeleton in its spec"
            raise InputError(port, f"{spec.describe()} ({error})", accepts) from None
        return tree

    @staticmethod
    def from_facts(facts: Any) -> JointTree:
        """What `facts` gave. Raises KeyError, TypeError, ValueError or OverflowError."""
        joints, parents, offsets = facts["joints"], facts["parents"], facts["offsets_m"]
        if not all(isinstance(name, str) for name in joints):
            raise ValueError("joints have names")
        return JointTree(tuple(joints), np.array(parents, np.int64), np.array(offsets, np.float64))


@kernel
def turn(q: Samples, v: Samples, out: Samples) -> None:
    """`v` (3,) turned by the unit quaternion `q` (4,) (w, x, y, z), into `out` (3,)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    a = 2.0 * (y * v[2] - z * v[1])
    b = 2.0 * (z * v[0] - x * v[2])
    c = 2.0 * (x * v[1] - y * v[0])
    p, r, s = v[0] + w * a + y * c - z * b, v[1] + w * b + z * a - x * c, v[2] + w * c + x * b - y * a
    out[0], out[1], out[2] = p, r, s


@kernel
def multiply(p: Samples, q: Samples, out: Samples) -> None:
    """The quaternion product p q (first q, then p) into `out` (4,), which may be `p` or `q`."""
    w = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3]
    x = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2]
    y = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1]
    z = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]
    out[0], out[1], out[2], out[3] = w, x, y, z


@kernel
def place_joints(pose: Samples, parents: Times, offsets: Samples, turns: Samples, joints: Samples) -> None:
    """Where the joints of one pose (3 + 4 j,) are: world rotations into `turns` (j, 4), positions into `joints` (j, 3)."""
    joints[0] = pose[:3]
    turns[0] = pose[3:7]
    for j in range(1, parents.shape[0]):
        parent = parents[j]
        multiply(turns[parent], pose[3 + 4 * j : 7 + 4 * j], turns[j])
        turn(turns[parent], offsets[j], joints[j])
        for a in range(3):
            joints[j, a] += joints[parent, a]


@kernel
def place_all(poses: Samples, parents: Times, offsets: Samples, turns: Samples, joints: Samples) -> None:
    """`place_joints` for poses (n, 3 + 4 j): into `turns` (n, j, 4) and `joints` (n, j, 3)."""
    for i in range(poses.shape[0]):
        place_joints(poses[i], parents, offsets, turns[i], joints[i])


def joints_of(tree: JointTree, poses: Samples) -> tuple[Samples, Samples]:
    """World rotations (n, j, 4) and positions (n, j, 3) m of the joints in `poses` (n, 3 + 4 j)."""
    n, j = len(poses), len(tree.joints)
    turns, joints = np.empty((n, j, 4)), np.empty((n, j, 3))
    place_all(np.ascontiguousarray(poses, np.float64), tree.parents, tree.offsets, turns, joints)
    return turns, joints


def local_poses(tree: JointTree, root: Samples, turns: Samples) -> Samples:
    """Poses (n, 3 + 4 j) of the root's positions `root` (n, 3) and world rotations `turns` (n, j, 4); signs follow the frame before."""
    made = np.empty((len(turns), tree.width))
    made[:, :3], made[:, 3:7] = root, turns[:, 0]
    for j in range(1, len(tree.joints)):
        p, q = turns[:, tree.parents[j]] * [1.0, -1.0, -1.0, -1.0], turns[:, j]
        made[:, 3 + 4 * j : 7 + 4 * j] = _products(p, q)
    quaternions = made[:, 3:].reshape(len(made), len(tree.joints), 4)
    flips = np.sign(np.einsum("njk,njk->nj", quaternions[1:], quaternions[:-1]))
    quaternions[1:] *= np.cumprod(np.where(flips < 0, -1.0, 1.0), axis=0)[..., None]
    return made


def _products(p: Samples, q: Samples) -> Samples:
    """Quaternion products (n, 4) of `p` and `q`, row by row."""
    w, v, a, u = p[:, :1], p[:, 1:], q[:, :1], q[:, 1:]
    real = w * a - (v * u).sum(1, keepdims=True)
    return np.asarray(np.hstack([real, w * u + a * v + np.cross(v, u)]))


def chain(tree: JointTree, joint: int) -> Sequence[int]:
    """The joints from the root to `joint`, both included."""
    found = [joint]
    while tree.parents[found[-1]] >= 0:
        found.append(int(tree.parents[found[-1]]))
    return found[::-1]
