"""What is known of a device's clock, into the log once a minute."""

from __future__ import annotations

import time
from collections.abc import Callable

import structlog

from devices.clocks.device_clock import ClockState

EVERY_S = 60.0

log = structlog.get_logger(__name__)


class ClockLog:
    """One device's; `tell` may be called as often as one likes, and asks for the state only when it is time."""

    def __init__(self, device: str, state: Callable[[], ClockState | None]) -> None:
        self._device, self._state = device, state
        self._due = time.monotonic() + EVERY_S

    def tell(self) -> None:
        """Log offset, drift and uncertainty, if it is time and there is a clock."""
        now = time.monotonic()
        if now < self._due or (state := self._state()) is None:
            return
        self._due = now + EVERY_S
        log.info(
            "device clock",
            device=self._device,
            offset_s=round(state.offset_s, 6),
            drift_ppm=round(state.drift_ppm, 2),
            uncertainty_s=round(state.uncertainty_s, 6),
        )
