"""Binary frames as a graph declares them: sync bytes, fields, checksum, footer. Bytes to frames and back; no port, no clock."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np

from devices.protocols.checksums import CHECKSUMS
from stream.chunk import Array, Samples, Times
from stream.errors import ParameterError
from stream.params import param

SPOILT = 40
"""Frames with a wrong checksum that a feed shows."""
NS_PER = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 10**9, "min": 60 * 10**9, "h": 3600 * 10**9}
Type = Literal["u8", "i8", "u16", "i16", "u24", "i24", "u32", "i32", "u64", "i64", "f32", "f64"]
Kind = Literal[
    "none",
    "sum8",
    "zero_sum8",
    "xor8",
    "crc8",
    "sum16",
    "fletcher8",
    "crc16_modbus",
    "crc16_ccitt",
    "crc16_xmodem",
    "crc32",
]


@dataclass(frozen=True, slots=True)
class Field:
    """One number in a frame.

    A field of data becomes a channel: its number times `scale`, plus `offset`, in `unit`. A field of time is its number times `scale` in
    `unit`: ns, us, ms, s, min or h; several of them add up (a clock of hours, minutes, seconds).
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    type: Type = param(help="u or i (signed) and the bits, or f32, f64")
    name: str = param("", help="the channel's name; without one the field is passed over")
    role: Literal["data", "counter", "time"] = param("data", help="data, a counter of frames, or the device's time")
    scale: float = param(1.0, help="factor from the number to the unit")
    offset: float = param(0.0, help="added after the factor")
    unit: str = param("", help="unit of the channel, or of the time")
    endian: Literal["", "little", "big"] = param("", help="byte order, where it differs from the frame's")
    count: int = param(1, least=1, most=4096, help="so many of them, one after the other: channels NAME1, NAME2, ...")

    def each(self) -> tuple[Field, ...]:
        """The numbers of an array, each a field of its own."""
        if self.count == 1:
            return (self,)
        return tuple(replace(self, name=self.name and f"{self.name}{i + 1}", count=1) for i in range(self.count))

    @property
    def bits(self) -> int:
        return int(self.type[1:])

    @property
    def is_channel(self) -> bool:
        return self.role == "data" and bool(self.name)


