"""configs/dualsense.yaml: repetitions with a game controller; its USB reports are declared in the graph, without a driver.

Recording: no recording of the controller may be kept. A phone's six axes in a walker's pocket (GeoTec; CC BY 4.0) stand in for it, in
the controller's units and at its 250 Hz. How reports are decoded is tested in tests/devices/test_usb.py.
Truth: scipy's filter on the same samples, and numpy's reading of which way is down.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import TURNING, WALKING, evenly, pocket_walks, signal

RATE = 250.0
SECONDS, PHONE = evenly(pocket_walks("s01")[0], pocket_walks("s01")[1], RATE)
REPORTS = np.hstack([np.degrees(PHONE[:, 3:]), PHONE[:, :3] / 9.80665])


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    imu = signal(REPORTS, RATE, ("gx", "gy", "gz", "ax", "ay", "az"), ("deg/s",) * 3 + ("g",) * 3)
    return kg.load("dualsense").run({"controller.imu": imu}, keep=["smooth", "segment.primitive"])


@pytest.fixture(scope="module")
def smooth(replayed: kg.Results) -> kg.Series:
    return replayed["smooth"]


def test_repetitions_lie_where_the_annotators_saw_walking(replayed: kg.Results) -> None:
    seconds, _, labels = pocket_walks("s01")
    rows = replayed["segment.primitive"].data
    rows = rows[rows["repetition"] > 0]
    middle = np.searchsorted(seconds, (rows["onset"] + rows["end"]) / 2 / NS).clip(max=len(labels) - 1)
    assert len(rows) > 10 and np.isin(labels[middle], (WALKING, TURNING)).mean() > 0.85


def test_values_are_scipys(smooth: kg.Series) -> None:
    offline = sosfilt(butter(4, 20.0, fs=RATE, output="sos"), REPORTS, axis=0)
    np.testing.assert_allclose(smooth.data, offline, atol=1e-6)


def test_stamps_are_moved_back_by_the_delay_so_that_smooth_and_raw_lie_on_one_another(smooth: kg.Series) -> None:
    own = smooth.time / NS
    misfit = []
    for shift_s in np.arange(-0.03, 0.031, 0.002):
        raw = np.stack(
            [np.interp(own + shift_s, np.arange(len(REPORTS)) / RATE, column) for column in REPORTS.T], axis=1
        )
        misfit.append(np.abs(smooth.data - raw)[50:-50, 3:].mean())
    assert abs(-0.03 + 0.002 * int(np.argmin(misfit))) <= 0.004


def test_a_phone_that_rests_shows_1_g(smooth: kg.Series) -> None:
    still = slice(25, 150)  # the first trial begins with somebody who sits
    assert np.linalg.norm(smooth.data[still, 3:], axis=1).mean() == pytest.approx(1.0, abs=0.05)
    assert np.linalg.norm(smooth.data[still, :3], axis=1).mean() < 5.0
