"""Treadmills by Bluetooth's fitness machine service (FTMS): what they tell, what they can do, how they are set. No port.

Source: Bluetooth SIG, Fitness Machine Service 1.0; field order as pyftms has it.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

SERVICE, DATA, FEATURES, SPEEDS, INCLINES = "1826", "2acd", "2acc", "2ad4", "2ad5"
CONTROL, STATUS = "2ad9", "2ada"
REQUEST, RESET, SPEED, INCLINE, START, STOP = 0, 1, 2, 3, 7, 8
RESULT = {1: "ok", 2: "not supported", 3: "wrong parameter", 4: "failed", 5: "not permitted"}
SAFETY_KEY, CONTROL_LOST = 3, 0xFF
ABSENT = -(2**15)
"""The value of an unknown incline."""

_PARTS: tuple[tuple[int, str, tuple[tuple[str, int, bool, float], ...]], ...] = (
    # bit, and its fields: name, bytes, signed, factor
    (1, "", (("average_speed", 2, False, 0.01),)),
    (2, "", (("distance", 3, False, 1.0),)),
    (3, "", (("incline", 2, True, 0.1), ("ramp_angle", 2, True, 0.1))),
    (4, "", (("climbed", 2, False, 0.1), ("descended", 2, False, 0.1))),
)


class TreadmillData(NamedTuple):
    """By name, what a notification holds: speed (km/h), incline (%), ramp_angle (deg), distance (m), elapsed (s), force (N), ...

    more    a notification that holds no speed: the rest follows in another one
    """

    values: dict[str, float]
    more: bool


def parse(data: bytes, pace_bytes: int = 1) -> TreadmillData | None:
    """A treadmill's notification (2ACD); None for one that is cut off.

    pace_bytes   the width of a pace, which sources do not agree on: 1 in pyftms, 2 in the SIG's own text; rarely sent
    """
    if len(data) < 2:
        return None
    flags, at = int.from_bytes(data[:2], "little"), 2
    pace = ("pace", pace_bytes, False, 0.1)
    parts: list[tuple[bool, tuple[tuple[str, int, bool, float], ...]]] = [
        (not flags & 1, (("speed", 2, False, 0.01),)),
        *((bool(flags >> bit & 1), fields) for bit, _, fields in _PARTS),
        (bool(flags >> 5 & 1), (pace,)),
        (bool(flags >> 6 & 1), (("average_pace", *pace[1:]),)),
        (bool(flags >> 7 & 1), (("energy", 2, False, 1.0), ("energy_per_hour", 2, False, 1.0), ("energy_per_minute", 1, False, 1.0))),
        (bool(flags >> 8 & 1), (("heart_rate", 1, False, 1.0),)),
        (bool(flags >> 9 & 1), (("metabolic_equivalent", 1, False, 0.1),)),
        (bool(flags >> 10 & 1), (("elapsed", 2, False, 1.0),)),
        (bool(flags >> 11 & 1), (("remaining", 2, False, 1.0),)),
        (bool(flags >> 12 & 1), (("force", 2, True, 1.0), ("power", 2, True, 1.0))),
        (bool(flags >> 13 & 1), (("steps", 3, False, 1.0),)),
    ]  # fmt: skip
    values: dict[str, float] = {}
    for present, fields in parts:
        for name, size, signed, factor in fields if present else ():
            if at + size > len(data):
                return None
            values[name] = int.from_bytes(data[at : at + size], "little", signed=signed) * factor
            at += size
    return TreadmillData(values, bool(flags & 1))


def build(speed: float, incline: float, distance: float, elapsed: float) -> bytes:
    """What a treadmill sends; for simulators and tests."""
    metres = round(distance)
    head = struct.pack("<HHHB", 1 << 2 | 1 << 3 | 1 << 10, round(speed * 100), metres & 0xFFFF, metres >> 16)
    return head + struct.pack("<hhH", round(incline * 10), 0x7FFF, round(elapsed))


def target(op: int, value: float) -> bytes:
    """The command that sets the speed (km/h) or the incline (%)."""
    return struct.pack("<BH", op, round(value * 100)) if op == SPEED else struct.pack("<Bh", op, round(value * 10))


def limits(data: bytes, *, signed: bool, factor: float) -> tuple[float, float, float]:
    """Least, most and step of a setting (2AD4, 2AD5). Raises struct.error."""
    low, high = struct.unpack_from("<hh" if signed else "<HH", data)
    (step,) = struct.unpack_from("<H", data, 4)
    return low * factor, high * factor, step * factor


def can_be_set(features: bytes) -> tuple[bool, bool]:
    """Whether speed and incline can be set (2ACC)."""
    settable = int.from_bytes(features[4:8], "little")
    return bool(settable & 1), bool(settable & 2)
