"""The latest cycles as they were reported, so that one can be taken back, or counted after all, by whatever adds cycles up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Samples, Times

REVISABLE = 64
"""This many of the latest cycles can be revised."""
UNKNOWN, ACCEPTED = -2, -1


@dataclass(slots=True)
class CycleHistory:
    """
    numbers (64,)    of the latest cycles, a ring; `seen` in all
    reasons (64,)    why each was rejected, as a number of the reader's own; ACCEPTED: it was not
    curves (64, points, m)   what was added up of it; NaN: nothing
    """

    numbers: Times
    reasons: Times
    curves: Samples
    seen: int

    @staticmethod
    def empty(points: int, muscles: int) -> CycleHistory:
        return CycleHistory(
            np.full(REVISABLE, -1), np.zeros(REVISABLE, np.int64), np.full((REVISABLE, points, muscles), np.nan), 0
        )

    def note(self, number: int, reason: int) -> int:
        """A cycle's event has come; gives the reason (or ACCEPTED) that was reported for it before, UNKNOWN if it is new."""
        found = np.flatnonzero(self.numbers == number)
        if len(found):
            before = int(self.reasons[found[0]])
            self.reasons[found[0]] = reason
            return before
        k = self.seen % REVISABLE
        self.numbers[k], self.reasons[k], self.curves[k] = number, reason, np.nan
        self.seen += 1
        return UNKNOWN

    def put(self, number: int, curve: Samples) -> None:
        """Keep what was added up of a cycle (points, m)."""
        self.curves[self.numbers == number] = curve

    def take(self, number: int) -> Samples:
        """What was added up of a cycle (points, m), which is then forgotten; NaN if nothing was."""
        found = np.flatnonzero(self.numbers == number)
        if not len(found):
            return np.full(self.curves.shape[1:], np.nan)
        curve: Samples = self.curves[found[0]].copy()
        self.curves[found[0]] = np.nan
        return curve

    def highest(self) -> Samples:
        """The highest kept value of each muscle (m,); 0 without any."""
        return np.asarray(np.nan_to_num(np.fmax.reduce(self.curves, axis=(0, 1))))
