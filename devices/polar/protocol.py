"""Polar's measurement data (PMD) over Bluetooth LE: settings, commands, answers, frames raw and compressed. No port, no clock.

Source: the public Polar BLE SDK; the tests use its test vectors.
"""

from __future__ import annotations

import struct
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import NS

SERVICE = "fb005c80-02e7-f387-1cad-8acd2d8df0c8"
CONTROL = "fb005c81-02e7-f387-1cad-8acd2d8df0c8"
DATA = "fb005c82-02e7-f387-1cad-8acd2d8df0c8"
ECG, ACC = 0, 2
SETTINGS, START, STOP = 1, 2, 3
EPOCH_S = 946_684_800
"""2000-01-01 UTC in Unix time: a device's time is counted from there."""
SHORTEST_MTU = 230
"""A frame of 36 accelerations has 226 bytes, and a notification three more."""
STATUS = {
    0: "ok", 1: "unknown command", 2: "unknown kind of measurement", 3: "not supported", 4: "wrong length", 5: "wrong parameter",
    6: "already running", 7: "wrong resolution", 8: "wrong rate", 9: "wrong range",
    10: f"packets are too small for its frames (an MTU of {SHORTEST_MTU} is needed): pair it once with the system, or use another adapter",
    11: "wrong number of channels", 12: "wrong state", 13: "it is being charged",
}  # fmt: skip
_SIZES = {0: 2, 1: 2, 2: 2, 3: 2, 4: 1, 5: 4}
Kind = Literal[0, 2]


class PmdFrame(NamedTuple):
    """kind: ECG or ACC; last_ns: the device's time of the last sample; data (n, c) in uV or g."""

    kind: int
    last_ns: int
    data: NDArray[np.float64]


def start(kind: int, **settings: int) -> bytes:
    """The command that starts a measurement: rate, resolution, range, channels."""
    ids = {"rate": 0, "resolution": 1, "range": 2, "channels": 4}
    body = b"".join(bytes([ids[k], 1]) + v.to_bytes(_SIZES[ids[k]], "little") for k, v in settings.items())
    return bytes([START, kind]) + body


def settings(data: bytes) -> dict[int, tuple[float, ...]]:
    """By setting's id, its values. Raises ValueError for what is cut off."""
    found: dict[int, tuple[float, ...]] = {}
    at = 0
    while at + 2 <= len(data):
        key, count = data[at], data[at + 1]
        at += 2
        size = _SIZES.get(key)
        if size is None or at + size * count > len(data):
            raise ValueError(f"setting {key} with {count} values, where {len(data) - at} bytes are left")
        raw = [data[at + size * i : at + size * (i + 1)] for i in range(count)]
        found[key] = tuple(struct.unpack("<f", r)[0] if key == 5 else int.from_bytes(r, "little") for r in raw)
        at += size * count
    return found


class PmdDecoder:
    """Frames to numbers. `factor`: by kind, what a compressed number is multiplied with, from the answer to the start."""

    def __init__(self) -> None:
        self.factor: dict[int, float] = {}

    def started(self, answer: bytes) -> None:
        """The answer to a start: it may say the factor. Raises ValueError."""
        if len(answer) > 5:
            chosen = settings(answer[5:])
            if chosen.get(5):
                self.factor[answer[2]] = chosen[5][0]

    def frame(self, data: bytes) -> PmdFrame | None:
        """One notification; None for what is cut off or of no kind that is known."""
        if len(data) < 11:
            return None
        kind, (last,), form = data[0], struct.unpack_from("<Q", data, 1), data[9]
        body = data[10:]
        if (kind, form) == (ECG, 0x00):
            if len(body) % 3:
                return None
            return PmdFrame(kind, last, signed24(body)[:, None].astype(np.float64))
        if kind != ACC:
            return None
        factor = self.factor.get(kind, 1.0)
        if form == 0x01:
            if len(body) % 6:
                return None
            return PmdFrame(kind, last, np.asarray(np.frombuffer(body, "<i2").reshape(-1, 3) / 1000.0, np.float64))
        if form in (0x80, 0x81):
            counts = unpacked(body, 3)
            scale = factor if form == 0x80 else factor / 1000.0
            return None if counts is None else PmdFrame(kind, last, np.asarray(counts * scale, np.float64))
        return None


def signed24(data: bytes) -> NDArray[np.int32]:
    """Numbers (n,) of three bytes each, the lowest first."""
    parts = np.frombuffer(data, np.uint8).reshape(-1, 3).astype(np.int32)
    number = parts[:, 0] | parts[:, 1] << 8 | parts[:, 2] << 16
    return np.asarray(number - (number >> 23 << 24), np.int32)


def unpacked(data: bytes, channels: int) -> NDArray[np.int64] | None:
    """A compressed frame's numbers (n, channels): a reference of 16 bits each, then blocks of differences; None if it is cut off."""
    if len(data) < 2 * channels:
        return None
    rows = [np.frombuffer(data, "<i2", channels).astype(np.int64)[None]]
    at = 2 * channels
    while at < len(data):
        if at + 2 > len(data):
            return None
        bits, count = data[at], data[at + 1]
        size = -(-bits * count * channels // 8)
        if not 0 < bits <= 32 or not count or at + 2 + size > len(data):
            return None
        ones = np.unpackbits(np.frombuffer(data, np.uint8, size, at + 2), bitorder="little")
        digits = ones[: bits * count * channels].reshape(count, channels, bits).astype(np.int64)
        steps = (digits << np.arange(bits)).sum(axis=2) - (digits[..., -1] << bits)
        rows.append(rows[-1][-1] + np.cumsum(steps, axis=0))
        at += 2 + size
    return np.concatenate(rows)


def packed(rows: NDArray[np.int64], bits: int) -> bytes:
    """Numbers (n, c) compressed in blocks of at most 255 differences; for simulators and tests."""
    made: bytes = rows[0].astype("<i2").tobytes()
    steps = np.diff(rows, axis=0)
    for at in range(0, len(steps), 255):
        block = steps[at : at + 255]
        digits = (block[..., None] >> np.arange(bits) & 1).astype(np.uint8)
        made += bytes([bits, len(block)]) + np.packbits(digits.ravel(), bitorder="little").tobytes()
    return made


def unix_ns(device_ns: int) -> int:
    """A device's time as Unix time."""
    return device_ns + EPOCH_S * NS