@dataclass(frozen=True, slots=True)
class Frame:
    """One kind of frame: sync bytes, fields one after the other, checksum, footer; always of the same length.

    Its data fields are the channels of an output of the frame's name. A frame without a time of its own has that of the last frame
    before it that brought one.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    sync: str = param(help='the bytes it begins with, in hex: "55 51"')
    fields: tuple[Field, ...] = param(help="what stands between sync and checksum, in order")
    name: str = param("", help="the output's name; a frame without data needs none")
    endian: Literal["little", "big"] = param("little", help="byte order of fields and checksum")
    checksum: Kind = param("none", help="over all bytes before it, the first `checksum_from` left out")
    checksum_from: int = param(0, least=0, help="with how many bytes at its beginning the checksum does not deal")
    footer: str = param("", help="the bytes it ends with, in hex")
    rate_hz: float | None = param(None, above=0, help="frames per second; left out: irregular")

    def __post_init__(self) -> None:
        object.__setattr__(self, "fields", tuple(number for f in self.fields for number in f.each()))

    @property
    def channels(self) -> tuple[Field, ...]:
        return tuple(f for f in self.fields if f.is_channel)

    def with_role(self, role: str) -> tuple[Field, ...]:
        return tuple(f for f in self.fields if f.role == role)


def hex_bytes(text: str, parameter: str) -> bytes:
    """Bytes from "55 51"; raises ParameterError."""
    try:
        return bytes.fromhex(text.replace("0x", "").replace(",", " "))
    except ValueError:
        raise ParameterError(parameter, text, "bytes in hex, as in '55 51'") from None


class FrameLayout:
    """A frame's layout, worked out: where each field stands. Raises ParameterError for what cannot be."""

    def __init__(self, frame: Frame, at: str = "frames") -> None:
        self.frame = frame
        self.sync, self.footer = hex_bytes(frame.sync, f"{at}.sync"), hex_bytes(frame.footer, f"{at}.footer")
        if not self.sync:
            raise ParameterError(f"{at}.sync", frame.sync, "at least one byte in hex")
        if not frame.fields:
            raise ParameterError(f"{at}.fields", [], "at least one field")
        self.checksum = CHECKSUMS[frame.checksum]
        self._places: list[int] = []
        end = len(self.sync)
        for f in frame.fields:
            self._places.append(end)
            end += f.bits // 8
        self.body_end = end
        self.size = end + self.checksum.size + len(self.footer)
        if frame.checksum != "none" and frame.checksum_from >= end:
            raise ParameterError(f"{at}.checksum_from", frame.checksum_from, f"below {end}, where the checksum stands")
        self._dtype = np.dtype(
            {
                "names": [f"f{i}" for i in range(len(frame.fields))],
                "formats": [self._format(f) for f in frame.fields],
                "offsets": self._places,
                "itemsize": self.size,
            }
        )
        self._scale = np.array([f.scale for f in frame.channels])
        self._offset = np.array([f.offset for f in frame.channels])

    @property
    def pattern(self) -> bytes:
        """Matches a frame with any content."""
        rest = self.size - len(self.sync) - len(self.footer)
        return re.escape(self.sync) + b".{%d}" % rest + re.escape(self.footer)

    def sound(self, frame: bytes) -> bool:
        """Whether the checksum is right."""
        if not self.checksum.size:
            return True
        said = int.from_bytes(frame[self.body_end : self.body_end + self.checksum.size], self.frame.endian)
        return said == self.checksum.of(frame[self.frame.checksum_from : self.body_end])

    def table(self, frames: bytes) -> Array:
        """Frames, one after the other, as a structured array (n,)."""
        return np.frombuffer(frames, self._dtype)

    def values(self, table: Array) -> Samples:
        """The channels (n, c) in their units."""
        chosen = [i for i, f in enumerate(self.frame.fields) if f.is_channel]
        columns = [self._numbers(table, i) for i in chosen]
        raw = np.stack([c.astype(np.float64) for c in columns], axis=1) if columns else np.empty((len(table), 0))
        return np.asarray(raw * self._scale + self._offset)

    def counters(self, table: Array) -> Times | None:
        """The counter of every frame; None if there is none."""
        for i, f in enumerate(self.frame.fields):
            if f.role == "counter":
                return self._numbers(table, i).astype(np.int64)
        return None

    def times_ns(self, table: Array) -> Times | None:
        """The device's time of every frame; None if it does not say."""
        total: Times | None = None
        for i, f in enumerate(self.frame.fields):
            if f.role == "time":
                numbers = self._numbers(table, i)
                ns = (
                    numbers.astype(np.float64) * NS_PER[f.unit] * f.scale
                    if f.type[0] == "f"
                    else numbers.astype(np.int64) * (NS_PER[f.unit] if f.scale == 1.0 else NS_PER[f.unit] * f.scale)
                )
                total = np.round(ns).astype(np.int64) + (0 if total is None else total)
        return total

    def build(self, numbers: Mapping[int, float]) -> bytes:
        """A frame with these raw numbers, by the field's place; 0 in the others. For simulators and tests."""
        table = np.zeros(1, self._dtype)
        for i, f in enumerate(self.frame.fields):
            value = numbers.get(i, 0)
            if f.bits == 24:
                table[f"f{i}"] = int(value).to_bytes(3, self._endian(f), signed=f.type[0] == "i")
            else:
                table[f"f{i}"] = value
        body = self.sync + table.tobytes()[len(self.sync) : self.body_end]
        total = self.checksum.of(body[self.frame.checksum_from :])
        return body + total.to_bytes(self.checksum.size, self.frame.endian) + self.footer

    def _numbers(self, table: Array, i: int) -> Array:
        """One field of every frame, as it stands there."""
        f, column = self.frame.fields[i], np.asarray(table[f"f{i}"])
        if f.bits != 24:
            return column
        three = np.frombuffer(column.tobytes(), np.uint8).reshape(-1, 3).astype(np.int32)
        low, middle, high = three.T if self._endian(f) == "little" else three.T[::-1]
        numbers = low | middle << 8 | high << 16
        return np.asarray(numbers - (numbers >> 23 << 24) if f.type == "i24" else numbers)

    def _endian(self, f: Field) -> Literal["little", "big"]:
        return f.endian or self.frame.endian

    def _format(self, f: Field) -> str:
        if f.bits == 24:
            return "V3"
        return f"{'<' if self._endian(f) == 'little' else '>'}{f.type[0]}{f.bits // 8}"


