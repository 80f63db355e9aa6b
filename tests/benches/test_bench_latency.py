"""The bench of a camera's latency: its config is the shipped one, and its measure of lag finds a lag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.camera_latency import lag_of_wrists, rendered_config
from kinegraph.devices.people.rendered_performer import POINTS
from kinegraph.stream.domain.humanoid import BONES, usual_body
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.operator import grid


@pytest.mark.parametrize("frames", [0, 2, 4])
def test_the_lag_of_the_wrists_is_found(frames: int) -> None:
    time, tree = grid(30.0, 400), usual_body()
    poses = np.tile(np.concatenate([tree.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))]), (400, 1))
    angle = 0.5 * np.sin(0.2 * np.arange(400)) + 0.3 * np.sin(0.07 * np.arange(400) + 1)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        at = 3 + 4 * BONES.index(f"{side}UpperArm")
        poses[:, at], poses[:, at + 3] = np.cos(angle / 2), sign * np.sin(angle / 2)
    joints, true = joints_of(tree, poses)[1], np.zeros((400, len(POINTS), 3))
    for side in ("Left", "Right"):
        true[:, POINTS.index(f"{side.lower()}_wrist")] = -joints[:, BONES.index(f"{side}Hand")]
        true[:, POINTS.index(f"{side.lower()}_hip")] = -joints[:, 0]
    late = np.concatenate([np.repeat(poses[:1], frames, axis=0), poses[: 400 - frames]])
    assert lag_of_wrists(time, late, time, true) == pytest.approx(1e3 * frames / 30.0, abs=5.0)


def test_the_config_is_the_shipped_one_with_another_camera(tmp_path: Path) -> None:
    text = rendered_config(tmp_path, alone=True).read_text()
    assert "BeforeCamera" in text and "Oak" not in text.split("nodes:")[1] and "camera.joints" in text
