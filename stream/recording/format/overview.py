"""A recorded signal seen from afar: the least and the greatest value of equal pieces of time, written beside it as it is recorded.

Each file of a recording ends with one MCAP attachment per signal, which other readers pass over:

    u32 length of the header | header, JSON, padded to a multiple of 8 (with the u32) | int64 (n,) numbers of pieces |
    float32 (n, channels) least values | float32 (n, channels) greatest values; NaN: no finite value

Piece k lasts from k to k + 1 times `width_ns` since 1970; pieces without a sample are not there. A file of before, or of a killed process,
has no overview: it has to be read as a whole.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from math import prod
from struct import Struct
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Array, StreamSpec, Times
from kinegraph.stream.recording.format.layout import COLUMNS, Kept, table

NAME, MEDIA_TYPE = "kinegraph.overview/", "application/x-kinegraph-overview"
MIN_WIDTH_NS, MAX_WIDTH_NS = 1 << 26, 1 << 62
SAMPLES_IN_A_PIECE = 16
MAX_CHANNELS, MAX_GAPS = 64, 1000
COMPILED = "fdbBhHiIlLqQ"
"""The number types for which there is machine code; others are made float32 before."""
LENGTH = Struct("<I")
Rows: TypeAlias = NDArray[np.float32]


def width_of(spec: StreamSpec) -> int:
    """Length of a piece of a stream's overview (ns); 0: no overview. It pays for itself where a piece holds many samples."""
    if not spec.is_signal or not spec.period_ns or prod(spec.shape) > MAX_CHANNELS or spec.dtype.kind not in "fiu":
        return 0
    width = max(MIN_WIDTH_NS, 1 << (SAMPLES_IN_A_PIECE * spec.period_ns - 1).bit_length())
    return width if width < MAX_WIDTH_NS else 0


@dataclass(frozen=True, slots=True)
class Overview:
    """pieces    (n,) their numbers, ascending
    low, high    (n, channels)
    gaps         where samples are missing (ns): until when there were any, and from when again; at most `MAX_GAPS`
    """

    width_ns: int
    pieces: Times
    low: Rows
    high: Rows
    gaps: list[tuple[int, int]]


class OverviewWriter:
    """Takes a signal's messages as they are written. `width_ns` must not be 0. Making one compiles (or loads) its kernels."""

    def __init__(self, spec: StreamSpec, width_ns: int) -> None:
        from kinegraph.stream.recording.format.extremes import extremes, torn

        self._find_extremes, self._find_torn = extremes, torn
        self._spec, self._width = spec, width_ns
        self._channels = prod(spec.shape)
        self._pieces, self._low, self._high = bytearray(), bytearray(), bytearray()
        self._open: tuple[int, Rows, Rows] | None = None
        self._before: int | None = None
        self._gaps: list[tuple[int, int]] = []
        nothing = np.frombuffer(b"", np.int64)
        self._extremes(np.frombuffer(b"", spec.dtype).reshape(0, self._channels), nothing)
        torn(nothing.reshape(0, COLUMNS), nothing, 0, 0, np.empty((0, 2), np.int64))

    def add(self, body: bytes | memoryview) -> None:
        """Take the samples of a message."""
        rows, times, _, start = table(body)
        if not len(times):
            return
        count = len(times) * self._channels
        data = np.frombuffer(body, self._spec.dtype, count, start).reshape(len(times), self._channels)
        self._note_gaps(rows, times)
        self._append(*self._extremes(data, times))

    def _extremes(self, data: Array, times: Times) -> tuple[Times, Rows, Rows]:
        """The pieces of rows `data` (n, channels), and the least and the greatest values of each."""
        if data.dtype.char not in COMPILED or not data.dtype.isnative:
            with np.errstate(over="ignore"):
                data = data.astype(np.float32)
        numbers = times // self._width
        m = bool(len(times)) + int(np.count_nonzero(numbers[1:] != numbers[:-1]))
        pieces, low, high = np.empty(m, np.int64), *np.empty((2, m, data.shape[1]), np.float32)
        self._find_extremes(data, times, self._width, pieces, low, high)
        return pieces, low, high

    def _append(self, pieces: Times, low: Rows, high: Rows) -> None:
        """All but the last piece are complete."""
        if self._open and self._open[0] == pieces[0]:
            low[0], high[0] = np.fmin(low[0], self._open[1]), np.fmax(high[0], self._open[2])
        elif self._open:
            self._keep(np.array([self._open[0]]), self._open[1], self._open[2])
        self._keep(pieces[:-1], low[:-1], high[:-1])
        self._open = int(pieces[-1]), low[-1].copy(), high[-1].copy()

    def _keep(self, pieces: Times, low: Rows, high: Rows) -> None:
        self._pieces += pieces.astype("<i8").tobytes()
        self._low += low.astype("<f4").tobytes()
        self._high += high.astype("<f4").tobytes()

    def _note_gaps(self, rows: Times, times: Times) -> None:
        before = int(times[0]) if self._before is None else self._before
        gaps = np.empty((MAX_GAPS - len(self._gaps), 2), np.int64)
        found = self._find_torn(rows, times, before, 2 * self._spec.period_ns, gaps)
        self._gaps += [(begin, end) for begin, end in gaps[:found].tolist()]
        self._before = int(times[-1])

    def pack(self) -> bytes:
        """The attachment; b"" where no sample came."""
        if self._open:
            self._keep(np.array([self._open[0]]), self._open[1], self._open[2])
            self._open = None
        if not self._pieces:
            return b""
        facts = {
            "width_ns": self._width,
            "pieces": len(self._pieces) // 8,
            "channels": self._channels,
            "gaps": self._gaps,
        }
        text = json.dumps(facts).encode()
        text += b" " * (-(len(text) + LENGTH.size) % 8)
        return b"".join((LENGTH.pack(len(text)), text, self._pieces, self._low, self._high))


def overview_of(spec: StreamSpec, kept: Kept) -> OverviewWriter | None:
    """What sums up a stream while it is recorded; None for one that has no overview."""
    width = width_of(spec) if kept == "whole" else 0
    return OverviewWriter(spec, width) if width else None


def unpack(data: bytes, spec: StreamSpec) -> Overview:
    """What `pack` gave. Raises ValueError, KeyError, TypeError or struct.error for anything else."""
    end = LENGTH.size + LENGTH.unpack_from(data)[0]
    facts = json.loads(data[LENGTH.size : end])
    n, channels, width = facts["pieces"], facts["channels"], facts["width_ns"]
    if (
        channels != prod(spec.shape)
        or not 1 <= width < MAX_WIDTH_NS
        or n < 1
        or len(data) != end + n * (8 + 8 * channels)
    ):
        raise ValueError("an overview of another size")
    pieces = np.frombuffer(data, "<i8", n, end).astype(np.int64)
    if (np.diff(pieces) <= 0).any():
        raise ValueError("the pieces of an overview are out of order")
    low, high = np.frombuffer(data, "<f4", 2 * n * channels, end + 8 * n).astype(np.float32).reshape(2, n, channels)
    gaps = [(int(a), int(b)) for a, b in facts["gaps"][:MAX_GAPS]]
    np.array(gaps, np.int64)  # raises OverflowError for what is no stamp
    return Overview(width, pieces, low, high, gaps)
