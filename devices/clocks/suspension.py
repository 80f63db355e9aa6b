"""Notices that the machine was suspended, and whether a device's clock stood still meanwhile."""

from __future__ import annotations

from kinegraph.stream.chunk import NS
from kinegraph.stream.system.clock import suspended_ns

SLEPT_NS = NS
"""After a longer silence it is asked whether the machine was suspended as long."""
DRAINED_NS, WATCHED_NS, STOOD_NS = 100_000_000, 250_000_000, 100_000_000
"""What had waited for the machine has come so long after it woke. If all of the time after that is later than before by more than the
last, the device's clock stood still, too."""


class Suspension:
    """`woke`: when the machine woke, while what comes is watched for that; else 0. One device's."""

    def __init__(self) -> None:
        self.woke = 0
        self._slept = suspended_ns()
        self._later: int | None = None
        """By how much the packets after the machine was suspended are later than those before, at least."""
        self._gap = False

    def is_waking(self, silent_ns: int) -> bool:
        """Whether the machine was suspended just before a packet that comes now, after a silence of the device."""
        return self.woke > 0 or (silent_ns > SLEPT_NS and suspended_ns() - self._slept > SLEPT_NS)

    def see(self, later: int, arrival_ns: int) -> int:
        """A packet has come now, while the machine is waking, `later` by this much (ns) than those before.

        Returns for how long (ns) the device's clock stood still, as soon as that is known; 0: it did not, or is not known yet.
        """
        if not self.woke:
            self._slept, self.woke, self._later = suspended_ns(), arrival_ns, None
            self._gap = later > STOOD_NS
        elif arrival_ns - self.woke > DRAINED_NS:
            self._later = later if self._later is None else min(self._later, later)
            if self._later <= STOOD_NS:
                self.woke = 0
            elif arrival_ns - self.woke > WATCHED_NS:
                self.woke, self._gap = 0, True
                return self._later
        return 0

    def take_gap(self) -> bool:
        """Whether to mark a gap before the last packet, since its device's clock stood still for an unknown time; once."""
        gap, self._gap = self._gap, False
        return gap
