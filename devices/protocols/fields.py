"""Where numbers stand in a frame of fixed size, declared in YAML: bytes to columns; no port, no clock.

Shared by everything whose layout its user declares: framed byte streams and USB reports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from stream.chunk import Array, Samples
from stream.errors import ParameterError
from stream.params import param

NumberType = Literal[
    "u8", "i8", "u16", "i16", "u24", "i24", "u32", "i32", "i64", "f32", "f64",
    "u16be", "i16be", "u24be", "i24be", "u32be", "i32be", "i64be", "f32be", "f64be",
]  # fmt: skip
"""Unsigned, signed or floating, how many bits, little-endian unless it ends in be."""

Table = NDArray[np.uint8]


def size_of(kind: NumberType) -> int:
    """Bytes that a number takes."""
    return int(kind[1:].removesuffix("be")) // 8


@dataclass(frozen=True, slots=True)
class Number:
    """A number in a frame that is no channel: a counter, the device's time."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    at: int = param(least=0, help="its first byte, counted from the frame's first (0)")
    type: NumberType = param(help="u8, i16, u24, f32, ...; little-endian, or big-endian: i16be")

    @property
    def bits(self) -> int:
        return 8 * size_of(self.type)


@dataclass(frozen=True, slots=True)
class Field:
    """A number in a frame that is a channel: its value is number * scale + offset, in `unit`."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    name: str = param(help="the channel's name")
    at: int = param(least=0, help="its first byte, counted from the frame's first (0)")
    type: NumberType = param(help="u8, i16, u24, f32, ...; little-endian, or big-endian: i16be")
    scale: float = param(1.0, help="units per count")
    offset: float = param(0.0, help="added after scaling")
    unit: str = param("", help="the unit after scaling")


class Layout:
    """Reads fields and numbers of frames of `size` bytes, many frames at once."""

    def __init__(self, size: int, fields: Sequence[Field]) -> None:
        self.size, self._fields = size, tuple(fields)
        self._scale = np.array([f.scale for f in fields])
        self._offset = np.array([f.offset for f in fields])

    def samples(self, table: Table) -> Samples:
        """(n, fields) float64 of frames (n, size), scaled."""
        out = np.empty((len(table), len(self._fields)))
        for column, field in enumerate(self._fields):
            out[:, column] = numbers(table, field.at, field.type)
        out *= self._scale
        out += self._offset
        return out


def numbers(table: Table, at: int, kind: NumberType) -> Array:
    """The number at byte `at` of each frame (n, size): (n,) int64, or float64."""
    order = ">" if kind.endswith("be") else "<"
    size = size_of(kind)
    raw = table[:, at : at + size]
    if size == 3:
        raw, wide = np.zeros((len(table), 4), np.uint8), raw
        raw[:, slice(0, 3) if order == ">" else slice(1, 4)] = wide
        values = np.ascontiguousarray(raw).view(order + kind[0] + "4")[:, 0]
        return values.astype(np.int64) >> 8
    values = np.ascontiguousarray(raw).view(f"{order}{kind[0]}{size}")[:, 0]
    return values.astype(np.float64 if kind[0] == "f" else np.int64)


def check(name: str, size: int, parts: Sequence[Field | Number]) -> None:
    """Raise ParameterError, under the parameter's `name`, for what does not fit into `size` bytes or is named twice."""
    names = [part.name for part in parts if isinstance(part, Field)]
    for part in parts:
        if part.at < 0 or part.at + size_of(part.type) > size:
            label = part.name if isinstance(part, Field) else name
            raise ParameterError(
                name, f"{label} ({part.type} at byte {part.at})", f"within the frame's {size} bytes, 0 to {size - 1}"
            )
    if len(set(names)) != len(names):
        raise ParameterError(name, names, "different names")
