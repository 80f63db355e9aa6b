"""NatNet 3.0 to 4.2, OptiTrack's protocol: messages, frames of data, descriptions of models. Bytes in, no socket, no clock.

Source: the NatNet SDK 4.2's public sample clients (C++; its Python one misses parts of 4.1), a capture of version 3.0.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple

CONNECT, SERVER_INFO, REQUEST, RESPONSE, REQUEST_MODELS, MODELS, FRAME, KEEP_ALIVE, UNKNOWN = (
    0,
    1,
    2,
    3,
    4,
    5,
    7,
    10,
    100,
)
ECHO_REQUEST, ECHO, DISCOVERY = 12, 13, 14
COMMAND_PORT, DATA_PORT, GROUP = 1510, 1511, "239.255.42.99"
OLDEST, NEWEST = (3, 0), (4, 2)
SIZED = (4, 1)
"""From this version on, sections say how long they are."""
OCCLUDED, UNLABELLED = 0x01, 0x10
RECORDING, MODELS_CHANGED = 0x01, 0x02

Version = tuple[int, int]


class NatNetError(ValueError):
    """Bytes that are no message of NatNet, or one that is cut off."""


NUMBER, POINT, BODY, MARKER = (struct.Struct("<" + form) for form in ("i", "3f", "i3f4ffh", "i3ffhf"))


@cache
def _packed(form: str) -> struct.Struct:
    return struct.Struct("<" + form)


class Reader:
    """Numbers and texts out of a message, one after the other; raises NatNetError at its end."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def take(self, form: str) -> tuple[Any, ...]:
        """Numbers, little-endian, packed."""
        return self.unpacked(_packed(form))

    def unpacked(self, made: struct.Struct) -> tuple[Any, ...]:
        """Numbers as packed so."""
        if self._at + made.size > len(self._data):
            raise NatNetError(f"{made.format} at byte {self._at} of {len(self._data)}")
        self._at += made.size
        return made.unpack_from(self._data, self._at - made.size)

    def rows(self, made: struct.Struct, n: int) -> Iterator[tuple[Any, ...]]:
        """`n` times the same numbers."""
        begin, self._at = self._at, self._at + n * made.size
        if self._at > len(self._data):
            raise NatNetError(f"{n} times {made.format} at byte {begin} of {len(self._data)}")
        return made.iter_unpack(self._data[begin : self._at])

    def count(self) -> int:
        """A number of parts, which cannot be more than there are bytes."""
        (number,) = self.unpacked(NUMBER)
        if not 0 <= number <= len(self._data):
            raise NatNetError(f"{number} parts in {len(self._data)} bytes")
        return int(number)

    def text(self) -> str:
        end = self._data.find(b"\0", self._at)
        if end < 0:
            raise NatNetError("a text without an end")
        made, self._at = self._data[self._at : end].decode("utf-8", "replace"), end + 1
        return made

    def part(self) -> Reader:
        """What follows a count of bytes, as many as that says."""
        (size,) = self.unpacked(NUMBER)
        if not 0 <= size <= len(self._data) - self._at:
            raise NatNetError(f"a part of {size} bytes, where {len(self._data) - self._at} are left")
        self._at += size
        return Reader(self._data[self._at - size : self._at])


@dataclass(frozen=True, slots=True)
class ServerInfo:
    """Who answers a connect; `tick_hz` is that of its clock, `multicast`: None where it does not say (older than 3)."""

    application: str
    version: tuple[int, ...]
    natnet: Version
    tick_hz: int = 0
    data_port: int = DATA_PORT
    multicast: bool | None = None
    group: str = GROUP


class NatNetBody(NamedTuple):
    """position (m), rotation (x, y, z, w), mean error of its markers (m)."""

    id: int
    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    error: float
    tracked: bool


class NatNetMarker(NamedTuple):
    """model and marker: of which model it is which marker; position and residual in m."""

    model: int
    marker: int
    position: tuple[float, float, float]
    size: float
    flags: int
    residual: float


@dataclass(slots=True)
class NatNetFrame:
    """One frame. analog: by kind ("plate", "device") and id, the channels, each with its samples in this frame."""

    number: int
    sets: dict[str, list[tuple[float, float, float]]] = field(default_factory=dict)
    unlabelled: list[tuple[float, float, float]] = field(default_factory=list)
    bodies: list[NatNetBody] = field(default_factory=list)
    skeletons: dict[int, list[NatNetBody]] = field(default_factory=dict)
    markers: list[NatNetMarker] = field(default_factory=list)
    analog: dict[tuple[str, int], list[tuple[float, ...]]] = field(default_factory=dict)
    timecode: tuple[int, int] = (0, 0)
    time_s: float = 0.0
    ticks: tuple[int, int, int] = (0, 0, 0)
    """Middle of the exposure, received, sent, in ticks of the server's clock."""
    flags: int = 0


@dataclass(slots=True)
class NatNetModels:
    """What the ids of frames mean."""

    sets: dict[str, list[str]] = field(default_factory=dict)
    bodies: dict[int, str] = field(default_factory=dict)
    markers: dict[int, list[str]] = field(default_factory=dict)
    """By a rigid body's id, its markers' names, where they have some (4.0)."""
    skeletons: dict[int, tuple[str, dict[int, tuple[str, int]]]] = field(default_factory=dict)
    """By id: a name, and by a bone's id its name and its parent's id."""
    analog: dict[tuple[str, int], list[str]] = field(default_factory=dict)


