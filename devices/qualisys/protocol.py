"""Qualisys' real-time protocol (QTM RT, little-endian): packets, commands, markers and bodies. Bytes in, no socket, no clock.

Source: Qualisys' public protocol documentation (1.20); its own client qtm-rt reads what `build_data` makes (tests/peers). We do
not read with it: it owns its socket and an asyncio loop, so that packets cannot be cut anywhere in tests and arrivals are stamped late, and
the simulator needs the same packets all the same.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

PORT, VERSION = 22223, "1.25"
ERROR, COMMAND, XML, DATA, NO_MORE, EVENT = 0, 1, 2, 3, 4, 6
MARKERS, ANALOG, BODIES, SKELETONS = 1, 3, 5, 18
HEADER = struct.Struct("<II")
LONGEST = 1 << 24
SEGMENT = np.dtype([("number", "<u4"), ("values", "<f4", 7)])


class QualisysError(ValueError):
    """Bytes that are no packet, or one that is cut off."""


@dataclass(frozen=True, slots=True)
class AnalogSamples:
    """Of one device: its samples (n, channels), in the device's unit, and the running number of the first."""

    device: int
    first: int
    values: NDArray[np.float32]


@dataclass(slots=True)
class QualisysFrame:
    """markers (m, 3) and bodies (b, 12): position and nine numbers of the rotation, in QTM's order; mm; NaN: lost. time_us is QTM's.

    skeletons    of each, in QTM's order, the segments by their number: position in mm and quaternion x, y, z, w (7,)
    analog       what has come since the frame before, on a clock of its own: a frame may bring 0 or several frames' samples
    """

    number: int
    time_us: int
    markers: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    bodies: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 12), np.float32))
    skeletons: list[dict[int, NDArray[np.float32]]] = field(default_factory=list)
    analog: list[AnalogSamples] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class AnalogDevice:
    """name, samples per second, and each channel's name and unit."""

    number: int
    name: str
    rate_hz: float
    channels: list[str]
    units: list[str]


@dataclass(slots=True)
class QualisysNames:
    """What QTM has, in the order of the data. rate_hz: frames per second, 0: unknown; segments: of each skeleton, name to number;
    up: the axis that points up, "" if unknown."""

    rate_hz: float
    markers: list[str]
    bodies: list[str]
    skeletons: dict[str, dict[str, int]]
    analog: list[AnalogDevice]
    up: str = ""


