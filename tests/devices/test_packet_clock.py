"""Counters unwrapped and mapped onto session time, read by read, against a simulation that knows the truth."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.devices.clocks.clock_log import ClockLog
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.clocks.packet_clock import PacketClock
from kinegraph.stream.chunk import NS, Times
from tests.support.device_feed import Kept

pytestmark = pytest.mark.quick

RATE = 250.0
PERIOD = NS / RATE
START = 1_767_225_600 * NS


def at(number: Times | float) -> Times:
    """When packets were made (ns)."""
    return START + np.round(np.asarray(number) * PERIOD).astype(np.int64)


def reads(numbers: Times, arrivals: Times, bits: int = 8) -> tuple[Times, Times, Times]:
    """(number, lost, stamp) of all packets; packets with the same arrival come in one read."""
    clock = PacketClock(bits, RATE)
    taken = []
    for arrival in np.unique(arrivals):
        taken.append(clock.take((numbers[arrivals == arrival] % (1 << bits)).astype(np.uint8), int(arrival)))
    return tuple(np.concatenate([getattr(p, name) for p in taken]) for name in ("number", "lost", "stamp"))  # type: ignore[return-value]


def test_nothing_missing() -> None:
    numbers = np.arange(3000)
    number, lost, stamp = reads(numbers, at(numbers) + 3_000_000)
    assert np.array_equal(number, numbers) and not lost.any()
    assert np.abs(stamp - at(numbers) - 3_000_000).max() < 1000


@pytest.mark.parametrize("outage", [1, 255, 256, 257, 400, 1000, 5000])
@pytest.mark.parametrize("burst", [1, 40, 300])
def test_what_is_missing_is_counted_also_beyond_the_counters_range(outage: int, burst: int) -> None:
    """The read after the outage holds `burst` packets that piled up."""
    before, after = np.arange(600), np.arange(600 + outage, 600 + outage + burst)
    arrivals = np.concatenate([at(before) + 3_000_000, np.repeat(at(after[-1]) + 9_000_000, burst)])
    number, lost, _ = reads(np.concatenate([before, after]), arrivals)
    assert lost[600] == outage and not np.delete(lost, 600).any()
    assert np.array_equal(number[600:], after)


@pytest.mark.parametrize("stall_s", [0.3, 0.6, 1.2, 5.0])
def test_a_stall_after_which_everything_comes_at_once_loses_nothing(stall_s: float) -> None:
    numbers = np.arange(4000)
    arrivals = at(numbers) + 3_000_000
    held = (numbers >= 1000) & (numbers < 1000 + stall_s * RATE)
    arrivals[held] = arrivals[held].max()
    number, lost, stamp = reads(numbers, arrivals)
    assert not lost.any() and np.array_equal(number, numbers)
    assert np.abs(stamp - at(numbers) - 3_000_000).max() < 1000


def test_repeated_packets_are_left_out() -> None:
    clock = PacketClock(8, RATE)
    one = clock.take(np.array([7, 8, 8, 9], np.uint8), START)
    two = clock.take(np.array([9], np.uint8), START + 1000)
    three = clock.take(np.array([9, 10], np.uint8), START + 4_000_000)
    assert one.kept.tolist() == [True, True, False, True] and one.number.tolist() == [7, 8, 9]
    assert not two.kept.any() and not len(two.stamp)
    assert three.number.tolist() == [10] and three.lost.tolist() == [0]


def test_a_counter_that_begins_again_is_not_taken_for_loss() -> None:
    clock = PacketClock(8, RATE)
    for i in range(1100):
        before = clock.take(np.array([i % 256], np.uint8), int(at(i)) + 3_000_000)
    for i in range(1100, 1400):
        after = clock.take(np.array([(i - 1100) % 256], np.uint8), int(at(i)) + 3_000_000)
        assert after.lost[0] == (-1 if i == 1100 else 0)
        assert after.stamp[0] > before.stamp[0] and (after.number[0] - i + 1100) % 2 == 0
        before = after
    assert abs(int(after.stamp[0]) - int(at(1399)) - 3_000_000) < 8_000_000


def test_jitter_of_twenty_milliseconds_and_a_drift_of_fifty_ppm() -> None:
    rng = np.random.default_rng(1)
    numbers = np.arange(60 * 250)
    true = START + np.round(numbers * PERIOD * (1 - 50e-6)).astype(np.int64)
    delay = 3_000_000 + rng.integers(0, 20_000_000, len(numbers)) + 100_000_000 * (rng.random(len(numbers)) < 0.01)
    lost_here = rng.random(len(numbers)) < 0.02
    lost_here[0] = False
    there = numbers[~lost_here]
    number, lost, stamp = reads(there, np.maximum.accumulate(true + delay)[~lost_here])
    assert np.array_equal(number, there) and np.array_equal(lost, np.diff(there, prepend=-1) - 1)
    assert np.abs(stamp - true[there] - 3_000_000)[20 * 250 :].max() < 2_000_000


def test_the_clocks_state_is_in_the_metrics_from_the_first_second_and_in_the_log_once_a_minute(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now, rows, feed = [0.0], [], Kept()
    monkeypatch.setattr("kinegraph.devices.clocks.clock_log.time.monotonic", lambda: now[0])
    monkeypatch.setattr(
        "kinegraph.devices.clocks.clock_log.log.info", lambda *_, **facts: rows.append(facts), raising=False
    )
    states: list[ClockState | None] = [None] + [ClockState(1.5, float(n), 0.001, n) for n in (2, 9, 10, 61, 62)]
    clock_log = ClockLog("board", feed, lambda: states.pop(0))
    for now[0] in (0.5, 1.1, 2.2, 2.3, 9.0, 10.5, 61.0, 61.5, 123.0):
        clock_log.tell()
    assert [facts["drift_ppm"] for facts in rows] == [61.0, 62.0]
    assert [(facts["seconds"], facts["settling"]) for facts in feed.clocks] == [
        (2, True), (9, True), (10, False), (61, False), (62, False),
    ]  # fmt: skip
