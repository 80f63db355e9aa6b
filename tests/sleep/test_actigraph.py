"""The simulated actigraph through the configuration that ships: scored, summarised, and unknown where the device was off."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np

from kinegraph.devices.people.actigraph import Actigraph, ActigraphNight
from kinegraph.operators.sleep.evaluation.reference import read_hypnogram

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "actigraphy_sleep.yaml"


def test_a_night_is_its_seeds_and_is_off_the_wrist_when_told() -> None:
    one, again, other = (
        ActigraphNight(Actigraph()),
        ActigraphNight(Actigraph()),
        ActigraphNight(Actigraph(seed=1, off_wrist_min=10)),
    )
    assert (one.counts == again.counts).all() and not np.array_equal(one.counts, other.counts)
    assert np.isnan(other.counts).sum() == 20 and other.on - other.off == 960
    assert not one.asleep[: one.off].any() and not one.asleep[one.on :].any() and one.asleep.mean() > 0.5


def test_the_configuration_runs_and_its_epochs_agree_with_its_night(tmp_path: Path) -> None:
    command = [str(Path(sys.executable).parent / "kinegraph"), "run", str(CONFIG), "-o", "night"]
    settings = ["--set", "actigraph.off_wrist_min=10", "--set", "actigraph.bed_h=6"]
    done = subprocess.run([*command, *settings], cwd=tmp_path, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    assert done.returncode == 0, done.stdout + done.stderr
    with (tmp_path / "reports" / "actigraphy_night.csv").open() as file:
        (night,) = csv.DictReader(file)
    with (tmp_path / "reports" / "actigraphy_epochs.csv").open() as file:
        finals = [row for row in csv.DictReader(file) if row["final"] == "1"]
    assert night["bed"] == "lights" and night["estimated"] == "0" and float(night["tib (min)"]) == 360.0
    assert float(night["unknown (min)"]) == 10.0
    assert float(night["tst_high (min)"]) == float(night["tst (min)"]) + 10.0
    begin = len(finals) - round(0.75 * 120) - 720
    states = [row["state"] for row in finals[begin : begin + 720]]
    assert states.count("sleep") / 2 == float(night["tst (min)"]) and states.count("unknown") == 20
    assert (
        read_hypnogram(tmp_path / "night").state == [("unknown", "wake", "sleep").index(r["state"]) for r in finals]
    ).all()
