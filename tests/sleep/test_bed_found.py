"""The bed is found in rooms that a camera sees from any side, tilted by up to 60 degrees."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.bed.bed_plateau import BedLimits, bed_in
from kinegraph.stream.chunk import Array
from tests.sleep.tilted_cameras import on_mattress, placed, random_room
from tests.sleep.tilted_night import blocks_of
from tests.sleep.tilted_room import Stay, TiltedCamera, TiltedRoom

LIMITS = BedLimits(200.0, 1200.0, 0.08)


def shares(room: TiltedRoom, rectangle: tuple[int, int, int, int]) -> tuple[float, float]:
    """How much of the mattress a rectangle in blocks holds, and how much of it is mattress."""
    bed = on_mattress(room).astype(float)
    height, width = bed.shape
    blocks = bed.reshape(height // 8, 8, width // 8, 8).mean(axis=(1, 3))
    row, column, rows, columns = rectangle
    inside: Array = blocks[row : row + rows, column : column + columns]
    return float(inside.sum() / blocks.sum()), float(inside.mean())


@pytest.mark.parametrize(
    ("where", "height", "tilt", "sensor", "lies"),
    [
        ("foot", 2.2, 45.0, "tof", False),
        ("right", 1.5, 55.0, "stereo", False),
        ("head", 2.6, 20.0, "tof", True),
        ("left", 2.2, 30.0, "stereo", True),
        ("foot", 2.4, 0.0, "tof", False),
    ],
)
def test_the_bed_is_found_from_any_side(where: str, height: float, tilt: float, sensor: str, lies: bool) -> None:
    camera = placed(where, height, tilt, TiltedCamera(sensor=sensor))  # type: ignore[arg-type]
    room = TiltedRoom(256, 192, camera, Stay(0, 1e9) if lies else Stay(), seed=12)
    found = bed_in(blocks_of(room, 1.0, 4.0).mean(axis=0), LIMITS)
    assert found is not None
    held, filled = shares(room, found)
    assert held > 0.75 and filled > 0.6


@pytest.mark.parametrize("depth", [40.0, 2000.0, 65535.0])
def test_a_wall_before_the_camera_is_no_bed(depth: float) -> None:
    assert bed_in(np.full((24, 32), depth), LIMITS) is None


@pytest.mark.nightly
@pytest.mark.parametrize("sensor", ["tof", "stereo"])
def test_the_bed_is_found_in_nine_random_rooms_of_ten(sensor: str) -> None:
    right = 0
    for seed in range(300, 340):
        room, *_ = random_room(seed, 320, 240, TiltedCamera(sensor=sensor))  # type: ignore[arg-type]
        depth = blocks_of(room, 1.0, 4.0)
        known = np.isfinite(depth).sum(axis=0)
        found = bed_in(np.where(known, np.nansum(depth, axis=0) / np.maximum(known, 1), np.nan), LIMITS)
        held, filled = shares(room, found) if found else (0.0, 0.0)
        right += held > 0.75 and filled > 0.5
    assert right >= 36
