"""LSL's stamps as session time: the law of cuts, corrections without leaps, losses, and senders that stamp badly."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.devices.lsl.clock import SenderClock
from kinegraph.devices.lsl.stamps import NEWEST_S, STEADY_S, SURE, LslStamps
from kinegraph.stream.chunk import NS, Samples

ZERO = 1_700_000_000 * NS
"""Session time at which the local clock stood at 0."""
BEGIN = 5000.0
RATE = 1000.0


def even(n: int, rate_hz: float = RATE) -> Samples:
    return BEGIN + np.arange(n) / rate_hz


def arrival(stamps: Samples) -> int:
    """When a chunk with these stamps is read: 5 ms after its last sample."""
    return ZERO + round((float(stamps[-1]) + 0.005) * NS)


def mapped(
    stamps: Samples, cuts: list[int], rate_hz: float | None = RATE, **options: float
) -> tuple[Samples, dict[int, int]]:
    """Session times and {index: lost} of stamps that are read in these pieces."""
    by, times, gaps, start = LslStamps(rate_hz, ZERO, **options), [], {}, 0
    for stop in sorted({*(c % (len(stamps) + 1) for c in cuts), len(stamps)} - {0}):
        one = by.map(stamps[start:stop], arrival(stamps[start:stop]))
        times.append(one.time)
        gaps |= {start + i: lost for i, lost in one.gaps}
        start = stop
    return np.concatenate(times), gaps


@given(
    st.lists(st.integers(0, 10**4), max_size=8),
    st.lists(st.tuples(st.integers(2500, 4999), st.integers(1, 40)), max_size=4),
)
def test_any_cut_gives_the_same_stamps_and_losses(cuts: list[int], holes: list[tuple[int, int]]) -> None:
    kept = np.ones(5000, bool)
    for at, n in holes:
        kept[at : at + n] = False
    stamps = even(5000)[kept]
    whole, gaps = mapped(stamps, [])
    pieces, same = mapped(stamps, cuts)
    assert gaps == same
    assert np.array_equal(whole, pieces)
    assert np.abs(whole - ZERO - np.round(stamps * NS).astype(np.int64)).max() <= 1
    missing = np.diff(np.flatnonzero(kept)) - 1
    assert gaps == {int(i) + 1: int(missing[i]) for i in np.flatnonzero(missing)}


def test_a_sender_that_has_not_yet_shown_to_be_even_is_not_counted_on() -> None:
    stamps = np.delete(even(1000), slice(300, 304))
    assert mapped(stamps, [])[1] == {}, "0.3 s of even steps prove nothing"
    assert STEADY_S > 0.3
    assert mapped(np.delete(even(5000), slice(300, 1000)), [])[1] == {300: -1}, "0.7 s is a gap in any case"


def test_a_sender_that_stamps_when_it_gets_there_has_gaps_only_above_the_limit() -> None:
    rng = np.random.default_rng(3)
    stamps = np.sort(even(5000) + rng.uniform(0, 0.02, 5000))
    stamps[3000:] += 0.4
    assert mapped(stamps, [])[1] == {}
    stamps[4000:] += 0.6
    assert mapped(stamps, [700, 4000])[1] == {4000: -1}
    assert mapped(stamps, [700, 4000], gap_s=2.0)[1] == {}
    assert mapped(stamps, [10], None)[1] == {}, "what has no rate has no gaps"


def test_the_constant_delay_is_taken_off() -> None:
    assert (mapped(even(10), [], latency_s=0.25)[0] == mapped(even(10), [])[0] - NS // 4).all()


def test_a_better_estimate_of_the_clocks_never_makes_a_stamp_leap() -> None:
    stamps, offset = even(20000), -3500.0
    by = LslStamps(RATE, ZERO)
    by.correct(offset, at_once=True)
    estimates, times = np.random.default_rng(5).normal(offset, 2e-3, 20), []
    for k, estimate in enumerate(estimates):
        part = stamps[k * 1000 : (k + 1) * 1000]
        by.correct(estimate)
        times.append(by.map(part, ZERO + round((part[-1] + offset) * NS)).time)
    steps = np.diff(np.concatenate(times))
    assert steps.min() >= 0.998e6 and steps.max() <= 1.002e6
    final = times[-1][-1] - ZERO - round((stamps[-1] + estimates[-1]) * NS)
    assert abs(final) < 1_500_000, "within a second it is a millisecond nearer"


def test_another_clock_is_taken_over_at_once_and_stamps_wait_rather_than_run_backwards() -> None:
    by, stamps = LslStamps(RATE, ZERO), even(3000)
    first = by.map(stamps[:1000], arrival(stamps[:1000]))
    by.correct(2.0)
    later = by.map(stamps[1000:2000], arrival(stamps[1000:2000]) + 2 * NS)
    assert later.time[0] == first.time[-1] + 2_001_000_000
    by.correct(0.0)
    back = by.map(stamps[2000:], arrival(stamps[2000:]))
    assert (np.diff(back.time) >= 0).all() and back.time[0] == later.time[-1] + 1 and back.backwards == 1000


def test_after_a_pause_the_loss_stands_where_the_stamps_leap() -> None:
    by, stamps = LslStamps(RATE, ZERO), even(5000)
    by.map(stamps[:1000], arrival(stamps[:1000]))
    both = np.concatenate([stamps[1000:1010], stamps[4000:4010]])
    assert by.map(both, arrival(both), after_pause=True).gaps == [(10, -1)]
    assert by.map(stamps[4010:4020], arrival(stamps[4010:4020]), after_pause=True).gaps == [(0, -1)]
    by = LslStamps(None, ZERO)
    assert by.map(stamps[:1], arrival(stamps[:1]), after_pause=True).gaps == [(0, -1)]


def test_blocks_that_overlap_are_put_one_after_the_other() -> None:
    """Senders that stamp a block by the moment at which they send it give its first samples times before the last block's."""
    by, times = LslStamps(RATE, ZERO), []
    for k, late in enumerate([0.0, 0.012, 0.003]):
        block = even(32) + k * 0.032 + late
        found = by.map(block, arrival(block))
        assert found.backwards == (8 if k == 2 else 0)
        times.append(found.time)
    assert (np.diff(np.concatenate(times)) >= 0).all()
    assert all(b[0] > a[-1] for a, b in pairwise(times))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300, -1e300, 0.0, 1.7e9, BEGIN + NEWEST_S + 1])
