"""Breath as a signal: the chest's movement, its lift, the rate's interval, and pauses; in the night's table and in EDF+."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.reports.night import archive
from kinegraph.devices.reports.night.edf import write_edf
from kinegraph.devices.reports.night.rows import risen
from kinegraph.operators.bed.breath_wave import BreathWave
from kinegraph.operators.bed.breathing import Breathing
from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.operator import grid
from tests.sleep.depth_frames import blocks_spec, play
from tests.sleep.depth_frames import regions as regions_at

FPS, START = 8.0, 1_767_218_400 * NS
PER_MIN, LIFT_MM = 14.0, 3.0


def breaths(second: Array, uneven: float) -> Array:
    """How many breaths so far."""
    lengths = 60 / PER_MIN * np.exp(np.random.default_rng(9).normal(0, uneven, 300))
    count: Array = np.interp(second, np.concatenate([[0.0], np.cumsum(lengths)]), np.arange(301))
    return count


def made(
    seconds: float,
    *,
    pauses: tuple[tuple[float, float], ...] = (),
    noise: float = 0.3,
    uneven: float = 0.0,
    shallow_s: float = 1e9,
) -> dict[str, Array]:
    """What comes out of blocks of 12 x 16, of which 4 x 5 are a chest that lifts by 3 mm; the lengths of breaths may vary.

    shallow_s: from then on breath lifts a quarter as far
    """
    second = np.arange(int(seconds * FPS)) / FPS
    lift = LIFT_MM * (1 - np.cos(2 * np.pi * breaths(second, uneven))) / 2
    lift[second >= shallow_s] /= 4
    for begin, end in pauses:
        lift[(second >= begin) & (second < end)] = lift[int(begin * FPS)]
    depth = 2000.0 + np.random.default_rng(8).normal(0, noise, (len(second), 12, 16))
    depth[:, 4:8, 5:10] -= lift[:, None, None]
    time = grid(FPS, len(second), START)
    return play(
        Breathing(cell_blocks=1),
        regions=regions_at(START, a=(0, 0, 96, 128)),
        blocks=(blocks_spec(12, 16, FPS), time, depth),
    )


def test_cells_that_are_mostly_noise_do_not_turn_the_wave_against_itself() -> None:
    wave = made(600, noise=3.0)["wave"][120:, 0]
    second = 30 + np.arange(len(wave)) / 4
    lift = -np.cos(2 * np.pi * breaths(second + 0.125, 0.0))
    alike = [np.corrcoef(wave[a : a + 120], lift[a : a + 120])[0, 1] for a in range(0, len(wave) - 119, 120)]
    assert len(alike) >= 18 and min(alike) > 0.5


def test_the_rate_of_uneven_breaths_is_that_of_the_mean_breath() -> None:
    rates = made(900, uneven=0.1)["out"]["rate"][2:30]
    true = 2 * np.diff(breaths(30.0 * np.arange(2, 31), 0.1))
    error = np.abs(rates - true)
    assert np.isfinite(rates).mean() > 0.9 and np.nanmedian(error) < 0.2 and np.nanmax(error) < 1.0


def test_the_wave_is_the_movement_of_the_chest() -> None:
    given = made(120)
    wave, events = given["wave"][:, 0], given["out"]
    assert len(wave) >= 119 * 4 and np.isnan(wave[:119]).all(), "the first epoch shows where the chest is"
    second = np.arange(len(wave)) / 4 + 0.125
    truth = -np.cos(2 * np.pi * PER_MIN / 60 * second)
    assert np.corrcoef(wave[160:], truth[160:])[0, 1] > 0.95, "up when the chest is up"
    assert np.nanmedian(events["amplitude"]) == pytest.approx(LIFT_MM, rel=0.15)
    assert (events["regularity"][1:] > 0.9).all()
    assert (abs(events["rate"] - PER_MIN) <= events["error"]).all() and (events["error"] < 1.0).all()
    assert (events["pauses"][1:] == 0).all()


def test_pauses_are_counted_from_10_s_on() -> None:
    events = made(240, pauses=((70, 85), (110, 130), (160, 166)))["out"]
    assert np.nansum(events["pauses"]) == 2
    assert np.nansum(events["paused_s"]) == pytest.approx(35, abs=4)


def test_noise_alone_has_no_wave_and_no_pauses() -> None:
    given = made(90, pauses=((0, 90),))
    assert np.isnan(given["wave"]).all() and np.isnan(given["out"]["pauses"]).all()


def test_the_wave_lies_in_edf_at_its_own_rate(tmp_path: Path) -> None:
    import edfio

    wave = np.sin(np.arange(240) / 3.0)
    wave[130:140] = np.nan
    rows = [",".join(archive.COLUMNS)]
    for k in range(3):
        known = {
            "onset": archive.iso(START + 30 * k * NS),
            "end": archive.iso(START + 30 * (k + 1) * NS),
            "state": "sleep",
        }
        known |= {"activity": "0", "wave": " ".join(risen(v) for v in wave[120 * k : 120 * (k + 1)])}
        rows.append(",".join(known.get(name, "") for name in archive.COLUMNS))
    (tmp_path / archive.EPOCHS).write_text("\n".join(rows) + "\n")
    write_edf(tmp_path / "night.edf", archive.Facts("n", START, 30.0, "UTC"), archive.read_epochs(tmp_path))
    (signal,) = [s for s in edfio.read_edf(tmp_path / "night.edf").signals if s.label == "Chest movement"]
    assert signal.sampling_frequency == 4.0 and signal.physical_dimension == "mm"
    expected = np.where(np.isfinite(wave), wave, -32.0)
    assert np.abs(signal.data[:240] - expected).max() < 0.01 and (signal.data[240:] == -32.0).all()


def test_the_interval_of_uneven_breath_is_wider_and_holds_the_rate_of_the_epoch() -> None:
    """The peak of a spectrum is surer of itself than breath is whose lengths vary by 8 %."""
    events = made(600, uneven=0.08)["out"]
    rates = 2 * np.diff(breaths(np.arange(0, 601, 30.0), 0.08))
    errors = abs(events["rate"] - rates)
    assert (errors <= events["error"])[1:].mean() >= 0.9, errors
    assert np.median(events["error"][1:]) < 1.5


def test_breath_that_has_become_shallow_is_no_pause_for_the_rest_of_the_night() -> None:
    """As under another blanket; what is usual must follow even where a pause seems to be in every epoch."""
    events = made(600, shallow_s=180)["out"]
    assert np.isfinite(events["rate"][10:]).all() and (events["pauses"][11:] == 0).all(), events["pauses"]


def watched(lift: Callable[[int], float], skipped: Callable[[int], bool]) -> BreathWave:
    """Two minutes of a chest that lifts by 3 mm, four times a second, but for 30 s from second 50 on."""
    wave = BreathWave.of(1, 12, 120)
    wave.chosen[:], wave.usual[:] = 1.0, LIFT_MM
    for tick in range(480):
        breath = LIFT_MM / 2 * np.sin(2 * np.pi * PER_MIN / 60 * tick / 4)
        if not (200 <= tick < 320 and skipped(tick)):
            wave.add(np.full(12, 2000.0 - (lift(tick) if 200 <= tick < 320 else breath)), tick, 0.25)
    return wave


def test_a_tick_without_a_frame_is_not_what_it_was_an_epoch_ago() -> None:
    """Frames are lost while nobody breathes: the wave of before must not end the pause."""
    wave = watched(lambda tick: 0.0, lambda tick: tick % 7 < 2)
    assert wave.pauses.tolist() == [1] and wave.paused[0] == pytest.approx(30, abs=2)


def test_an_outlier_does_not_make_two_pauses_of_one() -> None:
    wave = watched(lambda tick: -5.0 if tick == 262 else 0.0, lambda tick: False)
    assert wave.pauses.tolist() == [1] and wave.paused[0] == pytest.approx(30, abs=3)
