"""configs/segment_emg_acc.yaml: actions and repetitions by muscles and motion together, from Trigno sensors.

Recordings: three muscles of a treadmill walk (Santuz; MIT). The walk has no accelerations: those are made of the file's touch-downs, a sine
of one stride's length and its double, in three directions a sensor.
Truth: the file's touch-downs.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS, Array
from tests.replay.replaying import evenly, signal
from tests.support.real import real_arrays

MUSCLES = ("TA", "SO", "GM")
WALK = real_arrays("emg/emg_santuz_tw12.npz")
DOWN = WALK["touchdown_s"]
EMG_HZ, AUX_HZ = 2000.0, 4000.0 / 27


def acceleration(seconds: Array) -> Array:
    """Nine axes (n, 9) in g."""
    stride_s = np.diff(DOWN).mean()
    marks = np.concatenate([[DOWN[0] - 2 * stride_s], DOWN, [DOWN[-1] + 2 * stride_s]])
    phase = 2 * np.pi * np.interp(seconds, marks, np.concatenate([[-2.0], np.arange(6.0), [7.0]]))
    axes = [np.sin(phase + 0.7 * k) * 0.4 + 0.2 * np.sin(2 * phase + k) for k in range(9)]
    return np.stack(axes, axis=1) + np.tile([0.0, 0.0, 1.0], 3)


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    columns = [WALK["names"].tolist().index(name) for name in MUSCLES]
    seconds, emg = evenly(WALK["t_s"], WALK["emg_uV"][:, columns], EMG_HZ)
    slow = np.arange(seconds[0], seconds[-1], 1 / AUX_HZ)
    names = [f"{muscle}.a{axis}" for muscle in MUSCLES for axis in "xyz"]
    return kg.load("segment_emg_acc").run(
        {
            "trigno.emg": signal(emg, EMG_HZ, MUSCLES, ["uV"], start_s=seconds[0]),
            "trigno.aux": signal(acceleration(slow), AUX_HZ, names, ["g"], start_s=slow[0]),
        },
        keep=["segment.primitive", "scaled", "weighted"],
    )


def test_every_stride_is_one_repetition(replayed: kg.Results) -> None:
    rows = replayed["segment.primitive"].data
    rows = rows[rows["repetition"] > 0]
    assert abs(len(rows) - len(DOWN)) <= 1
    assert np.median((rows["end"] - rows["onset"]) / NS) == pytest.approx(np.diff(DOWN).mean(), rel=0.05)


def test_muscles_count_a_third(replayed: kg.Results) -> None:
    """Squared, as in a distance: three muscles of weight 1 beside nine axes of weight 2, of which each sensor's three share theirs."""
    scaled, weighted = replayed["scaled"], replayed["weighted"]
    muscles = [c in MUSCLES for c in weighted.spec.channels]
    gain = weighted.data[100] / scaled.data[100]
    share = (gain[muscles] ** 2).sum() / (gain**2).sum()
    assert share == pytest.approx(1 / 3, abs=0.01)
