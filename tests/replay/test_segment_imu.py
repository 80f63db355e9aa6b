"""configs/segment_imu.yaml: actions and repetitions from how one inertial sensor turns.

Recording: a phone in the pocket of somebody who walks up and down (GeoTec; CC BY 4.0).
Truth: the annotators' labels, and scipy's spectrum of the acceleration, which the graph leaves out: it looks at the turning alone.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS, Array
from tests.replay.replaying import TURNING, WALKING, evenly, pocket_walks, signal, steps_per_s

AXES = ("ax", "ay", "az", "gx", "gy", "gz")
SECONDS, IMU, LABELS = pocket_walks("s01")


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    imu = signal(IMU, None, AXES, ("m/s2",) * 3 + ("rad/s",) * 3, time_s=SECONDS)
    return kg.load("segment_imu").run({"sensor.imu": imu}, keep=["segment.primitive", "segment.rest", "turning"])


@pytest.fixture(scope="module")
def repetitions(replayed: kg.Results) -> Array:
    rows = replayed["segment.primitive"].data
    return np.asarray(rows[rows["repetition"] > 0])


def test_what_is_compared_is_the_phones_turning_below_3_hz(replayed: kg.Results) -> None:
    """A phone's bursty samples, made even, smoothed and thinned, against numpy and scipy."""
    from scipy.signal import butter, sosfilt

    live = replayed["turning"]
    even, gyro = evenly(SECONDS, IMU[:, 3:], 100.0)
    smooth = sosfilt(butter(4, 3.0, fs=100.0, output="sos"), gyro, axis=0)
    for column in range(3):
        offline = np.interp(live.time / NS, even, smooth[:, column])
        likeness = [np.corrcoef(live.data[30:-30, column], np.roll(offline, -lag)[30:-30])[0, 1] for lag in range(8)]
        assert max(likeness) > 0.98
        assert 3 <= int(np.argmax(likeness)) <= 5, "the stamps are moved back by the filter's 0.14 s, 4 frames"


def test_repetitions_lie_where_the_annotators_saw_walking(repetitions: Array) -> None:
    middle = np.searchsorted(SECONDS, (repetitions["onset"] + repetitions["end"]) / 2 / NS)
    assert np.isin(LABELS[middle], (WALKING, TURNING)).mean() > 0.85


def test_there_are_nearly_as_many_as_strides(repetitions: Array) -> None:
    walked_s = np.diff(SECONDS, append=SECONDS[-1])[LABELS == WALKING].sum()
    assert len(repetitions) == pytest.approx(steps_per_s("s01") / 2 * walked_s, rel=0.25)


def test_a_repetition_takes_about_as_long_as_a_stride(repetitions: Array) -> None:
    lasted = np.median((repetitions["end"] - repetitions["onset"]) / NS)
    assert lasted == pytest.approx(2 / steps_per_s("s01"), rel=0.25)
