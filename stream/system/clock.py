"""The session clock: host monotonic time anchored to UTC once, so that it never jumps, whatever happens to the wall clock."""

from __future__ import annotations

import time

from kinegraph.stream.chunk import NEVER

BOOTTIME: int | None = getattr(time, "CLOCK_BOOTTIME", None)
"""Linux' clock that goes on while the machine is suspended, where its monotonic clock stands still."""
MIN_SLEEP_NS = 10_000_000
"""Less than that is no suspended machine."""


class SessionClock:
    """Nanoseconds UTC that never run backwards. Anchored when made; never before `after` (the last stamp of a resumed session).

    A machine that was suspended (a laptop that was shut) leaves a gap as long as it was: what comes after is at the time that it is.
    """

    __slots__ = ("_anchor", "_suspended", "_zero", "utc_ns")

    def __init__(self, after: int = NEVER) -> None:
        monotonic, self._suspended = time.monotonic_ns(), suspended_ns()
        self.utc_ns = max(time.time_ns(), after + 1)
        self._zero = self.utc_ns - monotonic
        self._anchor = self._zero - self._suspended

    def now(self) -> int:
        return self.at(time.monotonic_ns())

    def at(self, monotonic_ns: int) -> int:
        """Session time of an instant, not long ago, of the host's monotonic clock (LSL and depthai stamp with it)."""
        if BOOTTIME is not None and time.clock_gettime_ns(BOOTTIME) - monotonic_ns - self._suspended > MIN_SLEEP_NS:
            suspended = suspended_ns()  # or the instant is some time ago
            if suspended - self._suspended > MIN_SLEEP_NS:
                self._suspended = suspended
        return monotonic_ns + self._anchor + self._suspended

    def to_json(self) -> dict[str, int]:
        """The anchor: UTC of the monotonic clock's zero, and UTC at the start, both in ns."""
        return {"utc_of_monotonic_zero_ns": self._zero, "start_utc_ns": self.utc_ns}


def suspended_ns() -> int:
    """How long the machine has been suspended since it was started; whoever is interrupted between both clocks gets less, never more."""
    return time.clock_gettime_ns(BOOTTIME) - time.monotonic_ns() if BOOTTIME is not None else 0
