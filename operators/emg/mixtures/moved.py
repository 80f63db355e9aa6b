"""Whether a muscle has moved from a reference: a number of windows in a row beyond the limit begin it, and as many within end it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Times
from kinegraph.stream.domain.alarm import ON, OVER

FIRST, STORED = 0, 1
ALARM_TEXT = ("moved from its first {} cycles", "moved from the stored reference")
ADVICE = "compare the curves before and after: fatigue, another speed, a shifted electrode"

Alarm = tuple[int, str, str, str, str]


@dataclass(slots=True)
class Moved:
    """Of each reference (`FIRST`, `STORED`) and mixture.

    above, below (2, g)   in how many windows in a row the limit was exceeded or kept
    since (2, g)          the onset of the first that exceeded it;  on (2, g): 1 while it has moved
    """

    above: Times
    below: Times
    since: Times
    on: Times

    @staticmethod
    def empty(count: int) -> Moved:
        return Moved(*(np.zeros((2, count), np.int64) for _ in range(4)))

    def from_which(self, muscle: int) -> str:
        return ("", "first", "stored", "both")[int(self.on[FIRST, muscle] + 2 * self.on[STORED, muscle])]

    def judge(self, kind: int, muscle: int, distance: float, limit: float, onset: int, windows: int) -> str:
        """Count a window; gives "on" or "over" where that changes what is known. What is not known changes nothing."""
        if not np.isfinite(limit) or np.isnan(distance):
            return ""
        if distance > limit:
            if not self.above[kind, muscle]:
                self.since[kind, muscle] = onset
            self.above[kind, muscle] += 1
            self.below[kind, muscle] = 0
        else:
            self.below[kind, muscle] += 1
            self.above[kind, muscle] = 0
        if not self.on[kind, muscle] and self.above[kind, muscle] >= windows:
            self.on[kind, muscle] = 1
            return ON
        if self.on[kind, muscle] and self.below[kind, muscle] >= windows:
            self.on[kind, muscle] = 0
            return OVER
        return ""

    def forget(self, kind: int, muscle: int) -> bool:
        """There is no such reference any more; gives whether the muscle had moved from it."""
        was = bool(self.on[kind, muscle])
        self.above[kind, muscle] = self.below[kind, muscle] = self.on[kind, muscle] = 0
        return was

    def alarm(self, kind: int, muscle: int, name: str, state: str, first: int) -> Alarm:
        advice = ADVICE if state == ON else ""
        return int(self.since[kind, muscle]), name, state, ALARM_TEXT[kind].format(first), advice
