"""What the causal envelope says of its delay, against scipy's group delay."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import firwin, group_delay, kaiserord, sos2tf

from kinegraph.operators.emg.envelope import causal_lowpass
from kinegraph.operators.emg.zero_phase import antialias_phases


@pytest.mark.parametrize(("order", "cutoff_hz", "rate_hz"), [(4, 20.0, 120.0), (2, 6.0, 1000.0), (3, 9.0, 100.0)])
def test_the_delay_is_the_mean_group_delay_of_the_lower_half_of_what_passes(
    order: int, cutoff_hz: float, rate_hz: float
) -> None:
    sos, delay_s = causal_lowpass(order, cutoff_hz, rate_hz)
    frequencies = np.linspace(0.0, cutoff_hz / 2, 4001)
    samples = group_delay(sos2tf(sos), w=frequencies, fs=rate_hz)[1]
    assert delay_s == pytest.approx(float(np.trapezoid(samples, frequencies)) / (cutoff_hz / 2) / rate_hz, rel=1e-3)


@pytest.mark.parametrize(("pass_hz", "stop_hz", "rate_hz", "up"), [(20.0, 60.0, 1000.0, 3), (10.0, 25.0, 250.0, 1)])
def test_the_plain_reduction_is_one_symmetric_low_pass_seen_in_phases(
    pass_hz: float, stop_hz: float, rate_hz: float, up: int
) -> None:
    """Each phase weighs samples by one kernel of odd length, read where that phase lies, and adds up to 1."""
    taps = antialias_phases(pass_hz, stop_hz, rate_hz, up)
    wide = rate_hz * up
    count, beta = kaiserord(60.0, (stop_hz - pass_hz) / (wide / 2))
    count += 1 - count % 2
    kernel = firwin(count, (stop_hz + pass_hz) / 2, window=("kaiser", beta), fs=wide)
    reach = taps.shape[1] // 2
    for phase, row in enumerate(taps):
        lags = [k * up - phase for k in range(-reach, reach + 1)]
        at = [kernel[count // 2 + lag] if abs(lag) <= count // 2 else 0.0 for lag in lags]
        np.testing.assert_allclose(row, np.array(at) / sum(at), atol=1e-15)
    assert reach * up >= count // 2
