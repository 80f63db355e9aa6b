"""A device's clock mapped onto the session's, online: no sample is moved by how late it happened to arrive.

A packet's arrival is its device time plus the clocks' offset plus a delay that is never less than some minimum. So the smallest
differences, arrival minus device time, lie on a line from below: its slope is the drift, its height the offset plus the least delay. The
line is the lower convex hull's edge over the middle of the last two minutes (Moon, Skelly, Towsley 1999; Olson 2010). Jitter, bursts and
stalls only make differences larger, and leave the line where it is. The constant least delay cannot be seen by any such mapping; it is
what `latency_s` of a source corrects.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.clocks.line_below import even_stamps, line_below
from kinegraph.devices.clocks.suspension import SLEPT_NS, Suspension
from kinegraph.stream.chunk import NS, STAMP, Times

BUCKET_NS = NS
WINDOW = 120
"""Buckets (seconds) that the line rests on."""
STEADY = 10
"""Below this many buckets the drift is taken as zero."""
MAX_DRIFT = 1e-3
"""No quartz is worse; a steeper line is an artefact of the delays, unless it is clear."""
STEEPEST, CLEAR = 0.03, 20
"""A device that is slow by more (an Arduino's resonator, a rate that is not quite the stated one) is believed up to this much, where over
the time known that makes this many times what the least delays stray about the line. One that is fast needs no belief: each second's
least delay is lower than those before.
"""
SLEW = 0.01
"""After the line has moved back, stamps still advance at this share of the device's pace until it is reached."""
JUMP_NS = 10_000_000
"""A device's clock that is ahead of what can be by more, and has leapt by more, was set forward."""
UNSURE_NS, SURE_FROM = 100_000_000, 3
"""The jump that is taken for a clock set forward until this many seconds are known: the first packets may have waited somewhere."""
ROUNDED = 2
"""If the first stamp is later than that by more than rounding (ns), all are later, as they advance faster."""


@dataclass(frozen=True, slots=True)
class ClockState:
    """What is known of a device's clock.

    offset_s         session time minus device time, now, with the least delay in it (s)
    drift_ppm        how much faster session time runs
    uncertainty_s    spread of the seconds' least delays about the line: how far the mapping may be off beside the constant part; in the
                     first seconds with what a drift that is not known yet may make
    seconds          how many seconds it rests on
    jumps            how often the device's clock was set, or started again
    jump_s           by how much the last time; below 0: back
    """

    offset_s: float
    drift_ppm: float
    uncertainty_s: float
    seconds: int
    jumps: int = 0
    jump_s: float = 0.0

    @property
    def settling(self) -> bool:
        """Whether the drift is not known yet."""
        return self.seconds < STEADY


class DeviceClock:
    """Maps device time to session time; O(1) per packet, at most 120 points a second for the line."""

    def __init__(self, latency_s: float = 0.0) -> None:
        """`latency_s`: the constant part of the delay, from the event to its arrival at best, measured by the user."""
        self._latency = round(latency_s * NS)
        self._last: tuple[int, int] | None = None
        """Device time and stamp of the last packet; after a restart the device's time is the next packet's."""
        self._restarted = False
        self._arrival = 0
        self._jumps = self._jump = 0
        self._suspension = Suspension()
        self._memory = np.empty(WINDOW, STAMP), np.empty(WINDOW), np.empty(3)
        """The kernel's: hull, distances, line."""
        self._forget()

    def _forget(self) -> None:
        self._x = np.zeros(WINDOW, STAMP)
        """Device time of each second's smallest difference, oldest first, of `_n` seconds."""
        self._y = np.zeros(WINDOW, STAMP)
        """The smallest difference of each second, arrival minus device time (ns)."""
        self._n = 0
        self._least = 0
        """That of the last second."""
        self._bucket: int | None = None
        self._slope = 0.0
        self._zero = 0
        """The line's height is counted from it, as it must not be rounded: the differences may be as long as the time since 1970."""
        self._height = 0.0
        self._at = 0
        self._spread = 0.0

    def see(self, device_ns: int, arrival_ns: int) -> None:
        """A packet with this (unwrapped) device time has arrived now."""
        silent = arrival_ns - self._arrival > SLEPT_NS
        if (silent or self._suspension.woke) and self._n and self.is_waking(arrival_ns):
            later = arrival_ns - device_ns - self._zero - round(self._above(device_ns))
            if stood_ns := self._suspension.see(later, arrival_ns):
                self.restart(-stood_ns)
        self._arrival = arrival_ns
        difference = arrival_ns - device_ns
        bucket = device_ns // BUCKET_NS
        if self._bucket is None or bucket > self._bucket:
            self._bucket = bucket
            # moving 120 numbers once a second costs less than a ring that the hull would have to unroll each time
            if self._n == WINDOW:
                self._x[:-1], self._y[:-1] = self._x[1:], self._y[1:]
                self._n -= 1
            self._n += 1
            self._lowest(device_ns, difference)
            self._fit()
        # a packet of an older second came late: its difference is large, and cannot lower the line
        elif bucket == self._bucket:
            # only what is below the line, or the lowest of its second, can change the hull: most packets are neither
            below = difference - self._zero < self._above(device_ns)
            if below or difference < self._least:
                self._lowest(device_ns, difference)
            if below:
                self._fit()

    def is_waking(self, arrival_ns: int) -> bool:
        """Whether the machine was suspended just before a packet that arrives now, so that the device's clock may have stood still."""
        return self._suspension.is_waking(arrival_ns - self._arrival)

    def take_gap(self) -> bool:
        """Whether to mark a gap before the last packet, since its device's clock stood still for an unknown time; once."""
        return self._suspension.take_gap()

    def _lowest(self, device_ns: int, difference: int) -> None:
        """The smallest difference of the last second so far."""
        self._x[self._n - 1], self._y[self._n - 1], self._least = device_ns, difference, difference

    def even_stamps(self, last_ns: int, step_ns: float, n: int) -> tuple[Times, Times]:
        """Device times (n,) of records so far apart, the last of which was made at `last_ns`, and what `stamps` gives for them."""
        device, stamp = np.empty(n, STAMP), np.empty(n, STAMP)
        even_stamps(last_ns, step_ns, self._at, self._slope, self._height, self._zero - self._latency, device, stamp)
        if self._last is not None:
            before, given = self._before(int(device[0]))
            if int(stamp[0]) <= given + max(int(SLEW * (int(device[0]) - before)), 1) + ROUNDED:
                return device, self.stamps(device)
        self._last = last_ns, int(stamp[-1])
        return device, stamp

    def stamps(self, device_ns: Times) -> Times:
        """Session times (n,) ns of device times (n,) ns, which do not run backwards.

        Never before one that was given; and what is raised for that stays before the arrival of the packet seen last.
        """
        if not len(device_ns):
            return device_ns
        offset = (device_ns - self._at) * self._slope
        offset += self._height
        mapped: Times = device_ns + np.rint(offset, out=offset).astype(STAMP)
        mapped += self._zero - self._latency
        if self._last is not None:
            device, stamp = self._before(int(device_ns[0]))
            if int(mapped[0]) <= stamp + max(int(SLEW * (int(device_ns[0]) - device)), 1) + ROUNDED:
                # the line has moved back: stamps creep on until the device's own time is ahead of them again
                raised = stamp + np.maximum((SLEW * (device_ns - device)).astype(STAMP), 1)
                order = np.arange(1, len(raised) + 1)
                # what creeps on must not overtake the arrival, else a wrong line would feed on itself; 1 ns apart where it would
                np.minimum(raised, self._arrival - len(raised) + order, out=raised)
                np.maximum(raised, stamp + order, out=raised)
                mapped = np.maximum(mapped, raised)
        self._last = int(device_ns[-1]), int(mapped[-1])
        return mapped

    def map(self, device_ns: Times, kept: NDArray[np.bool_], arrival_ns: int, stamps: Times) -> None:
        """Packets with these device times (n,) have arrived now; fills `stamps` (n,) of those that are `kept` (n,).

        One that claims to be later than the last of them is wrong by a little, and taken to be as late as that.
        """
        made = device_ns[kept]
        if len(made):
            self.see(int(made[-1]), arrival_ns)
            stamps[kept] = self.stamps(np.minimum(made, made[-1]))

    def stamp(self, device_ns: int) -> int:
        """The session time of one device time: bit for bit what `stamps` gives, in a tenth of its time."""
        mapped = device_ns + round(self._height + self._slope * (device_ns - self._at)) + self._zero - self._latency
        if self._last is not None:
            device, stamp = self._before(device_ns)
            raised = stamp + max(int(SLEW * (device_ns - device)), 1)
            if mapped < raised:
                mapped = max(mapped, min(raised, self._arrival), stamp + 1)
        self._last = device_ns, mapped
        return mapped

    def _before(self, device_ns: int) -> tuple[int, int]:
        """Device time and stamp of the packet before the one with this device time."""
        assert self._last is not None
        if self._restarted:
            self._restarted, self._last = False, (device_ns, self._last[1])
        return self._last

    def restart(self, jump_ns: int | None = None) -> None:
        """The device's own time started again: everything known of it is forgotten, but stamps still never run backwards.

        `jump_ns`: by how much it leapt; None: only its packets are counted otherwise from here on.
        """
        self._forget()
        self._restarted = True
        if jump_ns is not None:
            self._jumps, self._jump = self._jumps + 1, jump_ns

    def is_ahead(self, device_ns: int, arrival_ns: int) -> bool:
        """Whether a packet claims to have been made so long after its arrival that the device's clock must have been set forward."""
        if not self._n:
            return False
        # the first packets may have waited in a driver's buffer, so that everything after them seems early
        least = JUMP_NS if self._n >= SURE_FROM else UNSURE_NS
        return device_ns - arrival_ns + self._zero + self._above(device_ns) > least

    @property
    def offset_ns(self) -> float | None:
        """Session time minus device time now, with the least delay in it; None where nothing is known yet."""
        return self._line(int(self._x[self._n - 1])) if self._n else None

    @property
    def state(self) -> ClockState:
        now = int(self._x[self._n - 1]) if self._n else 0
        spread = self._spread
        if 0 < self._n < STEADY:
            spread = max(spread, self._falls_behind()) + MAX_DRIFT * (now - int(self._x[0]) + BUCKET_NS)
        return ClockState(
            offset_s=self._line(now) / NS,
            drift_ppm=self._slope * 1e6,
            uncertainty_s=spread / NS,
            seconds=self._n,
            jumps=self._jumps,
            jump_s=self._jump / NS,
        )

    def _falls_behind(self) -> float:
        """While no drift is taken: by how much (ns) stamps of a device that is slower than it says may be early at the end of this second.

        The line rests on its lowest second; what came since came later by as much as the device has fallen behind, or as it was held up.
        """
        at = int(self._y[: self._n].argmin())
        seconds = self._n - 1 - at
        return max(0.0, float(self._y[at : self._n].max() - self._y[at])) * (seconds + 2) / max(seconds, 1)

    def _line(self, device_ns: int) -> float:
        return self._zero + self._above(device_ns)

    def _above(self, device_ns: int) -> float:
        """How far the line is above `_zero`."""
        return self._height + self._slope * (device_ns - self._at)

    def _fit(self) -> None:
        """The lower hull's edge over the middle of what is known."""
        x, y = self._x, self._y
        at = line_below(x, y, self._n, STEADY, MAX_DRIFT, STEEPEST, float(CLEAR), *self._memory)
        self._zero, self._at = int(y[0]), int(x[at])
        self._slope, self._height, self._spread = self._memory[2].tolist()


FORGOTTEN = 0.02
"""The share of a rate by which a device may be slower than it says without seeming to come ever later."""


class Counter:
    """A packet counter of a few bits, unwrapped: what is missing is counted, also over an outage longer than the counter's range.

    A number that runs ahead of time, such as one with a changed digit, is left out, unless the next one goes on from it.
    """

    def __init__(self, bits: int, rate_hz: float, turn: int = 0) -> None:
        """`rate_hz`: packets per second, by which the number of whole turns in an outage is chosen; `turn`: after how many it starts
        again, where that is no power of two."""
        self._range, self.rate_hz = turn or 1 << bits, rate_hz
        self._last: int | None = None
        self._former: tuple[int, int] | None = None
        """Counter and running number of the one before the last."""
        self._doubtful: int | None = None
        self._arrival = self._highest = 0
        self._late = self._least = 0.0
        """By how many packets the last one came later than the first, and the least that it has been."""
        self.value = 0
        """The running number of the last packet."""
        self.restarted = False
        """Whether the device restarted its counter with the last packet: the number of missing ones is unknown."""

    def lost_before(self, counter: int, arrival_ns: int) -> int:
        """How many packets are missing just before this one; -1: it was there already (a repetition), or its number cannot be right."""
        self.restarted = False
        if self._last is None:
            self._last, self._arrival = counter, arrival_ns
            return 0
        step = (counter - self._last) % self._range
        elapsed = (arrival_ns - self._arrival) / NS * self.rate_hz
        if step == 0 and elapsed < self._range / 2:
            return -1
        advance: int | None = step + max(0, round((elapsed - step) / self._range)) * self._range
        if advance is not None and advance > self._late + elapsed - self._least + self._slack:
            advance = self._otherwise(counter)
        if advance is None:
            return -1
        self._former, self._doubtful = (self._last, self.value), None
        self._last, self._arrival = counter, arrival_ns
        self.value += advance
        self._late += elapsed - advance
        self._least = min(self._least + FORGOTTEN * max(0, advance), self._late)
        missing = self.value - self._highest - 1
        self._highest = max(self._highest, self.value)
        return max(missing, -1)

    @property
    def _slack(self) -> float:
        """By how many packets a number may be ahead of its time."""
        return 8 + 0.1 * self.rate_hz

    def _otherwise(self, counter: int) -> int | None:
        """The advance of a number that is ahead of its time; None where it is left out."""
        if self._former and (counter - self._former[0]) % self._range == 2:
            return self._former[1] + 2 - self.value  # it was the last one's number that was wrong
        if self._doubtful is None or not 0 < (counter - self._doubtful) % self._range <= self._slack:
            self._doubtful = counter
            return None
        assert self._last is not None
        back = (self._last - counter) % self._range
        self.restarted = back > self._slack
        return 1 if self.restarted else -back
