"""Depth frames as Foxglove shows them: messages of the schema foxglove.RawImage in Protocol Buffers, encoding 16UC1.

The other way to keep them is smaller (`stream/recording/format/packed.py`). Either way a stream of frames has two topics: its own name,
with one
message per frame, and "NAME/chunks", with the tables of its chunks in our own encoding, without the samples. The few bytes of Protocol
Buffers that this takes are written here by hand: a dependency would be larger.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import numpy as np

from kinegraph.stream.chunk import NS, Array, StreamSpec
from kinegraph.stream.data.bounded import check_size
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.format.packed import unpack

SCHEMA = "foxglove.RawImage"
CHUNKS = "/chunks"
"""What a frame stream's second topic ends in."""
ENCODING = b"16UC1"
INDEX = 1000
"""Our own field in an image: the frame's cumulative index. Programs that do not know it skip it."""

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_OPTIONAL = 1
_INT64, _INT32, _FIXED32_TYPE, _STRING, _MESSAGE, _BYTES_TYPE = 3, 5, 7, 9, 11, 12


def is_frames(spec: StreamSpec) -> bool:
    """Whether samples are (height, width) uint16."""
    return len(spec.shape) == 2 and spec.dtype == np.dtype("<u2")


def is_picture(spec: StreamSpec) -> bool:
    """Whether samples are images of any kind: of a source, they are recorded only where the graph says so."""
    return len(spec.shape) >= 2 and spec.dtype.kind == "u"


def encode_image(stamp: int, index: int, frame: Array) -> bytes:
    """One frame (height, width) uint16 at `stamp` ns."""
    height, width = frame.shape
    seconds, nanos = divmod(max(stamp, 0), NS)
    head = b"".join(
        (
            _field(1, _number(1, seconds) + _number(2, nanos)),
            _fixed32(2, width),
            _fixed32(3, height),
            _field(4, ENCODING),
            _fixed32(5, 2 * width),
            _number(INDEX, index),
        )
    )
    return head + _field(6, np.ascontiguousarray(frame, "<u2").tobytes())


def decode_image(body: memoryview) -> tuple[int, memoryview]:
    """A frame's cumulative index, and its samples. Raises RecordingError for any other format."""
    index, data = -1, None
    for number, value in wire_fields(body):
        if number == INDEX and isinstance(value, int):
            index = value
        elif number == 6 and isinstance(value, memoryview):
            data = value
    if index < 0 or data is None:
        raise RecordingError("a frame was not recorded by kinegraph; only its own recordings are read")
    return index, data


def frames_of(spec: StreamSpec, first: int, n: int, images: Sequence[memoryview], *, packed: bool) -> Array:
    """Frames number `first` ... `first` + n - 1, (n, height, width) in fresh memory. Raises RecordingError if one is missing."""
    if len(images) < n:
        raise RecordingError(
            f"{n - len(images)} of {n} frames are missing; `kinegraph recover` leaves out what cannot be read"
        )
    check_size(n * spec.sample_bytes, sum(map(len, images)), "a message of frames")
    data = np.empty((n, *spec.shape), spec.dtype)
    missing = set(range(n))
    for body in images:
        index, frame = unpack(body) if packed else _image(spec, body)
        if index - first in missing:
            data[index - first] = frame
            missing.remove(index - first)
    if missing:
        raise RecordingError(
            f"frame {first + min(missing)} is missing; `kinegraph recover` leaves out what cannot be read"
        )
    return data


def _image(spec: StreamSpec, body: memoryview) -> tuple[int, Array]:
    index, samples = decode_image(body)
    return index, np.frombuffer(samples, spec.dtype).reshape(spec.shape)


def _varint(value: int) -> bytes:
    made = bytearray()
    while value > 0x7F:
        made.append(value & 0x7F | 0x80)
        value >>= 7
    made.append(value)
    return bytes(made)


def _number(number: int, value: int) -> bytes:
    return _varint(number << 3 | _VARINT) + _varint(value)


def _fixed32(number: int, value: int) -> bytes:
    return _varint(number << 3 | _FIXED32) + struct.pack("<I", value)


def _field(number: int, value: bytes) -> bytes:
    return _varint(number << 3 | _BYTES) + _varint(len(value)) + value


def wire_fields(body: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """(number, value) of the fields of a message in Protocol Buffers; fixed-width numbers are passed over. Raises IndexError at a cut."""
    at = 0
    while at < len(body):
        tag, at = _read_varint(body, at)
        if tag & 7 == _VARINT:
            value, at = _read_varint(body, at)
            yield tag >> 3, value
        elif tag & 7 == _BYTES:
            length, at = _read_varint(body, at)
            yield tag >> 3, body[at : at + length]
            at += length
        else:
            at += 8 if tag & 7 == _FIXED64 else 4


def _read_varint(body: memoryview, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = body[at]
        at += 1
        if shift > 63:
            raise IndexError("a number of more than 64 bits")
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7


def descriptor() -> bytes:
    """The schema record: a FileDescriptorSet of foxglove.RawImage and of the google.protobuf.Timestamp in it."""
    stamp = _described("Timestamp", [("seconds", 1, _INT64, ""), ("nanos", 2, _INT32, "")])
    image = _described(
        "RawImage",
        [
            ("timestamp", 1, _MESSAGE, ".google.protobuf.Timestamp"),
            ("frame_id", 7, _STRING, ""),
            ("width", 2, _FIXED32_TYPE, ""),
            ("height", 3, _FIXED32_TYPE, ""),
            ("encoding", 4, _STRING, ""),
            ("step", 5, _FIXED32_TYPE, ""),
            ("data", 6, _BYTES_TYPE, ""),
        ],
    )
    timestamp_file = b"google/protobuf/timestamp.proto"
    return _field(1, _file(timestamp_file, b"google.protobuf", stamp)) + _field(
        1, _file(b"foxglove/RawImage.proto", b"foxglove", image, timestamp_file)
    )


def _file(name: bytes, package: bytes, message: bytes, needs: bytes = b"") -> bytes:
    return (
        _field(1, name)
        + _field(2, package)
        + (_field(3, needs) if needs else b"")
        + _field(4, message)
        + _field(12, b"proto3")
    )


def _described(name: str, fields: list[tuple[str, int, int, str]]) -> bytes:
    made = _field(1, name.encode())
    for label, number, kind, of in fields:
        described = _field(1, label.encode()) + _number(3, number) + _number(4, _OPTIONAL) + _number(5, kind)
        made += _field(2, described + (_field(6, of.encode()) if of else b""))
    return made
