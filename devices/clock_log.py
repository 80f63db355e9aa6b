"""What is known of a device's clock, into the log once a minute."""

from __future__ import annotations

import time

import structlog

from devices.device_clock import ClockState

EVERY_S = 60.0

log = structlog.get_logger(__name__)


class ClockLog:
    """One device's; `tell` may be called as often as one likes."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._due = time.monotonic() + EVERY_S

    def tell(self, state: ClockState | None) -> None:
        """Log offset, drift and uncertainty, if it is time and there is a clock."""
        now = time.monotonic()
        if state is None or now < self._due:
            return
        self._due = now + EVERY_S
        log.info(
            "device clock",
            device=self._device,
            offset_s=round(state.offset_s, 6),
            drift_ppm=round(state.drift_ppm, 2),
            uncertainty_s=round(state.uncertainty_s, 6),
        )
