"""Poses as the page shows them: where the joints are, and how an avatar's bones are turned. Plain Python, for the page's server loads no
compiler."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from kinegraph.stream.chunk import Array, Samples, StreamSpec
from kinegraph.stream.errors import KinegraphError


class Bones(NamedTuple):
    """A skeleton as a `pose` stream's spec says it (see `stream.domain.skeleton`)."""

    joints: list[str]
    parents: list[int]
    offsets: list[list[float]]

    @property
    def pairs(self) -> list[list[int]]:
        """Each joint's parent and itself: what a line is drawn between."""
        return [[parent, joint] for joint, parent in enumerate(self.parents) if parent >= 0]


def bones_of(spec: StreamSpec) -> Bones | None:
    """The skeleton of a stream of poses; None for any other stream."""
    facts: Any = spec.meta.get("skeleton")
    if spec.is_event or not isinstance(facts, dict) or not {"joints", "parents", "offsets_m"} <= facts.keys():
        return None
    found = Bones(facts["joints"], facts["parents"], facts["offsets_m"])
    return found if spec.shape == (3 + 4 * len(found.joints),) else None


def avatar_bones(spec: StreamSpec) -> dict[str, Any] | None:
    """What an avatar needs to follow a stream of poses. None for what is no humanoid.

    It is the joints' parents, and of every humanoid bone its joint and the rotation (w, x, y, z) from the T-pose to the skeleton's rest. A
    bone without a joint (-1) moves with its parent, and its rotation is beside that one's.
    """
    if bones_of(spec) is None:
        return None
    from kinegraph.stream.domain.humanoid import (  # the session's process has the compiler that these load
        BONES,
        NUMBERS,
        body_in,
        relative_to_parents,
    )
    from kinegraph.stream.domain.skeleton import JointTree

    try:
        joints, _, turns = body_in(tree := JointTree.of(spec))
    except KinegraphError:
        return None
    turns = relative_to_parents(joints, turns)
    names = [bone[0].lower() + bone[1:] for bone in BONES]  # as VRM writes them
    return {
        "parents": tree.parents.tolist(),
        "bones": [
            {"bone": name, "parent": int(parent), "joint": joint, "turn": turn.round(9).tolist()}
            for name, parent, joint, turn in zip(names, NUMBERS, joints, turns, strict=True)
        ],
    }


def places(bones: Bones, pose: Array) -> Samples:
    """Where the joints of a pose (3 + 4 j,) are, (j, 3) m."""
    numbers = pose.tolist()
    turns, found = [tuple(numbers[3:7])], [tuple(numbers[:3])]
    for joint in range(1, len(bones.joints)):
        parent = bones.parents[joint]
        w, x, y, z = turns[parent]
        a, b, c, d = numbers[3 + 4 * joint : 7 + 4 * joint]
        turns.append((
            w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c, w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a,
        ))  # fmt: skip
        p, q, r = bones.offsets[joint]
        i, j, k = 2 * (y * r - z * q), 2 * (z * p - x * r), 2 * (x * q - y * p)
        at = (p + w * i + y * k - z * j, q + w * j + z * i - x * k, r + w * k + x * j - y * i)
        found.append(tuple(here + step for here, step in zip(found[parent], at, strict=True)))
    return np.array(found)
