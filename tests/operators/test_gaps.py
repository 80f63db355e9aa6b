"""Gap filling against a plain reference that sees the whole stream."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from kinegraph.operators.filters.gaps import FillGaps
from kinegraph.stream.chunk import FOREVER, NS, Chunk, StreamSpec
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import grid
from tests.support.one_stream import RATE, noise, run, same, signal_spec


def filled(data, most, linear=True):
    """Every run of at most `most` bad values between two good ones, filled."""
    out = np.where(np.isfinite(data), data, np.nan)
    for column in out.T:
        good = np.flatnonzero(np.isfinite(column))
        for a, b in pairwise(good):
            if 1 < b - a <= most + 1:
                share = np.arange(1, b - a) / (b - a) if linear else 0.0
                column[a + 1 : b] = column[a] + share * (column[b] - column[a])
    return out


def spoilt(seed, n=500):
    rng = np.random.default_rng(seed)
    data = noise(n, seed=seed)
    for c in range(3):
        for start in rng.integers(0, n, 12):
            data[start : start + rng.integers(1, 9), c] = rng.choice([np.nan, np.inf, -np.inf])
    return data


@pytest.mark.parametrize("method", ["linear", "hold"])
@pytest.mark.parametrize("seed", range(5))
def test_short_runs_of_bad_values_are_filled(method, seed):
    data = spoilt(seed)
    operator = FillGaps(limit_s=5 / RATE, method=method)
    reference = filled(data, 5, method == "linear")
    cuts = np.random.default_rng(seed).integers(0, 500, 60).tolist()
    for some in ((), cuts, range(500)):
        _, stamps, out, marks = run(operator, data, cuts=some)
        assert same(out, reference) and np.array_equal(stamps, grid(RATE, 500)) and not marks


def test_lost_samples_are_put_back():
    data = noise(300)
    time = grid(RATE, 300)
    keep = np.r_[0:100, 105:200, 201:300]
    _, stamps, out, marks = run(
        FillGaps(limit_s=5 / RATE), data[keep], time=time[keep], lost={100: 5, 195: -1}, cuts=(99, 101)
    )
    hidden = data.copy()
    hidden[100:105] = hidden[200] = np.nan
    assert same(out, filled(hidden, 5)) and not marks
    assert np.array_equal(stamps, time)


def test_a_long_gap_stays_and_is_told():
    data = noise(300)
    data[97:100, 0] = data[106:108, 1] = np.nan
    time = grid(RATE, 300)
    keep = np.r_[0:100, 106:300]
    _, stamps, out, marks = run(FillGaps(limit_s=5 / RATE), data[keep], time=time[keep], lost={100: 6}, cuts=(98, 101))
    assert np.array_equal(stamps, time[keep]) and marks == {100: 6}
    assert np.isnan(out[97:100, 0]).all() and np.isnan(out[100:102, 1]).all() and np.isnan(out).sum() == 5


def test_lost_and_bad_samples_together_count_as_one_gap():
    data = noise(300, 2)
    data[98:100, 0] = np.nan
    time = grid(RATE, 300)
    keep = np.r_[0:100, 104:300]
    _, stamps, out, marks = run(FillGaps(limit_s=5 / RATE), data[keep], time=time[keep], lost={100: 4})
    assert np.array_equal(stamps, time) and not marks
    assert np.isnan(out[98:104, 0]).all() and np.isfinite(out[:, 1]).all()


def test_what_waits_is_given_up_when_time_shows_that_the_gap_is_too_long():
    spec = StreamSpec((1,), rate_hz=100.0)
    operator = FillGaps(limit_s=0.03)
    operator.open({"in": spec})
    time = grid(100.0, 3)
    nan = np.array([[1.0], [np.nan], [np.nan]])
    chunk = operator.process("in", Chunk(time, nan, int(time[-1])))
    assert len(chunk) == 1 and chunk.until == time[1] - 1
    nothing = np.empty(0, np.int64), np.empty((0, 1))
    chunk = operator.process("in", Chunk(*nothing, int(time[-1]) + 30_000_000))
    assert len(chunk) == 0 and chunk.until == time[1] - 1
    chunk = operator.process("in", Chunk(*nothing, int(time[-1]) + 90_000_000))
    assert len(chunk) == 2 and np.isnan(chunk.data).all() and chunk.until == time[-1] + 90_000_000
    chunk = operator.process("in", Chunk(time[-1:] + 100_000_000, np.ones((1, 1)), FOREVER))
    assert chunk.data.tolist() == [[1.0]]


def test_what_waits_at_the_end_comes_out():
    data = noise(50, 1)
    data[48:] = np.nan
    _, _, out, _ = run(FillGaps(limit_s=0.1), data, cuts=(49,))
    assert same(out, data)


def test_a_limit_below_one_sample_is_refused():
    with pytest.raises(ParameterError, match=r"limit_s is 0\.001; it must be at least 0\.005"):
        run(FillGaps(limit_s=0.001), noise(10))


def filled_by_stamps(data, time, longest_ns):
    """Every run of bad values between two good ones no further apart than that, on the line between them."""
    out = data.copy()
    for column in out.T:
        good = np.flatnonzero(np.isfinite(column))
        for a, b in pairwise(good):
            if b - a > 1 and time[b] - time[a] <= longest_ns:
                column[a + 1 : b] = np.interp(time[a + 1 : b], time[[a, b]], column[[a, b]])
    return out


@pytest.mark.parametrize("seed", range(5))
def test_in_an_irregular_stream_values_lie_on_a_line_by_their_stamps(seed):
    rng = np.random.default_rng(seed)
    data = np.where(rng.random((500, 3)) < 0.3, np.nan, noise(500, seed=seed))
    time = np.cumsum(rng.integers(20_000_000, 60_000_000, 500))
    reference = filled_by_stamps(data, time, 150_000_000)
    assert 0 < np.isnan(reference).sum() < np.isnan(data).sum() / 2
    for cuts in ((), rng.integers(0, 500, 60).tolist(), range(500)):
        _, stamps, out, marks = run(
            FillGaps(limit_s=0.15), data, spec=signal_spec(data.shape[1], None), time=time, cuts=cuts
        )
        assert np.allclose(out, reference, equal_nan=True, atol=1e-12) and np.array_equal(stamps, time) and not marks


def test_in_an_irregular_stream_nothing_is_filled_across_lost_samples():
    data = noise(100)
    data[49:51, 0] = data[70, 1] = np.nan
    time = np.arange(100) * 10_000_000 + np.arange(100) % 3
    _, _, out, marks = run(
        FillGaps(limit_s=0.1), data, spec=signal_spec(data.shape[1], None), time=time, lost={50: 2}, cuts=(45, 55)
    )
    assert marks == {50: 2} and np.isnan(out[49:51, 0]).all() and np.isnan(out).sum() == 2


def test_in_an_irregular_stream_nothing_is_put_back_so_time_goes_on_at_once():
    operator = FillGaps(limit_s=0.1)
    operator.open({"in": StreamSpec((1,))})
    chunk = operator.process("in", Chunk(np.array([NS]), np.ones((1, 1)), NS + 50_000_000))
    assert len(chunk) == 1 and chunk.until == NS + 50_000_000
