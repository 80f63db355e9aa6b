"""Made-up motion of a humanoid for motion graphs: someone who walks, straight on or in a curve, or waves on the spot."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinegraph.operators.maps.motion_graph.build import build_graph
from kinegraph.operators.maps.motion_graph.primitives import segmented
from kinegraph.operators.maps.motion_graph.takes import TOES, Take, symmetric
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.humanoid import BONES, to_humanoid, usual_body
from kinegraph.stream.domain.motion_graph import MotionGraph
from kinegraph.stream.domain.skeleton import JointTree, joints_of, local_poses

TREE = usual_body()
RATE = 30.0
CYCLE = 32
"""Frames of a stride."""


def bent(frames: int) -> Samples:
    row = np.concatenate([TREE.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))])
    return np.tile(row, (frames, 1))


def bend(poses: Samples, bone: str, axis: int, angle: Samples) -> None:
    at = 3 + 4 * BONES.index(bone)
    poses[:, at], poses[:, at + axis] = np.cos(angle / 2), np.sin(angle / 2)


def walking(cycles: int, turn_rad: float = 0.0, sway: float = 0.0) -> Samples:
    """Strides of a walk, each turned by `turn_rad`; the lower foot stands still. `sway` makes cycles differ."""
    n = cycles * CYCLE
    phase = 2 * np.pi * np.arange(n) / CYCLE
    poses = bent(n)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        swing = sign * np.sin(phase)
        lift = np.clip(sign * np.cos(phase), 0.0, None) ** 2
        bend(poses, f"{side}UpperLeg", 1, -0.35 * swing - 0.35 * lift)
        bend(poses, f"{side}LowerLeg", 1, 0.1 + 0.8 * lift)
        bend(poses, f"{side}Foot", 1, -0.1 + 0.35 * swing - 0.45 * lift)
        bend(poses, f"{side}UpperArm", 3, np.full(n, -sign * 1.3))
        bend(poses, f"{side}LowerArm", 2, -sign * (0.3 + sway * np.sin(phase / 3.7)))
    heading = turn_rad * np.arange(n) / CYCLE
    bend(poses, "Hips", 2, heading)
    poses[:, 0] = poses[:, 2] = 0.0
    toes = joints_of(TREE, poses)[1][:, TOES]
    lower = toes[:, :, 1].argmin(axis=1)
    move = np.array([toes[i, lower[i]] - toes[i + 1, lower[i]] for i in range(n - 1)])
    poses[1:, [0, 2]] += np.cumsum(move[:, [0, 2]], axis=0)
    poses[:, 1] -= toes[:, :, 1].min(axis=1) - 0.02
    return poses


def waving(cycles: int) -> Samples:
    """Somebody who stands and waves, from one standing pose back to it."""
    n = cycles * CYCLE
    phase = 2 * np.pi * np.arange(n) / CYCLE
    poses = bent(n)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        bend(poses, f"{side}UpperArm", 3, -sign * (1.3 - (0.9 * (1 - np.cos(phase)) if side == "Right" else 0.0)))
    return poses


def take(name: str, poses: Samples, cluster: int, every: int = CYCLE) -> Take:
    """A take cut into cycles of one cluster."""
    firsts = np.arange(0, len(poses), every)
    spans = np.stack([firsts, np.minimum(firsts + every, len(poses))], 1)
    return Take(name, 0, poses, spans, np.full(len(spans), cluster))


def cmu_takes(names: Sequence[str]) -> tuple[JointTree, list[Take]]:
    """CMU sequences of the real recordings (KINEGRAPH_DATA), 30 Hz, not segmented."""
    folder = Path(os.environ["KINEGRAPH_DATA"]) / "body"
    with np.load(folder / "human_male.npz") as z:
        joints, parents, heads = [str(j) for j in z["joint_names"]], z["parents"], z["head"].astype(float)
    order: list[int] = []
    while len(order) < len(joints):
        order += [j for j in range(len(joints)) if j not in order and (parents[j] < 0 or parents[j] in order)]
    offsets = np.array([heads[j] - (heads[parents[j]] if parents[j] >= 0 else 0.0) for j in order])
    above = np.array([order.index(parents[j]) if parents[j] >= 0 else -1 for j in order])
    tree = JointTree(tuple(joints[j] for j in order), above, offsets)
    takes = list[Take]()
    with np.load(folder / "cmu_mocap_30hz.npz") as z:
        for name in names:
            turns = z[f"rot_{name}"].astype(float)[:, order][..., [3, 0, 1, 2]]
            turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
            body, poses = to_humanoid(tree, local_poses(tree, z[f"root_{name}"].astype(float), turns))
            takes.append(Take(name, 0, poses, np.empty((0, 2), np.int64), np.empty(0, np.int64)))
    return symmetric(body), takes


def recorded(*names: str, within_m: float = 0.12) -> MotionGraph:
    """The motion graph of CMU sequences, as `kinegraph motion train graph` makes it."""
    tree, takes = cmu_takes(names)
    takes = segmented(tree, takes, RATE)
    clusters = range(1 + max(int(t.cluster.max()) for t in takes))
    return build_graph(tree, takes, [chr(65 + c) for c in clusters], RATE, within_m, 5)
