"""When an alarm begins and ends: only once several findings in a row agree, so that one odd cycle or window changes nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Times


@dataclass(slots=True)
class Latch:
    """`on`: what each alarm reports, 0 (or `calm`) for nothing; `against`: findings in a row that differ from it."""

    on: Times
    against: Times

    @classmethod
    def calm(cls, *shape: int, value: int = 0) -> Latch:
        return cls(np.full(shape, value), np.zeros(shape, np.int64))

    def turns(self, at: Any, found: int, times: int, *, hold: bool = False) -> bool:
        """Take a finding about the alarm `at`; whether it is the one that changes it. `hold`: it does not change yet."""
        self.against[at] = 0 if found == self.on[at] else self.against[at] + 1
        if self.against[at] < times or hold:
            return False
        self.on[at], self.against[at] = found, 0
        return True

    def end(self, at: Any) -> None:
        """End alarms at once."""
        self.on[at], self.against[at] = 0, 0
