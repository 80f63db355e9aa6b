"""Reading a recording: one file, the rotated parts of a session, or what a killed process left."""

from __future__ import annotations

import json
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any, Self

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from stream.chunk import Array, Chunk, Times
from stream.errors import RecordingError, nearest
from stream.recording.format import (
    HEAD,
    HEADER,
    LOG,
    METRICS,
    PROFILE,
    SUMMARY,
    Entry,
    check_format,
    decode,
    decode_log,
    spec_of,
    table,
)
from stream.recording.place import parts_of
from stream.recording.records import Record, RecordFile, declared, messages
from stream.recording.tally import RecordedStream


class RecordedPart:
    """One file of a recording, and what is known of its streams."""

    def __init__(self, path: Path, *, forgiving: bool = False) -> None:
        """Raises RecordingError for a file that is no recording of ours, is newer than we are, or holds nothing.

        With `forgiving`, every byte is read, and damaged places are left out and counted in `damaged`.
        """
        self.damaged = 0
        self._forgiving = forgiving
        self.file = RecordFile(path)
        try:
            self._open()
        except BaseException:
            self.file.close()
            raise

    def _open(self) -> None:
        path = str(self.file.path)
        head = self.file.header()
        if head is not None and head.profile != PROFILE:
            whose = f"profile {head.profile!r}" if head.profile else f"written by {head.library!r}"
            raise RecordingError(f"{path}: an MCAP file, but not a kinegraph recording ({whose})")
        facts = self.file.metadata(HEADER)
        if facts is None:
            raise RecordingError(f"{path}: truncated before anything was recorded; nothing can be recovered from it")
        version = facts.get("format", "")
        check_format(int(version) if version.isdigit() else version, path)
        self.header: dict[str, Any] = json.loads(facts["header"])
        self.chunks = self.file.chunks
        self.topics: dict[int, str] = {}
        self.streams: dict[str, RecordedStream] = {}
        self._schemas: dict[int, Schema] = {}
        if self.finished:
            self._declare_from_end()
        summary = self.file.metadata(SUMMARY) if self.finished and not self._forgiving else None
        if summary is None:
            self._scan()
        else:
            for name, counts in json.loads(summary["streams"]).items():
                self.streams[name].fill(counts)

    @property
    def finished(self) -> bool:
        return self.file.finished

    def _declare_from_end(self) -> None:
        """A finished file repeats all schemas and channels after its data."""
        for record in self.file.records[-_tail(self.file.records) :]:
            if record.opcode == Opcode.SCHEMA:
                schema = Schema.read(self.file.stream(record))
                self._schemas[schema.id] = schema
            elif record.opcode == Opcode.CHANNEL:
                self._declare(Channel.read(self.file.stream(record)))

    def _scan(self) -> None:
        """Count what an unfinished file holds; a damaged chunk at its very end is left out."""
        for record in list(self.chunks):
            try:
                data = self.file.unpack(record)
            except RecordingError:
                if not self._forgiving and record != self.chunks[-1]:
                    raise
                self.damaged += 1
                self.chunks.remove(record)
                continue
            for item in declared(data):
                if isinstance(item, Schema):
                    self._schemas[item.id] = item
                elif item.id not in self.topics:
                    self._declare(item)
            for message in messages(data):
                name = self.topics.get(message.channel)
                if name in self.streams:
                    self.streams[name].count(table(message.body))

    def _declare(self, channel: Channel) -> None:
        self.topics[channel.id] = channel.topic
        if channel.topic not in (LOG, METRICS):
            self.streams[channel.topic] = RecordedStream(*spec_of(self._schemas[channel.schema_id].data))

    def messages(self, topics: set[str], start: int = 0) -> Iterator[tuple[str, int, memoryview]]:
        """(topic, batch, body) of every message on `topics`, from the `start`-th chunk of records on."""
        wanted = {number: topic for number, topic in self.topics.items() if topic in topics}
        for record in self.chunks[start:]:
            for number, batch, _, _, body in messages(self.file.unpack(record)):
                if number in wanted:
                    yield wanted[number], batch, body

    def chunk_before(self, sequence: int, topics: set[str]) -> int:
        """A chunk of records before which no input comes after `sequence`: found by bisection, for sequences grow."""
        low, high = 0, len(self.chunks)
        while low < high:
            middle = (low + high) // 2
            first = self._first_sequence(middle, topics)
            if first is not None and first <= sequence:
                low = middle + 1
            else:
                high = middle
        return max(low - 2, 0)

    def _first_sequence(self, start: int, topics: set[str]) -> int | None:
        for _, _, body in self.messages(topics, start):
            return int(table(body).rows[0, 4])
        return None


def _tail(records: list[Record]) -> int:
    """How many records follow the data's end."""
    return next(n for n, record in enumerate(reversed(records)) if record.opcode == Opcode.DATA_END)


