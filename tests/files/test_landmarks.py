"""Tables of 33 landmarks found in videos; imitations of RepCount-pose's, made here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.formats.table.kinect import read_kinect
from kinegraph.devices.formats.table.landmarks import LANDMARKS, TORSO_M
from kinegraph.operators.features.pose import Pose
from kinegraph.stream.errors import RecordingError


def table(path: Path, frames: int, header: str = "", skip: int = -1) -> Path:
    """Somebody whose right wrist goes up, in shares of the picture."""
    rng, lines = np.random.default_rng(3), [header] if header else []
    body = rng.uniform(0.2, 0.8, (33, 3))
    for side, x in (("left", 0.6), ("right", 0.4)):
        body[LANDMARKS.index(f"{side}_shoulder")], body[LANDMARKS.index(f"{side}_hip")] = (x, 0.3, 0.0), (x, 0.55, 0.0)
    for frame in range(frames):
        if frame == skip:
            continue
        now = body.copy()
        now[LANDMARKS.index("right_wrist"), 1] -= 0.01 * frame
        lines.append(f"train/squat/clip.mp4/{frame}.jpg,squat," + ",".join(f"{v:.5f}" for v in now.ravel()))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_landmarks_of_a_video_are_upright_metres_with_their_names(tmp_path: Path) -> None:
    (made,) = read_kinect(table(tmp_path / "clip.csv", 6, skip=2), rate_hz=25.0)
    assert made.spec.channels == LANDMARKS and made.data.shape == (5, 33, 3) and len(set(LANDMARKS)) == 33
    assert made.time.tolist() == [0, 40_000_000, 120_000_000, 160_000_000, 200_000_000]
    at = {name: made.data[:, LANDMARKS.index(name)] for name in ("right_wrist", "left_hip", "left_shoulder")}
    assert (np.diff(at["right_wrist"][:, 1]) > 0).all()
    assert np.allclose(at["left_shoulder"][:, 1] - at["left_hip"][:, 1], TORSO_M)
    Pose().open(
        {"joints": made.spec.derive(rate_hz=25.0)} if "joints" in Pose.inputs else {next(iter(Pose.inputs)): made.spec}
    )


def test_a_header_is_skipped_and_a_short_row_is_named(tmp_path: Path) -> None:
    header = "name,class," + ",".join(f"{name}_{axis}" for name in LANDMARKS for axis in "xyz")
    (made,) = read_kinect(table(tmp_path / "clip.csv", 3, header))
    assert len(made.data) == 3
    path = tmp_path / "clip.csv"
    path.write_text(path.read_text() + "train/squat/clip.mp4/3.jpg,squat,1,2\n")
    with pytest.raises(RecordingError, match="line 5: a name and 99 numbers"):
        read_kinect(path)
