"""OpenBCI Ganglion over Bluetooth LE: packets of 20 bytes to four channels, firmware 2 (differences) and 3 (whole numbers). No port.

Source: OpenBCI's and BrainFlow's public decoders. They disagree on numbers with the lowest bit set: the firmware puts the sign there;
OpenBCI extends by it, BrainFlow (native) takes the highest bit and subtracts one. This follows OpenBCI; so do
impedances.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SERVICE, NOTIFY = "fe84", "2d30c082-f39f-4ce6-923f-3484ea480596"
WRITE, FIRMWARE = "2d30c083-f39f-4ce6-923f-3484ea480596", "2a28"
RATE_HZ = 200.0
UV = 1.2e6 / (8388607 * 1.5 * 51)
G = 0.016
IMPEDANCE_START, IMPEDANCE_STOP = b"z", b"Z"
IMPEDANCE_FIRST, REFERENCE = 201, 5
"""The first byte of a message with channel 1's impedance; the fifth such message is the reference's."""
AXES = {0: 2, 1: 0, 2: 1}
"""By a packet's number modulo 10: which axis its last byte is of (OpenBCI's order)."""


class GanglionPacket(NamedTuple):
    """rows (n, 4) in counts; places: running places (n,) in a turn; axis and acceleration (g), where it holds one."""

    rows: NDArray[np.int64]
    places: NDArray[np.int64]
    axis: int | None
    acceleration_g: float


def impedance_ohm(data: bytes) -> tuple[int, float] | None:
    """Which electrode (1 to 4 a channel's, 5 the reference's) a message is about, and its impedance in ohm; None for other messages.

    Behind its first byte stand digits, as text, and whatever else.
    """
    digits = re.match(rb"\d+", data[1:])
    if not data or not 0 <= (which := data[0] - IMPEDANCE_FIRST) < REFERENCE or not digits:
        return None
    return which + 1, float(digits[0])


class GanglionDecoder:
    """Packets in their order. `turn` is how many samples a turn of their number holds.

    Firmware 2 sends differences: after a lost packet nothing can be known until the next whole one, up to a second later.
    """

    def __init__(self, firmware: int) -> None:
        self.firmware, self.turn = firmware, 200 if firmware >= 3 else 201
        self._last: NDArray[np.int64] | None = None
        self._number = -1
        self.unknown = 0
        """Packets that could not be read, as one before them was lost."""

    def feed(self, data: bytes) -> GanglionPacket | None:
        """One notification; None for what holds no samples."""
        if len(data) != 20 or data[0] > 200:
            return None
        return self._whole(data) if self.firmware >= 3 else self._differences(data)

    def _whole(self, data: bytes) -> GanglionPacket:
        wide = data[0] >= 100
        rows = fields(data, 19 if wide else 18) << (5 if wide else 6)
        first = 2 * (data[0] % 100)
        return GanglionPacket(rows, np.array([first, first + 1]), *self._motion(data))

    def _differences(self, data: bytes) -> GanglionPacket | None:
        number = data[0] if data[0] <= 100 else data[0] - 100
        if data[0] == 0:
            parts = np.frombuffer(data, np.uint8, 12, 1).reshape(4, 3).astype(np.int64)
            whole = parts[:, 0] << 16 | parts[:, 1] << 8 | parts[:, 2]
            self._last, self._number = whole - (whole >> 23 << 24), 0
            return GanglionPacket(self._last[None].copy(), np.array([0]), None, 0.0)
        if self._last is None or number not in (self._number + 1, self._number):
            self._last, self.unknown = None, self.unknown + 1
            return None
        if number == self._number:
            return None  # it came twice
        steps = fields(data, 18 if data[0] <= 100 else 19)
        rows = self._last - np.cumsum(steps, axis=0)
        self._last, self._number = rows[1].copy(), number
        return GanglionPacket(rows, np.array([2 * number - 1, 2 * number]), *self._motion(data))

    def _motion(self, data: bytes) -> tuple[int | None, float]:
        """Packets of 18 bits have a byte left, which may be of the accelerometer."""
        axis = AXES.get(data[0] % 10) if data[0] < (100 if self.firmware >= 3 else 101) else None
        return axis, (data[19] - (data[19] >> 7 << 8)) * G


def fields(data: bytes, bits: int) -> NDArray[np.int64]:
    """Eight numbers (2, 4) of `bits` bits behind the first byte, the highest bit first, the sign in the lowest."""
    ones = np.unpackbits(np.frombuffer(data, np.uint8, 19, 1))[: 8 * bits].reshape(8, bits).astype(np.int64)
    number = (ones << np.arange(bits - 1, -1, -1)).sum(axis=1)
    return np.asarray((number - (ones[:, -1] << bits)).reshape(2, 4))


def packed(rows: NDArray[np.int64], bits: int) -> bytes:
    """Numbers (2, 4) with the sign in the lowest bit, as a packet holds them; for simulators and tests."""
    digits = (rows.ravel()[:, None] >> np.arange(bits - 1, -1, -1) & 1).astype(np.uint8)
    return np.packbits(digits.ravel()).tobytes()
