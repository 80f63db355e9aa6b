"""Neighbours computed plainly: every frame of the window, one after another. What the index must agree with, to the bit or nearly."""

from __future__ import annotations

import numpy as np


class Window:
    """The newest frames (n, width) as float32, in a list; squared distances by the stated rule, and in float64."""

    def __init__(self, width, window):
        self.window = window
        self.rows = np.empty((0, width), np.float32)
        self.reach = np.empty(0)
        self.first = 0
        self.weights = np.ones(width, np.float32)

    def insert(self, x, radius=np.nan):
        row = np.asarray(x, np.float64)
        good = np.isfinite(row).all() and (np.abs(row) <= 1e18).all()
        row = row.astype(np.float32) if good else np.full(len(row), np.nan, np.float32)
        self.rows = np.concatenate([self.rows, row[None]])[-self.window :]
        self.reach = np.append(self.reach, radius)[-self.window :]
        self.first += len(self.rows) == self.window and self.full
        self.full = len(self.rows) == self.window

    full = False

    @property
    def numbers(self):
        return np.arange(self.first, self.first + len(self.rows))

    def squared(self, q):
        """(n,) float32: each operation rounded, feature after feature; NaN for a bad frame."""
        total = np.zeros(len(self.rows), np.float32)
        q = np.asarray(q, np.float32)
        with np.errstate(over="ignore"):
            for i, w in enumerate(self.weights):
                off = self.rows[:, i] - q[i]
                total = total + (w * off) * off
        return total

    def distances64(self, q):
        """(n,) float64, without any rounding but the frames' own."""
        off = self.rows.astype(np.float64) - np.asarray(q, np.float32).astype(np.float64)
        return np.sqrt((off * off) @ self.weights.astype(np.float64))

    def allowed(self, at, band, squared):
        return (np.abs(self.numbers - at) > band) & np.isfinite(squared)

    def nearest(self, k, q, at, band):
        """Frames and distances, nearest first, ties: the older first."""
        squared = self.squared(q)
        ok = self.allowed(at, band, squared)
        numbers, squared = self.numbers[ok], squared[ok]
        order = np.lexsort((numbers, squared))[:k]
        return numbers[order], np.sqrt(squared[order])

    def within(self, radius, q, at, band, both=False):
        """Frames and distances, the oldest first, and both ways (m, 2)."""
        squared = self.squared(q)
        ok = self.allowed(at, band, squared)
        with np.errstate(invalid="ignore"):
            d = np.sqrt(squared)
            ways = np.stack([d <= np.float32(radius), d <= self.reach.astype(np.float32)], 1)
        ok &= ways.any(1) if both else ways[:, 0]
        return self.numbers[ok], d[ok], ways[ok]
