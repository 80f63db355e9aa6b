"""What crosses the network: subjects, and messages in the recorder's own encoding. Opens nothing, reads no clock.

A message holds chunks of one stream as a recording does (`stream.recording.format.layout`): stamps, samples, `until`, `lost`, the index of
the first sample. Its header names the session and the spec; by its id, made of session and index, the server refuses a second copy.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.stream.chunk import FOREVER, NEVER, Chunk, StreamSpec, add_lost
from kinegraph.stream.recording.format.layout import decode, dump, table
from kinegraph.stream.recording.write.message_builder import MessageBuilder

PREFIX = "kinegraph"
DATA, FACTS = "kinegraph-data", "kinegraph-facts"
"""The server's two streams: messages in order, and the last fact of each kind."""
DATA_SUBJECTS, FACT_SUBJECTS = f"{PREFIX}.*.data.>", f"{PREFIX}.*.facts.>"
MAX_BYTES = 256 << 10
"""A message is sent once it has this many bytes of samples."""
GATHER_S = 0.1
"""Or once its first chunk is so old."""
GATHER_BEHIND_S = 1.0
"""Or, while messages wait: each costs a way to the server and back, and larger ones catch up."""
MAX_SAMPLE_BYTES = 960 << 10
"""A server takes messages of 1 MiB unless it is configured otherwise."""
ID, SESSION, SPEC = "Nats-Msg-Id", "Kinegraph-Session", "Kinegraph-Spec"


def subject(bed: str, kind: str, name: str = "") -> str:
    """Such as kinegraph.bed1.data.night.scorer; kinds are data, facts, status, and ask for requests to the bed."""
    return ".".join(filter(None, (PREFIX, bed, kind, name)))


def spec_text(spec: StreamSpec) -> str:
    return json.dumps(json.loads(dump(spec.to_json())), sort_keys=True)


def digest_of(text: str | bytes) -> str:
    return hashlib.blake2b(text.encode() if isinstance(text, str) else text, digest_size=8).hexdigest()


def differences(declared: StreamSpec, found: StreamSpec) -> list[str]:
    """How a stream's spec differs from the declared one, in words, in what changes the meaning of a number."""
    names = ("shape", "dtype", "rate_hz", "channels", "units", "channel_axis")
    return [
        f"{name} is {getattr(found, name)}, not {getattr(declared, name)}"
        for name in names
        if getattr(found, name) != getattr(declared, name)
    ]


@dataclass(frozen=True, slots=True)
class StreamMessage:
    """One message on its way. `handed`: the newest arrival (ns) that the bed's recording had been handed when it was complete."""

    subject: str
    id: str
    session: str
    spec: str
    body: bytes
    handed: int = NEVER

    @property
    def headers(self) -> dict[str, str]:
        return {ID: self.id, SESSION: self.session, SPEC: self.spec}


class Gathering:
    """One stream's chunks until they are a message.

    samples, until   the index after the last sample, and up to when the stream is complete
    """

    def __init__(self, spec: StreamSpec, subject: str, session: str, samples: int = 0, until: int = NEVER) -> None:
        self.spec, self.samples, self.until = spec, samples, until
        self._subject, self._session, self._digest = subject, session, digest_of(spec_text(spec))
        self._builder: MessageBuilder | None = None
        self._began = self._handed = self._sequence = 0

    def add(self, chunk: Chunk, now: int, handed: int) -> Iterator[StreamMessage]:
        """Take a chunk at `now` (ns); the messages that are complete."""
        size = chunk.data.nbytes
        if size > MAX_BYTES and len(chunk) > 1:
            n = max(1, MAX_BYTES * len(chunk) // size)
            for at in range(0, len(chunk), n):
                yield from self.add(chunk.part(at, min(at + n, len(chunk))), now, handed)
            return
        if self._builder and self._builder.size + size > MAX_BYTES:
            yield self._ended()
        if self._builder is None:
            self._builder, self._began = MessageBuilder(self.spec, "whole", self.samples, copied=True), now
        self._builder.add(chunk, len(chunk), size, now, self._sequence)
        self._sequence += 1
        self.samples += len(chunk)
        self.until, self._handed = chunk.until, handed
        if self._builder.size >= MAX_BYTES:
            yield self._ended()

    def due(self, now: int, *, gather_s: float = GATHER_S, last: bool = False) -> Iterator[StreamMessage]:
        """What is to be sent at `now` (ns), because it is old enough or the `last`."""
        if self._builder and (last or now - self._began >= gather_s * 1e9):
            yield self._ended()

    def _ended(self) -> StreamMessage:
        builder, self._builder = self._builder, None
        assert builder
        id = f"{self._session}.{self._subject}.{builder.first}.{builder.count}.{self.until}"
        return StreamMessage(self._subject, id, self._session, self._digest, builder.body(), self._handed)


@dataclass(slots=True)
class Position:
    """How far a stream has been read.

    sequence   the server's number of the last message
    session    the bed's session
    index      of the sample that comes next; -1: unknown
    until      up to when it was read (ns of the bed's clock)
    """

    sequence: int = 0
    session: str = ""
    index: int = -1
    until: int = NEVER

    def to_json(self) -> dict[str, Any]:
        return {"sequence": self.sequence, "session": self.session, "index": self.index, "until": self.until}


class StreamReader:
    """Messages in the server's order become chunks, each sample once: what is repeated is left out, what is missing is `lost`.

    What is new is decided by stamps: no sample of a stream is at or before its watermark. The index counts what is missing.

    discarded   samples that the server or the bed's spool no longer had
    repeated    samples that came a second time
    before      samples of a new session of the bed that are stamped before the end of the last one, and left out
    ended       whether the bed's session has ended
    """

    def __init__(self, spec: StreamSpec, position: Position) -> None:
        self._spec, self.position = spec, position
        self.discarded = self.repeated = 0
        self.before = 0
        self.ended = self._begins = False

    def read(self, sequence: int, session: str, body: bytes) -> list[Chunk]:
        """The new chunks of a message. Raises ValueError or struct.error where it is damaged."""
        position, index, gap = self.position, table(body).first, -1 if self._begins else 0
        if session != position.session:
            if position.session:
                gap, position.index, self._begins = -1, -1, True
            position.session, self.ended = session, False
        begins = self._begins
        chunks = []
        for chunk, *_ in decode(self._spec, body):
            n = len(chunk)
            if chunk.until == FOREVER:
                self.ended = True
                chunk.until = max(position.until, int(chunk.time[-1]) if n else NEVER)
            old = int(np.searchsorted(chunk.time, position.until, "right")) if n else 0
            if begins:  # the bed's clock was set back: the gap before this session counts them
                self.before += old
            else:
                self.repeated += old
            if chunk.until <= position.until or (n and old == n):
                position.index = max(position.index, index + n)
                index += n
                continue
            if not old and position.index < 0 and position.until != NEVER and index:
                gap = -1
            elif not old and 0 <= position.index < index:
                gap = add_lost(gap, index - position.index)
                self.discarded += index - position.index
            index = position.index = index + n
            position.until = chunk.until
            fresh = chunk.part(old, n) if old else chunk
            self._begins = begins = False
            chunks.append(Chunk(fresh.time, fresh.data, fresh.until, add_lost(gap, fresh.lost)))
            gap = 0
        position.sequence = sequence
        return chunks


DAMAGE = (ValueError, struct.error, KeyError, TypeError)
