"""Statistics that grow with a session but do not take more memory: running means, and an even choice of what there was."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from kinegraph.stream.chunk import Array, Samples


@dataclass(slots=True)
class Running:
    """Mean and standard deviation of every element of an array, NaN left out element by element (Welford 1962).

    Where `turn` is not 0 the numbers are places on a circle of that length (percent of a cycle: 99 and 1 are neighbours): the mean is
    the direction of the summed unit vectors, the spread its circular standard deviation (Mardia and Jupp 2000).
    """

    n: Samples
    mean: Samples
    squares: Samples
    turn: float = 0.0
    vector: Samples = field(default_factory=lambda: np.zeros(0))

    @staticmethod
    def of(shape: tuple[int, ...], turn: float = 0.0) -> Running:
        """Nothing seen yet."""
        vector = np.zeros((2, *shape)) if turn else np.zeros(0)
        return Running(np.zeros(shape), np.zeros(shape), np.zeros(shape), turn, vector)

    def add(self, values: Array) -> None:
        """One more array of the shape."""
        x = np.asarray(values, np.float64)
        seen = np.isfinite(x)
        self.n += seen
        if self.turn:
            angle = 2 * np.pi * np.where(seen, x, 0.0) / self.turn
            self.vector += np.where(seen, np.stack([np.cos(angle), np.sin(angle)]), 0.0)
            return
        off = np.where(seen, x - self.mean, 0.0)
        self.mean += off / np.maximum(self.n, 1)
        self.squares += np.where(seen, off * (x - self.mean), 0.0)

    def remove(self, values: Array) -> None:
        """Take out an array that was added."""
        x = np.asarray(values, np.float64)
        seen = np.isfinite(x)
        self.n -= seen
        if self.turn:
            angle = 2 * np.pi * np.where(seen, x, 0.0) / self.turn
            self.vector -= np.where(seen, np.stack([np.cos(angle), np.sin(angle)]), 0.0)
            return
        off = np.where(seen, x - self.mean, 0.0)
        self.mean = np.where(self.n > 0, self.mean - off / np.maximum(self.n, 1), 0.0)
        self.squares = np.where(self.n > 1, self.squares - off * np.where(seen, x - self.mean, 0.0), 0.0)

    def centre(self) -> Samples:
        """The means; NaN where nothing was seen."""
        if not self.turn:
            return np.where(self.n > 0, self.mean, np.nan)
        around = np.arctan2(self.vector[1], self.vector[0]) / (2 * np.pi) * self.turn % self.turn
        return np.where(self.n > 0, around, np.nan)

    def spread(self) -> Samples:
        """The standard deviations (n - 1 below the line); NaN where fewer than two were seen."""
        if not self.turn:
            return np.where(self.n > 1, np.sqrt(self.squares / np.maximum(self.n - 1, 1)), np.nan)
        length = np.hypot(*self.vector) / np.maximum(self.n, 1)
        with np.errstate(divide="ignore"):
            spread = np.sqrt(np.maximum(-2 * np.log(length), 0.0)) * self.turn / (2 * np.pi)
        return np.where(self.n > 1, spread, np.nan)


@dataclass(slots=True)
class Choice:
    """At most `room` arrays out of any number, evenly spaced, the same ones whenever the same came.

    Every `step`-th is kept; when there is no more room, every second one kept is let go and `step` doubles.
    """

    kept: Array
    numbers: Array
    count: int = 0
    step: int = 1
    seen: int = 0

    @staticmethod
    def of(room: int, shape: tuple[int, ...]) -> Choice:
        return Choice(np.zeros((room, *shape), np.float32), np.zeros(room, np.int64))

    def add(self, values: Array, number: int = 0) -> None:
        """Add an array of the shape; `number` can remove it later."""
        if self.seen % self.step == 0:
            if self.count == len(self.kept):
                half = self.kept[::2].copy()
                self.kept[: len(half)] = half
                self.numbers[: len(half)] = self.numbers[::2].copy()
                self.count, self.step = len(half), 2 * self.step
            if self.seen % self.step == 0:
                self.kept[self.count], self.numbers[self.count] = values, number
                self.count += 1
        self.seen += 1

    def remove(self, number: int) -> None:
        """Take out the array of this number, if it was chosen."""
        stays = self.numbers[: self.count] != number
        left = int(stays.sum())
        self.kept[:left], self.numbers[:left] = self.kept[: self.count][stays], self.numbers[: self.count][stays]
        self.count = left

    def chosen(self) -> Array:
        """The arrays kept (k, ...)."""
        return self.kept[: self.count]
