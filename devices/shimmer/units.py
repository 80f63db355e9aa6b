"""Counts of a Shimmer3 to physical units: the sensors' calibration, as the device keeps it, and the ExG chips' registers.

A calibrated vector is inv(alignment) @ ((counts - offset) / sensitivity). Later boards carry other accelerometers than earlier ones, whose
ranges have other codes; its expansion board says which ones a device has.

Source of the nominal numbers, the codes and the boards: the maker's driver (ShimmerEngineering/Shimmer-Java-Android-API: SensorKionix*,
SensorLSM303*, SensorMPU9X50, NEW_IMU_EXP_REV) and firmware (ShimmerResearch/shimmer3).
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Samples

BLOCK = 21
"""Bytes of a sensor's calibration: offset, sensitivity (3 int16 each, big-endian), alignment (9 int8, hundredths)."""
ORDER = ("acceleration", "angular_velocity", "magnetic_field", "wide_acceleration")
ALL = BLOCK * len(ORDER)
ACROSS = (0, -1, 0, -1, 0, 0, 0, 0, -1)
"""How the low-noise accelerometer and the gyroscope sit on the board."""
GYRO_DPS = (250, 500, 1000, 2000)
GYRO_HZ = 8000.0
COUNTS_PER_DPS = (131.0, 65.5, 32.8, 16.4)


@dataclass(frozen=True, slots=True)
class Chips:
    """The accelerometers of a generation of boards.

    low_noise    offset (counts) and counts per m/s2 of the analogue one
    wide_g       the wide-range one's ranges, by the code that sets them
    wide_counts  counts per m/s2 in these ranges
    wide_sits    how it sits on the board
    wide_hz      its own rates, by the code that sets them; 0: not available
    """

    low_noise: tuple[float, float]
    wide_g: tuple[int, ...]
    wide_counts: tuple[float, ...]
    wide_sits: tuple[int, ...]
    wide_hz: tuple[float, ...]

    def wide_rate(self, rate_hz: float) -> int:
        """The code of its slowest rate that is not below the packets', or of its fastest."""
        enough = [code for code, hz in enumerate(self.wide_hz) if hz >= rate_hz]
        return enough[0] if enough else len(self.wide_hz) - 1


OLDER = Chips(
    (2047.0, 83.0), (2, 4, 8, 16), (1631.0, 815.0, 408.0, 135.0), (-1, 0, 0, 0, 1, 0, 0, 0, -1),
    (0, 1, 10, 25, 50, 100, 200, 400, 0, 1344),
)  # fmt: skip
"""KXRB5-2042 and LSM303DLHC."""
NEWER = Chips(
    (2253.0, 92.0), (2, 16, 4, 8), (1671.0, 209.0, 836.0, 418.0), (0, -1, 0, 1, 0, 0, 0, 0, -1),
    (0, 12.5, 25, 50, 100, 200, 400, 800, 1600, 3200, 6400),
)  # fmt: skip
"""KXTC9-2050 and LSM303AHTR, and what firmware makes to look like it (ICM-20948)."""
NEWER_FROM = {31: 6, 36: 3, 38: 3, 47: 3, 48: 3, 49: 3}
"""By the expansion board's number (SR31, ...): the first revision that comes with them."""
NEWER_BELOW = 171
"""The special revision of an older expansion board on a newer main board."""
APART = 1.6
"""A stored sensitivity that is further from the nominal one than this factor belongs to another range."""

VREF_V = 2.42
GAINS = (6, 1, 2, 3, 4, 8, 12)
EXG_RATES_HZ = (125, 250, 500, 1000, 2000, 4000, 8000)
EXG_REGISTERS = {
    "emg": (bytes([0, 160, 16, 105, 96, 32, 0, 0, 2, 3]), bytes([0, 160, 16, 129, 129, 0, 0, 0, 2, 1])),
    "ecg": (bytes([0, 160, 16, 64, 64, 45, 0, 0, 2, 3]), bytes([0, 160, 16, 64, 71, 0, 0, 0, 2, 1])),
}
"""What the maker's software writes into the two ExG chips for a purpose; the first byte's low bits are the rate."""


