"""configs/webcam_avatar.yaml: an avatar follows the person before an ordinary camera.

Recording: simulated, a performer of capsules whose grey images an ordinary camera shows (videos of people may not be kept here).
Truth: where the performer's joints are. The networks were made for people, so that a decimetre or two is what can be asked; how near
markers of people are: docs/lab/camera.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.devices.people.rendered_performer import POINTS, RenderedPerformer, camera_of
from kinegraph.operators.body.camera.expressions import EXPRESSIONS
from kinegraph.stream.chunk import NS
from tests.support.pose_model import camera_networks_or_skip

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
HZ, FROM = 30.0, 150
SIZE = (320, 240)


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    camera_networks_or_skip()
    performer = RenderedPerformer(*SIZE)
    images = np.array([np.repeat(performer.image(k, k / HZ)[..., None], 3, 2) for k in range(FROM, FROM + 60)])
    camera = dict(zip(("fx", "fy", "cx", "cy"), camera_of(*SIZE), strict=True))
    small = (CONFIGS / "webcam_avatar.yaml").read_text().replace("deadline_s: 30", "width: 320\n    height: 240")
    graph = kg.Graph.from_yaml(small)
    spec = kg.StreamSpec((SIZE[1], SIZE[0], 3), np.dtype(np.uint8), HZ, meta={"camera": camera})
    times = np.round(np.arange(len(images)) * NS / HZ).astype(np.int64)
    return graph.run(
        {"camera.image": kg.Series("", spec, times, images)}, keep=["markers", "pose.joints", "fingers", "face"]
    )


def test_joints_are_within_decimetres_of_the_performers(replayed: kg.Results) -> None:
    markers = replayed["markers"]
    truth = np.array([RenderedPerformer(*SIZE).joints((FROM + k) / HZ) for k in range(60)])
    names = [name for name in POINTS if name != "head"]
    found = markers.data[:, [markers.spec.channels.index(name) for name in names]]
    off = np.linalg.norm(found - truth[:, [POINTS.index(name) for name in names]], axis=2)
    assert np.isfinite(off).mean() > 0.8 and np.nanmedian(off) < 0.3


def test_the_avatar_stands_upright_on_its_feet(replayed: kg.Results) -> None:
    joints = replayed["pose.joints"]
    head, hips, left, right = (
        joints.data[20:, joints.spec.channels.index(bone)] for bone in ("Head", "Hips", "LeftFoot", "RightFoot")
    )
    assert (head[:, 1] > hips[:, 1] + 0.4).all()
    assert (np.minimum(left[:, 1], right[:, 1]) < hips[:, 1] - 0.6).all()


def test_hands_and_face_come_with_every_frame(replayed: kg.Results) -> None:
    """What has no hands and no face to speak of is relaxed, and does nothing."""
    assert len(replayed["fingers"].data) == len(replayed["face"].data) == 60
    assert np.isfinite(replayed["fingers"].data).all()
    assert replayed["face"].spec.channels == EXPRESSIONS and replayed["face"].data.min() >= 0.0
