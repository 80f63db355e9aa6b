"""Numbers of single cycles that a report keeps until its end, of the latest ones where a session has more: bursts, frequencies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Array, Samples

ROOM = 20_000


@dataclass(slots=True)
class CycleStore:
    """rows (20000, 2 + k): cycle's number (-1: empty), muscle, and k values, a ring; seen: in all."""

    rows: Samples
    seen: int

    @staticmethod
    def empty(values: int) -> CycleStore:
        return CycleStore(np.full((ROOM, 2 + values), -1.0), 0)

    def add(self, number: int, muscle: int, values: list[float]) -> None:
        self.rows[self.seen % ROOM] = number, muscle, *values
        self.seen += 1

    def forget(self, number: int) -> None:
        """A cycle is reported again: what it gave no longer counts."""
        self.rows[self.rows[:, 0] == number, 0] = -1.0

    def of(self, muscle: int) -> Array:
        """A muscle's rows (n, 2 + k)."""
        return np.asarray(self.rows[(self.rows[:, 0] >= 0) & (self.rows[:, 1] == muscle)])


def circular(places: Samples) -> tuple[float, float]:
    """Mean and standard deviation of places in % of the cycle, around the circle."""
    angle = 2 * np.pi * places / 100
    x, y = float(np.cos(angle).mean()), float(np.sin(angle).mean())
    length = min(float(np.hypot(x, y)), 1.0)
    spread = float(np.sqrt(max(-2 * np.log(length), 0.0))) if length > 0 else float("nan")
    return float(np.arctan2(y, x)) / (2 * np.pi) * 100 % 100, spread / (2 * np.pi) * 100