class Recording:
    """A recorded session. Samples come in fresh memory that may be written; nothing is held beyond what is being read.

    header     of the first part: the graph, versions, the session's facts (as handed to the recorder)
    finished   whether it was closed in order; one left by a killed process is read all the same
    streams    what was recorded, by name
    """

    def __init__(self, path: Path, parts: list[RecordedPart]) -> None:
        self.path = path
        self.parts = parts
        self.header = parts[0].header
        self.finished = all(part.finished for part in parts)
        self.streams: dict[str, RecordedStream] = {}
        for part in parts:
            for name, stream in part.streams.items():
                whole = self.streams.setdefault(name, RecordedStream(stream.spec, stream.role))
                if whole.spec != stream.spec:
                    raise RecordingError(
                        f"{part.file.path}: stream {name!r} changes from {whole.spec.describe()} to {stream.spec.describe()}; "
                        "open the parts one by one"
                    )
                whole.follow(stream)

    @classmethod
    def open(cls, path: Path) -> Recording:
        """Open a file, a session's folder, or what a killed process left. Raises RecordingError, which says what to do."""
        if not path.exists():
            raise RecordingError(f"{path}: there is no such recording")
        paths = parts_of(path)
        if not paths:
            raise RecordingError(f"{path}: the folder holds no recording (session.0000.mcap is missing)")
        parts: list[RecordedPart] = []
        try:
            for i, part in enumerate(paths):
                if i and i == len(paths) - 1 and part.stat().st_size == 0:
                    break
                parts.append(RecordedPart(part))
            return cls(path, parts)
        except BaseException:
            for opened in parts:
                opened.file.close()
            raise

    def close(self) -> None:
        for part in self.parts:
            part.file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def stream(self, name: str) -> RecordedStream:
        """The stream of this name. Raises RecordingError with the nearest one there is."""
        if name not in self.streams:
            raise RecordingError(f"{self.path}: no stream {name!r} was recorded; {nearest(name, self.streams)}")
        return self.streams[name]

    def inputs(self, after: int = -1) -> Iterator[tuple[int, str, Chunk, int]]:
        """The input log: (sequence, stream, chunk, arrival) in the order of `sequence`, from the one after `after` on.

        Chunks are gathered into messages stream by stream, so the messages of one batch are sorted before they are given out.
        """
        ends: dict[str, int] = {}
        for part in self.parts:
            topics = {name for name, s in part.streams.items() if s.role == "input"}
            last = max((part.streams[name].last_sequence for name in topics), default=-1)
            if last <= after:
                continue
            start = part.chunk_before(after, topics) if after >= 0 else 0
            batch = -1
            held: list[tuple[int, str, Chunk, int]] = []
            for name, number, body in part.messages(topics, start):
                if number != batch:
                    yield from _in_order(held, after)
                    batch, held = number, []
                held += [(seq, name, chunk, arrival) for chunk, arrival, seq in self._entries(part, name, body, ends)]
            yield from _in_order(held, after)

    def entries(self, name: str) -> Iterator[Entry]:
        """The chunks of one stream with their arrival and sequence, in order."""
        self.stream(name)
        ends: dict[str, int] = {}
        for part in self.parts:
            for _, _, body in part.messages({name} & part.streams.keys()):
                yield from self._entries(part, name, body, ends)

    @staticmethod
    def _entries(part: RecordedPart, name: str, body: memoryview, ends: dict[str, int]) -> list[Entry]:
        """A message's chunks; samples that the recorder had to drop before them count as lost."""
        _, samples, first = HEAD.unpack_from(body)
        missed = max(first - ends.get(name, first), 0)
        ends[name] = first + samples
        return decode(part.streams[name].spec, body, missed)

    def chunks(self, name: str) -> Iterator[Chunk]:
        """The chunks of one stream, in order."""
        return (entry.chunk for entry in self.entries(name))

    def read(self, name: str) -> tuple[Times, Array]:
        """The whole of a stream: stamps (n,) int64 ns, samples (n, *shape)."""
        spec = self.stream(name).spec
        chunks = list(self.chunks(name))
        times = [np.empty(0, np.int64), *(c.time for c in chunks)]
        data = [np.empty((0, *spec.shape), spec.dtype), *(c.data for c in chunks)]
        return np.concatenate(times), np.concatenate(data)

    @property
    def log(self) -> list[dict[str, Any]]:
        """The session's log: {"kind": ..., "time": ns, fact: value, ...} in the order in which it was written."""
        return [decode_log(body) for part in self.parts for _, _, body in part.messages({LOG})]

    def metrics(self) -> Iterator[dict[str, Any]]:
        """The nodes' metrics over time: {"time": ns, "table": {...}}."""
        for part in self.parts:
            for _, _, body in part.messages({METRICS}):
                yield json.loads(bytes(body))

    def last_samples(self, name: str) -> int:
        """The cumulative index after a stream's last recorded sample: where a resumed session goes on. 0 for an unknown stream."""
        return self.streams[name].end if name in self.streams else 0

    @property
    def inputs_recorded(self) -> dict[str, RecordedStream]:
        """The streams of the input log."""
        return {name: s for name, s in self.streams.items() if s.role == "input"}

    @property
    def last_sequence(self) -> int:
        """The last place in the input log; -1 if nothing was recorded."""
        return max((s.last_sequence for s in self.inputs_recorded.values()), default=-1)

    @property
    def begin_of_inputs(self) -> int:
        """The stamp of the first input sample (ns); 0 without samples."""
        return min((s.first for s in self.inputs_recorded.values() if s.first is not None), default=0)

    @property
    def end_of_inputs(self) -> int:
        """The arrival of the last input chunk (ns); 0 if nothing was recorded."""
        return max((s.last_arrival for s in self.inputs_recorded.values()), default=0)

    @property
    def duration_ns(self) -> int:
        """From the first to the last stamp of any stream."""
        first = [s.first for s in self.streams.values() if s.first is not None]
        last = [s.last for s in self.streams.values() if s.last is not None]
        return max(last) - min(first) if first else 0


def _in_order(held: list[tuple[int, str, Chunk, int]], after: int) -> list[tuple[int, str, Chunk, int]]:
    held.sort(key=itemgetter(0))
    return held if held and held[0][0] > after else [item for item in held if item[0] > after]
