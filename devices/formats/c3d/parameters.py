"""The parameters of a C3D file: records one behind another, of a PC, a DEC or an SGI machine."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod

import numpy as np

from kinegraph.stream.chunk import Array

BLOCK = 512
"""A C3D file counts in blocks of this many bytes, from 1."""
MAX_BLOCKS = 256
"""This many blocks the parameters may take: one byte counts them."""
HEAD = (254 + MAX_BLOCKS) * BLOCK
"""This many bytes hold the parameters, wherever they begin: one byte says where."""
INTEL, DEC, MIPS = 84, 85, 86
"""Processors, as a C3D file marks them: the first two put the low byte first."""
WIDTHS = {-1: 1, 1: 1, 2: 2, 4: 4}
"""Bytes of a parameter's values: letters, bytes, whole numbers, floating-point numbers."""
LONGEST = 9000
"""Bytes of a record that are believed where there is a choice: 255 labels of 32 letters, and a description."""
CONTINUATIONS = ("", *map(str, range(2, 30)))
"""A parameter holds 255 values; LABELS2, LABELS3, ... go on from LABELS."""

Value = tuple[str, ...] | Array


@dataclass(frozen=True, slots=True)
class Parameters:
    """What the records say: texts, or numbers in the shape that their extents declare, by group and name in capital letters."""

    processor: int
    groups: Mapping[str, Mapping[str, Value]]

    def texts(self, group: str, name: str) -> list[str]:
        """A parameter's texts, with those of its continuations."""
        return [text for value in self._parts(group, name) if isinstance(value, tuple) for text in value]

    def numbers(self, group: str, name: str) -> Array:
        """A parameter's numbers (n,), with those of its continuations; empty if it holds texts, or is missing."""
        parts = [value.ravel(order="F") for value in self._parts(group, name) if not isinstance(value, tuple)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def number(self, group: str, name: str) -> float:
        """A parameter's first number, NaN where unknown."""
        found = self.numbers(group, name)
        return float(found[0]) if len(found) else np.nan

    def count(self, group: str, name: str) -> int | None:
        """A parameter's first number where it counts something: 16 bits without a sign, whatever the records' signs are."""
        found = self.number(group, name)
        return None if not np.isfinite(found) else int(found) % (1 << 16) if found < 0 else int(found)

    def _parts(self, group: str, name: str) -> list[Value]:
        made = []
        for more in CONTINUATIONS:
            if (value := self.groups.get(group, {}).get(name + more)) is None:
                break
            made.append(value)
        return made


def read_parameters(head: bytes) -> Parameters:
    """The parameters in the first HEAD bytes of a file.

    A record is the length of a name, a group's number, the name, where the next record begins, and of a parameter the type of its values,
    their extents and the values themselves, which must lie before the next record. Raises ValueError that says at which byte they do not.
    """
    begin = (head[0] - 1) * BLOCK if head else -1
    data = head[max(0, begin) : begin + MAX_BLOCKS * BLOCK]
    if begin < 0 or len(head) < BLOCK or len(data) < 4 or data[3] not in (INTEL, DEC, MIPS):
        raise ValueError(f"its parameters end abruptly at byte {max(0, begin)}")
    names: dict[int, str] = {}
    found: list[tuple[int, str, Value]] = []
    at = 4
    while at + 2 <= len(data) and data[at]:
        try:
            number, name, value, after = _record(data, at)
        except (struct.error, ValueError):
            raise ValueError(f"its parameters end abruptly at byte {begin + at}") from None
        if value is None:
            names[-number] = name
        else:
            found.append((number, name, value))
        if not after:
            break
        at = after
    groups: dict[str, dict[str, Value]] = {name: {} for name in names.values()}
    for number, name, value in found:
        if number in names:
            groups[names[number]][name] = value
    return Parameters(data[3], groups)


def reals(data: bytes, processor: int) -> Array:
    """Floating-point numbers (n,) as IEEE has them. DEC puts the high word first, and an exponent that is greater by two."""
    if processor != DEC:
        return np.frombuffer(data, ">f4" if processor == MIPS else "<f4").astype(np.float32)
    words = np.frombuffer(data, "<u2").reshape(-1, 2).astype(np.uint32)
    bits = words[:, 0] << 16 | words[:, 1]
    large = (bits >> 23 & 0xFF) > 2
    return np.where(large, bits - np.uint32(2 << 23), bits & np.uint32(1 << 31)).astype(np.uint32).view(np.float32)


def wholes(data: bytes, processor: int) -> Array:
    """Whole numbers (n,) of 16 bits with a sign."""
    return np.frombuffer(data, ">i2" if processor == MIPS else "<i2")


def _bytes(data: bytes, processor: int) -> Array:
    return np.frombuffer(data, "i1")


def _record(data: bytes, at: int) -> tuple[int, str, Value | None, int]:
    """The number of a record's group, its name, its values (None: it is a group) and where the next begins (0: nowhere).

    Raises ValueError or struct.error where it does not hold together.
    """
    length, group = struct.unpack_from("bb", data, at)
    offset = at + 2 + abs(length)
    step = _step(data, offset)
    end = offset + step if step else len(data)
    if group == 0 or step < 0 or end > len(data):
        raise ValueError
    name = text_of(data[at + 2 : offset]).upper()
    if group < 0:
        return group, name, None, end if step else 0
    kind, dimensions = struct.unpack_from("bB", data, offset + 2)
    extents = tuple(data[offset + 4 : offset + 4 + dimensions])
    first = offset + 4 + dimensions
    if kind not in WIDTHS or dimensions > 7 or (last := first + prod(extents) * WIDTHS[kind]) > end:
        raise ValueError
    return group, name, _values(data[first:last], kind, extents, data[3]), end if step else 0


def _step(data: bytes, offset: int) -> int:
    """How far it is from here to the next record. Some SGI files have single steps in a PC's order: those that are shorter are meant."""
    order = ">" if data[3] == MIPS else "<"
    (step,) = struct.unpack_from(f"{order}h", data, offset)
    if order == ">" and not 0 <= step <= LONGEST:
        (other,) = struct.unpack_from("<h", data, offset)
        return int(other) if 0 <= other <= LONGEST else int(step)
    return int(step)


def _values(data: bytes, kind: int, extents: tuple[int, ...], processor: int) -> Value:
    if kind == -1:
        length = extents[0] if extents else 1
        return tuple(text_of(data[i : i + length]) for i in range(0, len(data), length or 1))
    numbers = {1: _bytes, 2: wholes, 4: reals}[kind](data, processor)
    return numbers.astype(np.float64).reshape(extents or (1,), order="F")


def text_of(data: bytes) -> str:
    """Letters, in UTF-8 or else in Latin-1, without the blanks that fill them up."""
    try:
        text = data.decode()
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.replace("\0", "").strip()
