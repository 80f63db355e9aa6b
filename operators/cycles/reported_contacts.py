"""One foot's reported contacts: touch-downs of open cycles, and the latest lift-offs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Times

WAITING, LIFTS = 16, 16


@dataclass(slots=True)
class ReportedContacts:
    """
    touches   (16, 2) touch-downs of open cycles, onset and stamp; `waiting` of them
    lifts     (16,) the latest lift-offs' onsets, a ring; `lifted` in all
    """

    touches: Times
    waiting: int
    lifts: Times
    lifted: int

    @staticmethod
    def empty() -> ReportedContacts:
        return ReportedContacts(np.zeros((WAITING, 2), np.int64), 0, np.zeros(LIFTS, np.int64), 0)

    @property
    def full(self) -> bool:
        """Whether there is no room for another touch-down."""
        return self.waiting == WAITING

    @property
    def first(self) -> tuple[int, int]:
        """Onset and stamp of the touch-down that has waited longest."""
        return int(self.touches[0, 0]), int(self.touches[0, 1])

    def touch(self, onset: int, stamp: int) -> None:
        self.touches[self.waiting] = onset, stamp
        self.waiting += 1

    def next_touch(self) -> None:
        """The first touch-down waits no longer."""
        self.touches[:-1] = self.touches[1:].copy()
        self.waiting -= 1

    def lift(self, onset: int) -> None:
        self.lifts[self.lifted % LIFTS] = onset
        self.lifted += 1

    def lifts_between(self, onset: int, end: int) -> list[int]:
        return [lift for lift in self.lifts[: self.lifted].tolist() if onset < lift < end]
