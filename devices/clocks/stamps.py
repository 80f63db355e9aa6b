"""Stamps and losses of what a device sends, by the best that it tells: its own time, else a counter, else only when it arrived."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from math import inf

import numpy as np

from kinegraph.devices.clocks.device_clock import ClockState, Counter, DeviceClock
from kinegraph.devices.clocks.device_time import DeviceTime
from kinegraph.devices.clocks.packet_clock import NOTHING, ONE, PacketClock, Packets, Stamped
from kinegraph.stream.chunk import NS, Array, Chunk, Times
from kinegraph.stream.source import Feed

REPEATED = -2
GAP_PERIODS = 1.75
"""Without a counter, a longer step of the device's time means that something is missing."""

TICK = 0.03
"""By this much the number of records between two ticks of a coarse time may be off, beside one."""


class Stamps:
    """For records that come some at a time.

    rate_hz        how many a second, where that is known; needed where a counter is the only clock
    counter_bits   of the counter in each record; 0: no counter
    counter_turn   after how many records it starts again, where that is no power of two
    has_time       whether each record brings the device's time
    wraps_ns       where that starts again; 0: never
    """

    def __init__(
        self,
        rate_hz: float | None,
        *,
        counter_bits: int = 0,
        counter_turn: int = 0,
        has_time: bool = False,
        wraps_ns: int = 0,
        latency_s: float = 0.0,
    ) -> None:
        self._rate, self._has_time = rate_hz, has_time
        self._latency = round(latency_s * NS)
        self._clock = DeviceClock(latency_s)
        self._time = DeviceTime(self._clock, wraps_ns)
        self._losses = Losses(rate_hz, counter_bits, counter_turn)
        # with a time of its own a counter only tells what is missing; without one it is the clock
        alone = counter_bits and not has_time
        self._packets = PacketClock(counter_bits, rate_hz or 1.0, latency_s, counter_turn) if alone else None
        self._last: int | None = None

    @property
    def state(self) -> ClockState | None:
        """What is known of the device's clock, or None."""
        if self._packets:
            return self._packets.state
        if not self._has_time:
            return None
        state, coarse_ns = self._clock.state, 0 if self._rate else self._time.coarse_ns
        return replace(state, uncertainty_s=state.uncertainty_s + coarse_ns / NS) if coarse_ns else state

    def follow(self, rate_hz: float) -> None:
        """From here on the record rate is another."""
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
            if n == 1:
                return self._one(device_ns, counter, arrival_ns, again is not None and bool(again[0]))
            if counter is None and again is None and (even := self._evenly(device_ns, arrival_ns)):
                return even
            return self._by_time(device_ns, counter, arrival_ns, np.zeros(n, bool) if again is None else again)
        if self._packets and counter is not None:
            return self._packets.take(counter, arrival_ns)
        return self._by_arrival(n, arrival_ns)

    def go_on(self, last_ns: int, n: int, arrival_ns: int) -> tuple[Times, Times] | None:
        """Device time and stamp (n,) of n > 0 records that have arrived now and lie evenly between the last one before and `last_ns`.

        None, with nothing changed, where they do not follow it without a gap; `take` is for those.
        """
        if (
            self._clock.is_waking(arrival_ns)
            or not self._losses.go_on_by(last_ns - self._time.value, n)
            or (step := self._time.go_on(last_ns, n, arrival_ns)) is None
        ):
            return None
        value = self._time.value
        self._losses.gone_on(value, step)
        self._clock.see(value, arrival_ns)
        return self._clock.even_stamps(value, step, n)

    def _by_time(self, raw_ns: Times, counter: Array | None, arrival_ns: int, again: Array) -> Packets:
        kept = np.zeros(len(raw_ns), bool)
        number, lost, device, stamp = (np.full(len(raw_ns), -1, np.int64) for _ in range(4))
        mapped = 0
        for i in range(len(raw_ns)):
            value = self._time.read(int(raw_ns[i]), arrival_ns, again=bool(again[i]))
            if value is None:
                continue
            if self._time.restarted:
                # what came before the restart in this read still belongs to the old clock
                self._clock.map(device[mapped:i], kept[mapped:i], arrival_ns, stamp[mapped:i])
                self._clock.restart(self._time.jump_ns)
                mapped = i
            here = None if counter is None else int(counter[i])
            lost[i] = self._losses.before(value, here, arrival_ns, self._time.restarted, again=bool(again[i]))
            kept[i], number[i] = lost[i] > REPEATED, self._losses.number
            device[i] = value + self._losses.within_ns
        self._clock.map(device[mapped:], kept[mapped:], arrival_ns, stamp[mapped:])
        missing = lost[kept]
        self._mark(missing)
        return Packets(kept, number[kept], missing, device[kept], stamp[kept])

    def take_one(self, device_ns: int, counter: int | None, arrival_ns: int, *, again: bool = False) -> Stamped | None:
        """What `take` gives for one record, as most reads bring it, without arrays on the way; None where it is left out."""
        value = self._time.read(device_ns, arrival_ns, again=again)
        if value is None:
            return None
        if self._time.restarted:
            self._clock.restart(self._time.jump_ns)
        lost = self._losses.before(value, counter, arrival_ns, self._time.restarted, again=again)
        if lost <= REPEATED:
            return None
        value += self._losses.within_ns
        self._clock.see(value, arrival_ns)
        lost = lost or -int(self._clock.take_gap())
        return Stamped(self._losses.number, lost, value, self._clock.stamp(value))

    def one(self, arrival_ns: int, device_ns: int | None = None, counter: int | None = None) -> Stamped | None:
        """What `take` gives for one record of any clock, without arrays; None where it is left out."""
        if device_ns is not None:
            return self.take_one(device_ns, counter, arrival_ns)
        if self._packets and counter is not None:
            return self._packets.one(counter, arrival_ns)
        stamp = arrival_ns - self._latency
        self._last = stamp if self._last is None else max(stamp, self._last)
        return Stamped(-1, 0, -1, self._last)

    def _one(self, raw_ns: Times, counter: Array | None, arrival_ns: int, again: bool) -> Packets:
        here = None if counter is None else int(counter[0])
        made = self.take_one(int(raw_ns[0]), here, arrival_ns, again=again)
        if made is None:
            return NOTHING
        row = np.array(made)
        return Packets(ONE, row[0:1], row[1:2], row[2:3], row[3:4])

    def _evenly(self, raw_ns: Times, arrival_ns: int) -> Packets | None:
        """The same as `_by_time` for records of one packet that follow each other without a gap; None where they do not."""
        device = self._time.read_even(raw_ns, arrival_ns) if self._losses.follow_each_other(raw_ns) else None
        if device is None:
            return None
        lost = self._losses.before_even(device, arrival_ns)
        self._clock.see(int(device[-1]), arrival_ns)
        self._mark(lost)
        stamp = self._clock.stamps(device)
        return Packets(np.ones(len(device), bool), np.full(len(device), -1, np.int64), lost, device, stamp)

    def _mark(self, lost: Times) -> None:
        """Mark a gap before the first of the records (n,) that were seen last, if one is due."""
        if len(lost) and self._clock.take_gap():
            lost[0] = lost[0] or -1

    def _by_arrival(self, n: int, arrival_ns: int) -> Packets:
        """Evenly back from the arrival, at the nominal rate, but not before what came last."""
        period = NS / self._rate if self._rate else 0.0
        span = period * (n - 1)
        if self._last is not None:
            # reads that come close together hold fewer new samples than the rate says: squeezed, not put before the last
            span = max(0.0, min(span, (arrival_ns - self._latency - self._last) * (n - 1) / n))
        back = np.round(span * np.arange(n - 1, -1, -1) / max(1, n - 1)).astype(np.int64)
        stamp = arrival_ns - self._latency - back
        if self._last is not None:
            stamp = np.maximum(stamp, self._last)
        self._last = int(stamp[-1])
        nothing = np.full(n, -1, np.int64)
        return Packets(np.ones(n, bool), nothing, np.zeros(n, np.int64), nothing, stamp)


