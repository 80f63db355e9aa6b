"""Packets with a counter and a device time in ticks, both of few bits: many at once, which are missing, and when each was made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.clocks.device_clock import JUMP_NS, ClockState, DeviceClock
from kinegraph.devices.clocks.packet_clock import Packets
from kinegraph.stream.chunk import NS, STAMP, Times
from kinegraph.stream.kernel import kernel

SLACK_NS = 10_000_000_000
"""A device's time may advance by this much more than what has passed here: what was made during a stall comes all at once."""


@kernel
def _follow(
    counters: Times, ticks: Times, begin: tuple[int, int, int, int], whole_ns: int, tick_ns: float, number: Times, device_ns: Times
) -> bool:  # fmt: skip
    """Whether packets (n,) come one after the other, without a number that has run over: then `number` and `device_ns` (n,) are theirs.

    begin      counter and ticks of the packet before, its running number and its unwrapped ticks
    whole_ns   a tick in ns; 0: it is no whole number, take `tick_ns`
    """
    counter, tick, running, device = begin
    before = tick
    for i in range(len(counters)):
        if counters[i] != counter + 1 + i or ticks[i] <= before:
            return False
        before = ticks[i]
        number[i] = running + 1 + i
        made = device + before - tick
        device_ns[i] = made * whole_ns if whole_ns else np.int64(np.rint(made * tick_ns))
    return True


def prepare() -> None:
    """Compile what counts on, or take it from the cache."""
    one = np.zeros(1, STAMP)
    _follow(one, one, (0, 0, 0, 0), 1, 1.0, one.copy(), one.copy())


