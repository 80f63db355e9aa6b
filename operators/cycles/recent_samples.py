"""The newest samples of a signal: enough for the longest cycle that may still have to be cut out of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import NEVER, Array, Samples, Times
from kinegraph.stream.data.finite import only_finite


@dataclass(slots=True)
class RecentSamples:
    """
    time, data   (2 keep,), (2 keep, c): the first `fill` count; `keep` of them suffice for any cycle
    began        the signal's first stamp
    """

    time: Times
    data: Samples
    fill: int
    keep: int
    began: int

    @staticmethod
    def of(keep: int, channels: int) -> RecentSamples:
        return RecentSamples(np.zeros(2 * keep, np.int64), np.zeros((2 * keep, channels)), 0, keep, NEVER)

    def append(self, time: Times, data: Array) -> None:
        """Add up to `keep` samples; of what came before, `keep` stay. What is not finite becomes NaN."""
        if not len(time):
            return
        if self.began == NEVER:
            self.began = int(time[0])
        if self.fill + len(time) > len(self.time):
            self.time[: self.keep] = self.time[self.fill - self.keep : self.fill].copy()
            self.data[: self.keep] = self.data[self.fill - self.keep : self.fill].copy()
            self.fill = self.keep
        self.time[self.fill : self.fill + len(time)] = time
        self.data[self.fill : self.fill + len(time)] = only_finite(data)
        self.fill += len(time)

    def after(self, stamp: int) -> int:
        """How many of the samples are stamped at or before `stamp`."""
        return int(self.time[: self.fill].searchsorted(stamp, "right"))
