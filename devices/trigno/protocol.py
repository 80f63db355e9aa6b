"""Delsys Trigno by its SDK server: commands and answers as text, samples as float32. No socket, no clock.

The server listens on a command port (50040 by default) and sends samples on others behind it: the two of old (EMG of 16 sensors, 3
auxiliary channels each) and the two of today (EMG of 16 sensors, 9 auxiliary channels each). A sample is a little-endian float32 per
channel, and nothing else: no head, no counter, no check.

Source: "Trigno SDK User's Guide"; layouts and commands as pytrigno has them, which is not on PyPI and was not run against this.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.stream.chunk import Samples

ENDING = b"\r\n\r\n"
BANNER = b"Delsys Trigno System Digital Protocol Version"
SENSORS = 16
FRAME_S = 0.0135
AUX_HZ = 2 / FRAME_S
RANGE_V = 1.0
"""No electrode gives more; such a number is damage."""
START, STOP = "START", "STOP"

Layout = Literal["legacy", "current"]


@dataclass(frozen=True, slots=True)
class Ports:
    """Where samples come from, as steps from the command port, and how many auxiliary channels a sensor has there."""

    emg: int
    aux: int
    aux_channels: tuple[str, ...]
    aux_units: tuple[str, ...]


PORTS: dict[Layout, Ports] = {
    "legacy": Ports(1, 2, ("ax", "ay", "az"), ("g",) * 3),
    "current": Ports(
        3, 4, ("ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz"), ("g",) * 3 + ("deg/s",) * 3 + ("",) * 3
    ),
}


def command(text: str) -> bytes:
    return text.encode("ascii") + ENDING


def answers(data: bytes) -> tuple[list[str], bytes]:
    """The whole answers in what has come, and what is left over."""
    *whole, rest = data.split(ENDING)
    return [one.decode("ascii", "replace").strip() for one in whole], rest


class TrignoRows:
    """Bytes to samples. Feed it bytes as they come, cut anywhere; it never waits and never raises."""

    def __init__(self, channels: int) -> None:
        self._channels, self._buffer = channels, b""

    def feed(self, data: bytes) -> Samples:
        """(n, channels) float64; what is not a number stays so."""
        buffer, size = self._buffer + data, 4 * self._channels
        n = len(buffer) // size
        self._buffer = buffer[n * size :]
        with np.errstate(invalid="ignore"):  # damage may look like a signalling NaN
            return np.frombuffer(buffer, "<f4", n * self._channels).reshape(n, self._channels).astype(np.float64)


def rows(values: Samples) -> bytes:
    """What the server sends; for simulators and tests."""
    return np.ascontiguousarray(values, "<f4").tobytes()
