"""configs/count_depth.yaml: repetitions of a person before a depth camera.

Recording: simulated, a performer before a rendered camera (of a real camera there is no recording that may be kept), without images: the
markers are those of the body's surface alone.
Truth: the performer's own period, from the true joints by autocorrelation.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import CAMERA_HZ, no_images, performance, period_s, signal


def test_the_graph_opens_with_a_cameras_frames() -> None:
    assert "repetitions.segment.count" in kg.load("count_depth").specs


@pytest.mark.nightly
def test_repetitions_last_as_long_as_the_performers_movement() -> None:
    depth, joints = performance(20.0)
    graph = kg.load("count_depth")
    frames = kg.Series("", graph.specs["camera.depth"], signal(depth, CAMERA_HZ).time, depth)
    given = {"camera.depth": frames, "camera.mono": no_images(graph, "camera.mono")}
    rows = graph.run(given, keep=["segment.primitive"])["segment.primitive"].data
    lasted = (rows["end"] - rows["onset"])[rows["repetition"] > 0] / NS
    period = period_s(joints[round(4 * CAMERA_HZ) :])
    assert len(lasted) >= 3
    ratio = np.median(lasted) / period
    assert min(abs(ratio - whole) for whole in (0.5, 1.0, 2.0)) < 0.2, "a step, a stride, or two"
