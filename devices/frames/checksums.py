"""The checksums that devices use, by name; each with the number of bytes that it takes."""

from __future__ import annotations

import binascii
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import xor


@dataclass(frozen=True, slots=True)
class Checksum:
    """How many bytes, and what they hold for the bytes before them."""

    size: int
    of: Callable[[bytes], int]


def _crc_table(polynomial: int) -> tuple[int, ...]:
    """For bytes with the lowest bit first."""
    table = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (polynomial if value & 1 else 0)
        table.append(value)
    return tuple(table)


_MODBUS = _crc_table(0xA001)
_CRC8 = tuple(reduce(lambda v, _: (v << 1 ^ (0x07 if v & 0x80 else 0)) & 0xFF, range(8), value) for value in range(256))


def _modbus(data: bytes) -> int:
    return reduce(lambda crc, byte: crc >> 8 ^ _MODBUS[(crc ^ byte) & 0xFF], data, 0xFFFF)


def _crc8(data: bytes) -> int:
    return reduce(lambda crc, byte: _CRC8[crc ^ byte], data, 0)


def _fletcher(data: bytes) -> int:
    """Two sums of 8 bits; the first is the lower byte."""
    first = second = 0
    for byte in data:
        first = (first + byte) & 0xFF
        second = (second + first) & 0xFF
    return first | second << 8


CHECKSUMS: dict[str, Checksum] = {
    "none": Checksum(0, lambda data: 0),
    "sum8": Checksum(1, lambda data: sum(data) & 0xFF),
    "zero_sum8": Checksum(1, lambda data: -sum(data) & 0xFF),
    "xor8": Checksum(1, lambda data: reduce(xor, data, 0)),
    "crc8": Checksum(1, _crc8),
    "sum16": Checksum(2, lambda data: sum(data) & 0xFFFF),
    "fletcher8": Checksum(2, _fletcher),
    "crc16_modbus": Checksum(2, _modbus),
    "crc16_ccitt": Checksum(2, lambda data: binascii.crc_hqx(data, 0xFFFF)),
    "crc16_xmodem": Checksum(2, lambda data: binascii.crc_hqx(data, 0)),
    "crc32": Checksum(4, zlib.crc32),
}
"""zero_sum8: with it all bytes add up to 0; crc8: polynomial 07; fletcher8: two sums of 8 bits each, as u-blox has it (little-endian)."""
