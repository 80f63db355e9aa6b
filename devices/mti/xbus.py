"""Xbus, which Xsens/Movella MTi sensors speak: bytes to messages and measurements, and commands as bytes. No port, no clock.

A message is FA FF, what it is (MID), the length of its data, the data, and a sum that makes all bytes after FA add up to 0 mod 256. A
length of FF stands for two more bytes with the length (255 to 2048). Measurements (MTData2) are items, each an identifier of 16 bits, the
length of its data and the data, big-endian; an identifier's last 4 bits say the numbers' format and the frame of reference. Messages of
the same layout that follow each other are taken at once.

Source: Xsens document MT0101P, "MT Low Level Communication Protocol Documentation" (public).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import msgspec
import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.mti import xbus_numbers as numbers
from kinegraph.stream.chunk import STAMP, Samples, Times

HEAD = b"\xfa\xff"
EXTENDED = 0xFF
LONGEST = 2048
"""Bytes of data that a message has at most."""
MAX = 512
"""Messages that are taken at once at most."""

REQUEST_DEVICE_ID, DEVICE_ID = 0x00, 0x01
GO_TO_MEASUREMENT, GO_TO_CONFIG = 0x10, 0x30
REQUEST_FIRMWARE, REQUEST_PRODUCT = 0x12, 0x1C
WAKE_UP, WAKE_UP_ACK = 0x3E, 0x3F
RESET = 0x40
ERROR = 0x42
OUTPUT_CONFIGURATION = 0xC0
MEASUREMENT = 0x36

PACKET_COUNTER, SAMPLE_TIME_FINE = 0x1020, 0x1060
QUATERNION = 0x2010
ACCELERATION, FREE_ACCELERATION, ACCELERATION_HR = 0x4020, 0x4030, 0x4040
RATE_OF_TURN, RATE_OF_TURN_HR = 0x8020, 0x8040
MAGNETIC_FIELD = 0xC020
STATUS_WORD, TEMPERATURE, PRESSURE = 0xE020, 0x0810, 0x3010

KIND = 0xFFF0
"""What of an identifier says which quantity it is; the rest is format and frame of reference."""
EVERY_PACKET = 0xFFFF
"""The rate of what comes with every packet: counters and times."""
TICKS_HZ = 10_000
"""SampleTimeFine counts tenths of a millisecond."""

ERRORS = {
    0x03: "a period it cannot do",
    0x04: "an invalid message, or one that it cannot obey in its present state",
    0x1E: "its timer has run over: its outputs are more than it can compute or the line can carry",
    0x20: "a baud rate it cannot do",
    0x21: "a parameter out of range",
    0x28: "an error of the device itself",
}

_BYTES = (4, 4, 6, 8)
"""A number's, by its format: 32 bits, 12.20, 16.32, 64 bits."""
_SIZES = {PACKET_COUNTER: 2, SAMPLE_TIME_FINE: 4, STATUS_WORD: 4}
_VECTORS = {
    QUATERNION: 4, ACCELERATION: 3, FREE_ACCELERATION: 3, ACCELERATION_HR: 3,
    RATE_OF_TURN: 3, RATE_OF_TURN_HR: 3, MAGNETIC_FIELD: 3, TEMPERATURE: 1,
}  # fmt: skip

Table = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class XbusLayout:
    """How messages of one kind are laid out.

    mid     what they are
    size    bytes of a whole message
    start   where the data begin
    items   (identifier, first byte, bytes) of a measurement's items
    fixed   the bytes that are the same in all messages of this layout
    """

    mid: int
    size: int
    start: int
    items: tuple[tuple[int, int, int], ...]
    fixed: Times


class XbusRun(msgspec.Struct, eq=False, gc=False):
    """Messages (n, size) of one layout that followed each other."""

    layout: XbusLayout
    table: Table

    def __len__(self) -> int:
        return len(self.table)

    @property
    def mid(self) -> int:
        return self.layout.mid

    @property
    def data(self) -> bytes:
        """The data of the last message."""
        return self.table[-1, self.layout.start : -1].tobytes()

    def has(self, kind: int) -> bool:
        """Whether these measurements hold this quantity."""
        return any(identifier & KIND == kind for identifier, _, _ in self.layout.items)

    def integers(self, kind: int) -> Times:
        """A counter or time (n,) int64."""
        _, at, size = _item(self.layout.items, kind)
        out = np.empty(len(self.table), STAMP)
        numbers.integers(self.table, at, size, out)
        return out

    def vectors(self, kind: int) -> Samples:
        """A quantity (n, components) float64, whichever of the four formats it comes in."""
        return self.columns((kind,))

    def columns(self, kinds: tuple[int, ...]) -> Samples:
        """Several quantities side by side (n, components) float64."""
        places, width = _places(self.layout.items, kinds)
        out = np.empty((len(self.table), width))
        numbers.reals(self.table, places, out)
        return out


class XbusFrames(msgspec.Struct, eq=False, gc=False):
    """What a feed brought: runs of messages in order, bytes outside messages, and how often it had to resynchronise."""

    runs: list[XbusRun]
    dropped: int
    resyncs: int