class Losses:
    """What is missing between records that bring the device's time, by their counter, else by the steps of that time."""

    def __init__(self, rate_hz: float | None, counter_bits: int = 0, counter_turn: int = 0) -> None:
        self._rate = rate_hz
        self._counter = Counter(counter_bits, rate_hz or 0.0, counter_turn) if counter_bits else None
        self._device: int | None = None
        self._finest = inf
        """The shortest step of the device's time so far, in periods."""
        self._beside = 0
        """How many records had the same time as the one before them: the device's time is too coarse for them."""
        self._known = False
        """Whether all records with the present time have come here."""

    def follow(self, rate_hz: float) -> None:
        """From here on the record rate is another."""
        self._rate = rate_hz
        if self._counter:
            self._counter.rate_hz = rate_hz

    @property
    def number(self) -> int:
        """The running number of the last record; -1 where there is no counter."""
        return self._counter.value if self._counter else -1

    def follow_each_other(self, raw_ns: Times) -> bool:
        """Whether nothing is missing, or there twice, between these n > 1 records (n,) by their time."""
        if self._counter or not self._rate:
            return False
        steps = np.diff(raw_ns)
        return bool(steps.min() > 0 and steps.max() / NS * self._rate <= GAP_PERIODS)

    def go_on_by(self, whole_ns: int, n: int) -> bool:
        """Whether nothing is missing among n > 0 records that lie evenly between the last one and one `whole_ns` later."""
        if self._counter or not self._rate or self._device is None or self._beside:
            return False
        return 0 < whole_ns / NS * self._rate <= GAP_PERIODS * n

    def gone_on(self, device_ns: int, step_ns: float) -> None:
        """They have come; the last one was made at `device_ns`."""
        self._finest = min(self._finest, step_ns / NS * (self._rate or 0.0))
        self._device, self._known = device_ns, True

    def before_even(self, device_ns: Times, arrival_ns: int) -> Times:
        """What `before` gives for each of n > 1 records (n,) that follow each other: only before the first may some be missing."""
        assert self._rate
        lost = np.zeros(len(device_ns), np.int64)
        lost[0] = self.before(int(device_ns[0]), None, arrival_ns)
        self._finest = min(self._finest, int(np.diff(device_ns).min()) / NS * self._rate)
        self._device, self._beside, self._known = int(device_ns[-1]), 0, True
        return lost

    def before(
        self, device_ns: int, counter: int | None, arrival_ns: int, restarted: bool = False, *, again: bool = False
    ) -> int:
        """How many are missing just before this one; -1: unknown; REPEATED: it was there already.

        again  it holds the same as the one before it. With the same time that is a repetition, but where the device's time is too coarse
               to tell two records apart
        """
        last, self._device = self._device, device_ns
        missing = self._counter.lost_before(counter, arrival_ns) if self._counter and counter is not None else None
        periods = (device_ns - last) / NS * self._rate if last is not None and self._rate else 0.0
        beside = 0 if last is None else self._place(periods, missing or 0, restarted)
        if restarted:
            return -1
        if missing is not None:
            if missing >= 0 and self._counter and self._counter.restarted:
                return -1
            return REPEATED if missing < 0 else missing
        if last is None or not self._rate:
            return 0
        if periods > 0:
            gap = round(periods) - 1 - beside
            return gap if beside >= 0 and periods > GAP_PERIODS and gap > (beside and 1 + TICK * periods) else 0
        # a repetition only where the device's time is fine enough to tell two records apart
        if again and self._finest < GAP_PERIODS:
            self._beside -= 1
            return REPEATED
        return 0

    def _place(self, periods: float, missing: int, restarted: bool) -> int:
        """Index of the record among those with the same time; returns how many had the one before, -1: unknown.

        The first time of all may be that of records which came before anybody listened.
        """
        beside = self._beside
        if periods > 0 or restarted:
            known, self._beside, self._known = self._known or not beside, 0, True
            if periods > 0 and not restarted:
                self._finest = min(self._finest, periods) if known else self._finest
            return beside if known else -1
        self._beside += 1 + max(0, missing)
        return beside

    @property
    def within_ns(self) -> int:
        """How long after its time the last record was made, where that is too coarse to tell it from those before it: as many periods as
        have the same time, as long as the next one has not come."""
        if not self._beside or not self._rate or not 1 < self._finest < inf:
            return 0
        return int(min(self._beside, self._finest - 1) * NS / self._rate)


def chunks(stamp: Times, lost: Times, data: Array) -> Iterator[Chunk]:
    """Records (n, ...) with their stamps and what is lost before each (n,): a chunk for those that follow each other without a gap."""
    if len(lost) == 1:
        yield Chunk(stamp, data, int(stamp[0]), int(lost[0]))
        return
    cuts = np.flatnonzero(lost)
    for a, b in pairwise([0, *(int(c) for c in cuts if c > 0), len(lost)]):
        if b > a:
            yield Chunk(stamp[a:b], data[a:b], int(stamp[b - 1]), int(lost[a]))


def report_losses(packets: Packets, feed: Feed, missing: str, restart: str) -> int:
    """Count the records that are missing, and restarts, as problems of these names; returns how many are missing."""
    if packets.clean or not packets.lost.any():
        return 0
    count = int(packets.lost.clip(0).sum())
    if count:
        feed.problem(missing, count)
    if (packets.lost < 0).any():
        feed.problem(restart)
    return count


def report_problems(feed: Feed, **counts: int) -> None:
    """Count problems (bad_checksum=3); those that did not happen are left out."""
    for kind, count in counts.items():
        if count:
            feed.problem(kind.replace("_", " "), count)
