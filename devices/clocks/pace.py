"""Samples that come with nothing but their order: when each was made, by counting them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.devices.clocks.device_clock import ClockState, DeviceClock
from kinegraph.stream.chunk import NS, Times

WATCHED_NS = NS
ASTRAY_NS = 100_000_000
"""By this much all samples of a second must be late, or one read early, before the count is taken to be wrong."""


@dataclass(frozen=True, slots=True)
class Counted:
    """n samples: running number, time by it (ns), session time (ns); `astray`: an unknown number is missing before them."""

    number: Times
    device: Times
    stamp: Times
    astray: bool


class DevicePace:
    """Counts samples of a steady rate that reach us in order (TCP), and maps the count onto session time.

    The count goes wrong where the sender left something out, which nothing tells; but from then on everything comes late by as much, while
    a stall delays only some. So the least lateness of a second is watched.
    """

    def __init__(self, rate_hz: float, latency_s: float = 0.0) -> None:
        self._period = NS / rate_hz
        self._clock = DeviceClock(latency_s)
        self._next = self._base = 0
        self._best = self._least = np.inf
        self._watched = 0
        self._followed = False

    @property
    def state(self) -> ClockState:
        """What is known of the sender's clock."""
        return self._clock.state

    def take(self, n: int, arrival_ns: int) -> Counted:
        """`n` > 0 samples have arrived now."""
        late = arrival_ns - (self._next + n - 1 - self._base) * self._period
        first = not np.isfinite(self._best)
        if first:
            self._watched = arrival_ns
        self._least = min(self._least, late)
        astray = not first and late < self._best - ASTRAY_NS
        if not first and arrival_ns - self._watched > WATCHED_NS:
            astray = astray or self._least > self._best + ASTRAY_NS
            self._watched, self._least = arrival_ns, np.inf
        if astray:
            self._clock.restart()
            self._base, self._best, self._least = self._next, np.inf, np.inf
            late = arrival_ns - (n - 1) * self._period
        self._best = min(self._best, late)
        astray, self._followed = astray or self._followed, False
        number = np.arange(self._next, self._next + n)
        self._next += n
        device = np.round((number - self._base) * self._period).astype(np.int64)
        self._clock.see(int(device[-1]), arrival_ns)
        return Counted(number, device, self._clock.stamps(device), astray)

    def follow(self, rate_hz: float) -> None:
        """From here on the rate is another; the next samples are marked, as some may be missing before them."""
        self._period, self._followed = NS / rate_hz, True
        self._clock.restart()
        self._base, self._best, self._least = self._next, np.inf, np.inf
