"""configs/video_gait.yaml: somebody who walks before one camera, seen from the side.

Recording: simulated, the walk of configs/overground_emg.yaml as a network that makes no mistakes would see it (videos of people may not
be kept here): what is tried is everything behind the network. How wrong the network is: docs/lab/camera.md.
Truth: the walker's own touch-downs, and what three joints of a leg span.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.devices.people.walkway import Walkway, WalkwayTrial
from kinegraph.operators.body.names import LANDMARKS, SEEN
from kinegraph.stream.chunk import NS
from kinegraph.stream.recording.series import write_recording

HZ, SECONDS, AWAY_M, FOCAL = 50.0, 12.0, 4.0, 500.0
CONFIG = Path(__file__).resolve().parents[2] / "configs" / "video_gait.yaml"
CAMERA = """  camera:
    use: devices.cameras.video.Video
    realtime: false                # a file is read as fast as the network takes it
    shows: walker                  # with --simulate

  network:
    use: operators.body.camera.image_pose.ImagePose
    from: camera.image
"""


def joints() -> tuple[WalkwayTrial, dict[str, np.ndarray]]:
    """The walk, and its joints (n, 3) in the axes of a camera that goes beside the walker: x along the way, y down, z away (m)."""
    trial = WalkwayTrial(Walkway())
    index = np.round(np.arange(round(SECONDS * HZ)) * 1000 / HZ).astype(int)
    made = {}
    for name, points in zip(("left", "right"), np.split(trial.markers(index) / 1000, 2, axis=1), strict=True):
        for k, joint in enumerate(("hip", "knee", "ankle", "toe")):
            side, along, up = points[:, k].T
            made[f"{name}_{joint}"] = np.stack([along - 1.2 * index / 1000, 1.0 - up, AWAY_M - side], axis=1)
        made[f"{name}_heel"] = made[f"{name}_ankle"] + [-0.05, 0.04, 0.0]
        for joint, (x, y) in {"shoulder": (0.0, -0.5), "elbow": (-0.05, -0.22), "wrist": (0.05, 0.0)}.items():
            made[f"{name}_{joint}"] = made[f"{name}_hip"] + [x, y, 0.0]
    return trial, made


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> tuple[WalkwayTrial, dict[str, np.ndarray], kg.Results]:
    folder = tmp_path_factory.mktemp("video")
    trial, places = joints()
    hips = (places["left_hip"] + places["right_hip"]) / 2
    rows = np.zeros(len(hips), SEEN)
    rows["points"], rows["presence"] = np.nan, 0.99
    rows["points"][..., 3:5] = 0.0
    for name, place in places.items():
        k = LANDMARKS.index(name)
        rows["points"][:, k, 0], rows["points"][:, k, 1] = (FOCAL * place[:, :2] / place[:, 2:] + [320.0, 240.0]).T
        rows["points"][:, k, 3:5] = 0.95
        rows["points"][:, k, 5:8] = place - hips
    meta = {"camera": {"fx": FOCAL, "fy": FOCAL, "cx": 320.0, "cy": 240.0}}
    times = np.round((1 + np.arange(len(rows))) * NS / HZ).astype(np.int64)
    spec = kg.StreamSpec((), SEEN, HZ, units=("px, m", "", ""), meta=meta)
    write_recording(folder / "seen.mcap", [kg.Series("network", spec, times, rows)], {})
    given = (
        f"  network: {{use: devices.recorded.recorded_streams.RecordedStreams, path: {folder}/seen.mcap, speed: 0}}\n"
    )
    text = CONFIG.read_text(encoding="utf-8")
    assert CAMERA in text
    lines = [line for line in text.replace(CAMERA, given).splitlines() if "feeds: camera.url" not in line]
    graph = kg.Graph.from_yaml("\n".join(lines))
    kept = ["walk.feet.touchdown", "walk.cycles.closed", "walk.angles"]
    return trial, places, graph.run({"network": kg.Series("", spec, times, rows)}, keep=kept)


def test_each_foot_lands_when_the_walkers_does(walked: tuple[WalkwayTrial, dict[str, np.ndarray], kg.Results]) -> None:
    trial, _, results = walked
    found = results["walk.feet.touchdown"].data
    for side in ("left", "right"):
        truth = trial.touchdowns(0, round(1000 * SECONDS), side) / 1000 + 1 / HZ
        mine = found["onset"][found["limb"] == side] / NS
        assert len(mine) >= len(truth) - 4
        assert np.abs(mine[:, None] - truth).min(axis=1).max() < 0.08


def test_cycles_take_as_long_as_the_walkers_strides(
    walked: tuple[WalkwayTrial, dict[str, np.ndarray], kg.Results],
) -> None:
    closed = walked[2]["walk.cycles.closed"].data
    accepted = closed[closed["rejected"] == ""]
    assert len(accepted) >= 10
    assert np.median(accepted["cadence"]) == pytest.approx(55.0, rel=0.03)


def test_a_knee_bends_as_hip_knee_and_ankle_span(
    walked: tuple[WalkwayTrial, dict[str, np.ndarray], kg.Results],
) -> None:
    _, places, results = walked
    angles = results["walk.angles"]
    for side, name in (("left", "LKnee.flexion"), ("right", "RKnee.flexion")):
        thigh, shank = places[f"{side}_hip"] - places[f"{side}_knee"], places[f"{side}_knee"] - places[f"{side}_ankle"]
        cosine = (thigh * shank).sum(1) / np.linalg.norm(thigh, axis=1) / np.linalg.norm(shank, axis=1)
        spanned = np.degrees(np.arccos(cosine))
        found = angles.data[:, angles.spec.channels.index(name)]
        assert np.median(np.abs(found - spanned)) < 12.0
