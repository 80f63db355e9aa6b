"""Streams as Foxglove plots them: MCAP with one JSON message per sample, each topic with its JSON Schema.

A channel or field is a key of the message, its letters, digits and underscores kept; a value that is not finite is left out, times (fields
in ns) are {sec, nsec}, and `lost` says how many samples are missing just before (-1: an unknown number).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from math import isfinite
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from mcap.writer import CompressionType, Writer

from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.data.columns import column_names, columns

TIME = {"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}


class FoxgloveWriter:
    """Writes one file; `close` ends it."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._writer: Any = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library="kinegraph")

    def write(self, name: str, spec: StreamSpec, chunks: Iterable[Chunk], progress: Callable[[int], None]) -> int:
        """Write a stream as the topic of its name; returns its messages."""
        messages = JsonMessages(name, spec)
        schema = self._writer.register_schema(name, "jsonschema", messages.schema)
        channel = self._writer.register_channel(topic=name, message_encoding="json", schema_id=schema)
        count = 0
        for chunk in chunks:
            for stamp, data in messages.of(chunk):
                self._writer.add_message(channel, log_time=stamp, publish_time=stamp, data=data, sequence=count)
                count += 1
            progress(len(chunk.time))
        return count

    def close(self) -> None:
        self._writer.finish()
        self._file.close()


class JsonMessages:
    """A stream's samples as JSON messages, and the JSON Schema that they keep to."""

    def __init__(self, name: str, spec: StreamSpec) -> None:
        self._spec, self._keys = spec, keys_of(spec)
        self._times = [unit == "ns" for _, unit in column_names(spec)]
        self._json = msgspec.json.Encoder()
        self.schema: bytes = self._json.encode(schema_of(name, spec))

    def of(self, chunk: Chunk) -> Iterator[tuple[int, bytes]]:
        """The stamp (ns) and the message of every sample."""
        table = [column.tolist() for column in columns(self._spec, chunk.data)]
        for i, (stamp, *values) in enumerate(zip(chunk.time.tolist(), *table, strict=True)):
            value = zip(self._keys, values, self._times, strict=True)
            message = {key: _plain(v, t) for key, v, t in value if _is_said(v)}
            message |= {"timestamp": _time(stamp), "lost": 0 if i else int(chunk.lost)}
            yield stamp, self._json.encode(message)


def keys_of(spec: StreamSpec) -> list[str]:
    """The keys of a stream's messages, one per column: what can stand in a message path, each once."""
    keys: list[str] = []
    for name, _ in column_names(spec):
        key = re.sub(r"\W", "_", name, flags=re.ASCII) or "value"
        keys.append(key if key not in {*keys, "timestamp", "lost"} else f"{key}_{len(keys) + 1}")
    return keys


def schema_of(name: str, spec: StreamSpec) -> dict[str, Any]:
    """The JSON Schema of a stream's messages; each key is described by its column's name and unit."""
    kinds = [column.dtype.kind for column in columns(spec, np.empty((0, *spec.shape), spec.dtype))]
    properties: dict[str, Any] = {"timestamp": TIME, "lost": {"type": "integer"}}
    for key, kind, (column, unit) in zip(keys_of(spec), kinds, column_names(spec), strict=True):
        json = (
            TIME
            if unit == "ns"
            else {"type": {"f": "number", "i": "integer", "u": "integer", "b": "boolean"}.get(kind, "string")}
        )
        properties[key] = {**json, "description": f"{column} [{unit}]" if unit else column}
    return {"title": name, "type": "object", "description": spec.describe(), "properties": properties}


def _is_said(value: Any) -> bool:
    return not isinstance(value, float) or isfinite(value)


def _plain(value: Any, is_time: bool) -> Any:
    if is_time:
        return _time(int(value))
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _time(ns: int) -> dict[str, int]:
    sec, nsec = divmod(ns, NS)
    return {"sec": sec, "nsec": nsec}
