"""A device's clock mapped onto the session's, online: no sample is moved by how late it happened to arrive.

A packet's arrival is its device time plus the clocks' offset plus a delay that is never less than some minimum. So the smallest
differences, arrival minus device time, lie on a line from below: its slope is the drift, its height the offset plus the least delay. The
line is the lower convex hull's edge over the middle of the last two minutes (Moon, Skelly, Towsley 1999; Olson 2010). Jitter, bursts and
stalls only make differences larger, and leave the line where it is. The constant least delay cannot be seen by any such mapping; it is
what `latency_s` of a source corrects.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stream.chunk import NS, STAMP, Samples, Times

BUCKET_NS = NS
WINDOW = 120
"""Buckets (seconds) that the line rests on."""
STEADY = 10
"""Below so many buckets the drift is taken as zero."""
MOST_DRIFT = 1e-3
"""No quartz is worse; a steeper line is an artefact of the delays, unless it is clear."""
STEEPEST, CLEAR = 0.03, 20
"""A device that is slow by more (an Arduino's resonator, a rate that is not quite the stated one) is believed up to so much, where what
that makes over the time known is so many times what the least delays stray about the line. One that is fast needs no belief: each second's
least delay is lower than those before.
"""
SLEW = 0.01
"""After the line has moved back, stamps still advance at this share of the device's pace until it is reached."""
ROUNDED = 2
"""Stamps whose first is later than that by more ns than rounding makes are all later, as they advance faster."""


@dataclass(frozen=True, slots=True)
class ClockState:
    """What is known of a device's clock.

    offset_s         session time minus device time, now, with the least delay in it (s)
    drift_ppm        how much faster session time runs
    uncertainty_s    spread of the seconds' least delays about the line: how far the mapping may be off beside the constant part
    seconds          how many seconds it rests on
    """

    offset_s: float
    drift_ppm: float
    uncertainty_s: float
    seconds: int


class DeviceClock:
    """Maps device time to session time; O(1) per packet, at most 120 points a second for the line."""

    def __init__(self, latency_s: float = 0.0) -> None:
        """`latency_s`: the constant part of the delay, from the event to its arrival at best, measured by the user."""
        self._latency = round(latency_s * NS)
        self._last: tuple[int, int] | None = None
        self._forget()

    def _forget(self) -> None:
        self._x: list[int] = []
        """Device time of each second's smallest difference, oldest first."""
        self._y: list[int] = []
        """The smallest difference of each second, arrival minus device time (ns)."""
        self._bucket: int | None = None
        self._slope = 0.0
        self._height = 0.0
        self._at = 0
        self._spread = 0.0

    def see(self, device_ns: int, arrival_ns: int) -> None:
        """A packet with this (unwrapped) device time has arrived now."""
        difference = arrival_ns - device_ns
        bucket = device_ns // BUCKET_NS
        if self._bucket is None or bucket > self._bucket:
            self._bucket = bucket
            self._x.append(device_ns)
            self._y.append(difference)
            if len(self._x) > WINDOW:
                del self._x[0], self._y[0]
            self._fit()
        elif difference < self._y[-1]:
            self._x[-1], self._y[-1] = device_ns, difference
            if difference < self._line(device_ns):
                self._fit()

    def stamps(self, device_ns: Times) -> Times:
        """Session times (n,) ns of device times (n,) ns, which do not run backwards; never before one that was given."""
        if not len(device_ns):
            return device_ns
        offset = (device_ns - self._at) * self._slope
        offset += self._height
        mapped: Times = device_ns + np.rint(offset, out=offset).astype(STAMP)
        mapped -= self._latency
        if self._last is not None:
            device, stamp = self._last
            if int(mapped[0]) <= stamp + max(int(SLEW * (int(device_ns[0]) - device)), 1) + ROUNDED:
                mapped = np.maximum(mapped, stamp + np.maximum((SLEW * (device_ns - device)).astype(STAMP), 1))
        self._last = int(device_ns[-1]), int(mapped[-1])
        return mapped

    def stamp(self, device_ns: int) -> int:
        """The session time of one device time: bit for bit what `stamps` gives, in a tenth of its time."""
        mapped = device_ns + round(self._height + self._slope * (device_ns - self._at)) - self._latency
        if self._last is not None:
            device, stamp = self._last
            mapped = max(mapped, stamp + max(int(SLEW * (device_ns - device)), 1))
        self._last = device_ns, mapped
        return mapped

    def restart(self) -> None:
        """The device's own time began anew (a reset): everything known of it is forgotten, but stamps still never run backwards."""
        self._forget()
        if self._last is not None:
            self._last = (0, self._last[1])

    @property
    def offset_ns(self) -> float | None:
        """Session time minus device time now, with the least delay in it; None where nothing is known yet."""
        return self._line(self._x[-1]) if self._x else None

    @property
    def state(self) -> ClockState:
        now = self._x[-1] if self._x else 0
        return ClockState(self._line(now) / NS, self._slope * 1e6, self._spread / NS, len(self._x))

    def _line(self, device_ns: int) -> float:
        return self._height + self._slope * (device_ns - self._at)

    def _fit(self) -> None:
        """The lower hull's edge over the middle of what is known."""
        x = np.array(self._x, np.float64) - self._x[0]
        y = np.array(self._y, np.float64) - self._y[0]
        if len(x) < STEADY:
            self._slope, lowest = 0.0, int(np.argmin(y))
            self._height, self._at = float(self._y[lowest]), self._x[lowest]
        else:
            left, right = _edge(x, y, float(x.mean()))
            slope = (y[right] - y[left]) / (x[right] - x[left])
            if slope > MOST_DRIFT:
                stray = np.median(y - y[left] - slope * (x - x[left]))
                clear = (slope - MOST_DRIFT) * (x[-1] - x[0]) > CLEAR * stray
                slope = min(slope, STEEPEST if clear else MOST_DRIFT)
            self._slope = float(max(slope, -MOST_DRIFT))
            self._at, self._height = self._x[left], float(self._y[left])
            below = float((y - y[left] - self._slope * (x - x[left])).min())
            self._height += min(below, 0.0)
        rest = y + self._y[0] - self._height - self._slope * (x + self._x[0] - self._at)
        self._spread = float(np.median(rest))


def _edge(x: Samples, y: Samples, middle: float) -> tuple[int, int]:
    """Indices of the two points of the lower convex hull between which `middle` lies. x (n,) increasing."""
    hull: list[int] = []
    for i in range(len(x)):
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            if (x[b] - x[a]) * (y[i] - y[a]) > (y[b] - y[a]) * (x[i] - x[a]):
                break
            hull.pop()
        hull.append(i)
    for a, b in pairwise(hull):
        if x[b] >= middle:
            return a, b
    return hull[-2], hull[-1]


class Counter:
    """A packet counter of a few bits, unwrapped: what is missing is counted, also over an outage longer than the counter's range."""

    def __init__(self, bits: int, rate_hz: float) -> None:
        """`rate_hz`: packets per second, by which the number of whole turns in an outage is chosen."""
        self._range, self._rate = 1 << bits, rate_hz
        self._last: int | None = None
        self._arrival = 0
        self.value = 0
        """The running number of the last packet."""

    def lost_before(self, counter: int, arrival_ns: int) -> int:
        """How many packets are missing just before this one; -1: it is one that was there already (a repetition)."""
        if self._last is None:
            self._last, self._arrival = counter, arrival_ns
            return 0
        step = (counter - self._last) % self._range
        elapsed = (arrival_ns - self._arrival) / NS * self._rate
        if step == 0 and elapsed < self._range / 2:
            return -1
        turns = max(0, round((elapsed - step) / self._range))
        advance = step + turns * self._range
        self._last, self._arrival = counter, arrival_ns
        self.value += advance
        return advance - 1
