"""Movella (Xsens) DOT over Bluetooth LE: measurement modes, what their packets hold, commands. No port, no clock.

Source: Movella, DOT BLE Services Specifications XD0506P.C; a captured packet of node-movella-dot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

BASE = "1517{}-4947-11e9-8646-d663bd873d93"
SERVICE, CONTROL = BASE.format("2000"), BASE.format("2001")
LONG, MEDIUM, SHORT = (BASE.format(n) for n in ("2002", "2003", "2004"))
DEVICE_CONTROL = BASE.format("1002")
RATE_BIT, RATE_AT = 0x10, 24
NAMES = ("Movella DOT", "Xsens DOT")
RATES = (1, 4, 10, 12, 15, 20, 30, 60, 120)
MEASUREMENT, BEGIN, END = 1, 1, 0
WRAPS_NS = (1 << 32) * 1000

_QUAT = tuple((n, "") for n in ("qw", "qx", "qy", "qz"))
_EULER = tuple((n, "deg") for n in ("roll", "pitch", "yaw"))
_FREE = tuple((n, "m/s2") for n in ("free_x", "free_y", "free_z"))
_ACC = tuple((n, "m/s2") for n in ("ax", "ay", "az"))
_GYRO = tuple((n, "deg/s") for n in ("gx", "gy", "gz"))
_MAG = tuple((n, "") for n in ("mx", "my", "mz"))
Mode = Literal["orientation", "quaternion", "euler", "free", "inertial", "inertial_magnetic", "quaternion_inertial"]


@dataclass(frozen=True, slots=True)
class DotMode:
    """A measurement mode: its number, the characteristic that notifies it, its channels with units, as float32 or (`counts`) int16."""

    number: int
    characteristic: str
    channels: tuple[tuple[str, str], ...]
    counts: int = 0

    @property
    def size(self) -> int:
        """Bytes of a packet; it may have zeros behind them."""
        return 4 + 4 * (len(self.channels) - self.counts) + 2 * self.counts


MODES: dict[Mode, DotMode] = {
    "orientation": DotMode(3, MEDIUM, _QUAT + _FREE),
    "quaternion": DotMode(5, SHORT, _QUAT),
    "euler": DotMode(4, SHORT, _EULER),
    "free": DotMode(6, SHORT, _FREE),
    "inertial": DotMode(21, MEDIUM, _ACC + _GYRO),
    "inertial_magnetic": DotMode(20, MEDIUM, _ACC + _GYRO + _MAG, counts=3),
    "quaternion_inertial": DotMode(26, LONG, _QUAT + _ACC + _GYRO),
}


def parse(mode: DotMode, data: bytes) -> tuple[int, NDArray[np.float64]] | None:
    """The device's time (us, 32 bits) and the channels (c,); None for a packet that is cut off."""
    if len(data) < mode.size:
        return None
    floats = len(mode.channels) - mode.counts
    with np.errstate(invalid="ignore"):  # damage may look like a signalling NaN
        values = np.frombuffer(data, "<f4", floats, 4).astype(np.float64)
    if mode.counts:
        values = np.concatenate([values, np.frombuffer(data, "<i2", mode.counts, 4 + 4 * floats) / 4096])
    return int.from_bytes(data[:4], "little"), values


def build(mode: DotMode, time_us: int, values: NDArray[np.float64]) -> bytes:
    """A packet; for simulators and tests."""
    floats = len(mode.channels) - mode.counts
    body = (time_us % (1 << 32)).to_bytes(4, "little") + values[:floats].astype("<f4").tobytes()
    body += np.round(values[floats:] * 4096).astype("<i2").tobytes()
    longest = {SHORT: 20, MEDIUM: 40, LONG: 63}[mode.characteristic]
    return body.ljust(longest, b"\0")


def command(mode: DotMode, action: int) -> bytes:
    """Begin or end a measurement."""
    return bytes([MEASUREMENT, action, mode.number])


def rate_command(rate_hz: int) -> bytes:
    """What is written to the device control to set the output rate: 32 bytes of which only the rate counts."""
    made = bytearray(32)
    made[0] = RATE_BIT
    made[RATE_AT : RATE_AT + 2] = rate_hz.to_bytes(2, "little")
    return bytes(made)
