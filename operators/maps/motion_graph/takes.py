"""What a motion graph is made of: takes of poses on one skeleton at one rate, feet on one floor, and their mirror images."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import NS, Array, Samples, Times
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.skeleton import JointTree, joints_of

SOLE_M = 0.02
"""The joint of the toes is so far above the floor when the foot stands."""
STILL_M_S, LOW_M = 0.35, 0.05
"""A foot stands while its toes are slower than this, and no more than this above where they stand."""
LONGEST_GAP_S = 0.2
"""Poses are interpolated over a gap no longer than this; a longer one ends a take."""
TOES = (BONES.index("LeftToes"), BONES.index("RightToes"))


@dataclass(frozen=True, slots=True)
class Take:
    """Poses (n, width) that follow one another at one rate, from `start` (ns) on; `spans` (p, 2) of primitives in frames, first and one
    past the last; `cluster` (p,), -1: no repetition; where it comes from."""

    name: str
    start: int
    poses: Samples
    spans: Times
    cluster: Times


def pieces(time: Times, poses: Samples, rate_hz: float) -> list[tuple[int, Samples]]:
    """Poses (n, width) at any stamps as runs of poses at `rate_hz`, each with its first stamp; bad ones are left out."""
    sizes = np.linalg.norm(poses[:, 3:].reshape(len(poses), -1, 4), axis=2)
    good: Array = np.isfinite(poses).all(axis=1) & (sizes > 0.5).all(axis=1)
    time, poses = time[good], np.asarray(poses[good], np.float64)
    if len(time) < 2:
        return []
    breaks = np.flatnonzero(np.diff(time) > max(LONGEST_GAP_S, 1.5 / rate_hz) * NS) + 1
    return [
        (int(t[0]), _resampled(t, p, rate_hz))
        for t, p in zip(np.split(time, breaks), np.split(poses, breaks), strict=True)
        if t[-1] - t[0] >= NS / rate_hz
    ]


def _resampled(time: Times, poses: Samples, rate_hz: float) -> Samples:
    """Poses at even times from the first stamp on: positions and quaternions between the two nearest, these of length 1 again."""
    count = int((time[-1] - time[0]) * rate_hz / NS + 1e-6) + 1
    at = (np.arange(count) / rate_hz).clip(max=(time[-1] - time[0]) / NS)
    was = (time - time[0]) / NS
    k = np.searchsorted(was, at, side="right").clip(1, len(was) - 1)
    w = ((at - was[k - 1]) / (was[k] - was[k - 1]))[:, None]
    p, q = poses[k - 1].copy(), poses[k].copy()
    a, b = p[:, 3:].reshape(count, -1, 4), q[:, 3:].reshape(count, -1, 4)
    b *= np.where((a * b).sum(2, keepdims=True) < 0.0, -1.0, 1.0)
    made = (1.0 - w) * p + w * q
    turns = made[:, 3:].reshape(count, -1, 4)
    turns /= np.linalg.norm(turns, axis=2, keepdims=True)
    return np.ascontiguousarray(made)


def on_floor(tree: JointTree, poses: Samples) -> Samples:
    """The same poses, moved up or down so that the toes, where lowest (1 % of frames aside), stand on the floor."""
    _, joints = joints_of(tree, poses)
    made = poses.copy()
    made[:, 1] -= np.quantile(joints[:, TOES, 1].min(axis=1), 0.01) - SOLE_M
    return made


def standing(tree: JointTree, poses: Samples, rate_hz: float) -> Array:
    """(n, 2) whether the left and the right foot stand: toes slow and low; holes and stands of at most two frames are ignored."""
    toes = joints_of(tree, poses)[1][:, TOES]
    speed = np.linalg.norm(np.gradient(toes, axis=0), axis=2) * rate_hz if len(toes) > 1 else np.zeros(toes.shape[:2])
    made = (speed < STILL_M_S) & (toes[:, :, 1] < SOLE_M + LOW_M)
    for foot in made.T:
        for value in (True, False):
            edges = np.flatnonzero(np.diff(foot)) + 1
            for first, last in itertools.pairwise(edges):
                if last - first <= 2 and foot[first] != value:
                    foot[first:last] = value
    return np.asarray(made)


def mirrored_poses(poses: Samples) -> Samples:
    """Humanoid poses (n, 91) seen in a mirror: left for right, x for -x."""
    swap = [BONES.index(_other_side(bone)) for bone in BONES]
    made = poses.copy()
    made[:, 0] *= -1.0
    turns = poses[:, 3:].reshape(len(poses), -1, 4)[:, swap] * [1.0, 1.0, -1.0, -1.0]
    made[:, 3:] = turns.reshape(len(poses), -1)
    return made


def mirrored_tree(tree: JointTree) -> JointTree:
    """The humanoid seen in a mirror: left for right, x for -x."""
    swap = [BONES.index(_other_side(bone)) for bone in BONES]
    return JointTree(tree.joints, tree.parents, tree.offsets[swap] * [-1.0, 1.0, 1.0])


def symmetric(tree: JointTree) -> JointTree:
    """The humanoid with both sides the same: the mean of the two. Without that a mirrored pose would stand beside its own feet."""
    made = 0.5 * (tree.offsets + mirrored_tree(tree).offsets)
    made[0] = tree.offsets[0]
    return JointTree(tree.joints, tree.parents, made)


def _other_side(bone: str) -> str:
    if bone.startswith("Left"):
        return "Right" + bone.removeprefix("Left")
    return "Left" + bone.removeprefix("Right") if bone.startswith("Right") else bone
