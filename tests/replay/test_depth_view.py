"""configs/depth_view.yaml: how far away what lies in the middle of a depth camera's view is.

Recording: simulated, five seconds before the camera: an empty room, then somebody who stands there (of a real camera there is no recording
that may be kept).
Truth: numpy's mean of the same pixels; the room's wall and the person's place.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.devices.people.rendered_performer import AWAY_M, EMPTY_S, WALL_M, RenderedPerformer
from tests.replay.replaying import signal

RATE = 5.0
SECONDS = np.arange(25) / RATE
CAMERA = RenderedPerformer(640, 400)
FRAMES = np.array([CAMERA.frame(i, s) for i, s in enumerate(SECONDS)])


@pytest.fixture(scope="module")
def bed() -> np.ndarray:
    return kg.load("depth_view").run({"camera.depth": signal(FRAMES, RATE, (), ["mm"], invalid=0)})["bed"].data


def test_depth_is_the_mean_of_the_measured_pixels_of_the_region(bed: np.ndarray) -> None:
    region = FRAMES[:, 100:300, 220:420].astype(float)
    region[region == 0] = np.nan
    np.testing.assert_allclose(bed[:, 0], np.nanmean(region, axis=(1, 2)), rtol=1e-12)
    np.testing.assert_allclose(bed[:, 1], np.isfinite(region).mean(axis=(1, 2)), rtol=1e-12)


def test_it_is_the_wall_and_then_somebody_before_it(bed: np.ndarray) -> None:
    empty = SECONDS < EMPTY_S
    assert np.abs(bed[empty, 0] / 1000 - WALL_M).max() < 0.02
    assert (bed[~empty, 0] / 1000 < WALL_M - 0.1).all() and (bed[~empty, 0] / 1000 > AWAY_M - 0.5).all()
