"""One file of a recording while it is written: messages gather in memory, and go to the disk as far as it takes them."""

from __future__ import annotations

import errno
import os
import struct
from collections import deque
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import IO, Any, cast

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.recording.format import overview, packed
from kinegraph.stream.recording.format.image import CHUNKS, SCHEMA, descriptor
from kinegraph.stream.recording.format.layout import (
    ENCODING,
    FORMAT,
    HEADER,
    LOG,
    LOG_SCHEMA,
    METRICS,
    METRICS_SCHEMA,
    PROFILE,
    SUMMARY,
    Kept,
    Role,
    dump,
    schema_of,
)
from kinegraph.stream.system.atomic_file import PRIVATE

PIECE = 4 << 20
"""A write call takes pieces until they have this many bytes."""
TOGETHER, MAX_PIECES = hasattr(os, "writev"), 64
"""Whether the system takes several pieces in one call, and how many: between two calls other threads take the interpreter."""
CHUNK_BYTES, LIVE_CHUNK_BYTES = 1 << 20, 2 << 20
"""Messages with more bytes are compressed at once, without waiting for the next `save`. Beside a live session less often, for each time
that the recorder's thread lets the interpreter go, to compress, and takes it back, holds the session up for a fraction of a millisecond."""
RECORD = struct.Struct("<BQ").pack
"""How a record begins: its opcode, and how many bytes follow."""


class DisturbedError(OSError):
    """Another program has deleted, moved or cut a file that is being written."""


class FileSegment:
    """A file in which every byte up to the last `save` that returned is whole messages; a `save` that raised can be tried again."""

    def __init__(
        self, path: Path, number: int, header: dict[str, Any], compression: CompressionType, *, live: bool = False
    ) -> None:
        """Creates the file, of a `live` session or not; raises OSError if that cannot be, FileExistsError if it is there."""
        self.path = path
        self.number = number
        self.saved = 0
        """Size of the file at the end of the last `save`."""
        self._spool = _Spool()
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), PRIVATE)
        self._written = 0
        self._finished = False
        self._writer = Writer(cast("IO[bytes]", self._spool), LIVE_CHUNK_BYTES if live else CHUNK_BYTES, compression)
        _join_once(self._writer)
        self._writer.start(PROFILE)
        self._writer.add_metadata(HEADER, {"format": str(FORMAT), "part": str(number), "header": dump(header).decode()})
        self._json = {
            LOG: self._declare_json(LOG, "foxglove.Log", LOG_SCHEMA),
            METRICS: self._declare_json(METRICS, "kinegraph.Metrics", METRICS_SCHEMA),
        }

    def _declare_json(self, topic: str, name: str, schema: bytes) -> int:
        return self._writer.register_channel(topic, "json", self._writer.register_schema(name, "jsonschema", schema))

    def declare(self, name: str, spec: StreamSpec, role: Role, kept: Kept = "whole") -> int:
        """The channel of a stream's chunks; a stream of frames gives its own name to the images."""
        schema = self._writer.register_schema(f"kinegraph.{name}", ENCODING, schema_of(spec, role, kept))
        topic = name if kept == "whole" else name + CHUNKS
        return self._writer.register_channel(topic, ENCODING, schema, {"role": role, "stream": name})

    def declare_frames(self, name: str, kept: Kept) -> int:
        """The channel of a stream's frames, kept as images or packed."""
        if kept == "packed":
            schema = self._writer.register_schema(packed.ENCODING, packed.ENCODING, packed.SCHEMA)
            return self._writer.register_channel(name, packed.ENCODING, schema)
        schema = self._writer.register_schema(SCHEMA, "protobuf", descriptor())
        return self._writer.register_channel(name, "protobuf", schema)

    def channel_of(self, topic: str) -> int:
        """The channel of the log or of the metrics."""
        return self._json[topic]

    def add(self, channel: int, log_time: int, publish_time: int, batch: int, body: bytes) -> None:
        """A message; to memory only. Times before 1970 are written as 0, for MCAP's are unsigned (the body keeps the true ones)."""
        self._writer.add_message(channel, max(log_time, 0), body, max(publish_time, 0), batch & 0xFFFFFFFF)

    @property
    def waiting(self) -> int:
        """Bytes in memory that `save` would write, without the chunk being compressed."""
        return self._spool.size

    def save(self, *, sync: bool = False) -> None:
        """Write everything so far. Raises OSError as the disk gives it; what it did not take is kept for the next try."""
        self._check_place()
        self._writer.flush()  # type: ignore[no-untyped-call]
        while pieces := self._spool.pieces():
            # the disk may take less than it is given: what it took is counted, the rest stays for the next try
            n = os.writev(self._file, pieces) if TOGETHER else os.write(self._file, pieces[0])
            self._spool.drop(n)
            self._written += n
        self.saved = self._written
        if sync:
            os.fsync(self._file)

    def _check_place(self) -> None:
        """Raises DisturbedError if another program has deleted, moved or cut the file: what is written now would be lost."""
        if not self.path.exists():
            raise DisturbedError(errno.ENOENT, "the file was deleted or moved", str(self.path))
        # a write behind a cut would leave zeros in between, which no reader could tell from data
        if os.fstat(self._file).st_size < self._written:
            raise DisturbedError(errno.EIO, "another program has cut the file", str(self.path))

    def finish(self, summary: dict[str, Any], overviews: Mapping[str, bytes]) -> None:
        """Write the end: overviews of signals, counts per stream, the index, the footer. Raises OSError; it can be tried again."""
        if not self._finished:
            # set first: a second try after a full disk must not write the end twice
            self._finished = True
            for name, packed_overview in overviews.items():
                self._writer.add_attachment(0, 0, overview.NAME + name, overview.MEDIA_TYPE, packed_overview)
            self._writer.add_metadata(SUMMARY, {"streams": dump(summary).decode()})
            self._writer.finish()  # type: ignore[no-untyped-call]
        self.save(sync=True)
        os.close(self._file)

    def abandon(self) -> None:
        """Close without an end, cut after the last whole `save`; a file into which nothing was saved is removed."""
        try:
            os.ftruncate(self._file, min(self.saved, os.fstat(self._file).st_size))
        finally:
            os.close(self._file)
            if not self.saved:
                self.path.unlink(missing_ok=True)


