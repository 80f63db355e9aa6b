"""configs/witmotion_ble.yaml: a Bluetooth inertial sensor, acceleration, angular velocity and angles in one packet, and its steps.

Recording: no recording of the sensor may be kept. A phone in a walker's pocket (GeoTec; CC BY 4.0) stands in for it, at 50 Hz; its
stamps come in bursts, as arrivals by Bluetooth do. How packets are decoded is tested in tests/devices/test_ble_protocols.py.
Truth: the step frequency by scipy's spectrum, and the annotators' labels.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import WALKING, evenly, pocket_walks, signal, steps_per_s

RATE = 50.0
CHANNELS = ("ax", "ay", "az", "gx", "gy", "gz", "roll", "pitch", "yaw")
UNITS = ("g",) * 3 + ("deg/s",) * 3 + ("deg",) * 3
WALKS, IMU, LABELS = pocket_walks("s04")
SECONDS, PHONE = evenly(WALKS, IMU, RATE)
TURNED = np.cumsum(np.degrees(PHONE[:, 3:]), axis=0) / RATE
PACKETS = np.hstack([PHONE[:, :3] / 9.80665, np.degrees(PHONE[:, 3:]), TURNED])


def test_its_steps_are_as_many_as_the_spectrum_says() -> None:
    steps = kg.load("witmotion_ble").run(
        {"imu.motion": signal(PACKETS, RATE, CHANNELS, UNITS)}, keep=["walk.steps.steps"]
    )["walk.steps.steps"]
    walked_s = np.diff(WALKS, append=WALKS[-1])[LABELS == WALKING].sum()
    at = np.searchsorted(WALKS, steps.data["end"] / NS).clip(max=len(LABELS) - 1)
    assert (LABELS[at] == WALKING).sum() == pytest.approx(steps_per_s("s04") * walked_s, rel=0.1)
