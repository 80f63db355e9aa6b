"""What is known of a device's clock: into the metrics every second, into the log once a minute, and each jump at once."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Self

import structlog

from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.stream.source import Feed

EVERY_S, LOGGED_EVERY_S = 1.0, 60.0

log = structlog.get_logger(__name__)


class ClockLog:
    """One device's; `tell` may be called as often as one likes, and asks for the state only when it is time."""

    def __init__(self, device: str, feed: Feed, state: Callable[[], ClockState | None]) -> None:
        self._device, self._feed, self._state = device, feed, state
        now = time.monotonic()
        self._due, self._logged = now + EVERY_S, now
        self._jumps = 0

    def tell(self) -> None:
        """Tell offset, drift and uncertainty, if it is time and there is a clock."""
        if (now := time.monotonic()) >= self._due:
            self._report(now)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """The end is reported too: what has happened since the last second would never be."""
        self._report(time.monotonic())

    def _report(self, now: float) -> None:
        self._due = now + EVERY_S
        if (state := self._state()) is None:
            return
        facts = {
            "offset_s": round(state.offset_s, 6),
            "drift_ppm": round(state.drift_ppm, 2),
            "uncertainty_s": round(state.uncertainty_s, 6),
        }
        self._feed.device_clock(**facts, seconds=state.seconds, settling=state.settling, jumps=state.jumps)
        if state.jumps > self._jumps:
            times = {"times": state.jumps - self._jumps} if state.jumps > self._jumps + 1 else {}
            self._feed.tell("device clock jumped", jump_s=round(state.jump_s, 6), **times)
            self._jumps = state.jumps
        if now - self._logged >= LOGGED_EVERY_S:
            self._logged = now
            log.info("device clock", device=self._device, **facts)
