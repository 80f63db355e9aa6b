"""configs/witmotion.yaml: a WitMotion sensor's steps and smoothed angles; its serial frames are declared in the graph, without a driver.

Recording: no recording of the sensor may be kept. A phone in a walker's pocket (GeoTec; CC BY 4.0) stands in for it, its tilt by
the sensor's own formula from the direction of the acceleration. How frames are decoded is tested in tests/devices/test_binary.py.
Truth: scipy's filter on the same angles; the annotators' labels say when the person stood up.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfilt, sosfiltfilt

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import WALKING, at, evenly, pocket_walks, signal, steps_per_s

RATE = 100.0
WALKS, IMU, LABELS = pocket_walks("s01")
SECONDS, PHONE = evenly(WALKS, IMU, RATE)
X, Y, Z = PHONE[:, :3].T
ANGLE = np.degrees(np.stack([np.arctan2(Y, Z), np.arctan2(-X, np.hypot(Y, Z)), np.zeros_like(X)], axis=1))
ANGLE[:, 0] = np.unwrap(ANGLE[:, 0], period=360.0)


@pytest.fixture(scope="module")
def session() -> kg.Results:
    given = {
        "sensor.acceleration": signal(PHONE[:, :3] / 9.80665, RATE, "xyz", ("g",)),
        "sensor.gyro": signal(np.degrees(PHONE[:, 3:6]), RATE, "xyz", ("deg/s",)),
        "sensor.angle": signal(ANGLE, RATE, ("roll", "pitch", "yaw"), ("deg",)),
    }
    return kg.load("witmotion").run(given, keep=["tilt", "walk.steps.steps", "walk.statistics.statistics"])


@pytest.fixture(scope="module")
def tilt(session: kg.Results) -> kg.Series:
    return session["tilt"]


def test_its_steps_are_as_many_as_the_spectrum_says(session: kg.Results) -> None:
    walked_s = np.diff(WALKS, append=WALKS[-1])[LABELS == WALKING].sum()
    at = np.searchsorted(WALKS, session["walk.steps.steps"].data["end"] / NS).clip(max=len(LABELS) - 1)
    assert (LABELS[at] == WALKING).sum() == pytest.approx(steps_per_s("s01") * walked_s, rel=0.1)
    cadence = session["walk.statistics.statistics"].data["cadence"]
    assert np.median(cadence) == pytest.approx(60 * steps_per_s("s01"), rel=0.15)


def test_values_are_scipys(tilt: kg.Series) -> None:
    offline = sosfilt(butter(4, 5.0, fs=RATE, output="sos"), ANGLE, axis=0)
    np.testing.assert_allclose(tilt.data, offline, atol=1e-6)
    assert tilt.spec.channels == ("roll", "pitch", "yaw") and not tilt.data[:, 2].any()


def test_at_its_own_stamps_it_is_nearly_what_a_filter_without_delay_gives(tilt: kg.Series) -> None:
    offline = at(tilt, SECONDS, sosfiltfilt(butter(2, 5.0, fs=RATE, output="sos"), ANGLE, axis=0))
    for column in (0, 1):
        assert np.corrcoef(tilt.data[20:-20, column], offline[20:-20, column])[0, 1] > 0.97


def test_a_thigh_turns_by_a_right_angle_when_somebody_stands_up(tilt: kg.Series) -> None:
    """Where gravity points, seen from the pocket, while the person sits and while the person walks."""
    label = LABELS[np.searchsorted(WALKS, tilt.time.clip(0) / NS)]

    def down(which: int) -> np.ndarray:
        roll, pitch = np.radians(np.median(tilt.data[label == which, :2], axis=0))
        return np.array([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])

    assert 60.0 < np.degrees(np.arccos(down(0) @ down(2))) < 110.0
