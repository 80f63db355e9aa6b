"""The records of an MCAP file, also of one that ends in the middle: where they lie, and the messages inside a chunk of them.

The `mcap` library's own reader gives up without a footer and spends some 15 us on a message; replay at hundreds of times real time needs
both otherwise, so records are hopped over here by their lengths, and only their contents are left to the library.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import NamedTuple, Protocol, Self, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema

from kinegraph.stream.data import bounded
from kinegraph.stream.errors import NothingRecorded, RecordingError

MAGIC = b"\x89MCAP0\r\n"
DAMAGE = (*bounded.DAMAGE, struct.error, McapError)
"""What reading a damaged record may raise."""
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_SPAN = struct.Struct("<QQ")
"""The first and the last time in a chunk of records, with which it begins."""
_UNPACKED = struct.Struct("<16xQ")
"""How large it is unpacked stands behind these."""


class _Readable(Protocol):
    """A kind of record that the library reads."""

    @classmethod
    def read(cls, stream: ReadDataStream) -> Self: ...


R = TypeVar("R", bound=_Readable)


class Record(NamedTuple):
    """Where a record's content lies in the file."""

    opcode: int
    offset: int
    length: int


class RawMessage(NamedTuple):
    """A message of a chunk: its channel, its batch (MCAP's "sequence"), and its body, a view of the chunk's memory."""

    channel: int
    batch: int
    log_time: int
    publish_time: int
    body: memoryview


