"""BITalino (r)evolution: frames of 3 to 8 bytes to counts, and commands as bytes. No port, no clock.

A frame is a string of bits, the last byte first: a sequence number (4 bits), a CRC (4 bits), the digital ports I1 I2 O1 O2, and the
acquired analogue inputs in ascending order, four of 10 bits and a fifth and sixth of 6 bits; 0 fills the first byte up. There are no bytes
to look for, so only CRC and sequence number show where frames begin: several in a row must agree.

Source: "BITalino (r)evolution MCU Block Data Sheet" and the firmware; the package `bitalino` agrees (tests/peers).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from kinegraph.stream.chunk import Array, Times

SEQUENCE = 16
RATES_HZ = (1, 10, 100, 1000)
VCC_V = 3.3
Sensor = Literal["emg", "ecg", "eeg", "eda", "volt"]
GAINS: dict[Sensor, tuple[float, float, str]] = {
    "emg": (VCC_V / 1009 * 1e6, 0.5, "uV"),
    "ecg": (VCC_V / 1100 * 1e6, 0.5, "uV"),
    "eeg": (VCC_V / 41782 * 1e6, 0.5, "uV"),
    "eda": (VCC_V / 0.132, 0.0, "uS"),
    "volt": (VCC_V, 0.0, "V"),
}
"""By sensor: (scale, zero, unit); a value is (counts / full scale - zero) * scale, by the sensors' data sheets."""

STOP, VERSION, STATE = b"\x00", b"\x07", b"\x0b"
AGREE = 3
"""This many frames in a row must be right where nothing is known of where they begin."""
NEAR = 4
"""Frames behind a bad one within which two are enough that stand where they should."""
STRAY = 3
"""By this much the sequence may jump between the first two frames after a bad one."""


def rate_command(rate_hz: int) -> bytes:
    return bytes([RATES_HZ.index(rate_hz) << 6 | 0x03])


def start_command(inputs: Sequence[int]) -> bytes:
    """Begin to send the analogue inputs 1 to 6."""
    return bytes([sum(1 << (1 + i) for i in inputs) | 0x01])


def state_size(version: str) -> int:
    """Bytes of the answer to STATE, by what the device says of its version ("BITalino_v5.2")."""
    number = version.partition("_v")[2].split(".")
    return 17 if [int(n) for n in number if n.isdigit()] >= [5, 2] else 16


def battery_v(answer: bytes, size: int) -> float | None:
    """The battery's voltage in the answer to STATE; None for any other answer. Half of it is measured, with 10 bits.

    The firmware's own numbers say so (BITalinoWorld/firmware-bitalino-revolution): its alarm at 3.4 to 3.8 V is at 527 to 590 counts.
    """
    if len(answer) != size or crc_of(answer) != answer[-1] & 0x0F:
        return None
    return int.from_bytes(answer[12:14], "little") / 1024 * 2 * VCC_V


def state(counts: Sequence[int], battery_v: float, digital: Sequence[int], version: str) -> bytes:
    """What the device answers to STATE: six inputs, the battery, its threshold, the digital ports; for simulators and tests."""
    words = [*counts, round(battery_v / 2 / VCC_V * 1024)]
    ports = sum(int(d) << 7 - i for i, d in enumerate(digital))
    body = b"".join(w.to_bytes(2, "little") for w in words) + bytes(state_size(version) - 15) + bytes([ports])
    return body[:-1] + bytes([ports | crc_of(body)])


def widths(channels: int) -> list[int]:
    """Bits of each acquired input."""
    return [10, 10, 10, 10, 6, 6][:channels]


def size_of(channels: int) -> int:
    """Bytes of a frame."""
    return (12 + sum(widths(channels)) + 7) // 8


@lru_cache(maxsize=1)
def _table() -> list[bytes]:
    """The CRC's next state by state and byte: polynomial x^4 + x + 1, highest bit first."""
    rows = []
    for state in range(16):
        row = bytearray()
        for byte in range(256):
            crc = state
            for bit in range(7, -1, -1):
                crc = (crc << 1) ^ (0x13 if crc & 8 else 0) ^ (byte >> bit & 1)
            row.append(crc)
        rows.append(bytes(row))
    return rows


