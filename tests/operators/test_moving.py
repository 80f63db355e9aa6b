"""Moving windows against slow references that look at every window afresh."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kinegraph.operators.filters.extremes import MovingMax, MovingMin
from kinegraph.operators.filters.mean import RemoveMean
from kinegraph.operators.filters.moving import MovingMean, MovingRms
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import grid
from tests.support.one_stream import RATE, noise, run, same

WINDOWS = [
    (MovingMean, lambda window: math.fsum(window) / len(window)),
    (MovingRms, lambda window: math.sqrt(math.fsum(v * v for v in window) / len(window))),
    (MovingMin, min),
    (MovingMax, max),
]
ids = [operator.__name__ for operator, _ in WINDOWS]


def slowly(data, w, measure):
    """`measure` of the newest `w` finite values of each channel, NaN where a value is not finite."""
    out = np.full(data.shape, np.nan)
    for c in range(data.shape[1]):
        seen = []
        for i, v in enumerate(data[:, c]):
            if np.isfinite(v):
                seen.append(float(v))
                out[i, c] = measure(seen[-w:])
    return out


@pytest.mark.parametrize(("operator", "measure"), WINDOWS, ids=ids)
@pytest.mark.parametrize("w", [1, 2, 7, 50])
def test_a_window_equals_its_own_measure(operator, measure, w):
    data = noise(400) * [1.0, 1e6, 1e-6]
    data[60:63, 1] = np.nan, np.inf, -np.inf
    _, stamps, out, _ = run(operator(window_s=w / RATE), data, cuts=(1, 49, 50, 51, 200))
    np.testing.assert_allclose(out, slowly(data, w, measure), rtol=4e-16, atol=0)
    assert np.array_equal(stamps, grid(RATE, 400) - round((w - 1) / 2 / RATE * 1e9))


@pytest.mark.parametrize("operator", [MovingMean, MovingRms, MovingMin, MovingMax, RemoveMean])
def test_a_spike_leaves_nothing_behind(operator):
    data = noise(3000, 1)
    spiked = data.copy()
    spiked[100] = 1e15
    _, _, out, _ = run(operator(window_s=0.25), spiked)
    _, _, clean, _ = run(operator(window_s=0.25), data)
    np.testing.assert_allclose(out[200:], clean[200:], rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("operator", [MovingMean, MovingRms])
def test_nothing_drifts(operator):
    """After a long run a window gives the bits that it gives alone, up to the rounding of one window."""
    data = noise(200_000, 1) + 1e4
    _, _, out, _ = run(operator(window_s=0.25), data)
    _, _, alone, _ = run(operator(window_s=0.25), data[-1000:])
    np.testing.assert_allclose(out[-900:], alone[-900:], rtol=3e-16)


def test_a_gap_above_the_limit_empties_the_window():
    data = noise(300)
    time = grid(RATE, 600)
    time = np.concatenate([time[:150], time[400:550]])
    for operator in (MovingMean(window_s=0.25), MovingMax(window_s=0.25), RemoveMean(window_s=0.25)):
        _, _, out, marks = run(operator, data, time=time, lost={150: -1})
        assert same(out[150:], run(operator, data[150:])[2]) and marks == {150: -1}


def test_moving_mean_is_removed():
    data = noise(400)
    data[7, 1] = np.inf
    _, stamps, out, _ = run(RemoveMean(window_s=0.25), data, cuts=(3, 100))
    mean = slowly(data, 50, lambda window: math.fsum(window) / len(window))
    np.testing.assert_allclose(out, np.where(np.isfinite(data), data - mean, np.nan), rtol=0, atol=1e-15)
    assert np.array_equal(stamps, grid(RATE, 400))


def test_running_mean_is_removed():
    data = noise(400) + 1e3
    _, _, out, _ = run(RemoveMean(mean="running"), data, cuts=(3, 100))
    np.testing.assert_allclose(out, data - slowly(data, 400, lambda w: math.fsum(w) / len(w)), rtol=0, atol=3e-13)


def test_initial_mean_is_kept():
    data = noise(400)
    assert RemoveMean() == RemoveMean(window_s=1.0), "a second by default"
    _, _, out, _ = run(RemoveMean(mean="initial", window_s=0.5), data, cuts=(3, 100))
    np.testing.assert_allclose(out[99:], data[99:] - data[:100].mean(axis=0), rtol=0, atol=1e-15)
    np.testing.assert_allclose(out[9], data[9] - data[:10].mean(axis=0), rtol=0, atol=1e-15)


def test_a_window_shorter_than_a_sample_is_refused():
    with pytest.raises(
        ParameterError, match=r"window_s is 0\.002; it must be at least 0\.005 \(one sample at 200 Hz\)"
    ):
        run(MovingMean(window_s=0.002), noise(10))


def test_windows_in_seconds_need_a_rate():
    with pytest.raises(InputError, match="irregular"):
        MovingMean(window_s=1.0).open({"in": StreamSpec((2,))})
