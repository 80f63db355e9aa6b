"""C3D files of SGI machines (high byte first) turned into those of a PC: the library that reads C3D refuses the former."""

from __future__ import annotations

import struct

from devices.files.c3d_check import BLOCK, INTEL, step_at

HEADER_FLOATS = ((12, 16), (20, 24), (304, 376))
"""Bytes of the header that hold floating-point numbers: the scale, the frame rate, the times of events."""
HEADER_TEXT = 396
"""From here on the header holds letters."""
WIDTHS = {2: 2, 4: 4}


def low_byte_first(data: bytes) -> bytes:
    """The same file for a PC. Raises ValueError where its parameters do not hold together (see `c3d_check.broken_at`)."""
    turned = bytearray(data)
    _header(turned)
    begin = (data[0] - 1) * BLOCK
    scale, start = _parameters(turned, data, begin)
    header_start = struct.unpack_from(">H", data, 16)[0]
    floats = (scale if scale is not None else struct.unpack_from(">f", data, 12)[0]) < 0
    at = ((start or header_start) - 1) * BLOCK
    if not 0 < at <= len(data):
        raise ValueError(f"its data begin at byte {at} of {len(data)}")
    _swap(turned, at, at + (len(data) - at) // 4 * 4, 4 if floats else 2)
    turned[begin + 3] = INTEL
    return bytes(turned)


def _header(turned: bytearray) -> None:
    floats = [range(a, b) for a, b in HEADER_FLOATS]
    at = 2
    while at < HEADER_TEXT:
        width = 4 if any(at in places for places in floats) else 2
        if not 376 <= at < HEADER_TEXT:  # the flags of events are single bytes
            _swap(turned, at, at + width, width)
        at += width


def _parameters(turned: bytearray, data: bytes, begin: int) -> tuple[float | None, int]:
    """Turn the numbers of every parameter; returns POINT:SCALE and POINT:DATA_START."""
    scale, start = None, 0
    at, end = begin + 4, min(len(data), begin + data[begin + 2] * BLOCK if data[begin + 2] else len(data))
    while at + 4 <= end and data[at]:
        length, group = struct.unpack_from("bb", data, at)
        offset = at + 2 + abs(length)
        if offset + 4 > len(data):
            raise ValueError("its parameters break off")
        step = step_at(data, offset, ">")
        struct.pack_into("<h", turned, offset, step)
        if group > 0:
            kind, dimensions = struct.unpack_from("bB", data, offset + 2)
            first = offset + 4 + dimensions
            size = abs(kind)
            for extent in data[offset + 4 : first]:
                size *= extent
            if first + size > len(data):
                raise ValueError("its parameters break off")
            if kind in WIDTHS:
                _swap(turned, first, first + size, WIDTHS[kind])
            name = data[at + 2 : offset].upper()
            if name == b"SCALE" and kind == 4 and size == 4 and scale is None:
                scale = struct.unpack_from(">f", data, first)[0]
            if name == b"DATA_START" and kind == 2 and not start:
                start = struct.unpack_from(">H", data, first)[0]
        if step <= 0:
            break
        at = offset + step
    return scale, start


def _swap(turned: bytearray, start: int, stop: int, width: int) -> None:
    """Turn the bytes of every number of `width` bytes."""
    part = bytes(turned[start:stop])
    whole = len(part) // width * width
    made = bytearray(part)
    for byte in range(width):
        made[byte:whole:width] = part[width - 1 - byte : whole : width]
    turned[start:stop] = made