class RecordFile:
    """An MCAP file as a list of whole records (but for its indexes); `finished` where it ends as it should.

    torn          bytes at its end that belong to no whole record
    torn_until    the last time in the chunk of records that breaks off there (ns); 0 where it is not known
    unpacked      bytes that its chunks of records say they hold
    """

    def __init__(self, path: Path) -> None:
        """Raises RecordingError for what is no MCAP file, or claims to hold far more than it can."""
        self.path = path
        try:
            self._file = path.open("rb", buffering=0)
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read ({error.strerror or error})") from None
        try:
            self._check_magic()
            self.finished = False
            self.torn = self.torn_until = 0
            self.unpacked = 0
            self.records = list(self._hop())
            bounded.check_whole(self.unpacked, self.size)
        except bounded.TooLarge as error:
            self._file.close()
            raise RecordingError(f"{path}: {error}; it is damaged or malicious") from None
        except BaseException:
            self._file.close()
            raise

    def _check_magic(self) -> None:
        self.size = os.fstat(self._file.fileno()).st_size
        magic = self._file.read(len(MAGIC))
        if not magic:
            raise NothingRecorded(f"{self.path}: the file is empty; nothing was written before the session ended")
        if self.size < len(MAGIC) and MAGIC.startswith(magic):
            raise NothingRecorded(
                f"{self.path}: truncated before anything was recorded; nothing can be recovered from it"
            )
        if magic != MAGIC:
            raise RecordingError(
                f"{self.path}: not an MCAP recording; CSV, NPZ and XDF files are read by `kinegraph files import`"
            )

    def close(self) -> None:
        self._file.close()

    def _hop(self) -> Iterator[Record]:
        """Every whole record, from its length to the next one's; ends where the file does, or where zeros or nonsense begin."""
        at = len(MAGIC)
        while at + _RECORD.size <= self.size:
            self._file.seek(at)
            head = self._file.read(_RECORD.size + _UNPACKED.size)
            if len(head) < _RECORD.size:
                return  # it became shorter since it was opened
            opcode, length = _RECORD.unpack_from(head)
            offset = at + _RECORD.size
            if opcode == 0 or offset + length > self.size:
                self._tear(at, opcode)
                return
            if opcode == Opcode.CHUNK and length >= _UNPACKED.size:
                declared = _UNPACKED.unpack_from(head, _RECORD.size)[0]
                self.unpacked += (
                    declared if declared <= bounded.most(length) else 0
                )  # a damaged one is refused by itself
            if opcode not in (Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX):
                yield Record(opcode, offset, length)
            at = offset + length
            if opcode == Opcode.FOOTER:
                self._file.seek(at)
                self.finished = self._file.read(len(MAGIC)) == MAGIC
                return
        self._tear(at, 0)

    def _tear(self, at: int, opcode: int) -> None:
        """The file breaks off in the record at `at`; the head of a chunk still says up to when it went."""
        self.torn = self.size - at
        if opcode == Opcode.CHUNK and self.torn >= _RECORD.size + _SPAN.size:
            self._file.seek(at + _RECORD.size)
            head = self._file.read(_SPAN.size)
            self.torn_until = _SPAN.unpack(head)[1] if len(head) == _SPAN.size else 0

    def content(self, record: Record) -> bytes:
        self._file.seek(record.offset)
        content: bytes = self._file.read(record.length)
        while len(content) < record.length:
            more: bytes = self._file.read(record.length - len(content))
            if not more:
                raise RecordingError(f"{self.path}: the file became shorter while it was read")
            content += more
        return content

    def stream(self, record: Record) -> ReadDataStream:
        """A record's content, as the library reads it."""
        return ReadDataStream(BytesIO(self.content(record)))

    def read(self, kind: type[R], record: Record) -> R:
        """A record of a kind. Raises RecordingError where it is damaged."""
        try:
            return kind.read(self.stream(record))
        except DAMAGE as error:
            raise self.damage(record, error) from None

    def damage(self, record: Record, error: Exception) -> RecordingError:
        """The error that says where the file is damaged."""
        what = str(error) or type(error).__name__
        return RecordingError(
            f"{self.path}: damaged at byte {record.offset} ({what}); `kinegraph recover` rewrites what can be read"
        )

    def header(self) -> Header | None:
        first = self.records[0] if self.records else None
        return self.read(Header, first) if first is not None and first.opcode == Opcode.HEADER else None

    def metadata(self, name: str, *, at_end: bool = False) -> dict[str, str] | None:
        """The metadata record of this name, looked for from the beginning or from the end."""
        for record in reversed(self.records) if at_end else self.records:
            if record.opcode == Opcode.METADATA:
                metadata = self.read(Metadata, record)
                if metadata.name == name:
                    found: dict[str, str] = metadata.metadata
                    return found
        return None

    @property
    def chunks(self) -> list[Record]:
        return [record for record in self.records if record.opcode == Opcode.CHUNK]

    def unpack(self, record: Record) -> bytes:
        """A chunk's records, decompressed and checked. Raises RecordingError where the file is damaged."""
        try:
            chunk = Chunk.read(self.stream(record))
            data: bytes = chunk.data
            if chunk.compression == "zstd":
                data = bounded.unpack_zstd(chunk.data, chunk.uncompressed_size)
            elif chunk.compression == "lz4":
                data = bounded.unpack_lz4(chunk.data, chunk.uncompressed_size)
            elif chunk.compression:
                raise ValueError(f"it is packed by {chunk.compression!r}, which is not known")
            if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
                raise ValueError("its checksum is wrong")
        except DAMAGE as error:
            raise self.damage(record, error) from None
        return data


def declared(data: bytes) -> Iterator[Channel | Schema]:
    """The schemas and channels declared in a chunk."""
    for opcode, offset, length in _records(data):
        if opcode == Opcode.SCHEMA:
            yield Schema.read(ReadDataStream(BytesIO(data[offset : offset + length])))
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(ReadDataStream(BytesIO(data[offset : offset + length])))


def messages(data: bytes) -> Iterator[RawMessage]:
    """The messages in a chunk, in the order in which they were written."""
    view = memoryview(data)
    for opcode, offset, length in _records(data):
        if opcode == Opcode.MESSAGE:
            channel, batch, log_time, publish_time = _MESSAGE.unpack_from(data, offset)
            yield RawMessage(channel, batch, log_time, publish_time, view[offset + _MESSAGE.size : offset + length])


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Every record in a chunk of them. Raises ValueError where they do not fit into it."""
    at, end, size = 0, len(data), _RECORD.size
    unpack = _RECORD.unpack_from
    while at < end:
        opcode, length = unpack(data, at) if at + size <= end else (0, 0)
        if not opcode or at + size + length > end:
            raise ValueError(f"its records end abruptly at byte {at} of {end}")
        yield opcode, at + size, length
        at += size + length
