"""Device clocks: drift, jitter, stalls and wraps, against the truth of a simulation."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.devices.clocks.device_clock import Counter, DeviceClock
from kinegraph.stream.chunk import NS, Times


def link(seconds: int, rate_hz: float, ppm: float, seed: int, offset_s: float = 1000.0) -> tuple[Times, Times, Times]:
    """True times, device times and arrivals (n,) ns: 20 ms of jitter, 1 % stalls of 100 ms, 3 ms at least, in order."""
    random = np.random.default_rng(seed)
    true = np.round(np.arange(seconds * rate_hz) * NS / rate_hz).astype(np.int64)
    device = np.round(true * (1 + ppm * 1e-6)).astype(np.int64) + round(offset_s * NS)
    delay = 0.003 + random.uniform(0, 0.02, len(true)) + 0.1 * (random.uniform(size=len(true)) < 0.01)
    return true, device, np.maximum.accumulate(true + (delay * NS).astype(np.int64))


def mapped(device: Times, arrival: Times, latency_s: float = 0.003) -> tuple[Times, DeviceClock]:
    clock = DeviceClock(latency_s)
    stamps = np.empty_like(device)
    for i in range(len(device)):
        clock.see(int(device[i]), int(arrival[i]))
        stamps[i] = clock.stamps(device[i : i + 1])[0]
    return stamps, clock


@pytest.mark.parametrize("ppm", [0.0, 50.0, -50.0, 200.0])
def test_stamps_follow_the_truth_through_jitter_and_stalls(ppm: float) -> None:
    true, device, arrival = link(300, 50, ppm, seed=1)
    stamps, clock = mapped(device, arrival)
    error = np.abs(stamps - true) / NS
    assert error[true > 30 * NS].max() < 0.002
    assert error[true > 120 * NS].max() < 0.001
    assert (np.diff(stamps) > 0).all()
    assert clock.state.drift_ppm == pytest.approx(-ppm, abs=10)
    assert 0 < clock.state.uncertainty_s < 0.005


@pytest.mark.parametrize("ppm", [-1500.0, -5000.0, -20000.0, 3000.0])
def test_a_clock_that_is_no_quartz_is_followed_as_well(ppm: float) -> None:
    """An Arduino's resonator, or a counter with a rate slightly off the stated one."""
    true, device, arrival = link(90, 50, ppm, seed=7)
    stamps, clock = mapped(device, arrival)
    error = np.abs(stamps - true) / NS
    assert error[true > 30 * NS].max() < (0.002 if ppm < 0 else 0.005)
    assert (np.diff(stamps) > 0).all()
    if ppm < 0:
        assert clock.state.drift_ppm == pytest.approx(1e6 / (1 + ppm * 1e-6) - 1e6, abs=30)


def test_delays_that_grow_for_a_while_are_no_drift() -> None:
    true, device, arrival = link(120, 50, 20.0, seed=8)
    late = np.interp(true / NS, [20, 35, 36, 120], [0, 0.3, 0, 0])
    stamps, clock = mapped(device, np.maximum.accumulate(arrival + (late * NS).astype(np.int64)))
    assert (np.abs(stamps - true) / NS)[true > 30 * NS].max() < 0.002
    assert abs(clock.state.drift_ppm) < 100


@pytest.mark.parametrize("ppm", [-200_000.0, -20_000.0, -5_000.0, -1_000.0, 0.0, 20_000.0])
def test_until_the_drift_is_known_the_uncertainty_covers_what_stamps_fall_behind(ppm: float) -> None:
    """A device slower than it says by far: for its first seconds nothing else than their own lateness shows it."""
    true, device, arrival = link(10, 50, ppm, seed=9)
    clock = DeviceClock(0.003)
    for i in range(len(device)):
        clock.see(int(device[i]), int(arrival[i]))
        error = abs(int(clock.stamps(device[i : i + 1])[0]) - int(true[i])) / NS
        if clock.state.seconds >= 2 and clock.state.settling:
            assert error <= clock.state.uncertainty_s + 0.020, "beside the jitter of what has come so far"
            assert clock.state.uncertainty_s < 0.15 + 3 * abs(ppm) * 1e-6 * true[i] / NS


def test_arrival_times_alone_would_be_far_worse() -> None:
    true, device, arrival = link(120, 50, 50.0, seed=2)
    stamps, _ = mapped(device, arrival)
    assert np.std(arrival - true) > 20 * np.std((stamps - true)[true > 30 * NS])


