"""configs/avatar_markers.yaml: an avatar's pose from thirteen markers of a body.

Recording: a workout of CMU's motion capture (subject 13). Its joints are the markers.
Truth: how far knees and elbows are bent, by the angle between three of the joints; of the pose, it is the turn of a shank or forearm.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS, Array
from tests.replay.replaying import cmu_joints, signal

GRAPH = kg.load("avatar_markers")
NAMES = GRAPH.specs["performer.markers"].channels
MARKERS = cmu_joints("13_31", NAMES)


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    markers = signal(MARKERS, 30.0, NAMES, ["m"])
    return GRAPH.run({"performer.markers": markers}, keep=["smooth", "body.pose", "body.joints"])


def bent_deg(side: str, *chain: str) -> Array:
    """By how much the second of three joints is bent."""
    first, middle, last = (MARKERS[:, NAMES.index(f"{joint}_{side}")] for joint in chain)
    a, b = middle - first, last - middle
    cosine = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    return np.asarray(np.degrees(np.arccos(cosine)))


@pytest.mark.parametrize(
    ("bone", "chain", "within_deg"),
    [("LowerLeg", ("hip", "knee", "ankle"), 10.0), ("LowerArm", ("shoulder", "elbow", "wrist"), 25.0)],
)
@pytest.mark.parametrize(("side", "name"), [("l", "Left"), ("r", "Right")])
def test_joints_are_bent_as_the_markers_are(
    replayed: kg.Results, bone: str, chain: tuple[str, ...], within_deg: float, side: str, name: str
) -> None:
    """CMU's shoulders and elbows are not where an avatar's are, so that its elbow is bent by a constant amount less."""
    pose = replayed["body.pose"]
    w = pose.data[:, pose.spec.channels.index(f"{name}{bone}.w")]
    found = 2 * np.degrees(np.arccos(np.abs(w).clip(0, 1)))
    truth = np.interp(pose.time / NS, np.arange(len(MARKERS)) / 30, bent_deg(side, *chain))
    late = slice(30, None)  # the first second gives the bones' lengths
    assert np.corrcoef(found[late], truth[late])[0, 1] > 0.93
    assert np.median(np.abs(found - truth)[late]) < within_deg


def test_the_skeletons_joints_are_where_the_markers_are(replayed: kg.Results) -> None:
    joints = replayed["body.joints"]
    for bone, marker in {"LeftLowerLeg": "knee_l", "RightFoot": "ankle_r", "LeftHand": "wrist_l"}.items():
        found = joints.data[:, joints.spec.channels.index(bone)]
        truth = MARKERS[:, NAMES.index(marker)]
        truth = np.stack([np.interp(joints.time / NS, np.arange(len(truth)) / 30, axis) for axis in truth.T], axis=1)
        assert np.median(np.linalg.norm(found - truth, axis=1)[30:]) < 0.1


def test_what_is_smoothed_stays_with_the_markers(replayed: kg.Results) -> None:
    assert np.median(np.linalg.norm(replayed["smooth"].data - MARKERS, axis=2)) < 0.02
