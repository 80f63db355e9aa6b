"""The envelope against its plain computation, against zero-phase filtering, and on bad samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from kinegraph.operators.emg.envelope import Envelope
from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from tests.gait.naive_emg import zero_phase_envelope
from tests.support.emg_run import recording

pytestmark = pytest.mark.quick

RATE = 1000.0


@pytest.fixture
def treadmill():
    return recording("emg_santuz_tw12")


def spec_of(channels, rate=RATE):
    return StreamSpec((channels,), rate_hz=rate, units=("uV",))


def run(operator, spec, time, data, cuts=(), lost=None):
    """All output chunks with samples joined: stamps, rows, and {row: lost}; checks the promise of `until` on the way."""
    operator = operator.unopened()
    operator.open({"in": spec})
    times, rows, gaps, promised = [], [], {}, -(2**62)
    edges = sorted({0, *cuts, *(lost or {}), len(time)})
    for a, b in pairwise(edges):
        emitted = operator.process("in", Chunk(time[a:b], data[a:b], int(time[b - 1]), (lost or {}).get(a, 0)))
        pieces = [c for _, c in emitted] if isinstance(emitted, list) else [emitted]
        for piece in pieces:
            if len(piece):
                assert piece.time[0] > promised
                assert piece.time[-1] <= piece.until
                if piece.lost:
                    gaps[sum(map(len, times))] = piece.lost
                times.append(piece.time)
                rows.append(piece.data)
            promised = piece.until
    operator.process("in", Chunk(time[:0], data[:0], FOREVER))
    return np.concatenate(times), np.concatenate(rows), gaps


def stamps(n, rate=RATE):
    return np.round(np.arange(n) * 1e9 / rate).astype(np.int64)


def test_agrees_with_the_plain_computation_on_the_real_recording(treadmill):
    x = treadmill["emg_uV"].astype(float)
    _, rows, _ = run(Envelope(), spec_of(13), stamps(len(x)), x, cuts=range(0, len(x), 7))
    plain = zero_phase_envelope(x, RATE)
    assert len(plain) - 3 <= len(rows) <= len(plain)
    np.testing.assert_allclose(rows, plain[: len(rows)], rtol=0, atol=1e-9)


def test_peaks_of_every_cycle_lie_within_one_percent_of_zero_phase_filtering(treadmill):
    """All 65 peaks (13 muscles, 5 cycles) against sosfiltfilt at full rate, high-pass and low-pass both."""
    x, t, touch = treadmill["emg_uV"].astype(float), treadmill["t_s"], treadmill["touchdown_s"]
    time, rows, _ = run(Envelope(), spec_of(13), np.round(t * 1e9).astype(np.int64), x)
    high, low = butter(2, 20, "highpass", fs=RATE, output="sos"), butter(4, 20, fs=RATE, output="sos")
    reference = sosfiltfilt(low, np.abs(sosfiltfilt(high, x, axis=0)), axis=0)
    for a, b in pairwise(touch):
        at = a + (b - a) * np.arange(100) / 100
        for muscle in range(13):
            ours = np.interp(at, time / 1e9, rows[:, muscle]).argmax()
            theirs = np.interp(at, t, reference[:, muscle]).argmax()
            assert min(abs(ours - theirs), 100 - abs(ours - theirs)) <= 1, (muscle, a)


def test_any_cutting_gives_the_same_bits():
    rng = np.random.default_rng(3)
    x = rng.standard_normal((900, 2)) * 40
    for operator in (Envelope(), Envelope(phase="causal"), Envelope(rate_hz=0.0, highpass_hz=0.0)):
        whole = run(operator, spec_of(2), stamps(900), x)
        for _ in range(5):
            parts = run(operator, spec_of(2), stamps(900), x, cuts=rng.integers(0, 900, 60).tolist())
            assert np.array_equal(whole[0], parts[0])
            assert np.array_equal(whole[1], parts[1])


@pytest.mark.parametrize("phase", ["zero", "causal"])
def test_a_burst_stays_where_it_is(phase):
    rng = np.random.default_rng(4)
    t = stamps(3000)
    shape = np.exp(-(((t / 1e9 - 1.5) / 0.08) ** 2))
    x = (rng.standard_normal(3000) * shape)[:, None] * 100 + 5.0
    time, rows, _ = run(Envelope(phase=phase), spec_of(1), t, x)
    centre = (rows[:, 0] * time).sum() / rows[:, 0].sum() / 1e9
    zero = sosfiltfilt(butter(2, 20, "highpass", fs=RATE, output="sos"), x[:, 0])
    expected = (np.abs(zero) * t).sum() / np.abs(zero).sum() / 1e9
    assert abs(centre - expected) < 0.005


def test_an_offset_alone_gives_no_activity():
    _, rows, _ = run(Envelope(), spec_of(1), stamps(1000), np.full((1000, 1), 250.0))
    assert np.abs(rows).max() < 1e-9


def test_missing_values_stay_with_their_channel_and_their_moment():
    rng = np.random.default_rng(5)
    x = rng.standard_normal((2000, 2)) * 30
    broken = x.copy()
    broken[800:830, 1] = np.nan
    broken[900, 1] = np.inf
    time, rows, _ = run(Envelope(), spec_of(2), stamps(2000), broken)
    _, whole, _ = run(Envelope(), spec_of(2), stamps(2000), x)
    assert np.array_equal(rows[:, 0], whole[:, 0])
    bad = np.isnan(rows[:, 1])
    touched = (time >= 0.8e9) & (time < 0.838e9) | (time >= 0.9e9) & (time < 0.905e9)
    assert np.array_equal(bad, touched)
    far = np.abs(time / 1e9 - 0.85) > 0.3
    np.testing.assert_allclose(rows[far, 1], whole[far, 1], rtol=2e-2, atol=0.05)


def test_a_long_gap_starts_again_and_a_short_one_does_not():
    rng = np.random.default_rng(6)
    x = rng.standard_normal((1500, 1)) * 30
    t = stamps(1500)
    late = t.copy()
    late[700:] += 500_000_000
    time, rows, gaps = run(Envelope(), spec_of(1), late, x, lost={700: 500})
    alone, fresh, _ = run(Envelope(), spec_of(1), late[700:], x[700:])
    assert list(gaps.values()) == [-1]
    at = next(iter(gaps))
    assert np.array_equal(time[at:], alone)
    assert np.array_equal(rows[at:], fresh)
    time, rows, gaps = run(Envelope(rate_hz=0.0), spec_of(1), np.where(t < 7e8, t, t + 20_000_000), x, lost={700: 20})
    assert gaps == {700: 20}
    assert np.array_equal(rows, run(Envelope(rate_hz=0.0), spec_of(1), t, x)[1])


def test_what_cannot_be_is_said():
    with pytest.raises(ParameterError, match=r"cutoff_hz is 70\.0; it must be below 60"):
        Envelope(cutoff_hz=70.0).open({"in": spec_of(1)})
    with pytest.raises(ParameterError, match=r"rate_hz is 4000\.0; it must be between"):
        Envelope(rate_hz=4000.0).open({"in": spec_of(1)})
    with pytest.raises(ParameterError, match="highpass_hz"):
        Envelope(highpass_hz=500.0).open({"in": spec_of(1)})
    with pytest.raises(InputError, match="irregular"):
        Envelope().open({"in": StreamSpec((1,))})


@pytest.mark.parametrize("phase", ["zero", "causal"])
def test_stamps_that_lie_close_after_a_stall_do_not_run_backwards(phase):
    """A device that was held up sends what it has at once: a hundred samples within 0.1 ms, each output's place is a share of 0.5 ms on."""
    steps = np.full(3000, 500_000)
    steps[1000:1100] = 1000
    time = 1_000_000_000 + np.cumsum(steps)
    data = np.random.default_rng(3).normal(size=(3000, 2))
    made = []
    for size in (7, 3000):
        operator = Envelope(phase=phase)
        operator.open({"in": StreamSpec((2,), rate_hz=2000.0, units=("uV",))})
        chunks = [
            operator.process("in", Chunk(time[i : i + size], data[i : i + size], int(time[i : i + size][-1])))
            for i in range(0, 3000, size)
        ]
        stamps = np.concatenate([chunk.time for chunk in chunks])
        until = [chunk.until for chunk in chunks]
        assert (np.diff(stamps) >= 0).all() and until == sorted(until)
        reached = 0
        for chunk in chunks:
            assert not len(chunk.time) or (int(chunk.time[0]) > reached and int(chunk.time[-1]) <= chunk.until)
            reached = chunk.until
        made.append(stamps)
    assert np.array_equal(*made)
