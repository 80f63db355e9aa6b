"""The simulated sleeper: what is known of the night is what the frames show."""

from __future__ import annotations

import numpy as np

from kinegraph.devices.people.sleeper import BED_MM, FLOOR_MM, Sleeper

SMALL = {"width": 96, "height": 72}


def test_a_frame_is_a_function_of_its_time_and_the_seed() -> None:
    one, other = Sleeper(**SMALL, seed=1), Sleeper(**SMALL, seed=1)
    late = other.frame(3000, 100.0)
    assert np.array_equal(one.frame(10, 1 / 3), other.frame(10, 1 / 3))
    assert np.array_equal(one.frame(3000, 100.0), late)
    assert not np.array_equal(Sleeper(**SMALL, seed=2).frame(10, 1 / 3), one.frame(10, 1 / 3))
    assert one.movements(0, 3600) == other.movements(0, 3600) != Sleeper(**SMALL, seed=2).movements(0, 3600)


def test_depths_are_those_of_the_room_and_a_tenth_flickers() -> None:
    sleeper = Sleeper(**SMALL)
    frames = np.array([sleeper.frame(k, k / 30) for k in range(32)])
    assert frames.dtype == np.uint16 and abs((frames == 0).mean() - 0.1) < 0.01
    valid = frames[frames > 0]
    assert valid.min() > BED_MM - 500 and valid.max() < FLOOR_MM + 40
    seen = (frames > 0).mean(axis=0)
    assert seen.min() > 0.5 and (seen < 1).mean() > 0.8, "other pixels in every frame"
    assert len({frame.tobytes() for frame in frames}) == 32


def test_breath_is_seen_on_the_chest() -> None:
    sleeper = Sleeper(**SMALL, per_min=0.0, invalid=0.0, seed=5)
    assert not [m for m in sleeper.movements(0, 60) if m.part != "turn"]
    seconds = np.arange(0, 20, 0.1)
    chest = np.array([sleeper.frame(i, s).astype(float)[24:31, 40:56].mean() for i, s in enumerate(seconds)])
    breath = np.array([sleeper.breathing_mm(s) for s in seconds])
    assert np.corrcoef(-chest, breath)[0, 1] > 0.95


def test_movements_are_seen_where_and_when_they_are_known() -> None:
    sleeper = Sleeper(**SMALL, per_min=2.0, invalid=0.0, noise_mm=0.0, seed=7)
    moved = sleeper.movements(0, 600)
    assert 8 < len(moved) < 40 and any(m.part == "turn" for m in moved)

    def change(a: float, b: float) -> float:
        return float(abs(sleeper.frame(0, a).astype(int) - sleeper.frame(0, b)).max())

    for movement in moved:
        middle = movement.onset_s + movement.duration_s / 2
        assert change(movement.onset_s - 0.05, middle) > max(10, 0.7 * movement.size_mm - 10), movement
    busy = [(m.onset_s - 0.3, m.onset_s + m.duration_s + 0.3) for m in moved]
    still = [s for s in np.arange(1, 590, 7.3) if not any(a < s < b for a, b in busy)]
    assert len(still) > 40 and max(change(s, s + 0.2) for s in still) < 6


def test_a_night_takes_no_more_memory_than_a_minute() -> None:
    sleeper = Sleeper(16, 12)
    for minute in range(600):
        sleeper.frame(0, 60.0 * minute)
    assert len(sleeper._blocks) <= 101
