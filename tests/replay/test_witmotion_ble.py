"""configs/witmotion_ble.yaml: a Bluetooth inertial sensor, acceleration, angular velocity and angles in one packet, smoothed.

Recording: no recording of the sensor may be kept. A phone in a walker's pocket (GeoTec; CC BY 4.0) stands in for it, at 50 Hz; its
stamps come in bursts, as arrivals by Bluetooth do. How packets are decoded is tested in tests/devices/test_ble_protocols.py.
Truth: scipy's filter on the same samples.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfilt, welch

import kinegraph as kg
from tests.replay.replaying import evenly, pocket_walks, signal

RATE = 50.0
CHANNELS = ("ax", "ay", "az", "gx", "gy", "gz", "roll", "pitch", "yaw")
UNITS = ("g",) * 3 + ("deg/s",) * 3 + ("deg",) * 3
WALKS, IMU, _ = pocket_walks("s04")
SECONDS, PHONE = evenly(WALKS, IMU, RATE)
TURNED = np.cumsum(np.degrees(PHONE[:, 3:]), axis=0) / RATE
PACKETS = np.hstack([PHONE[:, :3] / 9.80665, np.degrees(PHONE[:, 3:]), TURNED])


@pytest.fixture(scope="module")
def smooth() -> kg.Series:
    return kg.load("witmotion_ble").run({"imu.motion": signal(PACKETS, RATE, CHANNELS, UNITS)})["smooth"]


def test_values_are_scipys(smooth: kg.Series) -> None:
    offline = sosfilt(butter(4, 10.0, fs=RATE, output="sos"), PACKETS, axis=0)
    np.testing.assert_allclose(smooth.data, offline, atol=1e-6)
    assert smooth.spec.channels == CHANNELS and smooth.spec.units == UNITS


def test_what_is_faster_than_the_cutoff_is_gone_and_the_rest_is_kept(smooth: kg.Series) -> None:
    f, before = welch(PACKETS[:, :6], RATE, nperseg=512, axis=0)
    after = welch(smooth.data[:, :6], RATE, nperseg=512, axis=0)[1]
    share = after / before
    np.testing.assert_allclose(share[(f > 0.5) & (f < 5.0)], 1.0, atol=0.05)
    assert share[(f > 18.0) & (f < 24.0)].max() < 0.01
