"""Breathing rates beside the effort belt of a PSG."""

from __future__ import annotations

import json
from pathlib import Path

import edfio
import numpy as np
import pytest

from kinegraph.operators.sleep.evaluation.effort import belt_rate, breath_agreement
from kinegraph.stream.chunk import Array
from tests.support.command_line import Command

START = np.datetime64("2026-03-01T22:00:00")
EPOCHS = 40
RATES = 12 + 0.1 * np.arange(EPOCHS)


def psg(path: Path, rates: Array, *, late_s: float = 0.0, label: str = "THOR EFFORT") -> None:
    """A belt at 10 Hz, with noise, and a hypnogram."""
    when = (START + np.timedelta64(round(1000 * late_s), "ms")).astype("datetime64[s]").item()
    t = np.arange(30 * 10 * len(rates)) / 10
    phase = np.cumsum(np.repeat(rates, 300)) / 600
    x = np.sin(2 * np.pi * phase) + np.random.default_rng(4).normal(0, 0.2, len(t))
    signals = [
        edfio.EdfSignal(np.zeros(len(rates) * 30), 1.0, label="Nasal airflow", physical_range=(-1, 1)),
        edfio.EdfSignal(x, 10.0, label=label, physical_range=(-5, 5)),
    ]
    notes = [edfio.EdfAnnotation(30.0 * k, 30.0, "Sleep stage N2") for k in range(len(rates))]
    edfio.Edf(
        signals, recording=edfio.Recording(startdate=when.date()), starttime=when.time(), annotations=notes
    ).write(path)


def ours(path: Path, rates: Array) -> None:
    """epochs.csv; every fourth epoch has no rate."""
    lines = ["onset,end,state,breaths_per_min,rate_error"]
    for k, rate in enumerate(rates):
        begin = START + np.timedelta64(30 * k, "s")
        known = f"{rate:.2f},0.3" if k % 4 else ","
        lines.append(f"{begin}Z,{begin + np.timedelta64(30, 's')}Z,sleep,{known}")
    path.write_text("\n".join(lines) + "\n")


def test_our_rates_are_held_against_the_belts_epoch_by_epoch(tmp_path: Path) -> None:
    psg(tmp_path / "psg.edf", RATES)
    ours(tmp_path / "epochs.csv", RATES + 0.2)
    found = breath_agreement("night", tmp_path / "epochs.csv", tmp_path / "psg.edf", 0.0)
    assert found and (found.belt, found.epochs, found.known) == ("THOR EFFORT", EPOCHS, 30)
    assert found.bias == pytest.approx(0.2, abs=0.02) and found.most < 0.35 and found.within > 0.9


def test_a_belt_whose_clock_was_late_is_moved_by_the_offset(tmp_path: Path) -> None:
    psg(tmp_path / "psg.edf", RATES, late_s=300)
    ours(tmp_path / "epochs.csv", RATES)
    found = breath_agreement("night", tmp_path / "epochs.csv", tmp_path / "psg.edf", -300.0)
    assert found and abs(found.bias) < 0.02


def test_noise_has_no_rate_and_files_without_breath_no_comparison(tmp_path: Path) -> None:
    assert np.isnan(belt_rate(np.random.default_rng(1).normal(0, 1, 300), 10.0)) and np.isnan(
        belt_rate(np.ones(300), 10.0)
    )
    psg(tmp_path / "psg.edf", RATES, label="Flow")
    ours(tmp_path / "epochs.csv", RATES)
    assert breath_agreement("night", tmp_path / "epochs.csv", tmp_path / "psg.edf", 0.0) is None


def test_the_command_shows_it_beside_sleep_and_wake(tmp_path: Path, kinegraph: Command) -> None:
    psg(tmp_path / "psg.edf", RATES)
    ours(tmp_path / "epochs.csv", RATES)
    done = kinegraph("sleep", "evaluate", str(tmp_path / "epochs.csv"), str(tmp_path / "psg.edf"))
    assert "Breathing beside the effort belt" in done[1] and "THOR EFFORT" in done[1]
    done = kinegraph("sleep", "evaluate", str(tmp_path / "epochs.csv"), str(tmp_path / "psg.edf"), "--json")
    assert json.loads(done[1])[0]["breath"][0]["known"] == 30
