"""What became of every sample that a device offered: recorded, counted as lost, or inside a marked gap of unknown size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from kinegraph.stream.chunk import NS, Times
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.format.layout import table


@dataclass(frozen=True, slots=True)
class Ledger:
    """Samples between the first and the last recorded one of a stream.

    offered    what the device made, by its own count
    recorded   what stands in the recording
    counted    what is missing and counted, place by place, by the recording
    uncounted  what is missing where the recording marks a gap without knowing its size
    silent     what is missing where the recording marks nothing, or less than is missing
    invented   what the recording counts as lost although it was never offered
    twice      what stands in the recording more than once, or out of order
    """

    offered: int = 0
    recorded: int = 0
    counted: int = 0
    uncounted: int = 0
    silent: int = 0
    invented: int = 0
    twice: int = 0

    @property
    def balanced(self) -> bool:
        return not (self.silent or self.invented or self.twice) and self.offered == (
            self.recorded + self.counted + self.uncounted
        )

    def __add__(self, other: Ledger) -> Ledger:
        return Ledger(*(getattr(self, n) + getattr(other, n) for n in Ledger.__dataclass_fields__))

    @classmethod
    def of(cls, index: Times, lost: Times) -> Self:
        """From the true index of each recorded sample (n,), and what its recording says is missing just before it (n,); -1: some."""
        if not len(index):
            return cls()
        steps, marks = np.diff(index), lost[1:]
        missing = np.maximum(steps - 1, 0)
        known, some = marks > 0, marks < 0
        return cls(
            offered=int(index[-1] - index[0]) + 1,
            recorded=len(index),
            counted=int(np.minimum(missing, marks)[known].sum()),
            uncounted=int(missing[some].sum()),
            silent=int(np.maximum(missing - np.maximum(marks, 0), 0)[~some].sum()),
            invented=int(np.maximum(marks - missing, 0)[known].sum()),
            twice=int((steps < 1).sum()),
        )


def marked(recording: Recording, name: str) -> tuple[Times, Times]:
    """A recorded stream's stamps (n,), and what it says is missing just before each (n,); -1: some. Frames need not have been kept."""
    times: list[Times] = []
    lost: list[Times] = []
    waiting = end = 0
    for part in recording.parts:
        for _, _, body, _ in part.messages({name} & part.streams.keys()):
            rows, stamps, first, _ = table(body)
            waiting = _sum(waiting, max(first - end, 0) if times else 0)
            end = first + len(stamps)
            before = np.zeros(len(stamps), np.int64)
            at = 0
            for samples, _, missing, _, _ in rows.tolist():
                waiting = _sum(waiting, missing)
                if samples:
                    before[at], waiting = waiting, 0
                at += samples
            times.append(stamps)
            lost.append(before)
    return np.concatenate([np.empty(0, np.int64), *times]), np.concatenate([np.empty(0, np.int64), *lost])


def _sum(one: int, other: int) -> int:
    return -1 if min(one, other) < 0 else one + other


def mended(index: Times, lost: Times, most: int) -> tuple[Times, int]:
    """Indices of lines with digits damaged on the way, which lines without a checksum cannot show, as their marks say; how many.

    Half a line, cut off where a stopped process's terminal was full, may join the next one into numbers: an index of `most` or more. If the
    line was another than its mark says, the next one does not balance.
    """
    index = index.copy()
    damaged = np.flatnonzero(index >= most)
    for at in damaged.tolist():
        if at:
            index[at] = index[at - 1] + 1 + max(int(lost[at]), 0)
    return index, len(damaged)


def by_stamps(times: Times, lost: Times, rate_hz: float) -> Times:
    """The index of each sample of a stream with stamps on a grid of `rate_hz`; a gap of unknown size counts as 0.

    What a source offers that begins its grid where it is opened is not known for the time in between.
    """
    steps = np.round(np.diff(times) * (rate_hz / NS)).astype(np.int64)
    steps[lost[1:] < 0] = 1
    return np.concatenate([np.zeros(min(len(times), 1), np.int64), np.cumsum(steps)])
