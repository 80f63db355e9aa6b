"""The heart rate measurement of Bluetooth's heart rate service (characteristic 2A37): bytes in, numbers out.

Source: Bluetooth SIG, Heart Rate Service 1.0; test vectors of the Polar BLE SDK.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

SERVICE, MEASUREMENT = "180d", "2a37"


class HeartRateMeasurement(NamedTuple):
    """bpm; contact: None where the sensor cannot tell; energy_kj: None if not given; rr_s: oldest first."""

    bpm: int
    contact: bool | None
    energy_kj: int | None
    rr_s: tuple[float, ...]


def parse(data: bytes) -> HeartRateMeasurement | None:
    """One notification; None for one that is cut off."""
    if len(data) < 2:
        return None
    flags, at = data[0], 1
    try:
        (bpm,) = struct.unpack_from("<H" if flags & 1 else "<B", data, at)
        at += 2 if flags & 1 else 1
        energy = None
        if flags & 8:
            (energy,) = struct.unpack_from("<H", data, at)
            at += 2
        rest = data[at:] if flags & 16 else b""
        rr = tuple(ticks / 1024 for (ticks,) in struct.iter_unpack("<H", rest))
    except struct.error:
        return None
    return HeartRateMeasurement(bpm, bool(flags & 2) if flags & 4 else None, energy, rr)


def build(measured: HeartRateMeasurement) -> bytes:
    """The notification; for simulators and tests."""
    wide = measured.bpm > 255
    flags = (
        wide | (measured.contact is not None) << 2 | bool(measured.contact) << 1 | (measured.energy_kj is not None) << 3
    )
    flags |= bool(measured.rr_s) << 4
    body = struct.pack("<BH" if wide else "<BB", flags, measured.bpm)
    body += b"" if measured.energy_kj is None else struct.pack("<H", measured.energy_kj)
    return body + b"".join(struct.pack("<H", round(rr * 1024)) for rr in measured.rr_s)