class XbusDecoder:
    """Feed it bytes as they come, cut anywhere; it never waits and never raises.

    What cannot become a message any more is given up with the byte that shows it: a measurement's items must fill its length exactly, and
    known ones have known sizes. So after a damaged beginning the next one is found as soon as it has come, in nearly all cases.
    """

    def __init__(self) -> None:
        self._buffer = b""
        self._following = False
        self._usual = _NONE
        self._fixed: Table = np.zeros(0, np.uint8)
        """The layout of the last message, and what its fixed bytes were: what is like it need not be taken apart again."""

    def feed(self, data: bytes) -> XbusFrames:
        buffer = self._buffer + data if self._buffer else data
        raw: Table = np.frombuffer(buffer, np.uint8)
        runs: list[XbusRun] = []
        at = dropped = resyncs = 0
        while at < len(buffer):
            layout: XbusLayout | None = self._usual
            n = _sound(raw, at, self._usual, self._fixed)
            if not n:
                layout = _layout(buffer, at)
                if layout is None:
                    break
                n = _sound(raw, at, layout, raw[at + layout.fixed])
            assert layout is not None
            if n:
                stop = at + n * layout.size
                runs.append(XbusRun(layout, raw[at:stop].reshape(n, layout.size)))
                if layout is not self._usual:
                    self._usual, self._fixed = layout, raw[at + layout.fixed]
                at, self._following = stop, True
                continue
            resyncs += self._following
            self._following = False
            start = buffer.find(HEAD[:1], at + 1)
            start = start if start >= 0 else len(buffer)
            dropped += start - at
            at = start
        self._buffer = buffer[at:]
        return XbusFrames(runs, dropped, resyncs)


@lru_cache(maxsize=256)
def _known(mid: int, size: int, start: int, items: tuple[tuple[int, int, int], ...]) -> XbusLayout:
    fixed = [*range(start), *(at - 3 + i for _, at, _ in items for i in range(3))]
    return XbusLayout(mid, size, start, items, np.array(fixed, np.int64))


_NONE = XbusLayout(0, 0, 0, (), np.zeros(0, np.int64))
"""The layout of what is no message."""


def _layout(buffer: bytes, at: int) -> XbusLayout | None:
    """How the message at `at` is laid out; `_NONE` if there is no message, None if that is not yet known."""
    if not HEAD.startswith(buffer[at : at + 2]):
        return _NONE
    if len(buffer) < at + 4:
        return None
    mid, length, start = buffer[at + 2], buffer[at + 3], 4
    if length == EXTENDED:
        if len(buffer) < at + 6:
            return None
        length, start = int.from_bytes(buffer[at + 4 : at + 6], "big"), 6
        if not EXTENDED <= length <= LONGEST:
            return _NONE
    items: list[tuple[int, int, int]] = []
    if mid == MEASUREMENT:
        place, end = at + start, at + start + length
        while place < end:
            if place + 3 > end:
                return _NONE
            if len(buffer) < place + 3:
                return None
            identifier, size = int.from_bytes(buffer[place : place + 2], "big"), buffer[place + 2]
            if place + 3 + size > end or not _possible(identifier, size):
                return _NONE
            items.append((identifier, place + 3 - at, size))
            place += 3 + size
    if len(buffer) < at + start + length + 1:
        return None
    return _known(mid, start + length + 1, start, tuple(items))


def _possible(identifier: int, size: int) -> bool:
    """Whether an item of this kind can have this size."""
    kind = identifier & KIND
    if kind in _VECTORS:
        return size == _VECTORS[kind] * _BYTES[identifier & 3]
    return size == _SIZES.get(kind, size)


def _sound(raw: Table, at: int, layout: XbusLayout, fixed: Table) -> int:
    """How many messages of this layout follow each other from `at` with a right sum, the bytes that are the same in all being `fixed`."""
    if not layout.size or len(raw) - at < layout.size:
        return 0
    return numbers.sound(raw, at, layout.size, MAX, layout.fixed, fixed)


def _item(items: tuple[tuple[int, int, int], ...], kind: int) -> tuple[int, int, int]:
    for item in items:
        if item[0] & KIND == kind:
            return item
    raise KeyError(f"these measurements have no {kind:04X}")


@lru_cache(maxsize=64)
def _places(items: tuple[tuple[int, int, int], ...], kinds: tuple[int, ...]) -> tuple[Times, int]:
    """(first byte, components, format) of each of these quantities, and the components of all."""
    found = [_item(items, kind) for kind in kinds]
    places = [(at, size // _BYTES[identifier & 3], identifier & 3) for identifier, at, size in found]
    return np.array(places, np.int64), sum(components for _, components, _ in places)


def message(mid: int, data: bytes = b"") -> bytes:
    """A message, of the host or the device."""
    length = bytes([len(data)]) if len(data) < EXTENDED else bytes([EXTENDED]) + len(data).to_bytes(2, "big")
    body = HEAD[1:] + bytes([mid]) + length + data
    return HEAD[:1] + body + bytes([-sum(body) % 256])


def item(identifier: int, data: bytes) -> bytes:
    """An item of a measurement; for simulators and tests."""
    return struct.pack(">HB", identifier, len(data)) + data


def configuration(outputs: Sequence[tuple[int, int]]) -> bytes:
    """The data of SetOutputConfiguration: (identifier, rate in Hz) of every output, in this order."""
    return b"".join(struct.pack(">HH", identifier, rate) for identifier, rate in outputs)


def outputs_of(data: bytes) -> list[tuple[int, int]]:
    """The (identifier, rate in Hz) that a device says are set."""
    return list(struct.iter_unpack(">HH", data[: len(data) // 4 * 4]))


def firmware(data: bytes) -> str:
    """The firmware's version from the answer to its request: "1.8.2"."""
    return ".".join(str(part) for part in data[:3]) if len(data) >= 3 else "unknown"
