"""configs/imu_steps.yaml: when a foot meets and leaves the ground, from an inertial sensor on it.

Recording: simulated. Real recordings of feet with annotated contacts exist, but under terms that keep them out of this repository
(the tests in tests/gait/test_contacts.py use them where KINEGRAPH_DATA names them).
Truth: the simulated walk's touch-downs and lift-offs; scipy finds the swings once more, as the fastest forward turns of the foot.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import find_peaks

import kinegraph as kg
from kinegraph.devices.people.walking_limb import Limb
from kinegraph.stream.chunk import NS, Array
from tests.replay.replaying import signal

RATE, SAMPLES = 100.0, 2000
FOOT = Limb("foot", RATE)
MEASURED = FOOT.measure(np.arange(SAMPLES))


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    data = np.hstack([MEASURED["acceleration"], MEASURED["angular_velocity"]])
    units = ("m/s2",) * 3 + ("rad/s",) * 3
    return kg.load("imu_steps").run({"mti.imu": signal(data, RATE, ("ax", "ay", "az", "gx", "gy", "gz"), units)})


def onsets(replayed: kg.Results, edge: str) -> Array:
    return np.asarray(replayed[f"steps.{edge}"].data["onset"] / NS)


@pytest.mark.parametrize("edge", ["touchdown", "liftoff"])
def test_contacts_are_those_of_the_simulated_walk(replayed: kg.Results, edge: str) -> None:
    truth = (
        getattr(FOOT.gait, f"{edge}s")(300, SAMPLES - 100) / RATE
    )  # the sensor's mounting is learned in the first strides
    found = onsets(replayed, edge)
    assert np.abs(found[:, None] - truth).min(axis=0).max() < 0.05
    assert len(found[(found > 2.95) & (found < SAMPLES / RATE - 0.95)]) == len(truth)


def test_between_a_liftoff_and_the_next_touchdown_the_foot_swings_once(replayed: kg.Results) -> None:
    turning = np.linalg.norm(MEASURED["angular_velocity"], axis=1)
    swings, _ = find_peaks(turning, height=0.7 * turning.max(), distance=60)
    up, down = onsets(replayed, "liftoff"), onsets(replayed, "touchdown")
    for lift in up[up < down[-1]]:
        land = down[down > lift][0]
        assert ((swings / RATE > lift - 0.05) & (swings / RATE < land)).sum() == 1


def test_a_stride_takes_as_long_as_the_cadence_says(replayed: kg.Results) -> None:
    assert np.diff(onsets(replayed, "touchdown")).mean() == pytest.approx(60 / 57.0, rel=0.02)
