"""The input log of a recording: all inputs in the order in which they entered the graph."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from operator import itemgetter
from typing import TypeAlias

from kinegraph.stream.chunk import Chunk
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.format.layout import HEAD, Entry, decode, table
from kinegraph.stream.recording.read.recorded_file import RecordedFile
from kinegraph.stream.recording.read.records import DAMAGE
from kinegraph.stream.recording.read.seeking import chunk_before

Input: TypeAlias = tuple[int, str, Chunk, int]
"""Sequence, stream, chunk, arrival (ns)."""


class MessageReader:
    """Reads the messages of some streams, each stream's in order; samples that the recorder had to drop between two of them are `lost`."""

    def __init__(self) -> None:
        self._ends: dict[str, int] = {}
        """By stream, the cumulative index after its last sample."""

    def skip(self, name: str, body: memoryview) -> None:
        """Pass a message over."""
        _, samples, first = HEAD.unpack_from(body)
        self._ends[name] = first + samples

    def read(self, part: RecordedFile, name: str, body: memoryview, frames: list[memoryview]) -> list[Entry]:
        """A message's chunks. Raises RecordingError."""
        try:
            _, samples, first = HEAD.unpack_from(body)
            missed = max(first - self._ends.get(name, first), 0)
            self._ends[name] = first + samples
            stream = part.streams[name]
            return decode(stream.spec, body, missed, frames, stream.kept)
        except (RecordingError, *DAMAGE) as error:
            raise RecordingError(f"{part.file.path}: stream {name!r}: {error}") from None


def inputs(parts: Sequence[RecordedFile], after: int, also: Container[str]) -> Iterator[Input]:
    """The inputs of a recording in the order of `sequence`, from the one after `after` on; see `Recording.inputs`.

    Chunks are gathered into messages stream by stream, so the messages of one batch are sorted before they are given out.
    """
    reader = MessageReader()
    for part in parts:
        topics = {name for name, s in part.streams.items() if s.role == "input" or name in also}
        last = max((part.streams[name].last_sequence for name in topics), default=-1)
        if last <= after:
            continue
        start = chunk_before(part, after, topics) if after >= 0 else 0
        batch = -1
        held: list[Input] = []
        for name, number, body, frames in part.messages(topics, start):
            if number != batch:
                yield from _in_order(held, after)
                batch, held = number, []
            if after >= 0 and int(table(body).rows[-1, 4]) <= after:
                reader.skip(name, body)
                continue
            held += [(seq, name, chunk, arrival) for chunk, arrival, seq in reader.read(part, name, body, frames)]
        yield from _in_order(held, after)


def _in_order(held: list[Input], after: int) -> list[Input]:
    held.sort(key=itemgetter(0))
    return held if held and held[0][0] > after else [item for item in held if item[0] > after]
