"""A recorded signal seen from afar: the least and the greatest value of equal pieces of time, made in one pass, and its gaps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.page.transfer.downsample import Curve, as_rows, breaks
from kinegraph.stream.chunk import Array, Chunk, StreamSpec, Times
from kinegraph.stream.recording.format.overview import Overview

PIECES = 1 << 15
MAX_PIECES = 1 << 17
MOST_VALUES = 1 << 23
"""Least (and as many greatest) values of one pyramid: `MAX_PIECES` of 64 channels."""
MAX_GAPS = 1000
AT_ONCE = 1 << 20
"""Values of a chunk that are looked at together."""
Rows = NDArray[np.float32]


class Pyramid:
    """Equal pieces of a signal from `first` to `last` (ns); pieces without a sample take no memory.

    width    of a piece (ns), at least two samples
    pieces   (m,) numbers of the pieces that hold samples, ascending; piece k begins at `first` + k `width`
    low      (m, c) float32, and `high`: NaN where a piece holds no value
    gaps     where samples are missing (ns): until when there were any, and from when again; at most `MAX_GAPS`
    """

    def __init__(
        self, spec: StreamSpec, first: int, last: int, pieces: int = PIECES, width: int = 0, most: int = MOST_VALUES
    ) -> None:
        """`most` values are kept: where there are many channels, of fewer pieces."""
        self.spec, self.first = spec, first
        self._channels = int(np.prod(spec.shape))
        pieces = max(1, min(pieces, most // max(self._channels, 1)))
        self.width = width or max(1, -(-(last - first + 1) // pieces), 2 * spec.period_ns)
        self.count = (last - first) // self.width + 1
        self.pieces: Times = np.empty(0, np.int64)
        self.low: Rows = np.empty((0, self._channels), np.float32)
        self.high = self.low
        self.gaps: list[tuple[int, int]] = []
        self._waiting: list[tuple[Times, Rows, Rows]] = []
        self._before: int | None = None

    @classmethod
    def seen(
        cls, spec: StreamSpec, overviews: Sequence[Overview], first: int, last: int, most: int = MOST_VALUES
    ) -> Pyramid:
        """The pyramid that the recorder left, at most `MAX_PIECES` long."""
        base = overviews[0].width_ns
        longest = max(1, min(MAX_PIECES, most // max(int(np.prod(spec.shape)), 1)))
        wide = base << max(0, ((last - first) // base // longest).bit_length())
        made = cls(spec, first // wide * wide, last, width=wide)
        before: int | None = None
        for part in overviews:
            made._take(part.pieces * part.width_ns // wide - made.first // wide, part.low, part.high)
            if before is not None and part.pieces[0] - before > 1:
                made.gaps.append(((before + 1) * base, int(part.pieces[0]) * base))
            made.gaps += part.gaps
            before = int(part.pieces[-1])
        made._settle()
        del made.gaps[MAX_GAPS:]
        return made

    def build(self, chunks: Iterable[Chunk], progress: Callable[[float], None]) -> None:
        """Take all samples; `progress` is given the share that is done."""
        for chunk in chunks:
            if not len(chunk.time):
                continue
            self._add(chunk)
            progress(min(1.0, max(0.0, (int(chunk.time[-1]) - self.first) / (self.width * self.count))))
        self._settle()

    def _add(self, chunk: Chunk) -> None:
        torn = np.flatnonzero(breaks(chunk.time, chunk.lost, self._before, self.spec.period_ns))
        for i in torn[: MAX_GAPS - len(self.gaps)]:
            before = int(chunk.time[i - 1]) if i else self._before
            self.gaps.append((int(chunk.time[i]) if before is None else before, int(chunk.time[i])))
        self._before = int(chunk.time[-1])
        rows = as_rows(chunk.data)
        step = max(1, AT_ONCE // max(self._channels, 1))
        for start in range(0, len(rows), step):
            part = rows[start : start + step]
            part = np.where(np.isfinite(part), part, np.nan).astype(np.float32)
            self._take((chunk.time[start : start + step] - self.first) // self.width, part, part)

    def _take(self, piece: Times, low: Array, high: Array) -> None:
        """Samples, or pieces of an overview, with the numbers of the pieces that they are in."""
        piece = np.clip(piece, 0, self.count - 1)
        starts = np.flatnonzero(np.diff(piece, prepend=-1))
        self._waiting.append((piece[starts], np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)))
        if sum(len(at) for at, _, _ in self._waiting) > len(self.pieces) + max(1, AT_ONCE // max(self._channels, 1)):
            self._settle()

    def _settle(self) -> None:
        """Have each piece once, and in order."""
        parts = [(self.pieces, self.low, self.high), *self._waiting]
        self._waiting = []
        piece, low, high = (np.concatenate(each) for each in zip(*parts, strict=True))
        if not len(piece):
            return
        if (np.diff(piece) < 0).any():  # stamps ran backwards
            order = np.argsort(piece, kind="stable")
            piece, low, high = piece[order], low[order], high[order]
        starts = np.flatnonzero(np.diff(piece, prepend=-1))
        self.pieces = piece[starts]
        self.low, self.high = np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)

    def curve(self, begin: int, end: int, width: int) -> Curve:
        """What is drawn between two times, in points `width` ns apart; where points lack, a row of NaN is a gap."""
        together = max(1, round(width / self.width))
        first = max(0, (begin - self.first) // self.width // together * together)
        last = min(self.count, (end - self.first) // self.width + 1)
        held = slice(*np.searchsorted(self.pieces, [first, max(first, last)]))
        point = (self.pieces[held] - first) // together
        if not len(point):
            return Curve(np.empty(0, np.int64), self.low[:0], self.high[:0])
        starts = np.flatnonzero(np.diff(point, prepend=-1))
        point = point[starts]
        low, high = np.fmin.reduceat(self.low[held], starts), np.fmax.reduceat(self.high[held], starts)
        gap = np.flatnonzero(np.diff(point) > 1) + 1
        point = np.insert(point, gap, point[gap - 1] + 1)
        low, high = (np.insert(rows, gap, np.nan, axis=0) for rows in (low, high))
        return Curve(self.first + (first + point * together) * self.width, low, high)
