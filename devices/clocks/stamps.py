"""Stamps and losses of what a device sends, by the best that it tells: its own time, else a counter, else only when it arrived."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import inf

import numpy as np

from devices.clocks.device_clock import ClockState, Counter, DeviceClock
from devices.clocks.device_time import DeviceTime
from devices.clocks.packet_clock import PacketClock, Packets
from stream.chunk import NS, Array, Chunk, Times
from stream.source import Feed

REPEATED = -2
GAP_PERIODS = 1.75
"""Without a counter, a longer step of the device's time means that something is missing."""


class Stamps:
    """For records that come some at a time.

    rate_hz        how many a second, where that is known; needed where a counter is the only clock
    counter_bits   of the counter in each record; 0: there is none
    has_time       whether each record brings the device's time
    wraps_ns       where that starts again; 0: never
    """

    def __init__(
        self,
        rate_hz: float | None,
        *,
        counter_bits: int = 0,
        has_time: bool = False,
        wraps_ns: int = 0,
        latency_s: float = 0.0,
    ) -> None:
        self._rate, self._has_time = rate_hz, has_time
        self._latency = round(latency_s * NS)
        self._clock = DeviceClock(latency_s)
        self._time = DeviceTime(self._clock, wraps_ns)
        self._losses = Losses(rate_hz, counter_bits)
        self._packets = PacketClock(counter_bits, rate_hz or 1.0, latency_s) if counter_bits and not has_time else None
        self._last: int | None = None

    @property
    def state(self) -> ClockState | None:
        """What is known of the device's clock; None where it has none."""
        if self._packets:
            return self._packets.state
        return self._clock.state if self._has_time else None

    def follow(self, rate_hz: float) -> None:
        """From here on there are so many records a second."""
        self._rate = rate_hz
        self._losses.follow(rate_hz)
        if self._packets:
            self._packets.follow(rate_hz)

    def take(
        self,
        n: int,
        arrival_ns: int,
        device_ns: Times | None = None,
        counter: Array | None = None,
        again: Array | None = None,
    ) -> Packets:
        """`n` > 0 records have arrived now; with them the device's time (n,) and counters (n,), where there are such.

        again  (n,) whether each holds the same as the one before it, where that is known
        """
        if device_ns is not None:
            return self._by_time(device_ns, counter, arrival_ns, np.zeros(n, bool) if again is None else again)
        if self._packets and counter is not None:
            return self._packets.take(counter, arrival_ns)
        return self._by_arrival(n, arrival_ns)

    def _by_time(self, raw_ns: Times, counter: Array | None, arrival_ns: int, again: Array) -> Packets:
        kept = np.zeros(len(raw_ns), bool)
        number, lost, device, stamp = (np.full(len(raw_ns), -1, np.int64) for _ in range(4))
        mapped = 0
        for i in range(len(raw_ns)):
            value = self._time.read(int(raw_ns[i]), arrival_ns)
            if value is None:
                continue
            if self._time.restarted:
                self._clock.map(device[mapped:i], kept[mapped:i], arrival_ns, stamp[mapped:i])
                self._clock.restart(self._time.jump_ns)
                mapped = i
            here = None if counter is None else int(counter[i])
            lost[i] = self._losses.before(value, here, arrival_ns, self._time.restarted, again=bool(again[i]))
            kept[i], number[i], device[i] = lost[i] > REPEATED, self._losses.number, value
        self._clock.map(device[mapped:], kept[mapped:], arrival_ns, stamp[mapped:])
        return Packets(kept, number[kept], lost[kept], device[kept], stamp[kept])

    def _by_arrival(self, n: int, arrival_ns: int) -> Packets:
        """Evenly back from the arrival, at the nominal rate, but not before what came last."""
        period = NS / self._rate if self._rate else 0.0
        span = period * (n - 1)
        if self._last is not None:
            span = max(0.0, min(span, (arrival_ns - self._latency - self._last) * (n - 1) / n))
        back = np.round(span * np.arange(n - 1, -1, -1) / max(1, n - 1)).astype(np.int64)
        stamp = arrival_ns - self._latency - back
        if self._last is not None:
            stamp = np.maximum(stamp, self._last)
        self._last = int(stamp[-1])
        none = np.full(n, -1, np.int64)
        return Packets(np.ones(n, bool), none, np.zeros(n, np.int64), none, stamp)


class Losses:
    """What is missing between records that bring the device's time, by their counter, else by the steps of that time."""

    def __init__(self, rate_hz: float | None, counter_bits: int = 0) -> None:
        self._rate = rate_hz
        self._counter = Counter(counter_bits, rate_hz or 0.0) if counter_bits else None
        self._device: int | None = None
        self._finest = inf
        """The shortest step of the device's time so far, in periods."""
        self._beside = 0
        """How many records had the same time as the one before them: the device's time is too coarse for them."""

    def follow(self, rate_hz: float) -> None:
        """From here on there are so many records a second."""
        self._rate = rate_hz
        if self._counter:
            self._counter.rate_hz = rate_hz

    @property
    def number(self) -> int:
        """The running number of the last record; -1 where there is no counter."""
        return self._counter.value if self._counter else -1

    def before(
        self, device_ns: int, counter: int | None, arrival_ns: int, restarted: bool = False, *, again: bool = False
    ) -> int:
        """How many are missing just before this one; -1: nobody knows; REPEATED: it was there already.

        again  it holds the same as the one before it. With the same time that is a repetition, but where the device's time is too coarse
               to tell two records apart
        """
        last, self._device = self._device, device_ns
        missing = self._counter.lost_before(counter, arrival_ns) if self._counter and counter is not None else None
        if restarted:
            return -1
        if missing is not None:
            if missing >= 0 and self._counter and self._counter.restarted:
                return -1
            return REPEATED if missing < 0 else missing
        if last is None or not self._rate:
            return 0
        periods = (device_ns - last) / NS * self._rate
        if periods > 0:
            self._finest, beside, self._beside = min(self._finest, periods), self._beside, 0
            return max(0, round(periods) - 1 - beside) if periods > GAP_PERIODS else 0
        if again and self._finest < GAP_PERIODS:
            return REPEATED
        self._beside += 1
        return 0


def chunks(stamp: Times, lost: Times, data: Array) -> Iterator[Chunk]:
    """Records (n, ...) with their stamps and what is lost before each (n,): a chunk for those that follow each other without a gap."""
    cuts = np.flatnonzero(lost)
    for a, b in pairwise([0, *(int(c) for c in cuts if c > 0), len(lost)]):
        if b > a:
            yield Chunk(stamp[a:b], data[a:b], int(stamp[b - 1]), int(lost[a]))


def tell_losses(packets: Packets, feed: Feed, missing: str, restart: str) -> int:
    """Count the records that are missing, and restarts, as problems of these names; returns how many are missing."""
    if packets.clean or not packets.lost.any():
        return 0
    count = int(packets.lost.clip(0).sum())
    if count:
        feed.problem(missing, count)
    if (packets.lost < 0).any():
        feed.problem(restart)
    return count


def tell_problems(feed: Feed, **counts: int) -> None:
    """Count problems (bad_checksum=3); those that did not happen are left out."""
    for kind, count in counts.items():
        if count:
            feed.problem(kind.replace("_", " "), count)
