"""How somebody walks, and how many cycles count: cadence and stance of the latest strides, accepted and rejected cycles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.cycles.cycle import REASONS
from kinegraph.operators.cycles.statistics.ensemble_events import SESSION, rows_of
from kinegraph.stream.chunk import Array, Samples, Times


@dataclass(slots=True)
class StrideTally:
    """
    strides, stances (over,)  durations in s and stance in % of the latest accepted cycles, rings; numbers (over,); `walked` in all
    accepted, reasons (7,)    counts
    """

    strides: Samples
    stances: Samples
    numbers: Times
    walked: int
    accepted: int
    reasons: Array

    @staticmethod
    def empty(over: int) -> StrideTally:
        return StrideTally(
            np.full(over, np.nan), np.full(over, np.nan), np.full(over, -1), 0, 0, np.zeros(len(REASONS), np.int64)
        )

    def add(self, closed: Array) -> Array:
        """Count one more cycle; the session's event (`SESSION`)."""
        reason = str(closed["rejected"])
        if reason:
            self.reasons[REASONS.index(reason)] += 1
        else:
            k = self.walked % len(self.numbers)
            self.strides[k], self.stances[k] = closed["duration_s"], closed["stance_pct"]
            self.numbers[k] = closed["number"]
            self.walked += 1
            self.accepted += 1
        rows = rows_of(SESSION, closed[None], 1)
        strides, stances = self.strides[np.isfinite(self.strides)], self.stances[np.isfinite(self.stances)]
        rows["cadence"] = 60 / strides.mean() if len(strides) else np.nan
        rows["stance_pct"] = stances.mean() if len(stances) else np.nan
        rows["accepted"], rows["rejected"] = self.accepted, self.reasons.sum()
        for name, count in zip(REASONS, self.reasons, strict=True):
            rows[name.replace(" ", "_")] = count
        return rows

    def take_back(self, number: int) -> None:
        """A cycle that was accepted no longer is."""
        self.accepted -= 1
        here = self.numbers == number
        self.strides[here], self.stances[here], self.numbers[here] = np.nan, np.nan, -1
