"""The machine was suspended, and the device's clock went on or stood still: no stamp stays wrong, and the gap is marked."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from kinegraph.devices.clocks import suspension
from kinegraph.devices.clocks.packet_clock import PacketClock, Packets
from kinegraph.devices.clocks.short_counter import ShortCounter
from kinegraph.devices.clocks.stamps import Stamps
from kinegraph.devices.clocks.tick_clock import TickClock
from kinegraph.stream.chunk import NS

RATE = 200.0
AT_S, SLEPT_S = 15.0, 60.0
BEGAN = 1_767_225_600 * NS


def _first(packets: Packets) -> tuple[int, int] | None:
    """None: the packet was left out."""
    return (int(packets.stamp[0]), int(packets.lost[0])) if len(packets.stamp) else None


def clocks() -> dict[str, Callable[[int, int], tuple[int, int] | None]]:
    """By name: a packet of running number i, made at i / RATE of the device's time, arrives: its stamp, and what is lost before it."""
    time, both = Stamps(RATE, has_time=True), Stamps(RATE, counter_bits=16, has_time=True)
    wide, narrow, short = PacketClock(16, RATE), PacketClock(8, RATE), ShortCounter(4, RATE)
    ticks = TickClock(counter_bits=16, tick_bits=32, tick_ns=100_000.0, rate_hz=RATE)

    def at(i: int) -> int:
        return round(i * NS / RATE)

    return {
        "time": lambda i, now: _first(time.take(1, now, np.array([at(i)]))),
        "time and counter": lambda i, now: _first(both.take(1, now, np.array([at(i)]), np.array([i % 65_536]))),
        "counter of 16 bits": lambda i, now: _first(wide.take(np.array([i % 65_536]), now)),
        "counter of 8 bits": lambda i, now: _first(narrow.take(np.array([i % 256]), now)),
        "counter of 4 bits": lambda i, now: _first(short.take(np.array([i % 16]), now)),
        "ticks": lambda i, now: _first(ticks.take(np.array([i % 65_536]), np.array([at(i) // 100_000]), now)),
    }


def played(name: str, monkeypatch: pytest.MonkeyPatch, *, goes_on: bool) -> tuple[np.ndarray, ...]:
    """Seconds of truth of each packet since the machine woke, how wrong its stamp is (s), what is lost.

    Five that were made just before come after the machine woke.
    """
    slept_ns = 0
    monkeypatch.setattr(suspension, "suspended_ns", lambda: slept_ns)
    take, random = clocks()[name], np.random.default_rng(4)
    before, rows = round(AT_S * RATE), []
    for i in range(before + round(5 * RATE)):
        awake = i >= before - 5
        slept_ns = round(SLEPT_S * NS) if awake else 0
        number = i + (round(SLEPT_S * RATE) if goes_on and i >= before else 0)
        true_s = i / RATE + (SLEPT_S if i >= before else 0.0)
        come_s = max(true_s, AT_S + SLEPT_S if awake else 0.0) + 0.002 * random.random()
        if came := take(number, BEGAN + round(come_s * NS)):
            stamp, lost = came
            rows.append((true_s - AT_S - SLEPT_S, (stamp - BEGAN) / NS - true_s, lost))
    since, error, lost = np.array(rows).T
    return since, np.abs(error), lost


def between_marks(wrong: np.ndarray, lost: np.ndarray) -> bool:
    """Whether what is wrong has a mark before it, and one right after it."""
    at, marks = np.flatnonzero(wrong), np.flatnonzero(lost)
    return not len(at) or bool(marks[0] <= at[0] and at[-1] < marks[-1])


@pytest.mark.parametrize("goes_on", [False, True])
@pytest.mark.parametrize("name", clocks())
def test_stamps_are_right_a_third_of_a_second_after_the_machine_woke(
    name: str, goes_on: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    since, error, lost = played(name, monkeypatch, goes_on=goes_on)
    assert error[since < -SLEPT_S - 1].max() < 0.010 and error[since > 0.36].max() < 0.010
    assert between_marks((error > 0.010) & (since >= 0), lost)
    assert lost.any() and not lost[(since < -SLEPT_S - 1) | (since > 0.36)].any()


def test_a_computer_that_was_only_busy_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same silence, with nothing suspended: what was made meanwhile comes all at once."""
    monkeypatch.setattr(suspension, "suspended_ns", lambda: 0)
    clock = Stamps(RATE, has_time=True)
    for i in range(4000):
        made_s = i / RATE
        come_s = 12.0 if 10.0 <= made_s < 12.0 else made_s
        stamp, lost = _first(clock.take(1, BEGAN + round((come_s + 0.002) * NS), np.array([round(made_s * NS)]))) or (
            0,
            0,
        )
        assert abs((stamp - BEGAN) / NS - made_s) < 0.010 and not lost