@pytest.mark.parametrize("rate_hz", [RATE, None])
def test_a_stamp_that_cannot_be_is_replaced_by_its_arrival(bad: float, rate_hz: float | None) -> None:
    by, stamps = LslStamps(rate_hz, ZERO), even(30)
    stamps[10] = bad
    found = by.map(stamps, arrival(stamps))
    assert found.impossible == 1
    assert (np.diff(found.time) >= 0).all()
    assert ((found.time >= ZERO + round(BEGIN * NS)) & (found.time <= arrival(stamps))).all()
    after = by.map(even(60)[30:], arrival(even(60)))
    assert after.impossible == 0 and (after.time > found.time[-1]).all()


@pytest.mark.parametrize("epoch", [1.7e9 - BEGIN, -BEGIN, 1e12])
def test_stamps_of_another_epoch_keep_their_pace(epoch: float) -> None:
    by, stamps = LslStamps(RATE, ZERO), even(5000)
    found = [by.map(stamps[k : k + 50] + epoch, arrival(stamps[k : k + 50])) for k in range(0, 5000, 50)]
    assert found[0].shifted_s == pytest.approx(-epoch, abs=0.01) and not any(one.shifted_s for one in found[1:])
    assert found[0].gaps == [(SURE - 1, -1)] and not any(one.gaps or one.impossible for one in found[1:])
    off = np.concatenate([one.time for one in found[1:]]) - ZERO - np.round(stamps[50:] * NS)
    assert np.abs(off).max() < 0.01 * NS


def test_a_clock_that_is_set_back_makes_a_gap_and_keeps_its_pace() -> None:
    by, stamps = LslStamps(RATE, ZERO), even(5000)
    found = []
    for k in range(0, 5000, 50):
        sent = stamps[k : k + 50] - (20.0 if k >= 2000 else 0.0)
        found.append(by.map(sent, arrival(stamps[k : k + 50])))
    assert sum(one.shifted_s for one in found) == pytest.approx(20.0, abs=0.01)
    assert [(k, one.gaps) for k, one in enumerate(found) if one.gaps] == [(40, [(SURE - 1, -1)])]
    off = np.concatenate([one.time for one in found]) - ZERO - np.round(stamps * NS)
    assert np.abs(off[2050:]).max() < 0.01 * NS and (np.diff(np.concatenate([one.time for one in found])) >= 0).all()


@given(st.lists(st.floats(), min_size=1, max_size=30), st.integers(1, 7))
def test_no_stamps_whatever_make_time_run_backwards(stamps: list[float], size: int) -> None:
    by, last = LslStamps(RATE, ZERO), -1
    for start in range(0, len(stamps), size):
        part = np.array(stamps[start : start + size])
        found = by.map(part, ZERO + round((BEGIN + start) * NS), after_pause=start % 3 == 1)
        assert found.time[0] > last and (np.diff(found.time) >= 0).all() and len(found.time) == len(part)
        assert all(0 <= i < len(part) and (lost > 0 or lost == -1) for i, lost in found.gaps)
        assert abs(int(found.time[-1]) - ZERO) < 10**14
        last = int(found.time[-1])


def test_a_senders_clock_drifts_and_is_set() -> None:
    clock = SenderClock(zero_s=100.0)
    assert clock.state() is None
    for k in range(21):
        clock.see(5.0 + 30e-6 * k, 0.0003, float(k))
    state = clock.state()
    assert state and state.offset_s == pytest.approx(105.0006) and state.drift_ppm == pytest.approx(30.0)
    assert not state.settling and state.jumps == 0 and state.uncertainty_s == 0.0003
    clock.see(-3595.0, 0.0003, 21.0)
    state = clock.state()
    assert state and state.settling and state.jumps == 1 and state.jump_s == pytest.approx(3600.0, abs=0.001)
