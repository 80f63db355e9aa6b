"""A message of the recording while it is gathered: the chunks of one stream that come within about 100 ms, joined as they come.

Joining where a chunk is handed over costs hardly more than the copy that has to be made there, and leaves the recorder's thread, which
shares the interpreter with the session, next to nothing to do for a chunk.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from stream.chunk import Array, Chunk, StreamSpec, Times
from stream.recording.format import HEAD, INT, Kept

ROW = struct.Struct("<5q").pack
"""A chunk in a message's table: samples, until, lost, arrival, sequence."""
HELD_BYTES = 1 << 14
"""Samples of a computed edge with more bytes are held until they are written, not joined: nobody writes to them again."""


class Gathering:
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
        *("_copied", "_dtype", "_joins", "_kept", "_samples", "_shape", "_spec", "_stamps", "_table", "_tail"),
        *("arrival", "began", "chunks", "count", "first", "frames", "size"),
    )

    def __init__(self, spec: StreamSpec, kept: Kept, first: int, *, copied: bool) -> None:
        """`copied`: what comes may be written to later, so it is copied at once."""
        self._spec, self._dtype, self._kept, self._copied, self.first = spec, spec.dtype, kept, copied, first
        self._joins = kept == "whole" and not spec.dtype.names  # not every structured dtype can be read as a buffer
        self._shape: tuple[int, ...] = (-1,)
        self.count = self.chunks = self.began = self.arrival = self.size = 0
        self.frames: list[tuple[int, list[int], Array]] = []
        self._table, self._stamps, self._tail = bytearray(), bytearray(), bytearray()
        self._samples: list[Any] = [self._tail]

    def add(self, chunk: Chunk, size: int, arrival: int, sequence: int) -> None:
        """Join a chunk of `size` bytes to the others; raises ValueError or TypeError for one that is not of the stream's spec."""
        time, data, n = chunk.time, chunk.data, len(chunk.time)
        if data.shape != self._shape or self._shape[0] != n or data.dtype is not self._dtype or time.dtype is not INT:
            time, data = self._conformed(time, data)
        if self._joins and (self._copied or size < HELD_BYTES):
            _extend(self._tail, data)
        else:
            self._add_unjoined(time, data, arrival)
        if not self.chunks:
            self.began = time.item(0) if n else arrival
        self._table.extend(ROW(n, chunk.until, chunk.lost, arrival, sequence))
        _extend(self._stamps, time)
        self.chunks += 1
        self.count += n
        self.arrival = arrival
        self.size += size

    def _conformed(self, time: Times, data: Array) -> tuple[Times, Array]:
        """Stamps and samples in the declared types, of the declared shape."""
        if data.shape[1:] != self._spec.shape or len(data) != len(time):
            raise ValueError(f"samples of shape {data.shape[1:]} in a stream of shape {self._spec.shape}")
        self._shape = data.shape
        return time.astype(INT, copy=False), data.astype(self._dtype, copy=False)

    def _add_unjoined(self, time: Times, data: Array, arrival: int) -> None:
        """Samples that are large, events, frames, or not kept."""
        if self._kept == "whole" and self._dtype.names:
            self._tail.extend(data.tobytes())
        elif self._kept == "whole":
            self._tail = bytearray()
            self._samples += [np.ascontiguousarray(data), self._tail]
        elif self._kept != "outline" and len(time):
            self.frames.append((arrival, time.tolist(), data.copy() if self._copied else data))

    def body(self) -> bytes:
        """The message, as `stream.recording.format` lays it out."""
        head = HEAD.pack(self.chunks, self.count, self.first)
        return b"".join([head, self._table, self._stamps, *self._samples])


def _extend(joined: bytearray, array: Array) -> None:
    try:
        joined.extend(array)
    except TypeError:  # its memory is not in order
        joined.extend(array.tobytes())