@dataclass(slots=True)
class FoundFrames:
    """What a feed brought.

    kinds     (n,) which layout each frame has, in the order in which they came
    frames    per layout, its frames one after the other
    bad       frames whose checksum was wrong
    spoilt    the first of these: layout, frame
    dropped   bytes that belonged to no frame
    resyncs   how often the beginning of the next frame had to be looked for
    """

    kinds: list[int] = field(default_factory=list)
    frames: dict[int, bytearray] = field(default_factory=dict)
    bad: int = 0
    dropped: int = 0
    resyncs: int = 0
    spoilt: list[tuple[int, bytes]] = field(default_factory=list)


class FrameDecoder:
    """Feed it bytes as they come, cut anywhere; it never waits and never raises.

    A frame without a checksum is believed if it follows another directly, or if another begins directly behind it.
    """

    def __init__(self, layouts: Sequence[FrameLayout]) -> None:
        self._layouts = layouts
        in_order = sorted(range(len(layouts)), key=lambda i: -len(layouts[i].sync))
        self._order = in_order
        self._frame = re.compile(b"|".join(b"(%s)" % layouts[i].pattern for i in in_order), re.DOTALL)
        self._sync = re.compile(b"|".join(b"(%s)" % re.escape(layouts[i].sync) for i in in_order))
        starts = {layout.sync[:n] for layout in layouts for n in range(1, len(layout.sync))}
        self._tails = re.compile(
            rb"(?:%s)\Z" % b"|".join(map(re.escape, sorted(starts, key=len, reverse=True))) if starts else b"(?!)"
        )
        self._longest = max(len(layout.sync) for layout in layouts)
        self._buffer = b""
        self._following = False

    def feed(self, data: bytes) -> FoundFrames:
        buffer = self._buffer + data
        found = FoundFrames()
        at = 0
        while True:
            start, waits = self._next_sync(buffer, at)
            if start > at and self._following:
                self._following = False
                found.resyncs += 1
            found.dropped += start - at
            at = start
            if waits:
                break
            match = self._frame.match(buffer, at)
            believed = self._believe(buffer, match, found) if match else False
            if believed is None:
                break
            if match and believed:
                kind = self._order[(match.lastindex or 1) - 1]
                found.kinds.append(kind)
                found.frames.setdefault(kind, bytearray()).extend(match.group())
                at, self._following = match.end(), True
                continue
            found.resyncs += self._following
            self._following = False
            found.dropped += 1
            at += 1
        self._buffer = buffer[at:]
        return found

    def _next_sync(self, buffer: bytes, at: int) -> tuple[int, bool]:
        """Where the next frame may begin, and whether more must come to know."""
        sync = self._sync.search(buffer, at)
        if sync is None:
            tail = self._tails.search(buffer, max(at, len(buffer) - self._longest + 1))
            return (tail.start() if tail else len(buffer)), True
        layout = self._layouts[self._order[(sync.lastindex or 1) - 1]]
        return sync.start(), len(buffer) - sync.start() < layout.size

    def _believe(self, buffer: bytes, match: re.Match[bytes], found: FoundFrames) -> bool | None:
        """Whether this is a frame; None if what follows it must come first."""
        layout = self._layouts[self._order[(match.lastindex or 1) - 1]]
        if layout.checksum.size:
            if not layout.sound(match.group()):
                found.bad += 1
                if len(found.spoilt) < SPOILT:
                    found.spoilt.append((self._order[(match.lastindex or 1) - 1], match.group()))
                return False
            return True
        if self._following:
            return True
        after = buffer[match.end() : match.end() + self._longest]
        if self._sync.match(after):
            return True
        return None if len(after) < self._longest else False
