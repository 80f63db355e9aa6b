"""What is always measured: how long every node takes, what is lost; at well below a microsecond a message.

The durations of calls are gathered, and folded into a histogram of 16 bins per octave now and then, off the hot path. So a quantile is
exact to 4.4 %. Where a graph runs without a rest, not every call is timed (`stream.engine.flow.segment`).
"""

from __future__ import annotations

import math
from array import array
from time import perf_counter_ns
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Times
from kinegraph.stream.kernel import kernel

BINS_PER_OCTAVE = 16
BINS = 40 * BINS_PER_OCTAVE
MIDDLES_NS = 2 ** ((np.arange(BINS) + 0.5) / BINS_PER_OCTAVE)
FOLD_AT = 1024
"""Durations are folded at least once per this many chunks."""


class Timing:
    """How long a node's calls took, as a histogram of ns.

    durations       ns of calls that are not folded yet; links append to it
    recent, total   calls by duration, since the last reading and before it
    read_ns         when it was read last
    """

    __slots__ = ("calls", "durations", "longest_ns", "read_ns", "recent", "total")

    def __init__(self) -> None:
        self.durations: array[int] = array("q")
        self.calls = 0
        self.longest_ns = 0
        self.read_ns = perf_counter_ns()
        self.total = np.zeros(BINS, np.int64)
        self.recent = np.zeros(BINS, np.int64)

    def fold(self) -> None:
        """Move the durations into the histogram."""
        if not self.durations:
            return
        taken = self.durations[:]
        del self.durations[: len(taken)]
        times = np.ones((len(taken), 2), np.int64)
        times[:, 1] += np.frombuffer(taken, np.int64)
        add(times, 0, self)

    def read(self) -> dict[str, float]:
        """Quantiles in microseconds since the last reading (`p50_us`, `p99_us`) and since the start (`all_p50_us`, `all_p99_us`); and
        `cpu_pct`, the part of a core that the calls timed since the last reading took."""
        self.fold()
        before, self.read_ns = self.read_ns, perf_counter_ns()
        busy_ns = float((self.recent * MIDDLES_NS).sum())
        p50, p99, all_p50, all_p99 = map(_middle, take_stock(self.recent, self.total))
        return {
            "calls": self.calls,
            "p50_us": p50,
            "p99_us": p99,
            "all_p50_us": all_p50,
            "all_p99_us": all_p99,
            "longest_us": self.longest_ns / 1000,
            "cpu_pct": 100 * busy_ns / max(self.read_ns - before, 1),
        }


def add(times: Times, k: int, timing: Timing) -> None:
    """Put into a node's histogram how long its calls took, which lasted from `times[:, k]` to `times[:, k + 1]` (calls, ...) in ns; a call
    whose end is 0 was not made."""
    calls, longest = tally(times, k, timing.recent)
    timing.calls += calls
    timing.longest_ns = max(timing.longest_ns, longest)


@kernel
def tally(times: Times, k: int, histogram: Times) -> tuple[int, int]:
    """Count durations in their bins; returns how many there were, and the longest."""
    calls = longest = 0
    for i in range(times.shape[0]):
        if times[i, k + 1]:
            ns = max(times[i, k + 1] - times[i, k], 1)
            histogram[min(int(math.log2(ns) * BINS_PER_OCTAVE), BINS - 1)] += 1
            calls += 1
            longest = max(longest, ns)
    return calls, longest


def take_stock(recent: Times, total: Times) -> tuple[int, int, int, int]:
    """Count the recent calls among all; returns the bins that hold the median and the 99th percentile of both."""
    total += recent
    found = *quantiles(recent), *quantiles(total)
    recent[:] = 0
    return found


def quantiles(histogram: Times) -> tuple[int, int]:
    """The bins that hold the median and the 99th percentile; -1 where the histogram is empty."""
    below = np.cumsum(histogram)
    if not below[-1]:
        return -1, -1
    p50, p99 = np.searchsorted(below, (0.5 * below[-1], 0.99 * below[-1]))
    return int(p50), int(p99)


def _middle(k: int) -> float:
    """The middle of a bin in microseconds; 0 where nothing was measured."""
    return 2 ** ((k + 0.5) / BINS_PER_OCTAVE) / 1000 if k >= 0 else 0.0


def rounded(row: dict[str, Any]) -> dict[str, Any]:
    """The row with short numbers, for logs and recordings."""
    return {name: round(value, 3) if isinstance(value, float) else value for name, value in row.items()}
