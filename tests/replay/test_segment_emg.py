"""configs/segment_emg.yaml: gait cycles from muscle activity alone, without anything that says when a foot lands.

Recording: 13 muscles, six strides on a treadmill (Santuz; MIT).
Truth: the file's touch-downs, which the graph does not see. Where in a stride the graph begins a repetition is its own choice; what counts
is that it is the same place in every stride.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

import kinegraph as kg
from kinegraph.stream.chunk import NS, Array
from tests.replay.replaying import at, signal
from tests.support.real import real_arrays

WALK = real_arrays("emg/emg_santuz_tw12.npz")
DOWN = WALK["touchdown_s"]


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    emg = signal(WALK["emg_uV"], 1000.0, map(str, WALK["names"]), ["uV"], time_s=WALK["t_s"])
    return kg.load("segment_emg").run({"board.emg": emg}, keep=["segment.primitive", "segment.count", "features"])


@pytest.fixture(scope="module")
def repetitions(replayed: kg.Results) -> Array:
    rows = replayed["segment.primitive"].data
    return np.asarray(rows[rows["repetition"] > 0])


def test_every_stride_is_one_repetition(replayed: kg.Results, repetitions: Array) -> None:
    """Six touch-downs bound five strides; a sixth repetition lies partly before the first of them."""
    assert abs(len(repetitions) - len(DOWN)) <= 1
    assert replayed["segment.count"].data["count"][-1] == len(repetitions)


def test_repetitions_begin_at_the_same_place_of_every_stride(repetitions: Array) -> None:
    begins = repetitions["end"][:-1] / NS
    before = DOWN[np.searchsorted(DOWN, begins, "right").clip(1) - 1]
    phase = (begins - before) % np.diff(DOWN).mean()
    assert np.std(phase) < 0.05


def test_a_repetition_takes_as_long_as_a_stride(repetitions: Array) -> None:
    assert np.median((repetitions["end"] - repetitions["onset"]) / NS) == pytest.approx(np.diff(DOWN).mean(), rel=0.05)


def test_a_feature_rises_and_falls_with_its_muscle(replayed: kg.Results) -> None:
    """As scipy's slow envelope says."""
    live = replayed["features"]
    clean = sosfiltfilt(butter(2, 20.0, "highpass", fs=1000.0, output="sos"), WALK["emg_uV"].astype(float), axis=0)
    offline = at(live, WALK["t_s"], sosfiltfilt(butter(4, 10.0, fs=1000.0, output="sos"), np.abs(clean), axis=0))
    late = slice(60, -10)  # the scale of the first two seconds is still being learned
    for column in range(13):
        assert np.corrcoef(live.data[late, column], offline[late, column])[0, 1] > 0.9
