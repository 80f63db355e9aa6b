"""What is always measured: how long every node takes, what is lost; at well below a microsecond a message.

The durations of calls are gathered, and folded into a histogram of 16 bins per octave now and then, off the hot path. So a quantile is
exact to 4.4 %. Where a graph runs without a rest, not every call is timed (`stream.engine.chain`).
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np

from stream.chunk import Array

BINS_PER_OCTAVE = 16
BINS = 40 * BINS_PER_OCTAVE
FOLD_AT = 1024
"""Durations are folded at the latest after so many chunks."""


class Timing:
    """How long a node's calls took, as a histogram of ns.

    durations       ns of calls that are not folded yet; links append to it
    recent, total   calls by duration, since the last reading and before it
    """

    __slots__ = ("calls", "durations", "longest_ns", "recent", "total")

    def __init__(self) -> None:
        self.durations: array[int] = array("q")
        self.calls = 0
        self.longest_ns = 0
        self.total = np.zeros(BINS, np.int64)
        self.recent = np.zeros(BINS, np.int64)

    def fold(self) -> None:
        """Move the durations into the histogram."""
        if not self.durations:
            return
        taken = self.durations[:]
        del self.durations[: len(taken)]
        add(np.frombuffer(taken, np.int64)[None], [self])

    def read(self) -> dict[str, float]:
        """Quantiles in microseconds since the last reading (`p50_us`, `p99_us`) and since the start (`all_p50_us`, `all_p99_us`)."""
        self.fold()
        self.total += self.recent
        p50, p99 = _quantiles(self.recent)
        all_p50, all_p99 = _quantiles(self.total)
        self.recent[:] = 0
        return {
            "calls": self.calls,
            "p50_us": p50,
            "p99_us": p99,
            "all_p50_us": all_p50,
            "all_p99_us": all_p99,
            "longest_us": self.longest_ns / 1000,
        }


def add(ns: Array, timings: Sequence[Timing]) -> None:
    """Put durations (timings, calls) into the histograms of several nodes that were called as often."""
    bins = np.minimum((np.log2(np.maximum(ns, 1)) * BINS_PER_OCTAVE).astype(np.int64), BINS - 1)
    for timing, row, longest in zip(timings, bins, ns.max(axis=1).tolist(), strict=True):
        timing.calls += len(row)
        timing.longest_ns = max(timing.longest_ns, longest)
        timing.recent += np.bincount(row, minlength=BINS)


def _quantiles(histogram: Array) -> tuple[float, float]:
    """The middle of the bins that hold the median and the 99th percentile, in microseconds; 0 where nothing was measured."""
    below = np.cumsum(histogram)
    total = int(below[-1])
    if not total:
        return 0.0, 0.0
    p50, p99 = np.searchsorted(below, (0.5 * total, 0.99 * total)).tolist()
    return 2 ** ((p50 + 0.5) / BINS_PER_OCTAVE) / 1000, 2 ** ((p99 + 0.5) / BINS_PER_OCTAVE) / 1000


def rounded(row: dict[str, Any]) -> dict[str, Any]:
    """The row with short numbers, for logs and recordings."""
    return {name: round(value, 3) if isinstance(value, float) else value for name, value in row.items()}
