"""Changes of rate against scipy, and the derivative and binomial smoothing against their formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal

from kinegraph.operators.filters.decimate import Decimate
from kinegraph.operators.filters.derivative import Derivative
from kinegraph.operators.filters.resample import Resample, ratio
from kinegraph.operators.filters.smooth import Binomial
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import grid
from tests.support.one_stream import RATE, noise, run, same, signal_spec

# Resampling

RATIOS = [
    (2000.0, 100.0),
    (2000.0, 120.0),
    (2000.0, 30.0),
    (120.0, 30.0),
    (1000.0, 2000.0),
    (200.0, 441.0),
    (1000.0, 1024.0),
    (200.0, 200.0),
]


@pytest.mark.parametrize(("rate_hz", "wanted_hz"), RATIOS)
@pytest.mark.parametrize("half_length", [10, 3])
def test_resampling_equals_resample_poly(rate_hz, wanted_hz, half_length):
    data = noise(3000, 2)
    operator = Resample(rate_hz=wanted_hz, half_length=half_length)
    spec, stamps, out, _ = run(operator, data, spec=signal_spec(2, rate_hz), cuts=(1, 2, 3, 1000, 1001))
    up, down = ratio(wanted_hz, rate_hz)
    window = ("kaiser", 5.0)
    if half_length != 10 and up != down:
        window = signal.firwin(2 * half_length * max(up, down) + 1, 1 / max(up, down), window=window)
    reference = signal.resample_poly(data, up, down, axis=0, window=window)
    assert len(reference) - len(out) <= math.ceil(half_length * max(1, up / down)) + 1 and len(out) > 10
    np.testing.assert_allclose(out, reference[: len(out)], rtol=0, atol=1e-13)
    assert spec.rate_hz == pytest.approx(wanted_hz, rel=1e-12)
    assert np.abs(stamps - grid(wanted_hz, len(stamps))).max() <= 2


def test_resampling_declares_its_delay():
    operator = Resample(rate_hz=100.0)
    made = operator.open({"in": signal_spec(1, 2000.0)})["out"]
    assert operator.delay_s == 0.1 and made.settling_s == 0.1
    operator = Resample(rate_hz=100.0, half_length=2)
    operator.open({"in": signal_spec(1, 2000.0)})
    assert operator.delay_s == 0.02


def test_any_rate_is_met_by_the_nearest_ratio_which_the_spec_names():
    assert ratio(120.0, 2000.0) == (3, 50) and ratio(59.94, 60.0) == (999, 1000)
    operator = Resample(rate_hz=math.pi * 10)
    made = operator.open({"in": signal_spec(1, 200.0)})["out"]
    up, down = ratio(math.pi * 10, 200.0)
    assert made.rate_hz == 200.0 * up / down and abs(made.rate_hz - math.pi * 10) < 1e-4


def reachable(wanted_hz, rate_hz):
    """Whether any ratio of two numbers up to 1000 comes within 0.1 %: by trying all."""
    terms = np.arange(1, 1001)
    return bool((np.abs(terms[:, None] / terms * (rate_hz / wanted_hz) - 1) <= 1e-3).any())


@pytest.mark.parametrize("rate_hz", [200.0, 1000.0])
@pytest.mark.parametrize(
    "share", [1e-5, 4e-4, 9e-4, 1e-3, 1.04e-3, 2.1e-3, 0.7, 1.0, 1.3, 700.0, 1000.0, 1100.0, 2500.0, 1e5]
)
def test_rates_out_of_reach_are_refused(rate_hz, share):
    wanted_hz = share * rate_hz
    if reachable(wanted_hz, rate_hz):
        up, down = ratio(wanted_hz, rate_hz)
        assert max(up, down) <= 1000 and abs(up / down * rate_hz / wanted_hz - 1) <= 1e-3
        return
    with pytest.raises(ParameterError, match=rf"rate_hz is .*; it must be between {rate_hz / 1000:g} and "):
        Resample(rate_hz=wanted_hz).open({"in": signal_spec(rate_hz=rate_hz)})


def test_resampled_stamps_follow_a_device_that_drifts():
    data = noise(20_000, 1)
    time = 10**9 + np.round(np.arange(20_000) * (1e9 / 200.0) * 1.001).astype(np.int64)
    _, stamps, _, _ = run(Resample(rate_hz=50.0), data, time=time)
    assert np.abs(stamps - time[::4][: len(stamps)]).max() < 1_000_000


def test_resampled_stamps_rise_even_if_the_inputs_jitter():
    data = noise(2000, 1)
    jitter = np.random.default_rng(1).integers(-9_000_000, 9_000_000, 2000)
    time = np.sort(grid(RATE, 2000) + jitter)
    time[500:510] = time[500]
    time += np.arange(2000)
    _, stamps, _, _ = run(Resample(rate_hz=441.0), data, time=time, cuts=range(1, 2000, 3))
    assert (np.diff(stamps) > 0).all()


def test_a_bad_sample_is_missed_only_where_it_lies():
    data = noise(2000, 2)
    data[1000, 0] = np.nan
    _, _, out, _ = run(Resample(rate_hz=50.0), data)
    assert np.flatnonzero(np.isnan(out[:, 0])).tolist() == [250]
    assert np.isfinite(out[:, 1]).all()
    stand_in = data.copy()
    stand_in[1000, 0] = stand_in[999, 0]
    clean = run(Resample(rate_hz=50.0), stand_in)[2]
    assert same(np.delete(out, 250, axis=0), np.delete(clean, 250, axis=0))


def test_a_short_gap_keeps_the_grid_and_a_long_one_begins_a_new_one():
    data = noise(1000, 1)
    time = grid(RATE, 1000)
    keep = np.r_[0:400, 410:1000]
    _, stamps, out, marks = run(Resample(rate_hz=50.0), data[keep], time=time[keep], lost={400: 10})
    assert np.abs(stamps - grid(50.0, len(stamps))).max() <= 2 and list(marks.values()) == [-1]
    bridged = data.copy()
    bridged[400:410] = data[399]
    assert same(out, run(Resample(rate_hz=50.0), bridged)[2])
    keep = np.r_[0:400, 451:1000]
    _, stamps, out, marks = run(Resample(rate_hz=50.0), data[keep], time=time[keep], lost={400: -1})
    (at,) = marks
    assert stamps[at] == time[451] and marks[at] == -1
    assert same(out[at:], run(Resample(rate_hz=50.0), data[451:])[2])


# Thinning out


def test_decimation_keeps_its_grid_over_a_short_gap():
    data = noise(300)
    data[7] = np.inf
    time = grid(RATE, 300)
    _, stamps, out, _ = run(Decimate(every=7), data, cuts=(1, 3, 50, 200))
    assert same(out, np.where(np.isfinite(data), data, np.nan)[::7]) and np.array_equal(stamps, time[::7])
    keep = np.r_[0:100, 110:300]
    _, stamps, _, marks = run(Decimate(every=7), data[keep], time=time[keep], lost={100: 10}, cuts=(101,))
    assert np.array_equal(stamps, [t for t in time[::7] if t in time[keep]]) and list(marks.values()) == [-1]
    keep = np.r_[0:100, 150:300]
    _, stamps, _, _ = run(Decimate(every=7), data[keep], time=time[keep], lost={100: -1})
    assert np.array_equal(stamps, np.r_[time[:100:7], time[150::7]])


# Derivative


def test_the_derivative_of_a_quartic_is_exact():
    t = np.arange(100) / RATE
    data = np.stack([t**4 - 3 * t**2, 5 * t + 1], axis=1)
    spec, stamps, out, _ = run(Derivative(), data, spec=signal_spec(2, units=("m",)), cuts=(1, 2, 3, 4, 5, 6, 50))
    np.testing.assert_allclose(out, np.stack([4 * t**3 - 6 * t, 5 + 0 * t], axis=1)[2:-2], atol=1e-10)
    assert spec.units == ("m/s",) and np.array_equal(stamps, grid(RATE, 100)[2:-2])


def test_the_derivative_misses_what_rests_on_a_bad_sample():
    data = noise(100, 2)
    data[50, 0] = np.inf
    _, _, out, _ = run(Derivative(), data, cuts=(49, 50, 51))
    assert np.flatnonzero(np.isnan(out[:, 0])).tolist() == [46, 47, 48, 49, 50] and np.isfinite(out[:, 1]).all()


def test_the_derivative_begins_again_after_a_gap():
    data = noise(100, 2)
    time = np.r_[grid(RATE, 50), grid(RATE, 102)[52:]]
    _, stamps, out, marks = run(Derivative(), data, time=time, lost={50: 2}, cuts=(51, 52))
    assert np.array_equal(stamps, np.r_[time[2:48], time[52:98]])
    assert len(out) == 92 and marks == {46: 2}
    assert same(out[46:], run(Derivative(), data[50:])[2])


# Binomial smoothing


@pytest.mark.parametrize("window", [1, 2, 16, 101])
def test_binomial_smoothing_convolves_with_binomial_coefficients(window):
    data = noise(400)
    weights = np.array([math.comb(window - 1, k) for k in range(window)], dtype=float) / 2 ** (window - 1)
    _, stamps, out, _ = run(Binomial(window=window), data, cuts=(1, 15, 16, 17, 100))
    reference = np.stack([np.convolve(column, weights, "valid") for column in data.T], axis=1)
    np.testing.assert_allclose(out[window - 1 :], reference, rtol=0, atol=1e-14)
    assert np.array_equal(stamps, grid(RATE, 400) - round((window - 1) / 2 / RATE * 1e9))


def test_binomial_smoothing_leaves_a_constant_from_the_first_sample_on():
    _, _, out, _ = run(Binomial(), np.full((40, 2), 9.81))
    np.testing.assert_allclose(out, 9.81, rtol=1e-15)
