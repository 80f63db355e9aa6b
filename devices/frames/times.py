"""Stamps of frames that bring the device's time: several kinds of frame on one clock."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinegraph.devices.clocks.device_clock import ClockState, DeviceClock
from kinegraph.devices.clocks.device_time import DeviceTime
from kinegraph.devices.clocks.packet_clock import Packets, Stamped
from kinegraph.devices.clocks.stamps import REPEATED, Losses
from kinegraph.stream.chunk import Array, Times
from kinegraph.stream.source import Feed


class FrameTimes:
    """The device's clock, and what each kind of frame has lost of it. Frames without a time have that of the frame before."""

    def __init__(self, losses: Sequence[Losses], latency_s: float, wraps_ns: int) -> None:
        """losses: one per kind of frame; wraps_ns: at which value the device's time starts again, 0: never."""
        self._losses = losses
        self._clock = DeviceClock(latency_s)
        self._time = DeviceTime(self._clock, wraps_ns)
        self._now: int | None = None
        """The device's time by the last frame that brought one."""

    @property
    def clock(self) -> ClockState | None:
        return self._clock.state

    def follow(self, kind: int, rate_hz: float) -> None:
        """Frames of this kind come at another rate than was declared."""
        self._losses[kind].follow(rate_hz)

    def one(self, kind: int, own: Times | None, counter: int | None, arrival: int, feed: Feed) -> Stamped | None:
        """What `take` gives for one frame; None where it is left out."""
        restarted = False
        if own is not None:
            self._now = self._time.read(int(own[0]), arrival)
            restarted = self._time.restarted
            if restarted:
                self._clock.restart(self._time.jump_ns)
                feed.problem("device restarted")
        if self._now is None:
            return None
        lost = self._losses[kind].before(self._now, counter, arrival, restarted)
        if lost <= REPEATED:
            return None
        device = self._now + (0 if own is None else self._losses[kind].within_ns)
        self._clock.see(device, arrival)
        lost = lost or -int(self._clock.take_gap())
        return Stamped(self._losses[kind].number, lost, device, self._clock.stamp(device))

    def take(
        self,
        kinds: Array,
        raw: dict[int, Times | None],
        counters: dict[int, Times | None],
        arrival: int,
        feed: Feed,
    ) -> dict[int, Packets]:
        """Frames in the order in which they came, `kinds` (n,), get the device's time, all through one mapping.

        raw, counters: by kind, the device's time (ns) and the counter of each of its frames, where they have one.
        """
        seen = dict.fromkeys(raw, 0)
        device, lost, number, stamp = np.full((4, len(kinds)), -1, np.int64)
        mapped = 0
        kept = np.zeros(len(kinds), bool)
        for i, kind in enumerate(kinds.tolist()):
            place, seen[kind] = seen[kind], seen[kind] + 1
            own, restarted = raw[kind], False
            if own is not None:
                self._now = self._time.read(int(own[place]), arrival)
                restarted = self._time.restarted
                if restarted:
                    self._clock.map(device[mapped:i], kept[mapped:i], arrival, stamp[mapped:i])
                    self._clock.restart(self._time.jump_ns)
                    mapped = i
                    feed.problem("device restarted")
            if self._now is None:
                continue
            count = counters[kind]
            lost[i] = self._losses[kind].before(
                self._now, None if count is None else int(count[place]), arrival, restarted
            )
            within = 0 if own is None else self._losses[kind].within_ns
            device[i], number[i], kept[i] = self._now + within, self._losses[kind].number, lost[i] > REPEATED
        self._clock.map(device[mapped:], kept[mapped:], arrival, stamp[mapped:])
        if self._clock.take_gap():
            for kind in raw:
                first = np.flatnonzero((kinds == kind) & kept)[:1]
                lost[first] = np.where(lost[first] == 0, -1, lost[first])
        packets = {}
        for kind in raw:
            here = kinds == kind
            good = here & kept
            packets[kind] = Packets(kept[here], number[good], lost[good], device[good], stamp[good])
        return packets