class QualisysDecoder:
    """Feed it bytes as they come, cut anywhere: packets as (type, payload). Raises QualisysError for invalid bytes."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        self._buffer += data
        found: list[tuple[int, bytes]] = []
        while len(self._buffer) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._buffer)
            if not HEADER.size <= size <= LONGEST:
                raise QualisysError(f"a packet of {size} bytes; is it the little-endian port {PORT}?")
            if len(self._buffer) < size:
                break
            found.append((kind, self._buffer[HEADER.size : size]))
            self._buffer = self._buffer[size:]
        return found


def packet(kind: int, payload: bytes) -> bytes:
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def command(text: str) -> bytes:
    return packet(COMMAND, text.encode() + b"\0")


def text_of(payload: bytes) -> str:
    return payload.rstrip(b"\0").decode("utf-8", "replace")


def frame(payload: bytes) -> QualisysFrame:
    """A data packet; raises QualisysError."""
    try:
        time_us, number, count = struct.unpack_from("<qII", payload)
        made, at = QualisysFrame(number, time_us), 16
        for _ in range(count):
            size, kind = HEADER.unpack_from(payload, at)
            if size < HEADER.size or at + size > len(payload):
                raise QualisysError(f"a component of {size} bytes, where {len(payload) - at} are left")
            if kind in (MARKERS, BODIES):
                width = 3 if kind == MARKERS else 12
                (n,) = struct.unpack_from("<I", payload, at + 8)
                if 16 + 4 * width * n > size:
                    raise QualisysError(f"{n} parts in a component of {size} bytes")
                rows = np.frombuffer(payload, "<f4", width * n, at + 16).reshape(n, width)
                if kind == MARKERS:
                    made.markers = rows
                else:
                    made.bodies = rows
            elif kind == ANALOG:
                made.analog = _analog(payload[at + 8 : at + size])
            elif kind == SKELETONS:
                made.skeletons = _skeletons(payload[at + 8 : at + size])
            at += size
    except (struct.error, ValueError) as error:
        raise QualisysError(f"a frame that is cut off: {error}") from None
    return made


def _analog(data: bytes) -> list[AnalogSamples]:
    (devices,), at, made = struct.unpack_from("<I", data), 4, []
    for _ in range(devices):
        number, channels, n = struct.unpack_from("<III", data, at)
        at += 12
        if n:
            (first,) = struct.unpack_from("<I", data, at)
            values = np.frombuffer(data, "<f4", channels * n, at + 4).reshape(channels, n)
            made.append(AnalogSamples(number, first, values.T))
            at += 4 + 4 * channels * n
    return made


def _skeletons(data: bytes) -> list[dict[int, NDArray[np.float32]]]:
    (count,), at, made = struct.unpack_from("<I", data), 4, []
    for _ in range(count):
        (segments,) = struct.unpack_from("<I", data, at)
        rows = np.frombuffer(data, SEGMENT, segments, at + 4)
        made.append({int(row["number"]): row["values"] for row in rows})
        at += 4 + SEGMENT.itemsize * segments
    return made


def build_data(made: QualisysFrame) -> bytes:
    """The payload of a data packet; for simulators and tests."""
    parts = []
    for kind, rows in ((MARKERS, made.markers), (BODIES, made.bodies)):
        if len(rows):
            body = struct.pack("<Ihh", len(rows), 0, 0) + np.ascontiguousarray(rows, "<f4").tobytes()
            parts.append((kind, body))
    if made.analog:
        body = struct.pack("<I", len(made.analog))
        for block in made.analog:
            n, channels = block.values.shape
            body += struct.pack("<IIII", block.device, channels, n, block.first)
            body += np.ascontiguousarray(block.values.T, "<f4").tobytes()
        parts.append((ANALOG, body))
    if made.skeletons:
        body = struct.pack("<I", len(made.skeletons))
        for skeleton in made.skeletons:
            body += struct.pack("<I", len(skeleton)) + np.array([*skeleton.items()], SEGMENT).tobytes()
        parts.append((SKELETONS, body))
    whole = b"".join(HEADER.pack(HEADER.size + len(body), kind) + body for kind, body in parts)
    return struct.pack("<qII", made.time_us, made.number, len(parts)) + whole


def names(xml: str) -> QualisysNames:
    """What the parameters of QTM name. Raises QualisysError."""
    try:
        root = ElementTree.fromstring(xml)
    except ElementTree.ParseError as error:
        raise QualisysError(f"parameters that are not XML: {error}") from None
    return QualisysNames(
        _number(root.findtext("./General/Frequency")),
        [(one.findtext("Name") or "").strip() for one in root.findall("./The_3D/Label")],
        [(one.findtext("Name") or "").strip() for one in root.findall("./The_6D/Body")],
        {
            one.get("Name", ""): {segment.get("Name", ""): int(segment.get("ID", 0)) for segment in one.iter("Segment")}
            for one in root.findall("./Skeletons/Skeleton")
        },
        [_analog_device(one) for one in root.findall("./Analog/Device")],
        (root.findtext("./The_3D/AxisUpwards") or "").strip().lower().lstrip("+"),
    )


def _analog_device(element: ElementTree.Element) -> AnalogDevice:
    """Labels and units stand in a `Channel` each, in protocols before 1.12 in the device itself."""
    channels = [(one.text or "").strip() for one in element.iter("Label")]
    units = [(one.text or "").strip() for one in element.iter("Unit")]
    units = units if len(units) == len(channels) else (units[:1] or [""]) * len(channels)
    name = (element.findtext("Device_Name") or "").strip()
    return AnalogDevice(
        int(_number(element.findtext("Device_ID"))), name, _number(element.findtext("Frequency")), channels, units
    )


def _number(text: str | None) -> float:
    try:
        return float((text or "0").strip())
    except ValueError:
        return 0.0
