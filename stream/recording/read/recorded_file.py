"""One file of a recording, finished or not: its header, its streams, and its messages."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from struct import Struct
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Schema

from kinegraph.stream.errors import NothingRecorded, RecordingError
from kinegraph.stream.recording.format import overview
from kinegraph.stream.recording.format.layout import (
    ENCODING,
    HEADER,
    LOG,
    METRICS,
    PROFILE,
    SUMMARY,
    check_format,
    spec_of,
    table,
)
from kinegraph.stream.recording.format.overview import Overview
from kinegraph.stream.recording.format.recorded_stream import RecordedStream
from kinegraph.stream.recording.read.records import DAMAGE, RawMessage, Record, RecordFile, declared, messages

_ATTACHMENT = Struct("<QQI")
"""An attachment begins with two times and the length of its name."""


class RecordedFile:
    """One file of a recording, and what is known of its streams."""

    def __init__(self, path: Path, *, forgiving: bool = False) -> None:
        """Raises RecordingError for a file that is no recording of ours, is newer than we are, or holds nothing.

        With `forgiving`, every byte is read, and damaged places are left out and counted in `damaged`.
        """
        self.damaged = self._left_out = 0
        self._forgiving = forgiving
        self.file = RecordFile(path)
        try:
            self._open()
        except BaseException:
            self.file.close()
            raise

    def _open(self) -> None:
        self.header = self._read_header()
        self.chunks = self.file.chunks
        self.topics: dict[int, str] = {}
        self.images: dict[int, str] = {}
        self.streams: dict[str, RecordedStream] = {}
        self._schemas: dict[int, Schema] = {}
        if not self._read_end():
            self._scan()

    def _read_header(self) -> dict[str, Any]:
        """The session's facts; empty if they are damaged and damage is forgiven."""
        path = str(self.file.path)
        try:
            head = self.file.header()
            facts = self.file.metadata(HEADER)
        except RecordingError:
            if not self._forgiving:
                raise
            self.damaged += 1
            return {}
        if head is not None and head.profile != PROFILE:
            owner = f"profile {head.profile!r}" if head.profile else f"written by {head.library!r}"
            raise RecordingError(f"{path}: an MCAP file, but not a kinegraph recording ({owner})")
        if facts is None:
            raise NothingRecorded(f"{path}: truncated before anything was recorded; nothing can be recovered from it")
        version = facts.get("format", "")
        check_format(int(version) if version.isdigit() else version, path)
        try:
            header: dict[str, Any] = dict(json.loads(facts["header"]))
        except DAMAGE:
            if not self._forgiving:
                raise RecordingError(
                    f"{path}: its header is damaged; `kinegraph recover` rewrites what can be read"
                ) from None
            self.damaged += 1
            return {}
        return header

    @property
    def finished(self) -> bool:
        return self.file.finished

    @property
    def torn(self) -> int:
        """Bytes at its end that cannot be read: a record that breaks off, or is damaged."""
        return self.file.torn + self._left_out

    @property
    def whole(self) -> bool:
        """Whether all its data are there, though its index may be damaged."""
        ended = self.finished or any(record.opcode == Opcode.DATA_END for record in self.file.records)
        return ended and not self._left_out

    def _read_end(self) -> bool:
        """What a finished file says of itself at its end; False where it says nothing, or is damaged there: then all is read."""
        if not self.finished:
            return False
        try:
            self._declare_from_end()
            summary = self.file.metadata(SUMMARY, at_end=True)
            if summary is None or self._forgiving:
                return False
            for name, counts in json.loads(summary["streams"]).items():
                self.streams[name].fill(counts)
        except (RecordingError, *DAMAGE):
            self.file.finished = False
            self.damaged += 1
            for found in (self.topics, self.images, self.streams, self._schemas):
                found.clear()
            return False
        return True

    def _declare_from_end(self) -> None:
        """A finished file repeats all schemas and channels after its data."""
        for record in self.file.records[-_tail(self.file.records) :]:
            if record.opcode == Opcode.SCHEMA:
                schema = self.file.read(Schema, record)
                self._schemas[schema.id] = schema
            elif record.opcode == Opcode.CHANNEL:
                self._declare(self.file.read(Channel, record))

    def _scan(self) -> None:
        """Count what an unfinished file holds; a damaged chunk at its very end is left out."""
        for record in list(self.chunks):
            try:
                self._count(record)
            except RecordingError:
                if not self._forgiving and record != self.chunks[-1]:
                    raise
                self.damaged += 1
                self._left_out += record.length if record == self.chunks[-1] else 0
                self.chunks.remove(record)

    def _count(self, record: Record) -> None:
        """Take a chunk into account, all of it or nothing. Raises RecordingError where it is damaged."""
        data = self.file.unpack(record)
        try:
            for item in declared(data):
                if isinstance(item, Schema):
                    self._schemas[item.id] = item
                elif item.id not in self.topics:
                    self._declare(item)
            named = ((self.topics.get(message.channel), message.body) for message in messages(data))
            found = [(self.streams[name], table(body)) for name, body in named if name in self.streams]
        except DAMAGE as error:
            raise self.file.damage(record, error) from None
        for stream, message in found:
            stream.count(message)

    def _declare(self, channel: Channel) -> None:
        if channel.message_encoding == ENCODING:
            self.topics[channel.id] = name = channel.metadata["stream"]
            self.streams[name] = RecordedStream(*spec_of(self._schemas[channel.schema_id].data))
        elif channel.topic in (LOG, METRICS):
            self.topics[channel.id] = channel.topic
        else:
            self.images[channel.id] = channel.topic

    def messages(self, topics: set[str], start: int = 0) -> Iterator[tuple[str, int, memoryview, list[memoryview]]]:
        """(topic, batch, body, frames before it) of every message on `topics`, from the `start`-th chunk of records on."""
        wanted = {number: topic for number, topic in self.topics.items() if topic in topics}
        images = {number: topic for number, topic in self.images.items() if topic in topics}
        waiting: dict[str, list[memoryview]] = {topic: [] for topic in images.values()}
        for record in self.chunks[start:]:
            for number, batch, _, _, body in self.raw_messages(record):
                if number in wanted:
                    name = wanted[number]
                    yield name, batch, body, waiting.get(name, [])
                    if name in waiting:
                        waiting[name] = []
                elif number in images:
                    waiting[images[number]].append(body)

    def overview(self, name: str) -> Overview | None:
        """What the recorder saw of a signal from afar; None where it left nothing, or it is damaged."""
        wanted = (overview.NAME + name).encode()
        for record in self.file.records:
            if record.opcode != Opcode.ATTACHMENT:
                continue
            head = self.file.content(record._replace(length=min(record.length, _ATTACHMENT.size + len(wanted))))
            if len(head) < _ATTACHMENT.size or head[_ATTACHMENT.size :] != wanted:
                continue
            try:
                if _ATTACHMENT.unpack_from(head)[2] == len(wanted):
                    return overview.unpack(self.file.read(Attachment, record).data, self.streams[name].spec)
            except (RecordingError, *DAMAGE):
                return None
        return None

    def raw_messages(self, record: Record) -> Iterator[RawMessage]:
        """The messages of a chunk of records. Raises RecordingError where it is damaged."""
        try:
            yield from messages(self.file.unpack(record))
        except DAMAGE as error:
            raise self.file.damage(record, error) from None


def _tail(records: list[Record]) -> int:
    """How many records follow the data's end; all where it is not marked."""
    return next((n for n, r in enumerate(reversed(records)) if r.opcode == Opcode.DATA_END), len(records))
