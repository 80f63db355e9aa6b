"""Binary frames as a graph declares them: sync bytes, fields, checksum, footer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

from kinegraph.stream.errors import ParameterError
from kinegraph.stream.params import param

NS_PER = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 10**9, "min": 60 * 10**9, "h": 3600 * 10**9}
Type = Literal[
    "u8", "i8", "u16", "i16", "u24", "i24", "u32", "i32", "u64", "i64", "f32", "f64",
    "u1", "u2", "u3", "u4", "u5", "u6", "u7", "u10", "u12", "u14", "u18", "u20",
    "i4", "i10", "i12", "i14", "i18", "i20",
]  # fmt: skip
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

    type: Type = param(
        help="u or i (signed) and the bits, or f32, f64; numbers of 10 or 12 bits stand packed, one behind the other"
    )
    name: str = param("", help="the channel's name; without one the field is passed over")
    role: Literal["data", "counter", "time"] = param("data", help="data, a counter of frames, or the device's time")
    scale: float = param(1.0, help="factor from the number to the unit")
    offset: float = param(0.0, help="added after the factor")
    unit: str = param("", unit=True, help="unit of the channel, or of the time")
    endian: Literal["", "little", "big"] = param("", help="byte order, where it differs from the frame's")
    wraps: int = param(
        0, least=0, help="of a counter: after how many frames it starts again, where that is not by its bits"
    )
    count: int = param(1, least=1, most=4096, help="how many of them follow one another: channels NAME1, NAME2, ...")

    def each(self) -> tuple[Field, ...]:
        """The numbers of an array, each a field of its own."""
        if self.count == 1:
            return (self,)
        return tuple(replace(self, name=self.name and f"{self.name}{i + 1}", count=1) for i in range(self.count))

    @property
    def bits(self) -> int:
        return int(self.type[1:])

    @property
    def turn(self) -> int:
        """After how many frames a counter starts again."""
        return self.wraps or 1 << self.bits

    @property
    def is_channel(self) -> bool:
        return self.role == "data" and bool(self.name)


@dataclass(frozen=True, slots=True)
class Frame:
    """One kind of frame: sync bytes, fields one after the other, checksum, footer; always of the same length.

    Its data fields are the channels of an output of the frame's name. A frame without a time of its own has that of the last frame
    before it that brought one. With `samples`, its data fields, from the first to the last, stand there as often, one sample behind the
    other (or each channel's samples together); the frame's time, counter and `rate_hz` are those of the frame, and its time is the last
    sample's.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    sync: str | int = param(
        help='the bytes it begins with, in hex: "55 51"; "" where each transfer or packet is a frame, whatever it begins with'
    )
    fields: tuple[Field, ...] = param(help="what comes between sync and checksum, in order")
    name: str = param("", help="the output's name; not needed by a frame without data")
    endian: Literal["little", "big"] = param("little", help="byte order of fields and checksum")
    checksum: Kind = param("none", help="over all bytes before it, the first `checksum_from` left out")
    checksum_from: int = param(0, least=0, help="with how many bytes at its beginning the checksum does not deal")
    footer: str | int = param("", help="the bytes it ends with, in hex")
    rate_hz: float | None = param(None, above=0, help="frames per second; left out: irregular")
    samples: int = param(1, least=1, most=4096, help="how many samples a frame holds")
    by_channel: bool = param(False, help="of several samples, all of one channel stand together")

    def __post_init__(self) -> None:
        object.__setattr__(self, "fields", tuple(number for f in self.fields for number in f.each()))

    @property
    def channels(self) -> tuple[Field, ...]:
        return tuple(f for f in self.fields if f.is_channel)

    @property
    def sample_hz(self) -> float | None:
        """Samples per second."""
        return self.rate_hz and self.rate_hz * self.samples

    @property
    def laid_out(self) -> tuple[Field, ...]:
        """The fields as they stand in a frame, with those of every sample."""
        at = [i for i, f in enumerate(self.fields) if f.is_channel]
        if self.samples == 1 or not at:
            return self.fields
        before, each, behind = self.fields[: at[0]], self.fields[at[0] : at[-1] + 1], self.fields[at[-1] + 1 :]
        if self.by_channel:
            return (*before, *(f for f in each for _ in range(self.samples)), *behind)
        return (*before, *each * self.samples, *behind)

    def with_role(self, role: str) -> tuple[Field, ...]:
        return tuple(f for f in self.fields if f.role == role)


def hex_bytes(text: str | int, parameter: str) -> bytes:
    """Bytes from "55 51"; raises ParameterError, also for a number: of 0x00AA the zeros are lost, and 55 may be meant as hex."""
    if isinstance(text, int):
        read = f"without quotes, YAML reads a number (0x{text:X} is {text})"
        raise ParameterError(parameter, text, f"bytes in hex and in quotes, as in '55 51' or '0xAA55'; {read}")
    try:
        return bytes.fromhex(text.replace("0x", "").replace(",", " "))
    except ValueError:
        raise ParameterError(parameter, text, "bytes in hex, as in '55 51'") from None
