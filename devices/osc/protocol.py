"""Open Sound Control 1.0, received: messages and bundles of them. No socket; whatever is no OSC is refused, never more."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import TypeAlias

Argument: TypeAlias = int | float | str | bytes | bool | None
Message: TypeAlias = tuple[str, list[Argument]]
MAX_DEPTH = 4
MAX_SHAPES = 256
BUNDLE = b"#bundle\x00"
NUMBERS = {"i": "i", "f": "f", "d": "d", "h": "q", "t": "Q"}
"""Types of numbers, as `struct` has them."""
CONSTANTS: dict[str, Argument] = {"T": True, "F": False, "N": None, "I": float("inf")}


class OscError(ValueError):
    """A datagram that is no OSC."""


class OscReader:
    """Datagrams to messages. Those of one length mostly have one shape: of the last one it is known, so that only the numbers are read."""

    def __init__(self) -> None:
        self._shapes: dict[int, tuple[bytes, str, struct.Struct]] = {}
        """By the length of a message: all of it before its numbers, its address, the numbers."""

    def read(self, data: bytes) -> list[tuple[str, Sequence[Argument]]]:
        """What `read_osc` gives. Raises OscError."""
        return [self._message(data[begin:end]) for begin, end in _places(data)]

    def _message(self, data: bytes) -> tuple[str, Sequence[Argument]]:
        if shape := self._shapes.get(len(data)):
            head, address, numbers = shape
            if data.startswith(head):
                return address, numbers.unpack_from(data, len(head))
        address, arguments = _message(data)
        types, at = _types(data)
        forms = "".join(NUMBERS.get(tag, "-") for tag in types)
        if "-" not in forms and len(self._shapes) < MAX_SHAPES:
            numbers = struct.Struct(f">{forms}")
            if at + numbers.size == len(data):
                self._shapes[len(data)] = data[:at], address, numbers
        return address, arguments


def read_osc(data: bytes) -> list[Message]:
    """The messages of a datagram, in their order. Raises OscError."""
    return [_message(data[begin:end]) for begin, end in _places(data)]


def _places(data: bytes) -> Sequence[tuple[int, int]]:
    """Where the messages of a datagram stand in it."""
    if not data.startswith(BUNDLE):
        return ((0, len(data)),)
    found: list[tuple[int, int]] = []
    _unpack(data, 0, len(data), 0, found)
    return found


def _unpack(data: bytes, begin: int, end: int, depth: int, found: list[tuple[int, int]]) -> None:
    if depth > MAX_DEPTH or end - begin < 16:
        raise OscError("a bundle that is cut off, or bundles within too many others")
    at = begin + 16
    while at < end:
        if at + 4 > end:
            raise OscError("an element's length is cut off")
        size = int.from_bytes(data[at : at + 4], "big", signed=True)
        at += 4
        if size < 0 or size % 4 or at + size > end:
            raise OscError(f"an element of {size} bytes, where {end - at} are left")
        if data[at : at + size].startswith(BUNDLE):
            _unpack(data, at, at + size, depth + 1, found)
        else:
            found.append((at, at + size))
        at += size


def _message(data: bytes) -> Message:
    address, _ = _text(data, 0)
    if not address.startswith("/"):
        raise OscError(f"an address that does not begin with a slash: {address[:20]!r}")
    types, at = _types(data)
    arguments: list[Argument] = []
    for tag in types:
        value, at = _argument(tag, data, at)
        arguments.append(value)
    return address, arguments


def _types(data: bytes) -> tuple[str, int]:
    """A message's type tags, and where its arguments begin."""
    _, at = _text(data, 0)
    types, at = _text(data, at) if at < len(data) else (",", at)
    if not types.startswith(","):
        raise OscError("no type tags")
    return types[1:], at


def _argument(tag: str, data: bytes, at: int) -> tuple[Argument, int]:
    if tag in CONSTANTS:
        return CONSTANTS[tag], at
    if tag in "sS":
        return _text(data, at)
    try:
        if tag == "b":
            (size,) = struct.unpack_from(">i", data, at)
            if not 0 <= size <= len(data) - at - 4:
                raise OscError(f"a blob of {size} bytes")
            return data[at + 4 : at + 4 + size], at + 4 + (size + 3) // 4 * 4
        number = struct.Struct(">" + NUMBERS[tag])
        return number.unpack_from(data, at)[0], at + number.size
    except KeyError:
        raise OscError(f"a type that is not known: {tag!r}") from None
    except struct.error:
        raise OscError("an argument is cut off") from None


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.find(b"\x00", at)
    if end < 0:
        raise OscError("a text without an end")
    try:
        return data[at:end].decode(), end + 4 - (end - at) % 4
    except UnicodeDecodeError:
        raise OscError("a text that is no UTF-8") from None
