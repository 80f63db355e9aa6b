"""A recorded signal seen from afar: the least and the greatest value of equal pieces of time, made in one pass, and its gaps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from devices.outlets.page.thin import Curve, as_rows, breaks
from stream.chunk import Chunk, StreamSpec
from stream.recording.overview import Overview

PIECES = 1 << 15
MOST_PIECES = 1 << 17
MOST_GAPS = 1000


class Pyramid:
    """Equal pieces of a signal from `first` to `last` (ns).

    width    of a piece (ns); none is narrower than two samples
    low      (pieces, c) float32, and `high`: NaN where a piece holds no value
    gaps     where samples are missing (ns): until when there were any, and from when again; at most `MOST_GAPS`
    """

    def __init__(self, spec: StreamSpec, first: int, last: int, pieces: int = PIECES, width: int = 0) -> None:
        self.spec, self.first = spec, first
        self.width = width or max(1, -(-(last - first + 1) // pieces), 2 * spec.period_ns)
        n = (last - first) // self.width + 1
        shape = (n, int(np.prod(spec.shape)))
        self.low: NDArray[np.float32] = np.full(shape, np.nan, np.float32)
        self.high: NDArray[np.float32] = np.full(shape, np.nan, np.float32)
        self.gaps: list[tuple[int, int]] = []
        self._before: int | None = None

    @classmethod
    def seen(cls, spec: StreamSpec, overviews: Sequence[Overview], first: int, last: int) -> Pyramid:
        """The pyramid that the recorder left, at most `MOST_PIECES` long."""
        base = overviews[0].width_ns
        wide = base << max(0, ((last - first) // base // MOST_PIECES).bit_length())
        made = cls(spec, first // wide * wide, last, width=wide)
        before: int | None = None
        for part in overviews:
            piece = np.clip(part.pieces * part.width_ns // wide - made.first // wide, 0, len(made.low) - 1)
            starts = np.flatnonzero(np.diff(piece, prepend=-1))
            at = piece[starts]
            made.low[at] = np.fmin(made.low[at], np.fmin.reduceat(part.low, starts))
            made.high[at] = np.fmax(made.high[at], np.fmax.reduceat(part.high, starts))
            if before is not None and part.pieces[0] - before > 1:
                made.gaps.append(((before + 1) * base, int(part.pieces[0]) * base))
            made.gaps += part.gaps
            before = int(part.pieces[-1])
        return made

    def build(self, chunks: Iterable[Chunk], progress: Callable[[float], None]) -> None:
        """Take all samples; `progress` is given the share that is done."""
        for chunk in chunks:
            if not len(chunk.time):
                continue
            self._add(chunk)
            progress(min(1.0, (int(chunk.time[-1]) - self.first) / (self.width * len(self.low))))

    def _add(self, chunk: Chunk) -> None:
        torn = np.flatnonzero(breaks(chunk.time, chunk.lost, self._before, self.spec.period_ns))
        for i in torn[: MOST_GAPS - len(self.gaps)]:
            before = int(chunk.time[i - 1]) if i else self._before
            self.gaps.append((int(chunk.time[i]) if before is None else before, int(chunk.time[i])))
        self._before = int(chunk.time[-1])
        rows = as_rows(chunk.data)
        rows = np.where(np.isfinite(rows), rows, np.nan).astype(np.float32)
        piece = np.clip((chunk.time - self.first) // self.width, 0, len(self.low) - 1)
        starts = np.flatnonzero(np.diff(piece, prepend=-1))
        at = piece[starts]
        self.low[at] = np.fmin(self.low[at], np.fmin.reduceat(rows, starts))
        self.high[at] = np.fmax(self.high[at], np.fmax.reduceat(rows, starts))

    def curve(self, begin: int, end: int, width: int) -> Curve:
        """What is drawn between two times, in points `width` ns apart; empty points are gaps."""
        together = max(1, round(width / self.width))
        first = max(0, (begin - self.first) // self.width // together * together)
        last = min(len(self.low), (end - self.first) // self.width + 1)
        if last <= first:
            return Curve(np.empty(0, np.int64), self.low[:0], self.high[:0])
        starts = np.arange(first, last, together)
        low, high = (
            side.reduceat(rows[first:last], starts - first)
            for side, rows in ((np.fmin, self.low), (np.fmax, self.high))
        )
        return Curve(self.first + starts * self.width, low, high)
