"""Where LSL's clocks stand: this computer's on the session's, and a sender's on this computer's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.stream.chunk import NS

TRIES = 5
JUMP_S = 0.5
"""A sender's clock that moves by more between two measurements was set, or is another computer's."""


def zero_ns(lsl: Any, now: Callable[[], int]) -> int:
    """Session time (ns) at which LSL's local clock stood at 0; `now` tells session time. The quickest of a few looks counts."""
    best, zero = NS, 0
    for _ in range(TRIES):
        before, local, after = now(), lsl.local_clock(), now()
        if after - before < best:
            best, zero = after - before, (before + after) // 2 - round(local * NS)
    return zero


@dataclass(slots=True)
class SenderClock:
    """What LSL's measurements say about a sender's clock.

    zero_s      session time at which LSL's local clock stood at 0
    offset_s    what is added to the sender's stamps to have local ones, as measured last
    """

    zero_s: float
    offset_s: float = 0.0
    uncertainty_s: float = 0.0
    _first: tuple[float, float] | None = None
    _seconds: float = 0.0
    _jumps: int = 0
    _jump_s: float = 0.0

    def see(self, offset_s: float, uncertainty_s: float, now_s: float) -> None:
        """A measurement, at `now_s` of a clock that only runs forward."""
        if self._first is not None and abs(offset_s - self.offset_s) > JUMP_S:
            self._jumps += 1
            self._jump_s = self.offset_s - offset_s
            self._first = None
        if self._first is None:
            self._first = (now_s, offset_s)
        self.offset_s, self.uncertainty_s = offset_s, uncertainty_s
        self._seconds = now_s - self._first[0]

    def state(self) -> ClockState | None:
        """What is known; None before the first measurement."""
        if self._first is None:
            return None
        drift = (self.offset_s - self._first[1]) / self._seconds * 1e6 if self._seconds >= 1.0 else 0.0
        return ClockState(
            self.zero_s + self.offset_s, drift, self.uncertainty_s, int(self._seconds), self._jumps, self._jump_s
        )
