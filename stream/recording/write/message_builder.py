"""A message of the recording while it is gathered: the chunks of one stream that come within about 100 ms.

Where a chunk is handed over, what may be written to later is copied, and nothing else is done: a buffer that grows would be copied time and
again. The recorder's thread joins a message's pieces in one go.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Array, Chunk, StreamSpec, Times
from kinegraph.stream.recording.format.layout import HEAD, INT, Kept

ROW = struct.Struct("<5q").pack
"""A chunk in a message's table: samples, until, lost, arrival, sequence."""
MAX_BYTES = 1 << 62
HELD_BYTES = 1 << 14
"""Samples of a computed edge with more bytes are held until they are written, not copied: they never change again."""


class MessageBuilder:
    """Chunks of one stream, in the order in which they came.

    first     cumulative index of the first sample
    count     of samples
    chunks    of chunks
    began     the first sample's stamp, or the first chunk's arrival (ns): the message's publish time
    arrival   of the last chunk
    size      bytes of memory that it takes
    frames    arrival, stamps and frames (n, height, width) of each chunk, where frames are messages of their own
    """

    __slots__ = (
        *("_copied", "_dtype", "_copies_below", "_kept", "_rows", "_samples", "_shape", "_spec", "_stamps", "_table"),
        *("arrival", "began", "count", "first", "frames", "size"),
    )

    def __init__(self, spec: StreamSpec, kept: Kept, first: int, *, copied: bool) -> None:
        """`copied`: what comes may be written to later, so it is copied at once."""
        self._spec, self._dtype, self._kept, self._copied, self.first = spec, spec.dtype, kept, copied, first
        plain = kept == "whole" and not spec.dtype.names  # not every structured dtype can be read as a buffer
        self._copies_below = 0 if not plain else MAX_BYTES if copied else HELD_BYTES
        self._shape: tuple[int, ...] = (-1,)
        self._rows = -1
        self.count = self.began = self.arrival = self.size = 0
        self.frames: list[tuple[int, list[int], Array]] = []
        self._table: list[bytes] = []
        self._stamps: list[bytes] = []
        self._samples: list[Any] = []

    @property
    def chunks(self) -> int:
        return len(self._table)

    def add(self, chunk: Chunk, n: int, size: int, arrival: int, sequence: int, *, owned: bool = False) -> None:
        """Take a further chunk of `n` samples and `size` bytes; raises ValueError or TypeError for one that is not of the stream's
        spec. `owned`: no source shares its memory, and it never changes again."""
        time, data = chunk.time, chunk.data
        if n != self._rows or data.shape != self._shape or data.dtype is not self._dtype or time.dtype is not INT:
            time, data = self._conformed(time, data)
        if size < self._copies_below and not (owned and size >= HELD_BYTES):
            self._samples.append(data.tobytes())
        else:
            self._add_other(time, data, arrival)
        if not self._table:
            self.began = time.item(0) if n else arrival
        self._table.append(ROW(n, chunk.until, chunk.lost, arrival, sequence))
        self._stamps.append(time.tobytes())
        self.count += n
        self.arrival = arrival
        self.size += size

    def _conformed(self, time: Times, data: Array) -> tuple[Times, Array]:
        """Stamps and samples in the declared types, of the declared shape."""
        if data.shape[1:] != self._spec.shape or len(data) != len(time):
            raise ValueError(f"samples of shape {data.shape[1:]} in a stream of shape {self._spec.shape}")
        self._shape, self._rows = data.shape, len(data)
        return time.astype(INT, copy=False), data.astype(self._dtype, copy=False)

    def _add_other(self, time: Times, data: Array, arrival: int) -> None:
        """Samples that are large, events, frames, or not kept."""
        if self._kept == "whole":
            self._samples.append(data.tobytes() if self._dtype.names else np.ascontiguousarray(data))
        elif self._kept != "outline" and len(time):
            self.frames.append((arrival, time.tolist(), data.copy() if self._copied else data))

    def body(self) -> bytes:
        """The message, as `stream.recording.format.layout` lays it out."""
        head = HEAD.pack(self.chunks, self.count, self.first)
        return b"".join([head, *self._table, *self._stamps, *self._samples])