def test_a_constant_delay_is_corrected_by_what_the_user_measured_and_by_nothing_else() -> None:
    true, device, arrival = link(60, 50, 0.0, seed=3)
    late, _ = mapped(device, arrival, latency_s=0.0)
    assert np.median(late - true) / NS == pytest.approx(0.003, abs=0.001)


def test_stamps_never_run_backwards_when_the_line_moves_down() -> None:
    clock = DeviceClock()
    clock.see(0, 50_000_000)
    first = clock.stamps(np.arange(0, 5_000_000, 1_000_000))
    clock.see(5_000_000, 6_000_000)
    second = clock.stamps(np.arange(5_000_000, 200_000_000, 1_000_000))
    assert (np.diff(np.concatenate([first, second])) > 0).all()
    assert second[-1] == 199_000_000 + 1_000_000


def test_a_device_that_was_reset_is_learned_anew() -> None:
    _, device, arrival = link(30, 50, 20.0, seed=4)
    stamps, clock = mapped(device, arrival)
    clock.restart()
    clock.see(0, int(arrival[-1]) + NS)
    after = clock.stamps(np.array([0, NS]))
    assert after[0] > stamps[-1]
    assert after[1] - after[0] == NS


def test_a_counter_finds_what_is_missing() -> None:
    counter = Counter(8, 250.0)
    lost = [
        counter.lost_before(c, round(i * NS / 250))
        for i, c in ((0, 250), (1, 251), (5, 255), (6, 0), (7, 1), (7, 1), (8, 2))
    ]
    assert lost == [0, 0, 3, 0, 0, -1, 0]
    assert counter.value == 8


def test_one_stamp_at_a_time_is_the_same_bit_for_bit() -> None:
    _, device, arrival = link(40, 50, 50.0, seed=6)
    one, many = DeviceClock(0.003), DeviceClock(0.003)
    for i in range(len(device)):
        one.see(int(device[i]), int(arrival[i]))
        many.see(int(device[i]), int(arrival[i]))
        assert one.stamp(int(device[i])) == many.stamps(device[i : i + 1])[0]


@pytest.mark.parametrize("outage", [1, 255, 256, 257, 1000, 5000])
def test_an_outage_longer_than_the_counters_range_is_counted_by_elapsed_time(outage: int) -> None:
    counter = Counter(8, 250.0)
    for i in range(20):
        counter.lost_before(i, round(i * NS / 250))
    at = 20 + outage
    assert counter.lost_before(at % 256, round(at * NS / 250) + 30_000_000) == outage


@pytest.mark.parametrize("wrong", [1005, 1200, 9003, 60003, 3, 999])
@pytest.mark.parametrize("bits", [16, 32])
def test_a_wrong_digit_in_a_counter_costs_what_it_hides_and_no_more(wrong: int, bits: int) -> None:
    counter, given = Counter(bits, 200.0), [1000, 1001, 1002, wrong, *range(1004, 1100)]
    lost = [counter.lost_before(c, round(i * NS / 200)) for i, c in enumerate(given)]
    recorded, missing = sum(n >= 0 for n in lost), sum(n for n in lost if n > 0)
    assert recorded + missing == len(given)
    assert missing <= (1 if abs(wrong - 1003) > 30 else abs(wrong - 1003))
    assert counter.value == 1099 - 1000


@pytest.mark.parametrize("left_out", [100, 3000])
def test_what_a_stall_left_out_is_counted_although_it_comes_late(left_out: int) -> None:
    """All that was made during a stall comes at once, but what the device had no room for."""
    counter, now = Counter(16, 200.0), 0
    assert [counter.lost_before(i, i * NS // 200) for i in range(10)] == [0] * 10
    now = (10 + left_out) * NS // 200
    made = [*range(10, 20), *range(20 + left_out, 40 + left_out)]
    lost = [counter.lost_before(i, now) for i in made]
    recorded, missing = sum(n >= 0 for n in lost), sum(n for n in lost if n > 0)
    assert recorded + missing == made[-1] - 9 and recorded >= len(made) - 1


def test_a_device_that_begins_to_count_again_is_followed() -> None:
    counter = Counter(16, 200.0)
    given = [*range(300, 500), *range(200)]
    lost = [counter.lost_before(c, i * NS // 200) for i, c in enumerate(given)]
    assert lost[202:] == [0] * 198 and sum(n >= 0 for n in lost) >= len(given) - 2
