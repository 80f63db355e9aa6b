"""A bed seen obliquely, by time of flight and by stereo: breath, presence and what is no sleeper, in simulated tilted rooms."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.bed.breathing import Breathing
from kinegraph.operators.bed.presence import Presence
from kinegraph.stream.chunk import NS
from tests.sleep.depth_frames import play
from tests.sleep.tilted_night import HEIGHT, START, WIDTH, blocks_of, inputs
from tests.sleep.tilted_room import Stay, TiltedCamera, TiltedRoom


@pytest.mark.parametrize(
    ("sensor", "lift_mm", "per_min", "fps"),
    [
        ("tof", 2.0, 8.0, 5.0),
        ("tof", 2.0, 33.0, 5.0),
        ("tof", 4.0, 43.0, 5.0),
        ("stereo", 4.0, 14.0, 8.0),
        ("stereo", 4.0, 27.0, 8.0),
    ],
)
def test_the_rate_is_found_by_either_sensor_from_6_to_45_per_minute(
    sensor: str, lift_mm: float, per_min: float, fps: float
) -> None:
    room = TiltedRoom(WIDTH, HEIGHT, TiltedCamera(sensor=sensor), Stay(0, 1e9, per_min, lift_mm), seed=3)  # type: ignore[arg-type]
    made = play(Breathing(), **inputs(room, 90, fps))["out"]
    assert (abs(made["rate"] - per_min) < 0.5).all(), made["rate"]


@pytest.mark.parametrize("sensor", ["tof", "stereo"])
def test_an_empty_bed_does_not_breathe(sensor: str) -> None:
    room = TiltedRoom(WIDTH, HEIGHT, TiltedCamera(sensor=sensor, correlated=0.6), Stay(), seed=4)  # type: ignore[arg-type]
    assert np.isnan(play(Breathing(), **inputs(room, 120, 4.0))["out"]["rate"]).all()


def states(stay: Stay, seconds: float, **camera: object) -> list[tuple[str, int, str]]:
    """What presence reports of a scene: state, since when (s), why."""
    room = TiltedRoom(WIDTH, HEIGHT, TiltedCamera(**camera), stay, seed=5)  # type: ignore[arg-type]
    made = play(Presence(), **inputs(room, seconds, 2.5))["out"]
    return [(str(e["state"]), round((int(e["onset"]) - START) / NS), str(e["why"])) for e in made]


@pytest.mark.nightly
def test_who_lies_still_for_an_hour_and_breathes_is_in_bed() -> None:
    """Breath of 2 mm moves no block by as much as movement does; the rate is there, and is asked."""
    assert [s for s, _, _ in states(Stay(120, 1e9, 14.0, 2.0, moves=(300.0,)), 3900)] == ["out", "in", "unknown"]


def test_who_breathes_is_not_unknown_for_want_of_movement() -> None:
    made = states(Stay(100, 1e9, 14.0, 2.0), 900)
    assert [s for s, _, _ in made] == ["out", "in", "unknown"] and made[-1][1] == 900, made


@pytest.mark.parametrize("begins", [0.0, 150.0])
def test_a_fan_that_lifts_the_blanket_of_an_empty_bed_is_nobody(begins: float) -> None:
    made = states(Stay(fan=(begins, 1e9)), 900)
    assert "in" not in [s for s, _, _ in made], made


def test_a_heap_that_is_left_behind_is_no_sleeper_after_a_minute() -> None:
    made = states(Stay(60, 600, 14.0, 6.0, moves=(590.0,), heap=(600, 1e9)), 780)
    assert [(s, w) for s, _, w in made[:3]] == [("out", ""), ("in", ""), ("unknown", "still")], made
    assert 590 <= made[2][1] <= 630


def test_missing_pixels_that_jump_do_not_shake_the_blocks_of_a_tilted_bed() -> None:
    """The mean of what is measured of a tilted block depends on which pixels are missing: by 2.3 mm here."""
    spread = []
    for jump in (0.0, 0.15):
        room = TiltedRoom(320, 240, TiltedCamera(jump=jump), Stay(), seed=3)
        row, column, rows, columns = (v // 8 for v in room.rectangle())
        bed = blocks_of(room, 8, 5.0)[:, row + 1 : row + rows - 1, column + 2 : column + columns - 2]
        steps = np.diff(bed[:, np.isfinite(bed).all(axis=0)], axis=0)
        spread.append(float(np.median(np.sqrt((steps**2).mean(axis=0) / 2))))
    assert spread[1] < 1.4 * spread[0], spread