def message(kind: int, payload: bytes = b"") -> bytes:
    return struct.pack("<HH", kind, len(payload)) + payload


def opened(data: bytes) -> tuple[int, bytes]:
    """A message's kind and payload; raises NatNetError."""
    if len(data) < 4:
        raise NatNetError(f"a message of {len(data)} bytes")
    kind, size = struct.unpack_from("<HH", data)
    if size > len(data) - 4:
        raise NatNetError(f"{size} bytes are announced, {len(data) - 4} are there")
    return kind, data[4:]


def connect() -> bytes:
    """The first message to a server: who we are, and the newest version that we read."""
    result = b"kinegraph".ljust(256, b"\0") + bytes([1, 0, 0, 0]) + bytes([*NEWEST, 0, 0])
    return message(CONNECT, result + bytes([0]) + bytes([*NEWEST, 0, 0]))


def server_info(payload: bytes) -> ServerInfo:
    """Raises NatNetError."""
    if len(payload) < 264:
        raise NatNetError(f"a server's answer of {len(payload)} bytes")
    name = payload[:256].split(b"\0", 1)[0].decode("utf-8", "replace")
    version, natnet = tuple(payload[256:260]), (payload[260], payload[261])
    if len(payload) < 279:
        return ServerInfo(name, version, natnet)
    ticks, port, multicast = struct.unpack_from("<QHB", payload, 264)
    return ServerInfo(name, version, natnet, ticks, port, bool(multicast), ".".join(map(str, payload[275:279])))


def build_server_info(info: ServerInfo) -> bytes:
    """The payload of an answer; for simulators and tests."""
    head = info.application.encode().ljust(256, b"\0") + bytes(info.version) + bytes([*info.natnet, 0, 0])
    group = bytes(int(part) for part in info.group.split("."))
    return head + struct.pack("<QHB", info.tick_hz, info.data_port, bool(info.multicast)) + group


def frame(payload: bytes, version: Version) -> NatNetFrame:
    """A frame of data; raises NatNetError."""
    reader = Reader(payload)
    made = NatNetFrame(int(reader.take("i")[0]))
    sized = version >= SIZED

    def section() -> tuple[int, Reader]:
        n = reader.count()
        return n, reader.part() if sized else reader

    n, part = section()
    for _ in range(n):
        name = part.text()
        made.sets[name] = list(part.rows(POINT, part.count()))
    n, part = section()
    made.unlabelled = list(part.rows(POINT, n))
    n, part = section()
    made.bodies = _bodies(part, n)
    n, part = section()
    for _ in range(n):
        (number,) = part.unpacked(NUMBER)
        made.skeletons[number] = _bodies(part, part.count())
    if sized:
        section()  # assets: their markers are among the labelled ones
    n, part = section()
    made.markers = [
        NatNetMarker(both >> 16, both & 0xFFFF, (x, y, z), size, flags, residual)
        for both, x, y, z, size, flags, residual in part.rows(MARKER, n)
    ]
    for kind in ("plate", "device"):
        n, part = section()
        for _ in range(n):
            (number,) = part.take("i")
            made.analog[kind, number] = [part.take(f"{part.count()}f") for _ in range(part.count())]
    *timecode, made.time_s, a, b, c = reader.take("IIdQQQ")
    made.timecode, made.ticks = (timecode[0], timecode[1]), (a, b, c)
    if sized:
        reader.take("II")  # a time of high precision of another clock
    (made.flags,) = reader.take("h")
    return made


def _bodies(reader: Reader, n: int) -> list[NatNetBody]:
    return [
        NatNetBody(number, (x, y, z), (qx, qy, qz, qw), error, bool(flags & 1))
        for number, x, y, z, qx, qy, qz, qw, error, flags in reader.rows(BODY, n)
    ]


def models(payload: bytes, version: Version) -> NatNetModels:
    """Descriptions of models. From 4.1 on, kinds that are not known are passed over; before, they raise NatNetError."""
    reader, made = Reader(payload), NatNetModels()
    for _ in range(reader.count()):
        (kind,) = reader.take("i")
        part = reader.part() if version >= SIZED else reader
        if kind == 0:
            name = part.text()
            made.sets[name] = [part.text() for _ in range(part.count())]
        elif kind == 1:
            name, number, _, names = _described(part, version)
            made.bodies[number], made.markers[number] = name, names
        elif kind == 2:
            name, (number,) = part.text(), part.take("i")
            bones = [_described(part, version) for _ in range(part.count())]
            made.skeletons[number] = name, {bone: (text, parent) for text, bone, parent, _ in bones}
        elif kind == 3:
            (number,) = part.take("i")
            part.text()
            part.take("2f3f144f12fii")
            made.analog["plate", number] = [part.text() for _ in range(part.count())]
        elif kind == 4:
            (number,) = part.take("i")
            part.text()
            part.text()
            part.take("ii")
            made.analog["device", number] = [part.text() for _ in range(part.count())]
        elif kind == 5:
            part.text()
            part.take("3f4f")
        elif version < SIZED:
            raise NatNetError(f"a description of kind {kind}")
    return made


def _described(reader: Reader, version: Version) -> tuple[str, int, int, list[str]]:
    """A rigid body's or a bone's name, id, parent, names of its markers."""
    name = reader.text()
    number, parent = reader.take("ii")
    reader.take("3f4f" if version >= (4, 2) else "3f")
    n = reader.count()
    reader.take(f"{3 * n}f{n}i")
    return name, number, parent, [reader.text() for _ in range(n)] if version >= (4, 0) else []
