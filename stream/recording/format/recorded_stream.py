"""What a recording knows of each of its streams without its samples being read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.recording.format.layout import Kept, Role, Table


@dataclass(slots=True)
class RecordedStream:
    """A stream as far as it was recorded.

    kept              how its samples are kept; "outline": only when they came, and how many, not the samples themselves
    samples, chunks   how many came (and stand in the recording, unless only their outline does)
    first, last       stamps of the first and the last sample (ns); None without samples
    gaps              places where samples are missing (`lost` != 0, or dropped by the recorder)
    lost              how many samples are known to be missing there; gaps of unknown size count nothing
    dropped           samples that the recorder itself had to drop because the disk was slow or full
    begin, end        cumulative index of the first recorded sample and of the one after the last
    until             up to where the stream is known to be complete
    last_sequence     the last chunk's index in the input log; -1: no chunk
    last_arrival      the last chunk's arrival (ns)
    """

    spec: StreamSpec
    role: Role
    kept: Kept = "whole"
    samples: int = 0
    chunks: int = 0
    first: int | None = None
    last: int | None = None
    gaps: int = 0
    lost: int = 0
    dropped: int = 0
    begin: int = 0
    end: int = 0
    until: int = 0
    last_sequence: int = -1
    last_arrival: int = 0

    def count(self, message: Table) -> None:
        """Take a further message into account."""
        table, times, first, _ = message
        if self.chunks and first > self.end:
            self.dropped += first - self.end
            self.gaps += 1
        elif not self.chunks:
            self.begin = first
        lost = table[:, 2]
        if lost.any():
            self.gaps += int(np.count_nonzero(lost))
            self.lost += int(lost[lost > 0].sum())
        self.chunks += len(table)
        self.samples += len(times)
        self.end = first + len(times)
        if len(times):
            self.first = int(times[0]) if self.first is None else self.first
            self.last = int(times[-1])
        _, self.until, _, self.last_arrival, self.last_sequence = table[-1].tolist()

    def follow(self, part: RecordedStream) -> None:
        """Take a further part of the recording into account."""
        if not part.chunks:
            return
        if self.chunks and part.begin > self.end:
            self.dropped += part.begin - self.end
            self.gaps += 1
        elif not self.chunks:
            self.begin = part.begin
        self.first = part.first if self.first is None else self.first
        self.last = self.last if part.last is None else part.last
        for name in ("samples", "chunks", "gaps", "lost", "dropped"):
            setattr(self, name, getattr(self, name) + getattr(part, name))
        for name in ("end", "until", "last_sequence", "last_arrival"):
            setattr(self, name, getattr(part, name))

    @property
    def duration_s(self) -> float:
        return 0.0 if self.first is None or self.last is None else (self.last - self.first) / NS

    @property
    def rate_hz(self) -> float | None:
        """The rate that was reached, over the whole recording; None below two samples."""
        return (self.samples - 1) / self.duration_s if self.duration_s > 0 else None

    def to_json(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in COUNTED}

    def fill(self, record: dict[str, Any]) -> None:
        """Set the counts from what `to_json` gave."""
        for name in COUNTED:
            setattr(self, name, record[name])


COUNTED = (
    *("samples", "chunks", "first", "last", "gaps", "lost", "dropped", "begin", "end", "until"),
    *("last_sequence", "last_arrival"),
)