def crc_of(frame: bytes) -> int:
    """The CRC of a frame in which its own four bits count as 0."""
    table, crc = _table(), 0
    for byte in frame[:-1]:
        crc = table[crc][byte]
    return table[crc][frame[-1] & 0xF0]


@dataclass(frozen=True, slots=True)
class BitalinoFrames:
    """The frames found.

    sequence   (n,) int64, 0 to 15
    digital    (n, 4) int64: I1 I2 O1 O2
    counts     (n, channels) int64
    dropped    bytes that belonged to no frame
    resyncs    how often the beginning of the next frame had to be looked for
    """

    sequence: Times
    digital: Array
    counts: Array
    dropped: int
    resyncs: int

    def __len__(self) -> int:
        return len(self.sequence)


class BitalinoDecoder:
    """Feed it bytes as they come, cut anywhere; it never waits and never raises."""

    def __init__(self, channels: int) -> None:
        self._channels, self._size = channels, size_of(channels)
        self._buffer = b""
        self._last: int | None = None
        """The sequence number of the frame before, if the next must begin directly behind it."""

    def feed(self, data: bytes) -> BitalinoFrames:
        buffer, size = self._buffer + data, self._size
        found = bytearray()
        at = dropped = resyncs = 0
        while len(buffer) - at >= size:
            frame = buffer[at : at + size]
            if self._last is not None and frame[-1] >> 4 == (self._last + 1) % SEQUENCE and _right(frame):
                found += frame
                self._last, at = frame[-1] >> 4, at + size
                continue
            start, known = self._seek(buffer, at)
            if not known and self._last is not None and start - at <= NEAR * size:
                break
            if not known:
                resyncs += self._last is not None
                self._last = None
                dropped += start - at
                at = start
                break
            resyncs += self._last is not None and start > at
            dropped += start - at
            at = start + size
            found += buffer[start:at]
            self._last = buffer[at - 1] >> 4
        self._buffer = buffer[at:]
        return unpack(bytes(found), self._channels, dropped, resyncs)

    def _seek(self, buffer: bytes, at: int) -> tuple[int, bool]:
        """Where the next frame begins, and whether that is known; else where it has to be looked for when more has come."""
        size, start = self._size, at
        while True:
            aligned = self._last is not None and (start - at) % size == 0 and start - at <= NEAR * size
            needed = 2 if aligned else AGREE
            if len(buffer) - start < needed * size:
                return start, False
            if self._agree(buffer, start, needed, STRAY if aligned else 1):
                return start, True
            start += 1

    def _agree(self, buffer: bytes, start: int, frames: int, stray: int) -> bool:
        size, before = self._size, -1
        for i in range(frames):
            frame = buffer[start + i * size : start + (i + 1) * size]
            if not _right(frame):
                return False
            number = frame[-1] >> 4
            if before >= 0 and not 1 <= (number - before) % SEQUENCE <= stray:
                return False
            before = number
        return True


def _right(frame: bytes) -> bool:
    return crc_of(frame) == frame[-1] & 0x0F


def unpack(data: bytes, channels: int, dropped: int = 0, resyncs: int = 0) -> BitalinoFrames:
    """Frames, one after the other, to numbers."""
    table = np.frombuffer(data, np.uint8).reshape(-1, size_of(channels))
    bits = np.unpackbits(table[:, ::-1], axis=1).astype(np.int64)
    counts, at = np.empty((len(table), channels), np.int64), 12
    for channel, width in enumerate(widths(channels)):
        counts[:, channel] = bits[:, at : at + width] @ (1 << np.arange(width)[::-1])
        at += width
    return BitalinoFrames(bits[:, :4] @ np.array([8, 4, 2, 1]), bits[:, 8:12], counts, dropped, resyncs)


def frame(sequence: int, counts: Sequence[int], digital: Sequence[int] = (0, 0, 0, 0)) -> bytes:
    """What the device sends; for simulators and tests."""
    value, bits = sequence % SEQUENCE << 4, 8
    for number, width in [*((d, 1) for d in digital), *zip(counts, widths(len(counts)), strict=True)]:
        value, bits = value << width | int(number), bits + width
    size = size_of(len(counts))
    made = (value << (8 * size - bits)).to_bytes(size, "little")
    return made[:-1] + bytes([made[-1] | crc_of(made)])
