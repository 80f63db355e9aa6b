"""One name per joint: what sources call it, what graphs ask for, and one spelling inside."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.devices.people.exerciser import JOINTS as EXERCISER
from kinegraph.devices.people.performer import MARKERS as PERFORMER
from kinegraph.operators.body.names import MARKERS as CAMERA
from kinegraph.operators.contacts.marker import MarkerContacts
from kinegraph.operators.features.normalised_pose import NormalisedPose
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.domain.joint_names import JOINTS, find_point, joint_name, plain, spellings
from kinegraph.stream.errors import ParameterError

LIMBS = [f"{joint}_{side}" for joint in ("hip", "knee", "ankle", "wrist", "shoulder", "elbow") for side in "lr"]


@pytest.mark.parametrize("names", [EXERCISER, PERFORMER, CAMERA], ids=["exerciser", "performer", "camera"])
def test_the_joints_of_every_body_are_found_by_our_names(names: tuple[str, ...]) -> None:
    assert [joint_name(find_point(joint, names) or "") for joint in LIMBS] == LIMBS


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [("left_ankle", "ankle_l"), ("LANK", "ankle_l"), ("foot_l", "ankle_l"), ("Fred:RightFoot", "ankle_r"), ("RASI", "RASI"),
     ("LeftHandTip", "hand_l"), ("left_toe", "toe_l"), ("WristRight", "wrist_r"), ("withers", "withers")],
)  # fmt: skip
def test_a_joint_has_one_name(theirs: str, ours: str) -> None:
    assert joint_name(theirs) == ours and joint_name(ours) == ours


def test_every_joint_is_its_own_best_spelling() -> None:
    assert [joint for joint in JOINTS if joint_name(joint) != joint] == []
    assert all(plain(joint) in spellings(joint) or "+" in spellings(joint)[0] for joint in JOINTS if joint != "root")


def test_what_has_the_very_name_is_taken_before_what_has_another_of_the_joint() -> None:
    assert find_point("foot_l", ["ankle_l", "foot_l"]) == "foot_l"
    assert find_point("hip_l", ["LANK", "LKNE"]) is None


def test_operators_accept_another_programs_name() -> None:
    markers = StreamSpec((2, 3), rate_hz=100.0, channels=("LANK", "LHIP"), units=("m",))
    MarkerContacts(marker="left_ankle", reference="hip_l", side="left").open({"in": markers})
    with pytest.raises(ParameterError, match="knee_l"):
        MarkerContacts(marker="knee_l", reference="hip_l", side="left").open({"in": markers})
    body = np.array([[[0.1, 1.0, 0.0], [-0.1, 1.0, 0.0], [0.2, 0.5, 0.0]]])
    pose = NormalisedPose("hips", "hip_l", {"hips": ("hip_l", "hip_r"), "hip_l": ("hip_l",), "knee_l": ("knee_l",)})
    made = pose(body, rate_hz=30, channels=["left_hip", "right_hip", "LKNE"], units=["m"])
    np.testing.assert_allclose(made, [[0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.2, -0.5, 0.0]], atol=1e-12)
