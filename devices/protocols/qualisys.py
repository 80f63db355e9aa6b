"""Qualisys' real-time protocol (QTM RT, little-endian): packets, commands, markers and bodies. Bytes in, no socket, no clock.

Source: Qualisys' public protocol documentation (1.20); its own client qtm-rt reads what `build_data` makes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

PORT, VERSION = 22223, "1.25"
ERROR, COMMAND, XML, DATA, NO_MORE, EVENT = 0, 1, 2, 3, 4, 6
MARKERS, BODIES = 1, 5
HEADER = struct.Struct("<II")
LONGEST = 1 << 24


class QualisysError(ValueError):
    """Bytes that are no packet, or one that is cut off."""


@dataclass(slots=True)
class QualisysFrame:
    """markers (m, 3) and bodies (b, 12): position and nine numbers of the rotation, in QTM's order; mm; NaN: lost. time_us is QTM's."""

    number: int
    time_us: int
    markers: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    bodies: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 12), np.float32))


class QualisysDecoder:
    """Feed it bytes as they come, cut anywhere: packets as (type, payload). Raises QualisysError where they can be none."""

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
            at += size
    except struct.error as error:
        raise QualisysError(f"a frame that is cut off: {error}") from None
    return made


def build_data(made: QualisysFrame) -> bytes:
    """The payload of a data packet; for simulators and tests."""
    parts = []
    for kind, rows in ((MARKERS, made.markers), (BODIES, made.bodies)):
        if len(rows):
            body = struct.pack("<Ihh", len(rows), 0, 0) + np.ascontiguousarray(rows, "<f4").tobytes()
            parts.append(HEADER.pack(HEADER.size + len(body), kind) + body)
    return struct.pack("<qII", made.time_us, made.number, len(parts)) + b"".join(parts)


def names(xml: str) -> tuple[float, list[str], list[str]]:
    """Frames per second (0: not said), markers' and bodies' names, in the order of the data. Raises QualisysError."""
    try:
        root = ElementTree.fromstring(xml)
    except ElementTree.ParseError as error:
        raise QualisysError(f"parameters that are no XML: {error}") from None
    markers = [(one.findtext("Name") or "").strip() for one in root.findall("./The_3D/Label")]
    bodies = [(one.findtext("Name") or "").strip() for one in root.findall("./The_6D/Body")]
    rate = (root.findtext("./General/Frequency") or "0").strip()
    return float(rate) if rate.replace(".", "", 1).isdigit() else 0.0, markers, bodies
