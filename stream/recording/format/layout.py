"""How a recording's bytes are laid out: `docs/extend/format.md` says the same for other people's programs.

A recording is MCAP with the profile "kinegraph". Each stream is a channel; one message holds the chunks that came within about 100 ms,
each with its boundaries, its `until` and `lost`, its arrival and its place in the input log.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from math import prod
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec, add_lost
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.format.image import frames_of, is_frames

FORMAT = 1
"""The version of the layout; raised whenever an older kinegraph could misread a newer file."""
PROFILE = "kinegraph"
ENCODING = "kinegraph"
"""Schema encoding and message encoding of streams."""
HEADER = "kinegraph"
SUMMARY = "kinegraph.end"
"""Names of the metadata records at a part's beginning and end."""
LOG = "kinegraph/log"
METRICS = "kinegraph/metrics"
"""Topics of the session's log and of the nodes' metrics."""

Role: TypeAlias = Literal["input", "edge"]
Kept: TypeAlias = Literal["whole", "image", "packed", "outline"]
"""How a stream's samples are kept: in its messages; as frames beside them, images or packed; or not at all, only when they came."""

HEAD = struct.Struct("<IIq")
"""Chunks, samples, cumulative index of the first sample. After it come the table (chunks, 5), the stamps (n,), and, where they are kept
whole, the samples (n, *shape) as the spec's dtype lays them out: see `stream.recording.write.message_builder`."""
INT = np.dtype("<i8")
COLUMNS = 5
"""Per chunk: samples, until, lost, arrival, sequence (int64 each)."""


class Entry(NamedTuple):
    """A chunk with its arrival (ns of session time) and its place in the input log."""

    chunk: Chunk
    arrival: int
    sequence: int


class Table(NamedTuple):
    """What a message says about its chunks. `rows` (chunks, 5) int64; `times` (n,) int64; `first` the index of the first sample."""

    rows: Array
    times: Array
    first: int
    end: int
    """Where the samples begin in the message."""


def table(body: bytes | memoryview) -> Table:
    """The tables of a message, without its samples. The arrays are views of `body`. Raises ValueError or struct.error."""
    chunks, samples, first = HEAD.unpack_from(body)
    rows = np.frombuffer(body, INT, chunks * COLUMNS, HEAD.size).reshape(chunks, COLUMNS)
    if not chunks or rows[:, 0].min() < 0 or int(rows[:, 0].sum()) != samples or first < 0:
        raise ValueError(f"a message of {chunks} chunks and {samples} samples does not hold together")
    start = HEAD.size + rows.nbytes
    return Table(rows, np.frombuffer(body, INT, samples, start), first, start + 8 * samples)


def decode(
    spec: StreamSpec,
    body: bytes | memoryview,
    missed: int = 0,
    images: Sequence[memoryview] = (),
    kept: Kept = "whole",
) -> list[Entry]:
    """The chunks of a message, in fresh, writable memory; `missed` (what a full disk cost) adds to the first's `lost`.

    `images` are the frames that came before it, for a stream of frames. Samples that were not kept are lost.
    """
    rows, stamps, first, start = table(body)
    if kept == "outline":
        rows = rows.copy()
        rows[:, 2] = np.where(rows[:, 2] < 0, -1, rows[:, 2] + rows[:, 0])
        rows[:, 0] = 0
        stamps = stamps[:0]
    time = stamps.astype(np.int64)
    if kept in ("image", "packed"):
        data = frames_of(spec, first, len(time), images, packed=kept == "packed")
    else:
        data = (
            np.frombuffer(body, spec.dtype, len(time) * prod(spec.shape), start).copy().reshape(len(time), *spec.shape)
        )
    nothing, no_data = time[:0], data[:0]
    entries: list[Entry] = []
    at = 0
    for n, until, lost, arrival, sequence in rows.tolist():
        if n:
            chunk = Chunk(time[at : at + n], data[at : at + n], until, lost)
            at += n
        else:
            chunk = Chunk(nothing, no_data, until, lost)
        entries.append(Entry(chunk, arrival, sequence))
    if missed and entries:
        entries[0].chunk.lost = add_lost(entries[0].chunk.lost, missed)
    return entries


def schema_of(spec: StreamSpec, role: Role, kept: Kept) -> bytes:
    """A stream's schema record: its spec as JSON, with how messages are encoded."""
    return json.dumps({**spec.to_json(), "role": role, "kept": kept, "encoding": ENCODING, "format": FORMAT}).encode()


def spec_of(schema: bytes) -> tuple[StreamSpec, Role, Kept]:
    """The spec, the role, and how samples are kept, as `schema_of` wrote it down."""
    record = json.loads(schema)
    spec = StreamSpec.from_json(record)
    return spec, record["role"], record.get("kept", "image" if is_frames(spec) else "whole")


def dump(value: Any) -> bytes:
    """JSON of facts that may hold numpy numbers and arrays; whatever else JSON lacks is written as text."""
    return json.dumps(value, default=_plain).encode()


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else str(value)


LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4}
LOG_SCHEMA = dump(
    {
        "title": "foxglove.Log",
        "type": "object",
        "properties": {
            "timestamp": {
                "title": "time",
                "type": "object",
                "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
            },
            "level": {"title": "foxglove.LogLevel", "type": "integer"},
            "message": {"type": "string"},
            "name": {"type": "string"},
            "file": {"type": "string"},
            "line": {"type": "integer"},
            "kind": {"type": "string"},
            "time": {"type": "integer"},
            "facts": {"type": "object"},
        },
    }
)
METRICS_SCHEMA = dump(
    {
        "title": "kinegraph.Metrics",
        "type": "object",
        "properties": {"time": {"type": "integer"}, "table": {"type": "object"}},
    }
)


def encode_log(kind: str, time: int, facts: dict[str, Any]) -> bytes:
    """A line of the session's log, in the shape of foxglove.Log (so that Foxglove lists it) with our own fields beside."""
    message = " ".join([kind, *(f"{name}={value}" for name, value in facts.items())])
    level = LEVELS.get(str(facts.get("level", "info")), 2)
    stamp = {"sec": max(time, 0) // NS, "nsec": max(time, 0) % NS}
    line = {"timestamp": stamp, "level": level, "message": message, "name": "kinegraph", "file": "", "line": 0}
    return dump({**line, "kind": kind, "time": time, "facts": facts})


def decode_log(body: bytes | memoryview) -> dict[str, Any]:
    """{"kind": ..., "time": ..., fact: value, ...}. Raises ValueError, KeyError or TypeError where it is damaged."""
    record = json.loads(bytes(body))
    kind, time, facts = record["kind"], record["time"], record["facts"]
    if not (isinstance(kind, str) and isinstance(time, int) and isinstance(facts, dict)):
        raise ValueError("a line of the log lacks its kind, time or facts")
    return {**facts, "kind": kind, "time": time}


def check_format(version: object, path: str) -> None:
    """Raises RecordingError for a version that this kinegraph cannot read."""
    if not isinstance(version, int) or version < 1:
        raise RecordingError(f"{path}: the recording names no valid format version ({version!r}); it is damaged")
    if version > FORMAT:
        raise RecordingError(
            f"{path}: written in recording format {version}; this kinegraph reads formats up to {FORMAT}: install a newer kinegraph"
        )
