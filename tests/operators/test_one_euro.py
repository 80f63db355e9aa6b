"""One Euro and prediction: against their definition, and that they do what they are for."""

from __future__ import annotations

import numpy as np

from kinegraph.operators.filters.one_euro import OneEuro
from kinegraph.operators.filters.predict import Predict

RATE = 30.0
T = np.arange(300) / RATE


def test_one_euro_without_beta_is_a_one_pole_low_pass() -> None:
    x = np.random.default_rng(1).normal(size=300)
    share, level, expected = 1.0 - np.exp(-2.0 * np.pi * 2.0 / RATE), x[0], []
    for v in x:
        level += share * (v - level)
        expected.append(level)
    assert np.allclose(OneEuro(cutoff_hz=2.0, beta=0.0)(x, rate_hz=RATE), expected, atol=1e-6)


def test_one_euro_is_quieter_at_rest_and_quicker_in_motion() -> None:
    noise = np.random.default_rng(2).normal(0.0, 0.01, 300)
    still = OneEuro(cutoff_hz=1.0, beta=5.0)(noise, rate_hz=RATE)
    assert np.std(still[30:]) < 0.6 * np.std(noise[30:])
    ramp = 1.5 * T
    slow, quick = (OneEuro(cutoff_hz=1.0, beta=b)(ramp, rate_hz=RATE) for b in (0.0, 5.0))
    assert ramp[-1] - quick[-1] < 0.2 * (ramp[-1] - slow[-1])


def test_a_prediction_takes_back_a_lag() -> None:
    ramp = np.column_stack([0.8 * T, -0.3 * T])
    made = Predict(ahead_s=0.1)(ramp, rate_hz=RATE)
    assert np.allclose(made[60:], ramp[60:] + 0.1 * np.array([0.8, -0.3]), atol=1e-6)


def test_what_is_missing_is_missing_and_does_no_harm() -> None:
    x = np.column_stack([np.sin(T), np.cos(T)])
    x[100:103, 0] = np.nan
    for operator in (OneEuro(), Predict()):
        made = operator(x, rate_hz=RATE)
        assert np.isnan(made[100:103, 0]).all() and np.isfinite(np.delete(made, slice(100, 103), axis=0)).all()
        assert np.abs(made[103:] - np.nan_to_num(x[103:])).max() < 0.2
