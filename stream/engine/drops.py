"""Drops, repeated: what a queue before a lane dropped live is left out again, sample by sample, so that replay is what was live."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stream.chunk import Chunk, add_lost

KIND = "queue dropped"
"""The kind of log entry that says so; its facts are `queue`, `first` (running index of the first sample) and `samples`."""


@dataclass(slots=True)
class Drops:
    """What was dropped before one lane: ranges of the running sample index, how far the stream has come, and how many samples were left out
    since the last that was not."""

    ranges: list[tuple[int, int]] = field(default_factory=list)
    index: int = 0
    owed: int = 0

    def repeat(self, chunk: Chunk) -> Chunk:
        """The chunk without the samples that were dropped, which are added to the next sample's `lost`."""
        n = len(chunk.time)
        first, self.index = self.index, self.index + n
        if not self.ranges and not self.owed:
            return chunk
        gone = np.zeros(n, bool)
        for start, count in self.ranges:
            gone[max(0, start - first) : max(0, start + count - first)] = True
        self.ranges = [(s, c) for s, c in self.ranges if s + c > self.index]
        if not gone.any():
            return self._marked(chunk)
        self.owed = add_lost(self.owed, add_lost(chunk.lost, int(gone.sum())))
        return self._marked(Chunk(chunk.time[~gone], chunk.data[~gone], chunk.until, 0))

    def _marked(self, chunk: Chunk) -> Chunk:
        if not self.owed or not len(chunk.time):
            return chunk
        lost, self.owed = add_lost(self.owed, chunk.lost), 0
        return Chunk(chunk.time, chunk.data, chunk.until, lost)


def recorded_drops(log: Iterable[dict[str, Any]]) -> dict[str, Drops]:
    """Per queue, what a session's log says was dropped."""
    drops: dict[str, Drops] = {}
    for entry in log:
        if entry.get("kind") == KIND:
            drops.setdefault(entry["queue"], Drops()).ranges.append((entry["first"], entry["samples"]))
    return drops
