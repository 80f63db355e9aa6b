"""configs/motion_map_depth.yaml: where a pose is among all poses so far, of a person before a depth camera.

Recording: simulated, a performer before a rendered camera (of a real camera there is no recording that may be kept), without images: the
markers are those of the body's surface alone.
Truth: what the performer does.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from tests.replay.replaying import CAMERA_HZ, no_images, performance, signal


def test_the_graph_opens_with_a_cameras_frames() -> None:
    assert "places.map.map" in kg.load("motion_map_depth").specs


@pytest.mark.nightly
def test_whoever_moves_goes_round_on_the_map() -> None:
    depth, _ = performance(8.0)
    graph = kg.load("motion_map_depth")
    frames = kg.Series("", graph.specs["camera.depth"], signal(depth, CAMERA_HZ).time, depth)
    made = graph.run({"camera.depth": frames, "camera.mono": no_images(graph, "camera.mono")}, keep=["map.map"])[
        "map.map"
    ].data
    known = np.isfinite(made).all(axis=1)
    assert known[120:].mean() > 0.4, "half the time the body hides a wrist from the depth; an image shows it"
    assert np.ptp(made[known][-90:], axis=0).min() > 0.1, "within three seconds the pose goes decimetres about"
