"""What is always measured: how long every node takes, what is lost; at well below a microsecond a message.

The durations of calls are gathered, and folded into a histogram of 16 bins per octave now and then, off the hot path. So a quantile is
exact to 4.4 %. Where a graph runs without a rest, not every call is timed (`stream.engine.chain`).
"""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np

from stream.chunk import Array, Times

BINS_PER_OCTAVE = 16
BINS = 40 * BINS_PER_OCTAVE
FOLD_AT = 1024
"""Durations are folded at the latest after so many chunks."""


class Timing:
    """How long a node's calls took, as a histogram of ns.

    durations   ns of calls that are not folded yet; links append to it
    """

    __slots__ = ("_recent", "_total", "calls", "durations", "longest_ns")

    def __init__(self) -> None:
        self.durations: array[int] = array("q")
        self.calls = 0
        self.longest_ns = 0
        self._total = np.zeros(BINS, np.int64)
        self._recent = np.zeros(BINS, np.int64)

    def fold(self) -> None:
        """Move the durations into the histogram."""
        if not self.durations:
            return
        taken = self.durations[:]
        del self.durations[: len(taken)]
        self.add(np.frombuffer(taken, np.int64))

    def add(self, ns: Times) -> None:
        """Put durations into the histogram."""
        self.calls += len(ns)
        self.longest_ns = max(self.longest_ns, int(ns.max()))
        bins = np.minimum((np.log2(np.maximum(ns, 1)) * BINS_PER_OCTAVE).astype(np.int64), BINS - 1)
        self._recent += np.bincount(bins, minlength=BINS)

    def read(self) -> dict[str, float]:
        """Quantiles in microseconds since the last reading (`p50_us`, `p99_us`) and since the start (`all_p50_us`, `all_p99_us`)."""
        self.fold()
        self._total += self._recent
        row = {
            "calls": self.calls,
            "p50_us": _quantile(self._recent, 0.5),
            "p99_us": _quantile(self._recent, 0.99),
            "all_p50_us": _quantile(self._total, 0.5),
            "all_p99_us": _quantile(self._total, 0.99),
            "longest_us": self.longest_ns / 1000,
        }
        self._recent[:] = 0
        return row


def _quantile(histogram: Array, q: float) -> float:
    """The upper middle of the bin that holds quantile `q`, in microseconds; 0 where nothing was measured."""
    total = int(histogram.sum())
    if not total:
        return 0.0
    i = int(np.searchsorted(np.cumsum(histogram), q * total))
    return float(2 ** ((i + 0.5) / BINS_PER_OCTAVE) / 1000)


def rounded(row: dict[str, Any]) -> dict[str, Any]:
    """The row with short numbers, for logs and recordings."""
    return {name: round(value, 3) if isinstance(value, float) else value for name, value in row.items()}
