"""Poses as a BVH file: the skeleton, then one line a frame, in centimetres and degrees."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.skeleton import JointTree

CM = 100.0
TURNS = "Zrotation Xrotation Yrotation"
END_M = 0.05
"""A limb's end, which poses do not have, is drawn so far beyond its last joint."""
COUNT = 10
"""The number of frames takes this many characters, so that it can be corrected in place as a file grows."""


def bvh_head(tree: JointTree, rate_hz: float) -> tuple[str, int]:
    """The file up to its frames, with a frame count of 0; and the offset of that count (in characters, all ASCII)."""
    lines = ["HIERARCHY", *_joint(tree, 0, 0), "MOTION"]
    text = "\n".join(lines) + "\nFrames: "
    return f"{text}{0:{COUNT}d}\nFrame Time: {1 / rate_hz:.9f}\n", len(text)


def _joint(tree: JointTree, j: int, deep: int) -> Iterator[str]:
    """A joint and all after it, tabs before what is within."""
    indent, offset = "\t" * deep, " ".join(f"{CM * x:.6f}" for x in tree.offsets[j])
    children = [k for k in range(len(tree.joints)) if tree.parents[k] == j]
    places = "Xposition Yposition Zposition " if deep == 0 else ""
    yield f"{indent}{'JOINT' if deep else 'ROOT'} {tree.joints[j].replace(' ', '_')}"
    yield f"{indent}{{"
    yield f"{indent}\tOFFSET {offset if deep else '0.000000 0.000000 0.000000'}"
    yield f"{indent}\tCHANNELS {6 if places else 3} {places}{TURNS}"
    for child in children:
        yield from _joint(tree, child, deep + 1)
    if not children:
        length = float(np.linalg.norm(tree.offsets[j]))
        end = CM * END_M * (tree.offsets[j] / length if deep and length > 0 else np.array([0.0, 1.0, 0.0]))
        yield f"{indent}\tEnd Site"
        yield f"{indent}\t{{"
        yield f"{indent}\t\tOFFSET {' '.join(f'{x:.6f}' for x in end)}"
        yield f"{indent}\t}}"
    yield f"{indent}}}"


def order_of(tree: JointTree) -> list[int]:
    """The joints in the order in which a BVH file has them: each before its children, one limb after the other."""
    found: list[int] = []

    def take(j: int) -> None:
        found.append(j)
        for k in range(len(tree.joints)):
            if tree.parents[k] == j:
                take(k)

    take(0)
    return found


def bvh_rows(tree: JointTree, poses: Samples) -> str:
    """Frames of `poses` (n, 3 + 4 j) as lines."""
    n, order = len(poses), order_of(tree)
    if not n:
        return ""
    turns = np.asarray(poses[:, 3:], np.float64).reshape(n, -1, 4)[:, order].reshape(-1, 4)
    with warnings.catch_warnings():  # at 90 degrees one of two angles is free: any choice is right
        warnings.filterwarnings("ignore", "Gimbal lock")
        angles = Rotation.from_quat(turns, scalar_first=True).as_euler("ZXY", degrees=True).reshape(n, -1)
    rows = np.hstack([CM * np.asarray(poses[:, :3], np.float64), angles])
    return "".join(" ".join(f"{x:.6f}" for x in row) + "\n" for row in rows.tolist())