class _Records(RecordBuilder):
    """Records while they are made: pieces that are joined once, where the library's own copies each into a buffer that grows."""

    def __init__(self) -> None:
        self._pieces: list[bytes] = []
        self._begun: tuple[int, int, Opcode] | None = None
        self._size = 0

    @property
    def count(self) -> int:
        return self._size

    def start_record(self, opcode: Opcode) -> None:
        self.write(RECORD(opcode, 0))
        self._begun = len(self._pieces) - 1, self._size, opcode

    def finish_record(self) -> None:
        assert self._begun
        place, start, opcode = self._begun
        self._pieces[place] = RECORD(opcode, self._size - start)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self._pieces.append(bytes(data))  # of bytes no copy
        self._size += len(data)

    def end(self) -> bytes:
        whole = b"".join(self._pieces)
        self._pieces, self._size = [], 0
        return whole


def _join_once(writer: Writer) -> None:
    """Have the library's writer make its records as `_Records` do; one of another version that is built otherwise stays as it is."""
    # private names of the library: where they are missing, its own slower way is used
    chunk = getattr(writer, "_Writer__chunk_builder", None)
    if hasattr(writer, "_Writer__record_builder") and hasattr(chunk, "record_writer"):
        vars(writer)["_Writer__record_builder"] = _Records()
        chunk.record_writer = _Records()  # type: ignore[union-attr]


class _Spool:
    """Memory that the MCAP writer takes for a file. What it is given is kept as it is, not copied.

    size   bytes that wait
    """

    def __init__(self) -> None:
        self._waiting: deque[memoryview] = deque()
        self._total = self.size = 0

    def write(self, data: bytes) -> int:
        if data:
            self._waiting.append(memoryview(data))
            self._total += len(data)
            self.size += len(data)
        return len(data)

    def pieces(self) -> list[memoryview]:
        """What is to be written next, in order; nothing waits: []."""
        found: list[memoryview] = []
        size = 0
        for piece in islice(self._waiting, MAX_PIECES):
            found.append(piece[: PIECE - size])
            size += len(found[-1])
            if size == PIECE:
                break
        return found

    def drop(self, n: int) -> None:
        """The first `n` bytes are written."""
        self.size -= n
        while n:
            first = self._waiting.popleft()
            if n < len(first):
                self._waiting.appendleft(first[n:])
            n -= min(n, len(first))

    def flush(self) -> None:
        """What is pending goes to the disk by `FileSegment.save` only."""

    def tell(self) -> int:
        return self._total
