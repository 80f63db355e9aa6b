"""What was added up of the latest cycles, so that one that is reported again can be taken out first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Array, Samples, Times

REVISABLE = 64
"""This many of the latest cycles can be reported again; `operators.cycles.history` remembers as many."""
ACCEPTED = -1


@dataclass(slots=True)
class Revisable:
    """
    numbers, stamps (64,)     of the latest cycles, a ring, and of their events; `seen` in all; number -1: empty
    reasons (64,)             why each was rejected, as a number of the reader's own; ACCEPTED: it was not
    onsets (64,)              when each began
    gait (64, 3), curves (64, points, m), fields (64, f, m)   what was added up of it, NaN where nothing was
    """

    numbers: Times
    stamps: Times
    reasons: Times
    onsets: Times
    gait: Samples
    curves: Samples
    fields: Samples
    seen: int

    @staticmethod
    def empty(gait: int, curve: tuple[int, ...], fields: int) -> Revisable:
        n = REVISABLE
        return Revisable(
            np.full(n, -1), np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64),
            np.full((n, gait), np.nan), np.full((n, *curve), np.nan), np.full((n, fields, curve[1]), np.nan), 0,
        )  # fmt: skip

    def find(self, number: int) -> int | None:
        """Where a cycle stands; None if it is not among the latest."""
        found = np.flatnonzero(self.numbers == number)
        return int(found[0]) if len(found) else None

    def note(self, row: Array, stamp: int, reason: int) -> int:
        """Take a cycle's event, in place of one that was reported before if there was one; gives where it stands."""
        number = int(row["number"])
        k = self.find(number)
        if k is None:
            k = self.seen % REVISABLE
            self.seen += 1
        self.numbers[k], self.stamps[k], self.reasons[k], self.onsets[k] = number, stamp, reason, int(row["onset"])
        self.gait[k], self.curves[k], self.fields[k] = np.nan, np.nan, np.nan
        return k

    def awaiting(self, stamp: int) -> int | None:
        """Index of the first accepted cycle at `stamp` that still waits for its curve."""
        here = (self.stamps == stamp) & (self.reasons == ACCEPTED) & (self.numbers >= 0)
        found = np.flatnonzero(here & np.isnan(self.curves).all(axis=(1, 2)))
        return int(found[0]) if len(found) else None
