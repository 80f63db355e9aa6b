"""A device's own time, unwrapped: it begins anew at some value, now and then a number is wrong, and a device may be switched on again."""

from __future__ import annotations

SLACK_NS = 10_000_000_000
"""A device's time may advance by so much more than what has passed here: what was made during a stall comes all at once."""
BELIEVED = 3
"""So many numbers in a row that fit each other, but not what was before, mean that the device's clock began anew."""


class DeviceTime:
    """Turns what a device says into ns that only grow."""

    def __init__(self, wraps_ns: int = 0) -> None:
        """`wraps_ns`: at which value the device's time begins anew; 0: never."""
        self._wraps = wraps_ns
        self._raw: int | None = None
        self._value = self._arrival = 0
        self._doubtful: list[int] = []
        self.restarted = False
        """Whether with the last number the device's clock was found to have begun anew."""

    def read(self, raw_ns: int, arrival_ns: int) -> int | None:
        """Unwrapped ns; None for a number that cannot be right."""
        self.restarted = False
        if self._raw is None:
            return self._accept(raw_ns, raw_ns, arrival_ns)
        elapsed = arrival_ns - self._arrival
        step = raw_ns - self._raw
        if self._wraps:
            step %= self._wraps
            step += self._wraps * max(0, round((elapsed - step) / self._wraps))
        if 0 <= step <= elapsed + SLACK_NS:
            return self._accept(self._value + step, raw_ns, arrival_ns)
        return self._doubt(raw_ns, arrival_ns)

    def _accept(self, value: int, raw_ns: int, arrival_ns: int) -> int:
        self._value, self._raw, self._arrival = value, raw_ns, arrival_ns
        self._doubtful.clear()
        return value

    def _doubt(self, raw_ns: int, arrival_ns: int) -> int | None:
        if self._doubtful and not 0 <= raw_ns - self._doubtful[-1] <= SLACK_NS:
            self._doubtful.clear()
        self._doubtful.append(raw_ns)
        if len(self._doubtful) < BELIEVED:
            return None
        self.restarted = True
        return self._accept(raw_ns, raw_ns, arrival_ns)
