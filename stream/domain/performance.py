"""What someone does before a camera, as one: poses with the bones of fingers, and weights of expressions at the same times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec, Times
from kinegraph.stream.domain.fingers import BENDS, FINGER_BONES, RELAXED, finger_offsets, finger_rotations
from kinegraph.stream.domain.humanoid import BONES, to_humanoid
from kinegraph.stream.domain.skeleton import JointTree

PRESETS = {
    "Blink": "blink", "Blink_L": "blinkLeft", "Blink_R": "blinkRight", "A": "aa", "I": "ih", "U": "ou", "E": "ee", "O": "oh",
    "Joy": "happy", "Angry": "angry", "Sorrow": "sad", "Fun": "relaxed", "Neutral": "neutral", "Surprised": "surprised",
}  # fmt: skip
"""Expressions as VRM 0 and VMC call them, and as VRM 1 does; what is not here is an expression of the avatar's own."""


def is_fingers(spec: StreamSpec) -> bool:
    """Whether a stream holds how fingers bend (operators.body.camera.hands.Hands)."""
    return spec.channels == BENDS


def is_face(spec: StreamSpec) -> bool:
    """Whether a stream holds weights of a face's expressions (operators.body.camera.face.Face)."""
    return spec.is_signal and spec.dtype.kind == "f" and {"Blink_L", "Blink_R"} <= set(spec.channels)


@dataclass(frozen=True, slots=True)
class Performance:
    """seconds (n,) from the first pose on; poses (n, 3 + 4 j) of `tree`; weights (n, k), 0 to 1, of k `expressions`."""

    tree: JointTree
    seconds: Samples
    poses: Samples
    expressions: tuple[str, ...] = ()
    weights: Samples | None = None

    @classmethod
    def joined(
        cls,
        tree: JointTree,
        times: Times,
        poses: Array,
        fingers: tuple[Times, Array] | None = None,
        face: tuple[Sequence[str], Times, Array] | None = None,
    ) -> Performance:
        """Poses with what hands and face do at the same times: interpolated, and held before the first and after the last sample.

        With `fingers`, a body of another skeleton is turned into a humanoid. Raises KinegraphError where that cannot be done.
        """
        own, names, weights = np.asarray(poses, np.float64), tuple[str, ...](), None
        if fingers is not None:
            if tree.joints != BONES:
                tree, own = to_humanoid(tree, own)
            turns = finger_rotations(_at(times, *fingers, RELAXED))
            tree, own = with_fingers(tree), np.hstack([own, turns.reshape(len(own), -1)])
        if face is not None:
            names = tuple(face[0])
            weights = np.clip(_at(times, *face[1:], np.zeros(len(names))), 0.0, 1.0)
        return cls(tree, (times - times[0]) / NS, own, names, weights)


def with_fingers(body: JointTree) -> JointTree:
    """A humanoid with the 30 bones of its fingers after its own."""
    parents = [
        body.joints.index(f"{side}Hand") if joint == 0 else len(body.joints) + 15 * hand + 3 * finger + joint - 1
        for hand, side in enumerate(("Left", "Right"))
        for finger in range(5)
        for joint in range(3)
    ]
    return JointTree(
        (*body.joints, *FINGER_BONES),
        np.concatenate([body.parents, parents]),
        np.concatenate([body.offsets, finger_offsets()]),
    )


def _at(when: Times, times: Times, rows: Array, rest: Samples) -> Samples:
    """Finite `rows` (m, k) interpolated at `when` (n,); `rest` (k,) where there is no row."""
    good = np.isfinite(rows).all(axis=1)
    if not good.any():
        return np.tile(rest, (len(when), 1))
    at, known = (when - when[0]) / NS, (times[good] - when[0]) / NS
    return np.stack([np.interp(at, known, column) for column in np.asarray(rows[good], np.float64).T], axis=1)
