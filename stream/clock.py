"""The session clock: host monotonic time anchored to UTC once, so that it never jumps, whatever happens to the wall clock."""

from __future__ import annotations

import time

from stream.chunk import NEVER


class SessionClock:
    """Nanoseconds UTC that never run backwards. Anchored when made; never before `after` (the last stamp of a resumed session)."""

    __slots__ = ("_offset", "utc_ns")

    def __init__(self, after: int = NEVER) -> None:
        monotonic = time.monotonic_ns()
        self.utc_ns = max(time.time_ns(), after + 1)
        self._offset = self.utc_ns - monotonic

    def now(self) -> int:
        return time.monotonic_ns() + self._offset

    def at(self, monotonic_ns: int) -> int:
        """Session time of an instant of the host's monotonic clock (LSL and depthai stamp with it)."""
        return monotonic_ns + self._offset

    def to_json(self) -> dict[str, int]:
        """The anchor: UTC of the monotonic clock's zero, and UTC at the start, both in ns."""
        return {"utc_of_monotonic_zero_ns": self._offset, "start_utc_ns": self.utc_ns}
