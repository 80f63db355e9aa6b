"""configs/avatar.yaml: an avatar follows the person before a depth camera.

Recording: simulated, a performer of capsules before a rendered camera (of a real camera there is no recording that may be kept). Images are
left out: this is the avatar by depth alone, as in the dark, and it needs no network.
Truth: where the performer's joints are.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.devices.people.rendered_performer import EMPTY_S, POINTS
from kinegraph.stream.chunk import NS
from tests.replay.replaying import CAMERA_HZ, no_images, performance, signal

DEPTH, JOINTS = performance(6.0)
GRAPH = kg.load("avatar")


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    depth = kg.Series("", GRAPH.specs["camera.depth"], signal(DEPTH, CAMERA_HZ).time, DEPTH)
    return GRAPH.run(
        {"camera.depth": depth, "camera.mono": no_images(GRAPH, "camera.mono")},
        keep=["surer", "pose.joints", "avatar.prompt"],
    )


@pytest.mark.parametrize("point", ["head", "left_shoulder", "right_shoulder", "left_hip", "right_knee", "left_ankle"])
def test_a_marker_is_near_the_joint(replayed: kg.Results, point: str) -> None:
    """Depth shows the body's surface, which is some centimetres before a joint."""
    markers = replayed["surer"]
    later = slice(90, None)
    found = markers.data[later, markers.spec.channels.index(point)]
    truth = JOINTS[np.round(markers.time[later] / NS * CAMERA_HZ).astype(int), POINTS.index(point)]
    away = np.linalg.norm(found - truth, axis=1)
    assert np.isfinite(away).mean() > 0.9
    assert np.nanmedian(away) < 0.1


def test_the_person_is_asked_to_stand_still_and_is_then_followed(replayed: kg.Results) -> None:
    prompts = replayed["avatar.prompt"].data
    assert prompts["state"].tolist() == ["waiting", "stand", "follows"]
    assert prompts["onset"][1] / NS == pytest.approx(EMPTY_S, abs=0.2)
    assert 0.9 < (prompts["onset"][2] - prompts["onset"][1]) / NS < 1.5


def test_the_skeleton_is_as_tall_as_the_performer(replayed: kg.Results) -> None:
    joints = replayed["pose.joints"]
    head, ankle = (joints.data[120:, joints.spec.channels.index(bone), 1] for bone in ("Head", "LeftFoot"))
    truth = JOINTS[120:, POINTS.index("left_ankle"), 1] - JOINTS[120:, POINTS.index("head"), 1]
    assert np.median(np.abs(head - ankle)) == pytest.approx(np.median(truth), abs=0.2)
