"""The latest cycles' peaks and curves, as far back as a mixture of them needs; one that is taken back no longer counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.cycles.cycle import POINTS
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.kernel import kernel

MOST_PEAKS = POINTS // 2
REVISABLE = 64
"""This many of the latest cycles can still be reported again (`operators.cycles.history`)."""


@kernel
def gather(
    curves: Samples, peaks: Samples, tops: Times, slots: Times, group: Times, points: Samples, mean: Samples
) -> tuple[int, int]:
    """All peaks of a group's muscles in the cycles at `slots`, into `points` (most, 2), and their mean curve into `mean` (100,).

    Returns how many peaks, and how many curves (not counting muscles that are missing in a cycle).
    """
    found = counted = 0
    mean[:] = 0.0
    for slot in slots:
        for muscle in group:
            if np.isnan(curves[slot, 0, muscle]):
                continue
            counted += 1
            for p in range(mean.shape[0]):
                mean[p] += curves[slot, p, muscle]
            for i in range(tops[slot, muscle]):
                points[found, 0], points[found, 1] = peaks[slot, muscle, i, 0], peaks[slot, muscle, i, 1]
                found += 1
    for p in range(mean.shape[0]):
        mean[p] /= max(counted, 1)
    return found, counted


@kernel
def least_activity(curves: Samples, slots: Times, group: Times, mean: Samples, rest_sd: float, of_peak: float) -> float:
    """The height from which a peak is activity, not rest: as `operators.cycles.statistics.bursts.CycleBursts` begins a burst.

    Rest is the quietest tenth of the mean curve (one stretch), and the same stretch of each cycle. Activity is `rest_sd` of its standard
    deviations above it, and `of_peak` of the way from it to the mean curve's peak. With both 0 every peak is.
    """
    n = mean.shape[0]
    quiet = n // 10
    first, level, top = 0, np.inf, mean[0]
    for i in range(n):
        top = max(top, mean[i])
        total = 0.0
        for k in range(quiet):
            total += mean[(i + k) % n]
        if total / quiet < level:
            first, level = i, total / quiet
    squares, count = 0.0, 0
    for slot in slots:
        for muscle in group:
            if np.isnan(curves[slot, 0, muscle]):
                continue
            for k in range(quiet):
                squares += (curves[slot, (first + k) % n, muscle] - level) ** 2
                count += 1
    if rest_sd == 0.0 and of_peak == 0.0:
        return -np.inf
    return float(level + max(rest_sd * np.sqrt(squares / max(count, 1)), of_peak * (top - level)))


@kernel
def keep_active(points: Samples, count: int, least: float) -> int:
    """Move the points (count, 2) that are at least as high to the front; returns how many they are."""
    kept = 0
    for i in range(count):
        if points[i, 1] >= least:
            points[kept, 0], points[kept, 1] = points[i, 0], points[i, 1]
            kept += 1
    return kept


@dataclass(slots=True)
class PeakWindow:
    """A ring of cycles, each at its number modulo the ring's length. Of l limbs, number n is a cycle of limb (n - 1) modulo l.

    numbers (r,)             the cycle in each row, or -1;  accepted (r,): 1 where it counts
    tops (r, m), peaks (r, m, 50, 2)   of each muscle: how many local maxima, and their place in % and height
    curves (r, 100, m)       NaN: missing
    last                     the newest cycle's number;  limbs: l
    """

    numbers: Times
    accepted: Times
    tops: Times
    peaks: Samples
    curves: Samples
    last: int
    limbs: int

    @staticmethod
    def empty(cycles: int, muscles: int, limbs: int = 1) -> PeakWindow:
        r = max(REVISABLE, 2 * cycles) * limbs
        return PeakWindow(
            np.full(r, -1), np.zeros(r, np.int64), np.zeros((r, muscles), np.int64),
            np.zeros((r, muscles, MOST_PEAKS, 2)), np.full((r, POINTS, muscles), np.nan), -1, limbs,
        )  # fmt: skip

    def note_peaks(self, rows: Array) -> None:
        """Take local maxima (`operators.cycles.cycle.MAXIMUM`), but those without a place or a height; a cycle's come before its curve."""
        rows = rows[np.isfinite(rows["position_pct"]) & np.isfinite(rows["height"])]
        for number in np.unique(rows["number"]).tolist():
            slot = self._slot(number)
            of_cycle = rows[rows["number"] == number]
            for muscle in np.unique(of_cycle["muscle"]).tolist():
                more = of_cycle[of_cycle["muscle"] == muscle]
                had = int(self.tops[slot, muscle])
                n = min(len(more), MOST_PEAKS - had)
                self.peaks[slot, muscle, had : had + n, 0] = more["position_pct"][:n]
                self.peaks[slot, muscle, had : had + n, 1] = more["height"][:n]
                self.tops[slot, muscle] += n

    def accept(self, number: int, curve: Samples) -> None:
        """Count a cycle, with those muscles (100, m) that are not NaN."""
        slot = self._slot(number)
        self.curves[slot] = np.where(np.isfinite(curve).all(axis=0), curve, np.nan)
        self.accepted[slot] = 1
        self.last = number

    def reject(self, number: int) -> bool:
        """Count a cycle no longer; gives whether it did."""
        found = np.flatnonzero(self.numbers == number)
        if not len(found) or not self.accepted[found[0]]:
            return False
        self.accepted[found[0]] = 0
        return True

    def forget(self, limb: int) -> None:
        """Stop counting a limb's cycles."""
        self.accepted[(self.numbers - 1) % self.limbs == limb] = 0

    def take(self, other: PeakWindow) -> None:
        """Become a copy of another of the same size."""
        for name in ("numbers", "accepted", "tops", "peaks", "curves"):
            getattr(self, name)[...] = getattr(other, name)
        self.last = other.last

    def limb(self, number: int) -> int:
        """The limb of a cycle's number."""
        return (number - 1) % self.limbs

    def latest(self, cycles: int, limb: int = 0) -> Times:
        """Slots of a limb's latest accepted cycles, oldest first, at most `cycles`."""
        counts = (self.accepted == 1) & (self.numbers <= self.last) & (self.numbers > self.last - len(self.numbers))
        counts &= (self.numbers - 1) % self.limbs == limb
        slots = np.flatnonzero(counts)
        return np.ascontiguousarray(slots[np.argsort(self.numbers[slots])][-cycles:], np.int64)

    def _slot(self, number: int) -> int:
        slot = number % len(self.numbers)
        if self.numbers[slot] != number:
            self.numbers[slot], self.accepted[slot], self.tops[slot], self.curves[slot] = number, 0, 0, np.nan
        return slot
