"""Messages of depthai's own recordings: dai.proto.img_frame.ImgFrame in Protocol Buffers, as far as a depth frame needs it.

Field numbers are those of the schema that every such recording carries; a test compares them with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.recording.format.image import wire_fields

SCHEMA = "dai.proto.img_frame.ImgFrame"
RAW16 = 14
TS, TS_DEVICE, NUMBER, LAYOUT, DATA = 1, 2, 3, 4, 11
TYPE, WIDTH, HEIGHT, STRIDE = 1, 2, 3, 4
SEC, NSEC = 1, 2


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """One frame: its number, its times (ns, of the camera and of the computer that recorded it), its rows of pixels.

    type   RAW16, or something that is no depth
    rows   (height, stride in bytes) uint8, a view of the message
    """

    number: int
    device: int
    host: int
    type: int
    width: int
    rows: Array


def decode(body: memoryview) -> RecordedMessage | None:
    """The frame in a message; None for another kind, or if it is cut off."""
    try:
        found = dict(wire_fields(body))
        layout = _numbers(found.get(LAYOUT))
        width, height = layout.get(WIDTH, 0), layout.get(HEIGHT, 0)
        stride = layout.get(STRIDE, 0) or 2 * width
        data = np.frombuffer(_bytes(found.get(DATA)), np.uint8)
        if not width or not height or stride < 2 * width or len(data) < stride * height:
            return None
        host, device = _time(found.get(TS)), _time(found.get(TS_DEVICE))
        number = found.get(NUMBER, 0)
        rows = data[: stride * height].reshape(height, stride)
        return RecordedMessage(_signed(number), device, host, layout.get(TYPE, 0), width, rows)
    except (IndexError, ValueError, TypeError):
        return None


def _bytes(value: int | memoryview | None) -> memoryview:
    if not isinstance(value, memoryview):
        raise TypeError("a field of bytes is missing")
    return value


def _numbers(value: int | memoryview | None) -> dict[int, int]:
    """The whole numbers in a message within a message; empty where it is missing."""
    if value is None:
        return {}
    return {number: _signed(v) for number, v in wire_fields(_bytes(value)) if isinstance(v, int)}


def _time(value: int | memoryview | None) -> int:
    stamp = _numbers(value)
    return stamp.get(SEC, 0) * NS + stamp.get(NSEC, 0)


def _signed(value: int | memoryview) -> int:
    """A varint as the int64 that it stands for."""
    if not isinstance(value, int):
        raise TypeError("a number is missing")
    value &= (1 << 64) - 1
    return value - (1 << 64) if value >> 63 else value
