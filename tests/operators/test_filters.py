"""Filters against scipy and against slow, plain references; what they do at gaps, at bad samples, and at wrong parameters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from kinegraph.operators.filters.iir import Bandpass, Highpass, Lowpass, Notch
from kinegraph.operators.filters.rectify import Rectify
from kinegraph.operators.filters.resample import Resample
from kinegraph.operators.filters.scale import Scale
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import grid
from tests.support.emg_run import treadmill
from tests.support.one_stream import RATE, noise, run, same, signal_spec

pytestmark = pytest.mark.quick

# Rectify, Scale


def test_rectify_is_the_absolute_value_and_knows_no_infinity():
    data = noise()
    data[3, 0], data[4, 1], data[5, 2] = np.nan, np.inf, -np.inf
    _, time, out, _ = run(Rectify(), data)
    assert same(out, np.where(np.isfinite(data), np.abs(data), np.nan))
    assert np.array_equal(time, grid(RATE, len(data)))


def test_rectify_takes_markers_and_whole_numbers():
    data = np.random.default_rng(0).integers(-9, 9, (50, 4, 3)).astype(np.int16)
    spec, _, out, _ = run(Rectify(), data, spec=StreamSpec((4, 3), np.dtype(np.int16), 100.0))
    assert spec.dtype == np.float64 and np.array_equal(out, np.abs(data))


def test_filters_refuse_events():
    spec = StreamSpec((), np.dtype([("onset", "<i8")]), units=("ns",))
    with pytest.raises(InputError, match=r"input 'in' is events \(onset\).*must be a stream of numbers"):
        Rectify().open({"in": spec})


def test_scale_changes_numbers_and_unit():
    data = noise()
    spec, _, out, _ = run(Scale(gain=(1.0, 2.0, 0.5), offset=-3.0, unit="uV"), data)
    assert spec.units == ("uV",)
    assert np.array_equal(out, data * [1.0, 2.0, 0.5] - 3.0)


def test_scale_says_how_many_gains_it_takes():
    with pytest.raises(ParameterError, match=r"gain is .*; it must be one number, or 3: one per channel"):
        Scale(gain=(1.0, 2.0)).open({"in": signal_spec(3)})


# Second-order sections

DESIGNS = [
    (Lowpass(cutoff_hz=20.0), lambda: signal.butter(4, 20.0, fs=RATE, output="sos")),
    (Lowpass(cutoff_hz=6.0, order=5), lambda: signal.butter(5, 6.0, fs=RATE, output="sos")),
    (Highpass(cutoff_hz=10.0), lambda: signal.butter(4, 10.0, "highpass", fs=RATE, output="sos")),
    (Bandpass(low_hz=5.0, high_hz=80.0), lambda: signal.butter(4, (5.0, 80.0), "bandpass", fs=RATE, output="sos")),
    (Notch(notch_hz=50.0, width_hz=2.0), lambda: signal.tf2sos(*signal.iirnotch(50.0, 25.0, fs=RATE))),
]


@pytest.mark.parametrize(("operator", "design"), DESIGNS, ids=lambda p: type(p).__name__)
def test_sections_equal_sosfilt_bit_for_bit(operator, design):
    data = noise(3000, 5)
    _, _, out, _ = run(operator, data, cuts=(1, 2, 3, 700, 701, 1500))
    assert np.array_equal(out, signal.sosfilt(design(), data, axis=0))


def test_sections_may_start_steady_as_with_sosfilt_zi():
    data = noise()
    sos = signal.butter(4, 20.0, fs=RATE, output="sos")
    _, _, out, _ = run(Lowpass(cutoff_hz=20.0, start="first"), data, cuts=(1,))
    reference, _ = signal.sosfilt(sos, data, axis=0, zi=signal.sosfilt_zi(sos)[:, :, None] * data[0])
    assert np.array_equal(out, reference)


def test_a_steady_start_waits_for_each_channels_first_number():
    data = noise()
    data[:40, 1] = np.nan
    operator = Lowpass(cutoff_hz=20.0, start="first")
    _, _, out, _ = run(operator, data, cuts=(10, 39, 41))
    assert np.isnan(out[:40, 1]).all()
    assert np.array_equal(out[40:, 1], run(operator, data[40:])[2][:, 1])


def test_all_harmonics_of_the_mains_are_notched():
    t = np.arange(4000) / 1000.0
    hum = sum(np.sin(2 * np.pi * 50 * k * t) for k in (1, 2, 3))[:, None]
    _, _, out, _ = run(Notch(notch_hz=50.0, harmonics=3), hum, spec=signal_spec(1, 1000.0))
    assert np.abs(out[-500:]).max() < 1e-3 < 0.5 < np.abs(hum[-500:]).max()


def test_bad_samples_hold_the_state_channel_by_channel():
    data = noise()
    bad = data.copy()
    for row, value in ((100, np.nan), (101, np.inf), (300, -np.inf)):
        bad[row, 1] = value
    _, _, out, _ = run(Lowpass(cutoff_hz=20.0), bad)
    _, _, clean, _ = run(Lowpass(cutoff_hz=20.0), data)
    assert np.array_equal(out[:, [0, 2]], clean[:, [0, 2]])
    skipped = np.delete(data, (100, 101, 300), axis=0)
    assert np.isnan(out[[100, 101, 300], 1]).all()
    assert np.array_equal(np.delete(out[:, 1], (100, 101, 300)), run(Lowpass(cutoff_hz=20.0), skipped)[2][:, 1])


def test_only_a_gap_above_the_limit_resets():
    data = noise()
    time = grid(RATE, 800)
    whole = run(Lowpass(cutoff_hz=20.0), data)[2]
    short = np.concatenate([time[:300], time[320:720]])
    _, _, out, marks = run(Lowpass(cutoff_hz=20.0, reset_gap_s=0.1), data, time=short, lost={300: 20})
    assert np.array_equal(out, whole) and marks == {300: 20}
    long = np.concatenate([time[:300], time[321:721]])
    _, stamps, out, marks = run(Lowpass(cutoff_hz=20.0, reset_gap_s=0.1), data, time=long, lost={300: -1})
    assert np.array_equal(out[:300], whole[:300]) and marks == {300: -1}
    assert np.array_equal(out[300:], run(Lowpass(cutoff_hz=20.0), data[300:])[2])
    assert np.array_equal(np.diff(stamps), np.diff(long))


def test_low_pass_stamps_put_a_slow_peak_where_it_was():
    time = grid(1000.0, 2000)
    centre = int(time[1000])
    bump = np.exp(-0.5 * ((time - centre) / 60e6) ** 2)[:, None]
    operator = Lowpass(cutoff_hz=20.0)
    _, stamps, out, _ = run(operator, bump, spec=signal_spec(1, 1000.0))
    assert abs(int(stamps[out.argmax()]) - centre) <= 1_000_000
    opened = operator.unopened()
    opened.open({"in": signal_spec(1, 1000.0)})
    assert opened.delay_s == pytest.approx(0.0207, abs=5e-4)
    assert stamps[0] == time[0] - round(opened.delay_s * 1e9)


def test_a_band_passes_its_centre_undelayed():
    time = grid(1000.0, 4000)
    centre_hz = np.sqrt(20.0 * 80.0)
    tone = np.sin(2 * np.pi * centre_hz * (time - time[2000]) / 1e9) * np.exp(-0.5 * ((time - time[2000]) / 300e6) ** 2)
    _, stamps, out, _ = run(Bandpass(low_hz=20.0, high_hz=80.0), tone[:, None], spec=signal_spec(1, 1000.0))
    envelope = np.abs(signal.hilbert(out[:, 0]))
    assert abs(int(stamps[envelope.argmax()]) - int(time[2000])) <= 3_000_000


def test_settling_says_when_a_step_has_arrived():
    step = np.ones((400, 1))
    spec, _, out, _ = run(Lowpass(cutoff_hz=5.0, order=2), step)
    settled = round(spec.settling_s * RATE)
    assert 10 < settled < 100 and np.abs(out[settled:] - 1).max() < 0.02


@pytest.mark.parametrize(
    ("operator", "message"),
    [
        (Lowpass(cutoff_hz=1200.0), r"cutoff_hz is 1200\.0; it must be below 500 \(half of the input's 1000 Hz\)"),
        (Highpass(cutoff_hz=500.0), r"cutoff_hz is 500\.0; it must be below 500 \(half of the input's 1000 Hz\)"),
        (Bandpass(low_hz=20.0, high_hz=600.0), r"high_hz is 600\.0; it must be below 500"),
        (Bandpass(low_hz=40.0, high_hz=20.0), r"low_hz is 40\.0; it must be below high_hz, which is 20"),
        (Notch(notch_hz=50.0, width_hz=700.0), r"width_hz is 700\.0; it must be below 500"),
        (Notch(notch_hz=50.0, harmonics=12), r"harmonics is 12; it must be at most 9"),
    ],
)
def test_frequencies_above_nyquist_are_refused(operator, message):
    with pytest.raises(ParameterError, match=message):
        operator.open({"in": signal_spec(2, 1000.0)})


def test_sections_refuse_an_irregular_stream():
    with pytest.raises(InputError, match="irregular; it must be regular"):
        Lowpass(cutoff_hz=10.0).open({"in": signal_spec(2, None)})


# A real recording


def test_a_real_recording_is_filtered_as_scipy_filters_it():
    """Thirteen muscles on a treadmill: band-pass, rectify, resample to 120 Hz, low-pass (thesis 6.2.3), against scipy on the whole."""
    spec, time, emg = treadmill()["emg"]
    cuts = range(0, len(emg), 37)
    band = signal.sosfilt(signal.butter(4, (20.0, 450.0), "bandpass", fs=1000.0, output="sos"), emg, axis=0)
    _, stamps, made, _ = run(Bandpass(low_hz=20.0, high_hz=450.0), emg, spec=spec, time=time, cuts=cuts)
    assert np.array_equal(made, band)
    _, _, made, _ = run(Rectify(), made, spec=spec, time=stamps, cuts=cuts)
    slow, slow_stamps, made, _ = run(Resample(rate_hz=120.0), made, spec=spec, time=stamps, cuts=cuts)
    reference = signal.resample_poly(np.abs(band), 3, 25, axis=0)[: len(made)]
    np.testing.assert_allclose(made, reference, rtol=0, atol=1e-12 * np.abs(band).max())
    _, _, made, _ = run(Lowpass(cutoff_hz=20.0), made, spec=slow, time=slow_stamps, cuts=range(0, len(made), 5))
    sos = signal.butter(4, 20.0, fs=120.0, output="sos")
    np.testing.assert_allclose(made, signal.sosfilt(sos, reference, axis=0), rtol=0, atol=1e-12 * np.abs(band).max())
