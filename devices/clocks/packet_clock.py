"""Packets with a small counter and no time of their own: which are missing, and when each was made."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.clocks.device_clock import ClockState, DeviceClock
from kinegraph.stream.chunk import NS, Array, Times

Flags = NDArray[np.bool_]

EARLY_NS = 50_000_000
"""A packet that claims to be made this much later than it arrived does not count on from those before it."""


class Packets(msgspec.Struct, eq=False, gc=False):
    """The packets of one read. Repeated ones are left out: `kept` (n,) says of all which stand here, the rest has (m,) entries.

    number    running number of each packet; the first one ever has its own counter's, and odd ones stay odd
    lost      how many are missing just before each; -1: the counter has started again, and nobody knows
    device    the device's time by that number (ns)
    stamp     session time (ns), increasing
    """

    kept: Flags
    number: Times
    lost: Times
    device: Times
    stamp: Times
    clean: bool = False
    """Known to be without a gap and a repetition."""

    @property
    def missing(self) -> int:
        """How many are known to be missing, all together."""
        lost = self.lost
        return max(int(lost[0]), 0) if len(lost) == 1 else int(np.maximum(lost, 0).sum())


_NONE = np.empty(0, np.int64)
NOTHING = Packets(np.zeros(1, bool), _NONE, _NONE, _NONE, _NONE)
"""Of one record that is left out."""
ONE = np.ones(1, bool)
"""Of one record that is kept."""


class Stamped(NamedTuple):
    """One record: as `Packets` has it of several."""

    number: int
    lost: int
    device: int
    stamp: int


class PacketClock:
    """Unwraps the counter of a device that sends `rate_hz` packets a second, and maps it onto session time.

    In one read packets follow each other without a whole turn of the counter missing. Between two reads the number of turns is chosen by
    the time that has passed, the packets still to come in the read taken off; so read all that is there at once after a silence.
    """

    def __init__(self, bits: int, rate_hz: float, latency_s: float = 0.0, turn: int = 0) -> None:
        """`turn`: after how many packets the counter starts again, where that is no power of two."""
        self._range, self._rate, self._period = turn or 1 << bits, rate_hz, NS / rate_hz
        self._clock = DeviceClock(latency_s)
        self._counter = self._number = -1
        self._arrival = 0
        self._from_number, self._from_ns = 0, 0.0

    @property
    def state(self) -> ClockState:
        """What is known of the device's clock."""
        return self._clock.state

    def follow(self, rate_hz: float) -> None:
        """From here on the packet rate is another."""
        self._from_ns, self._from_number = self._made(self._number), self._number
        self._rate, self._period = rate_hz, NS / rate_hz
        self._clock.restart()

    def _made(self, number: int) -> float:
        """When a packet was made by its number (ns)."""
        return self._from_ns + (number - self._from_number) * self._period

    def take(self, counters: Array, arrival_ns: int) -> Packets:
        """Packets with these counters (n,), n > 0, have arrived now."""
        if len(counters) == 1:
            return self.take_one(int(counters[0]), arrival_ns)
        counters = counters.astype(np.int64)
        steps = np.empty(len(counters), np.int64)
        steps[1:] = (counters[1:] - counters[:-1]) % self._range
        steps[0] = self._first_step(int(counters[0]), arrival_ns, int(steps[1:].sum()))
        kept = steps != 0
        number = (self._number if self._counter >= 0 else int(counters[0]) - 1) + np.cumsum(steps)[kept]
        lost = steps[kept] - 1
        if len(number):
            excess = self._excess(int(number[-1]), arrival_ns)
            if excess:
                at = int(lost.argmax())
                # an even number is taken off: on boards that take turns, odd and even packets hold different channels
                excess += (int(number[-1]) - excess - int(counters[-1])) % 2
                if at:
                    excess = min(excess, int(lost[at]) & ~1)
                number[at:] -= excess
                lost[at] = -1
            self._number, self._counter, self._arrival = int(number[-1]), int(counters[-1]), arrival_ns
            self._clock.see(round(self._made(self._number)), arrival_ns)
            # the machine slept: the counter may have gone round any number of times
            lost[0] = lost[0] or -int(self._clock.take_gap())
        device = np.round(self._from_ns + (number - self._from_number) * self._period).astype(np.int64)
        return Packets(kept, number, lost, device, self._clock.stamps(device))

    def take_one(self, counter: int, arrival_ns: int) -> Packets:
        """The same for one packet, as most reads bring it, without arrays on the way."""
        made = self.one(counter, arrival_ns)
        if made is None:
            return NOTHING
        row = np.array(made)
        return Packets(ONE, row[0:1], row[1:2], row[2:3], row[3:4], not made.lost)

    def one(self, counter: int, arrival_ns: int) -> Stamped | None:
        """The same without any array; None where the packet was there already."""
        step = self._first_step(counter, arrival_ns, 0)
        if not step:
            return None
        number, lost = (self._number if self._counter >= 0 else counter - 1) + step, step - 1
        excess = self._excess(number, arrival_ns)
        if excess:
            number -= excess + (number - excess - counter) % 2
            lost = -1
        self._number, self._counter, self._arrival = number, counter, arrival_ns
        device = round(self._made(number))
        self._clock.see(device, arrival_ns)
        lost = lost or -int(self._clock.take_gap())
        return Stamped(number, lost, device, self._clock.stamp(device))

    def _first_step(self, counter: int, arrival_ns: int, following: int) -> int:
        """How far a read's first packet is from the last one before it; 0: it is that one again."""
        if self._counter < 0:
            return 1
        step = (counter - self._counter) % self._range
        # packets that follow in the same read were made later than this one, though all have one arrival
        elapsed = (arrival_ns - self._arrival) / self._period - following
        turns = max(0, round((elapsed - step) / self._range))
        return step + turns * self._range

    def _excess(self, number: int, arrival_ns: int) -> int:
        """By how much a number is too high for its arrival; 0 if it can be."""
        offset = self._clock.offset_ns
        if offset is None:
            return 0
        early = self._made(number) + offset - arrival_ns
        return round(early / self._period) if early > EARLY_NS else 0
