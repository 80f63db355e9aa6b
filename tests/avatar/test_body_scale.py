"""The size of a body from where its landmarks are while it stands, and what is taken for bones that no marker shows."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.pose.limb_kernel import ANKLE_AT, ELBOW_AT, HEAD_AT, HIP_AT, KNEE_AT, SHOULDER_AT, WRIST_AT
from kinegraph.operators.pose.marks_kernel import scale_body
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.humanoid import BONES, usual_body
from kinegraph.stream.domain.skeleton import joints_of

PLACES = {
    HIP_AT: "UpperLeg", KNEE_AT: "LowerLeg", ANKLE_AT: "Foot", SHOULDER_AT: "UpperArm", ELBOW_AT: "LowerArm", WRIST_AT: "Hand",
}  # fmt: skip


def standing(size: float) -> Samples:
    """Landmarks (m, 3) of the usual body, `size` times as large."""
    tree = usual_body()
    row = np.concatenate([tree.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))])
    joints = joints_of(tree, row[None])[1][0]
    made = np.zeros((HEAD_AT + 1, 3))
    for at, bone in PLACES.items():
        for k, side in enumerate(("Left", "Right")):
            made[at + k] = size * joints[BONES.index(side + bone)]
    return made


@pytest.mark.parametrize("size", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("hidden", [(), (KNEE_AT,), (ELBOW_AT,), (KNEE_AT, ELBOW_AT, WRIST_AT)])
def test_a_body_is_as_large_as_its_markers_say(size: float, hidden: tuple[int, ...]) -> None:
    usual = usual_body().offsets
    present = np.ones(HEAD_AT + 1, bool)
    for at in hidden:
        present[at : at + 2] = False
    offsets = np.zeros_like(usual)
    assert scale_body(standing(size), present, usual, offsets) == pytest.approx(size, rel=1e-3)
    np.testing.assert_allclose(offsets, size * usual, atol=1e-3)


def test_a_body_of_which_nothing_is_seen_has_the_usual_size() -> None:
    usual = usual_body().offsets
    offsets = np.zeros_like(usual)
    assert scale_body(standing(1.0), np.zeros(HEAD_AT + 1, bool), usual, offsets) == 1.0
    np.testing.assert_array_equal(offsets, usual)
