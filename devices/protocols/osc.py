"""Open Sound Control 1.0, received: messages and bundles of them. No socket; whatever is no OSC is refused, never more."""

from __future__ import annotations

import struct
from typing import TypeAlias

Argument: TypeAlias = int | float | str | bytes | bool | None
Message: TypeAlias = tuple[str, list[Argument]]
MOST_DEPTH = 4
CONSTANTS: dict[str, Argument] = {"T": True, "F": False, "N": None, "I": float("inf")}


class OscError(ValueError):
    """A datagram that is no OSC."""


def read_osc(data: bytes, depth: int = 0) -> list[Message]:
    """The messages of a datagram, in their order. Raises OscError."""
    if not data.startswith(b"#bundle\x00"):
        return [_message(data)]
    if depth > MOST_DEPTH or len(data) < 16:
        raise OscError("a bundle that is cut off, or bundles within too many others")
    found, at = [], 16
    while at < len(data):
        if at + 4 > len(data):
            raise OscError("an element's length is cut off")
        (size,) = struct.unpack_from(">i", data, at)
        at += 4
        if size < 0 or size % 4 or at + size > len(data):
            raise OscError(f"an element of {size} bytes, where {len(data) - at} are left")
        found += read_osc(data[at : at + size], depth + 1)
        at += size
    return found


def _message(data: bytes) -> Message:
    address, at = _text(data, 0)
    if not address.startswith("/"):
        raise OscError(f"an address that does not begin with a slash: {address[:20]!r}")
    types, at = _text(data, at) if at < len(data) else (",", at)
    if not types.startswith(","):
        raise OscError("no type tags")
    arguments: list[Argument] = []
    for tag in types[1:]:
        value, at = _argument(tag, data, at)
        arguments.append(value)
    return address, arguments


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
        form, size = {"i": (">i", 4), "f": (">f", 4), "d": (">d", 8), "h": (">q", 8), "t": (">Q", 8)}[tag]
        return struct.unpack_from(form, data, at)[0], at + size
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
