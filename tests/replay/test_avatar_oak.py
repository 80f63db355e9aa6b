"""configs/avatar_oak.yaml: an avatar follows the key points that a camera's own pose network finds.

Recording: simulated, a performer before a rendered camera; the key points are the performer's joints with 1 cm of noise, and the left arm
is lost for a second (of a real camera there is no recording that may be kept).
Truth: where the performer's joints are.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.devices.people.rendered_performer import EMPTY_S, POINTS
from kinegraph.stream.chunk import NS
from tests.devices.oak_runs import HEAD, archive, config
from tests.replay.replaying import CAMERA_HZ, performance, signal

DEPTH, JOINTS = performance(6.0)
LOST = slice(130, 160)


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> kg.Results:
    network = archive(
        tmp_path_factory.mktemp("network"), config(HEAD)
    )  # a replay reads what it gives, and runs nothing
    graph = kg.load("avatar_oak", {"camera.network": network})
    names, time = graph.specs["camera.markers"].channels, signal(DEPTH, CAMERA_HZ).time
    markers = np.full((len(DEPTH), len(names), 3), np.nan)
    for k, point in enumerate(POINTS):
        noise = np.random.default_rng(k).normal(0.0, 0.01, (len(DEPTH), 3))
        markers[:, names.index(point)] = JOINTS[:, k] + noise
    markers[: round(EMPTY_S * CAMERA_HZ)] = np.nan
    markers[LOST, [names.index("left_elbow")]] = np.nan
    sure = np.isfinite(markers).all(axis=2) * 0.9
    given = {"camera.depth": DEPTH, "camera.markers": markers, "camera.confidence": sure}
    series = {edge: kg.Series("", graph.specs[edge], time, data) for edge, data in given.items()}
    return graph.run(series, keep=["surer", "pose.joints", "avatar.prompt"])


def test_what_the_network_sees_is_taken_as_it_is(replayed: kg.Results) -> None:
    markers = replayed["surer"]
    for point in ("head", "right_wrist", "left_knee"):
        found = markers.data[90:, markers.spec.channels.index(point)]
        truth = JOINTS[np.round(markers.time[90:] / NS * CAMERA_HZ).astype(int), POINTS.index(point)]
        assert np.nanmedian(np.linalg.norm(found - truth, axis=1)) < 0.03


def test_the_person_is_followed_after_standing_still_for_a_second(replayed: kg.Results) -> None:
    prompts = replayed["avatar.prompt"].data
    assert prompts["state"].tolist() == ["waiting", "stand", "follows"]
    assert (prompts["onset"][2] - prompts["onset"][1]) / NS == pytest.approx(1.0, abs=0.3)


def test_the_skeletons_wrist_is_as_far_from_its_hips_as_the_performers(replayed: kg.Results) -> None:
    joints = replayed["pose.joints"]
    hand, hips = (joints.data[:, joints.spec.channels.index(bone)] for bone in ("RightHand", "Hips"))
    frames = np.round(joints.time / NS * CAMERA_HZ).astype(int).clip(0, len(JOINTS) - 1)
    centre = JOINTS[frames][:, [POINTS.index("left_hip"), POINTS.index("right_hip")]].mean(axis=1)
    truth = np.linalg.norm(JOINTS[frames, POINTS.index("right_wrist")] - centre, axis=1)
    found = np.linalg.norm(hand - hips, axis=1)
    assert np.nanmedian(np.abs(found - truth)[120:]) < 0.12
