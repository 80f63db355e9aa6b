"""configs/count_video.yaml: repetitions of a person before an ordinary camera.

Recording: simulated, a performer of capsules whose grey images the camera shows (videos of people may not be kept here).
Truth: the performer's own period, from the true joints by autocorrelation. Figures of counts: tests/replay/test_count_landmarks.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.devices.people.rendered_performer import RenderedPerformer, camera_of
from kinegraph.stream.chunk import NS
from tests.replay.replaying import CAMERA_HZ, period_s
from tests.support.pose_model import camera_networks_or_skip

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SIZE = (320, 240)


def test_the_graph_opens_with_a_cameras_images() -> None:
    assert "repetitions.segment.count" in kg.load("count_video").specs


@pytest.mark.nightly
def test_repetitions_last_as_long_as_the_performers_movement() -> None:
    camera_networks_or_skip()
    performer, frames = RenderedPerformer(*SIZE), range(round(4 * CAMERA_HZ), round(30 * CAMERA_HZ))
    images = np.array([np.repeat(performer.image(k, k / CAMERA_HZ)[..., None], 3, 2) for k in frames])
    joints = np.array([performer.joints(k / CAMERA_HZ) for k in frames])
    camera = dict(zip(("fx", "fy", "cx", "cy"), camera_of(*SIZE), strict=True))
    text = (CONFIGS / "count_video.yaml").read_text().replace("deadline_s: 30", "width: 320, height: 240")
    spec = kg.StreamSpec((SIZE[1], SIZE[0], 3), np.dtype(np.uint8), CAMERA_HZ, meta={"camera": camera})
    times = np.round(np.arange(len(images)) * NS / CAMERA_HZ).astype(np.int64)
    rows = (
        kg.Graph.from_yaml(text)
        .run({"camera.image": kg.Series("", spec, times, images)}, keep=["repetitions.segment.primitive"])[
            "repetitions.segment.primitive"
        ]
        .data
    )
    lasted = (rows["end"] - rows["onset"])[rows["repetition"] > 0] / NS
    assert len(lasted) >= 3
    ratio = np.median(lasted) / period_s(joints)
    assert min(abs(ratio - whole) for whole in (0.5, 1.0, 2.0)) < 0.2, "a step, a stride, or two"
