"""configs/webcam_avatar.yaml: an avatar follows the person before an ordinary camera.

Recordings: simulated, a performer of capsules whose grey images an ordinary camera shows (videos of people may not be kept here), and the
shipped clip of a rendered person. Truth: where the performer's joints are; how the person's fingers, lids and jaw were moved. The networks
were made for people, so that a decimetre or two is what can be asked; how near they come: docs/lab/camera.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import kinegraph as kg
from bench.demo_clip import frames, moves
from bench.hands_and_face import blinks, correlation
from kinegraph.devices.cameras.video.simulator import CLIPS
from kinegraph.devices.cameras.video.source import USUAL_FOCAL
from kinegraph.devices.people.rendered_performer import FIELD, POINTS, RenderedPerformer
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
    return graph_of(images, SIZE, FIELD)


def graph_of(images: np.ndarray, size: tuple[int, int], focal: float) -> kg.Results:
    """What the graph makes of pictures, 30 a second."""
    w, h = size
    camera = dict(zip(("fx", "fy", "cx", "cy"), (focal * w, focal * w, (w - 1) / 2, (h - 1) / 2), strict=True))
    small = (CONFIGS / "webcam_avatar.yaml").read_text().replace("deadline_s: 30", f"width: {w}\n    height: {h}")
    spec = kg.StreamSpec((h, w, 3), np.dtype(np.uint8), HZ, meta={"camera": camera})
    times = np.round(np.arange(len(images)) * NS / HZ).astype(np.int64)
    kept = ["markers", "pose.joints", "fingers", "face"]
    return kg.Graph.from_yaml(small).run({"camera.image": kg.Series("", spec, times, images)}, keep=kept)


@pytest.mark.nightly
def test_hands_and_eyes_follow_the_shipped_clip() -> None:
    camera_networks_or_skip()
    moved, made = moves(), graph_of(np.array(frames(CLIPS["someone"])), (640, 480), USUAL_FOCAL)
    bends, face = made["fingers"].data.reshape(-1, 2, 5, 4), made["face"].data
    true, found = (x[..., [0, 2, 3]].sum(-1) for x in (moved.bends, bends))
    for finger in range(1, 5):
        for hand in range(2):
            assert correlation(true[:, hand, finger], found[:, hand, finger]) > (0.85 if finger == 1 else 0.93)
    lids = face[:, [EXPRESSIONS.index("Blink_L"), EXPRESSIONS.index("Blink_R")]].min(axis=1)
    assert blinks(lids, moved.blink) == (6, 6, 0)
    assert correlation(moved.face["jawOpen"], face[:, EXPRESSIONS.index("jawOpen")]) > 0.93


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