class TickClock:
    """Unwraps both and maps the device's time onto session time.

    A time that goes back, or that advances by more than has passed, means that the device has started again: what is known of its clock is
    forgotten, and the number of missing packets is unknown. A packet with the same counter and time as the one before is a repetition.
    """

    def __init__(
        self, *, counter_bits: int, tick_bits: int, tick_ns: float, rate_hz: float, latency_s: float = 0.0
    ) -> None:
        """`rate_hz`: packets a second, by which the number of whole turns of the counter in an outage is chosen."""
        self._counters, self._ticks, self._tick_ns = 1 << counter_bits, 1 << tick_bits, tick_ns
        self._whole_ns = int(tick_ns) if float(tick_ns).is_integer() else 0
        self._packet_ticks = NS / rate_hz / tick_ns
        self._clock = DeviceClock(latency_s)
        self._counter = self._tick = -1
        self._number = self._device = self._arrival = self._passed = 0

    @property
    def state(self) -> ClockState:
        """What is known of the device's clock."""
        return self._clock.state

    def pass_by(self, counters: Times) -> None:
        """Packets without a time that matters have come: only their counters (n,) count."""
        if self._counter < 0 or not len(counters):
            return
        steps: Times = np.diff(counters, prepend=self._counter) % self._counters
        self._number += int(steps.sum())
        self._passed += int((steps - 1).clip(0).sum())
        self._counter = int(counters[-1])

    def take(self, counters: Times, ticks: Times, arrival_ns: int) -> Packets:
        """Packets with these counters and times (n,), n > 0, have arrived now."""
        if self._counter < 0:
            self._counter, self._number = int(counters[0]) - 1, int(counters[0]) - 1
            self._tick, self._device = int(ticks[0]) - 1, int(ticks[0]) - 1
            self._arrival = arrival_ns
        number, device_ns = np.empty(len(ticks), STAMP), np.empty(len(ticks), STAMP)
        # nearly every read is in order: one compiled look at it spares a dozen small numpy calls
        in_order = self._in_order(counters, ticks, arrival_ns, number, device_ns)
        if in_order:
            kept, lost = np.ones(len(ticks), bool), np.zeros(len(ticks), STAMP)
            last = self._device - self._tick + int(ticks[-1])
        else:
            steps: Times = np.diff(ticks, prepend=self._tick) % self._ticks
            leaps = self._leaps(counters, steps, arrival_ns)
            if leaps.any():
                return self._restarted_at(int(leaps.argmax()), counters, ticks, arrival_ns)
            lost = self._missing(counters, steps)
            kept = lost >= 0
            number = self._number + np.cumsum(lost + 1)
            device = self._device + np.cumsum(steps)
            last = int(device[-1])
            device_ns = device * self._whole_ns if self._whole_ns else np.round(device * self._tick_ns).astype(STAMP)
        clean = in_order and not self._passed
        lost[0] += self._passed
        self._number, self._device, self._arrival, self._passed = int(number[-1]), last, arrival_ns, 0
        self._counter, self._tick = int(counters[-1]), int(ticks[-1])
        if not in_order and not kept.all():
            lost, number, device_ns = lost[kept], number[kept], device_ns[kept]
        if len(device_ns):
            self._clock.see(int(device_ns[-1]), arrival_ns)
            if self._clock.take_gap():
                lost[0], clean = lost[0] or -1, False
        return Packets(kept, number, lost, device_ns, self._clock.stamps(device_ns), clean)

    def _in_order(self, counters: Times, ticks: Times, arrival_ns: int, number: Times, device_ns: Times) -> bool:
        """Whether all is as it mostly is: each packet the next one, nothing has started again, no number has run over.

        If so, `number` (n,) and `device_ns` (n,) are filled.
        """
        made = self._device + int(ticks[-1]) - self._tick
        if (int(ticks[-1]) - self._tick) * self._tick_ns > arrival_ns - self._arrival + SLACK_NS:
            return False
        if self._clock.is_ahead(round(made * self._tick_ns), arrival_ns):
            return False
        begin = (self._counter, self._tick, self._number, self._device)
        return _follow(counters, ticks, begin, self._whole_ns, float(self._tick_ns), number, device_ns)

    def _leaps(self, counters: Times, steps: Times, arrival_ns: int) -> NDArray[np.bool_]:
        """Before which packets (n,) the device's clock was set or started again: `steps` (n,) in ticks that cannot be."""
        leaps: NDArray[np.bool_] = steps * self._tick_ns > arrival_ns - self._arrival + SLACK_NS
        device = np.round((self._device + np.cumsum(steps)) * self._tick_ns)
        if not leaps.any() and self._clock.is_ahead(int(device[-1]), arrival_ns):
            made = np.diff(counters, prepend=self._counter) % self._counters * self._packet_ticks
            leaps = (steps - made) * self._tick_ns > JUMP_NS
        return leaps

    def _missing(self, counters: Times, steps: Times) -> Times:
        """How many are missing before each; -1: it is the one before again."""
        lost: Times = np.diff(counters, prepend=self._counter) % self._counters - 1
        # only a silence of half the counter's range can hide whole turns; ticks have the longer range and count them
        if steps.max() > self._counters // 2 * self._packet_ticks:
            turns = np.round((steps / self._packet_ticks - lost - 1) / self._counters).astype(np.int64)
            lost += turns.clip(0) * self._counters
        return np.asarray(np.where((lost < 0) & (steps > 0), 0, lost))

    def _restarted_at(self, at: int, counters: Times, ticks: Times, arrival_ns: int) -> Packets:
        """The device started again with packet `at`."""
        before = self.take(counters[:at], ticks[:at], arrival_ns) if at else None
        # what the clock advanced by, less what has passed here: the rest is how far it was set
        leapt = round((int(ticks[at]) - self._tick) * self._tick_ns) - (arrival_ns - self._arrival)
        self._clock.restart(leapt)
        number = self._number
        self._counter = -1
        after = self.take(counters[at:], ticks[at:], arrival_ns)
        after.lost[0] = -1
        shift = number + 1 - int(after.number[0])
        after.number[:] += shift
        self._number += shift
        parts = [after] if before is None else [before, after]
        names = ("kept", "number", "lost", "device", "stamp")
        kept, numbers, lost, device, stamp = (np.concatenate([getattr(p, name) for p in parts]) for name in names)
        return Packets(kept, numbers, lost, device, stamp)
