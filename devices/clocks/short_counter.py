"""A packet counter that runs over within milliseconds: which packets are missing, when whole turns of it may be."""

from __future__ import annotations

import numpy as np

from kinegraph.devices.clocks.device_clock import ClockState, DeviceClock
from kinegraph.devices.clocks.packet_clock import Packets
from kinegraph.stream.chunk import NS, Array, Times

WATCHED_NS = NS
SURE = 0.6
"""Share of a turn by which all packets of a while must be late before a turn is taken to be missing."""


class ShortCounter:
    """Numbers the packets of a device with so short a counter that one late read looks like a wrap-around.

    What a packet's number says at once is at most a turn. Whole turns that are missing show afterwards: from then on every packet comes
    late by as much, while a stall or a burst delays only some. So the least lateness of a second is watched, and if it is a turn or more,
    the next packet is counted as after that many missing ones; until then, stamps are early by that.
    """

    def __init__(self, bits: int, rate_hz: float, latency_s: float = 0.0) -> None:
        self._range, self._period = 1 << bits, NS / rate_hz
        self._clock = DeviceClock(latency_s)
        self._counter = self._number = -1
        self._watched, self._least = 0, np.inf
        self._from_number, self._from_ns = 0, 0.0

    def follow(self, rate_hz: float) -> None:
        """From here on the packet rate is another."""
        self._from_ns += (self._number - self._from_number) * self._period
        self._from_number, self._period = self._number, NS / rate_hz
        self._clock.restart()

    @property
    def state(self) -> ClockState:
        """What is known of the device's clock."""
        return self._clock.state

    def take(self, counters: Array, arrival_ns: int) -> Packets:
        """Packets with these counters (n,), n > 0, have arrived now, without repetitions."""
        counters = counters.astype(np.int64)
        first = self._counter < 0
        before = int(counters[0]) - 1 if first else self._counter
        lost: Times = (np.diff(counters, prepend=before) - 1) % self._range
        if first:
            self._number, self._watched = int(counters[0]) - 1, arrival_ns
        else:
            lost[0] += self._turns(arrival_ns) * self._range
        number = self._number + np.cumsum(lost + 1)
        self._number, self._counter = int(number[-1]), int(counters[-1])
        device = np.round(self._from_ns + (number - self._from_number) * self._period).astype(np.int64)
        self._watch(int(device[-1]), arrival_ns)
        self._clock.see(int(device[-1]), arrival_ns)
        lost[0] = lost[0] or -int(self._clock.take_gap())
        return Packets(np.ones(len(counters), bool), number, lost, device, self._clock.stamps(device))

    def _watch(self, device_ns: int, arrival_ns: int) -> None:
        offset = self._clock.offset_ns
        if offset is not None:
            self._least = min(self._least, arrival_ns - device_ns - offset)

    def _turns(self, arrival_ns: int) -> int:
        """How many whole turns are found to be missing now."""
        if arrival_ns - self._watched < WATCHED_NS:
            return 0
        turn = self._range * self._period
        missing = round(self._least / turn) if SURE * turn < self._least < np.inf else 0
        self._watched, self._least = arrival_ns, np.inf
        return missing