@dataclass(frozen=True, slots=True)
class ShimmerCalibration:
    """offset (3,), sensitivity (3,) counts per unit, alignment (3, 3); `own`: the device's, not the nominal one."""

    offset: Samples
    sensitivity: Samples
    alignment: Samples
    own: bool = True

    def apply(self, counts: Samples) -> Samples:
        """Units (n, 3) of counts (n, 3)."""
        return np.asarray((counts - self.offset) @ (np.linalg.inv(self.alignment) / self.sensitivity).T)

    def counts(self, values: Samples) -> Samples:
        """The reverse, for simulators."""
        return np.asarray(values @ (self.alignment.T * self.sensitivity) + self.offset)


def gyro_divider(rate_hz: float) -> int:
    """What sets the gyroscope's own rate, 8000 Hz / (1 + divider), to the slowest that is not below the packets'."""
    return min(255, max(0, int(GYRO_HZ / rate_hz) - 1))


def chips_of(board: bytes) -> Chips:
    """By the expansion board's number, revision and special revision, as the device tells them; FF where it does not know."""
    number, revision, special = board[:3]
    newer = special == NEWER_BELOW or NEWER_FROM.get(number, 256) <= revision
    return NEWER if newer else OLDER


def nominal(sensor: str, wide_range: int = 0, gyro_range: int = 1, chips: Chips = OLDER) -> ShimmerCalibration:
    """By the chips' data sheets; m/s2 and rad/s. `wide_range`, `gyro_range`: the codes of the ranges."""
    offset, sits = 0.0, chips.wide_sits if sensor == "wide_acceleration" else ACROSS
    if sensor == "acceleration":
        offset, per_unit = chips.low_noise
    elif sensor == "wide_acceleration":
        per_unit = chips.wide_counts[wide_range]
    else:
        per_unit = COUNTS_PER_DPS[gyro_range] * 180 / math.pi
    return ShimmerCalibration(np.full(3, offset), np.full(3, per_unit), np.array(sits, float).reshape(3, 3), own=False)


def calibration(
    data: bytes, sensor: str, wide_range: int = 0, gyro_range: int = 1, chips: Chips = OLDER
) -> ShimmerCalibration:
    """A sensor's, from the device's 84 bytes of calibrations; the nominal one if it keeps no calibration for this range."""
    block = data[ORDER.index(sensor) * BLOCK :][:BLOCK]
    known = nominal(sensor, wide_range, gyro_range, chips)
    numbers = struct.unpack(">6h9b", block)
    sensitivity, alignment = np.array(numbers[3:6], float), np.array(numbers[6:], float).reshape(3, 3) / 100
    if sensor == "angular_velocity":
        sensitivity *= 1.8 / math.pi  # stored in hundredths of counts per degree a second
    ratio = sensitivity / known.sensitivity
    if (ratio < 1 / APART).any() or (ratio > APART).any() or abs(np.linalg.det(alignment)) < 0.5:
        return known
    return ShimmerCalibration(np.array(numbers[:3], float), sensitivity, alignment)


def stored(sensors: dict[str, ShimmerCalibration]) -> bytes:
    """The 84 bytes of a device's calibrations; FF where one is missing. For simulators and tests."""
    out = b""
    for sensor in ORDER:
        if (known := sensors.get(sensor)) is None:
            out += b"\xff" * BLOCK
            continue
        sensitivity = known.sensitivity * (math.pi / 1.8 if sensor == "angular_velocity" else 1)
        whole = [*known.offset, *sensitivity, *(known.alignment * 100).ravel()]
        out += struct.pack(">6h9b", *(round(n) for n in whole))
    return out


def registers(purpose: str, rate_hz: float) -> tuple[bytes, bytes]:
    """Of both chips, which convert at least as often as the device samples."""
    fast = next((i for i, hz in enumerate(EXG_RATES_HZ) if hz >= rate_hz), len(EXG_RATES_HZ) - 1)
    first, second = EXG_REGISTERS[purpose]
    return bytes([fast]) + first[1:], bytes([fast]) + second[1:]


def exg_uv(purpose: str, channels: int) -> Samples:
    """uV per count of the channels (channels,)."""
    settings = [chip[i] for chip in EXG_REGISTERS[purpose] for i in (3, 4)]
    gains = np.array([GAINS[setting >> 4 & 7] for setting in settings[:channels]], float)
    return VREF_V / gains / (2**23 - 1) * 1e6
