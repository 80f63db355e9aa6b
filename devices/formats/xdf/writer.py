"""Streams as an XDF file (https://github.com/sccn/xdf/wiki/Specifications), which pyxdf, EEGLAB, MNE and FieldTrip read.

No library writes XDF. A file is the word "XDF:" and chunks: a length, a two-byte tag, and the content; the tag
says which are samples and which headers. Numbers are little-endian, texts are XML.
"""

from __future__ import annotations

import json
import struct
from datetime import UTC, datetime
from typing import BinaryIO
from xml.sax.saxutils import escape

import numpy as np

from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec
from kinegraph.stream.data.columns import column_names, columns

FILE_HEADER, STREAM_HEADER, SAMPLES, CLOCK_OFFSET, STREAM_FOOTER = 1, 2, 3, 4, 6
FORMATS = {
    "<f4": "float32",
    "<f8": "double64",
    "|i1": "int8",
    "<i2": "int16",
    "<i4": "int32",
    "<i8": "int64",
}
WIDER = {"|b1": "|i1", "|u1": "<i2", "<u2": "<i4", "<u4": "<i8", "<u8": "<f8", "<f2": "<f4"}
"""What XDF lacks, and the type that holds all its values (uint64 beyond 2^53 excepted)."""
UNITS = {"uV": "microvolts", "mV": "millivolts", "V": "volts"}


class XdfWriter:
    """Writes streams with times in seconds since `origin` (ns UTC), which every stream's header gives."""

    def __init__(self, file: BinaryIO, origin: int) -> None:
        self._file, self._origin = file, origin
        self._streams: list[_Stream] = []
        file.write(b"XDF:")
        moment = datetime.fromtimestamp(origin // NS, UTC).isoformat()
        self._chunk(FILE_HEADER, _xml("info", f"<version>1.0</version><datetime>{moment}</datetime>"))

    def add_stream(self, name: str, spec: StreamSpec) -> int:
        """Declare a stream; returns its number."""
        stream = _Stream(name, spec)
        self._streams.append(stream)
        number = len(self._streams)
        self._chunk(STREAM_HEADER, struct.pack("<I", number) + stream.header(self._origin))
        return number

    def write(self, number: int, chunk: Chunk) -> None:
        """The samples of a chunk, each with its stamp."""
        if not len(chunk.time):
            return
        stream = self._streams[number - 1]
        times = (chunk.time - self._origin) / NS
        body = stream.samples(times, chunk.data)
        self._chunk(SAMPLES, struct.pack("<I", number) + _length(len(chunk.time), 4) + body)
        if stream.first is None:
            stream.first = float(times[0])
            self._chunk(CLOCK_OFFSET, struct.pack("<Idd", number, stream.first, 0.0))
        stream.last = float(times[-1])
        stream.count += len(chunk.time)

    def close(self) -> None:
        """Write the footers; the file itself stays open."""
        for number, stream in enumerate(self._streams, 1):
            if stream.first is not None:
                self._chunk(CLOCK_OFFSET, struct.pack("<Idd", number, stream.last, 0.0))
            self._chunk(STREAM_FOOTER, struct.pack("<I", number) + stream.footer())

    def _chunk(self, tag: int, content: bytes) -> None:
        self._file.write(_length(len(content) + 2) + struct.pack("<H", tag) + content)


class _Stream:
    """A stream's type in XDF, and what its footer will say."""

    def __init__(self, name: str, spec: StreamSpec) -> None:
        self.name, self.spec = name, spec
        self.names = column_names(spec)
        self.dtype = type_of(spec)
        self.first: float | None = None
        self.last = 0.0
        self.count = 0

    def header(self, origin: int) -> bytes:
        channels = "".join(
            f"<channel><label>{escape(label)}</label><unit>{escape(UNITS.get(unit, unit))}</unit></channel>"
            for label, unit in self.names
        )
        kind = "Markers" if self.spec.is_event else str(self.spec.meta.get("xdf_type") or "Signal")
        facts = {
            "name": self.name,
            "type": kind,
            "channel_count": len(self.names),
            "nominal_srate": self.spec.rate_hz or 0,
            "channel_format": FORMATS[self.dtype.str] if self.dtype is not None else "string",
            "source_id": f"kinegraph.{self.name}",
        }
        text = "".join(f"<{key}>{escape(str(value))}</{key}>" for key, value in facts.items())
        spec = escape(json.dumps(self.spec.to_json()))
        ours = f"<kinegraph><time_zero_ns>{origin}</time_zero_ns><spec>{spec}</spec></kinegraph>"
        return _xml("info", f"{text}<desc><channels>{channels}</channels>{ours}</desc>")

    def footer(self) -> bytes:
        return _xml(
            "info",
            f"<first_timestamp>{self.first or 0.0!r}</first_timestamp><last_timestamp>{self.last!r}</last_timestamp>"
            f"<sample_count>{self.count}</sample_count>",
        )

    def samples(self, times: Array, data: Array) -> bytes:
        parts = columns(self.spec, data)
        if self.dtype is None:
            rows = zip(times.tolist(), *(p.tolist() for p in parts), strict=True)
            return b"".join(struct.pack("<Bd", 8, time) + b"".join(map(_string, values)) for time, *values in rows)
        row = np.dtype([("size", "u1"), ("time", "<f8"), ("values", self.dtype, (len(parts),))])
        table = np.empty(len(times), row)
        table["size"], table["time"] = 8, times
        for i, part in enumerate(parts):
            table["values"][:, i] = part
        return table.tobytes()


def type_of(spec: StreamSpec) -> np.dtype[np.generic] | None:
    """The one type that holds every number of a sample exactly; None: written as text (events that mix texts, long integers, fractions)."""
    kinds = [spec.dtype[name].base for name in spec.dtype.names] if spec.dtype.names else [spec.dtype]
    if any(kind.kind not in "fiub" for kind in kinds):
        return None
    wider = [np.dtype(WIDER.get(kind.newbyteorder("<").str, kind.newbyteorder("<").str)) for kind in kinds]
    common = wider[0]
    for other in wider[1:]:
        common = np.promote_types(common, other)
    exact = common.kind != "f" or all(kind.kind == "f" or kind.itemsize < 8 for kind in wider)
    return common if exact and common.str in FORMATS else None


def _string(value: object) -> bytes:
    text = (value.decode(errors="replace") if isinstance(value, bytes) else str(value)).encode()
    return _length(len(text)) + text


def _length(value: int, least: int = 1) -> bytes:
    """XDF's variable-length number: how many bytes it takes (1, 4 or 8), then the number."""
    for size, code in ((1, "<BB"), (4, "<BI"), (8, "<BQ")):
        if size >= least and value < 1 << (8 * size):
            return struct.pack(code, size, value)
    raise ValueError(value)


def _xml(root: str, content: str) -> bytes:
    return f'<?xml version="1.0"?><{root}>{content}</{root}>'.encode()
