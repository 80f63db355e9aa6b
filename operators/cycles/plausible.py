"""Whether a gait cycle can be one: its signal whole, its contacts in order, its duration like its neighbours'."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kinegraph.operators.cycles.cycle import Closing
from kinegraph.stream.chunk import Samples, Times

RECENT, FIRST = 11, 5
APART = 0.1
"""Lift-offs further apart than this part of their cycle are two, not one that chattered."""
NO_MEASURE = ("too short", "too long", "gap", "order", "stance")
"""Cycles rejected for these reasons say nothing of how long a cycle is."""


def signal_reason(time: Times, onset: int, began: int, settling: int, longest_step: int) -> str:
    """Why the signal, stamped `time` (n,), does not carry a cycle from `onset` on; "" if it does. All in ns."""
    gaps = time[1:][np.diff(time) > longest_step]
    if (gaps > onset).any():
        return "gap"
    if onset < began:
        return "incomplete"
    return "settling" if (gaps > onset - settling).any() or onset < began + settling else ""


def out_of_order(lifts: list[int], duration: int) -> bool:
    """Whether a foot that left the ground twice in one cycle of `duration` must have come down in between."""
    return bool(lifts) and max(lifts) - min(lifts) > APART * duration


@dataclass(slots=True)
class Durations:
    """
    latest   (11,) the latest plausible cycles' durations in ns, a ring; `measured` in all
    first    (5, 3) number, onset and end of those that came before there was a median; stances (5,); accepted (5,): 0 or 1
    """

    latest: Times
    measured: int
    first: Times
    stances: Samples
    accepted: Times

    @staticmethod
    def empty() -> Durations:
        return Durations(
            np.zeros(RECENT, np.int64), 0, np.zeros((FIRST, 3), np.int64), np.zeros(FIRST), np.zeros(FIRST, np.int64)
        )

    def irregular(self, duration: int, off_median: float) -> bool:
        """Whether a cycle's duration is off the median of the latest by more than `off_median` of it; never before there is one."""
        if not off_median or self.measured < FIRST:
            return False
        median = float(np.median(self.latest[: self.measured]))
        return abs(duration - median) > off_median * median

    def judge(self, closing: Closing, off_median: float) -> list[Closing]:
        """Take a cycle's duration; gives the cycle, and events of those of the first that are taken back now that there is a median."""
        if closing.rejected in NO_MEASURE:
            return [closing]
        self.latest[self.measured % RECENT] = closing.end - closing.onset
        self.measured += 1
        if self.measured > FIRST:
            return [closing]
        k = self.measured - 1
        self.first[k], self.stances[k] = (closing.number, closing.onset, closing.end), closing.stance_pct
        self.accepted[k] = not closing.rejected
        if self.measured < FIRST:
            return [closing]
        if not closing.rejected and self.irregular(closing.end - closing.onset, off_median):
            closing = replace(closing, rejected="irregular")
        return [closing, *self._taken_back(closing, off_median)]

    def _taken_back(self, closing: Closing, off_median: float) -> list[Closing]:
        rows = zip(self.first[:-1].tolist(), self.stances[:-1].tolist(), self.accepted[:-1].tolist(), strict=True)
        return [
            Closing(closing.stamp, onset, end, number, stance, "irregular", closing.curve, again=True)
            for (number, onset, end), stance, accepted in rows
            if accepted and self.irregular(end - onset, off_median)
        ]
