"""configs/bedside_two.yaml: two sleepers under one depth camera, each with a score and a breathing rate of their own.

Recording: a simulated bedroom with two sleepers (of a real one there is no recording that may be kept), who lie down 40 s after one another
and follow seven minutes of a real hypnogram (Walch 2019; PhysioNet).
Truth: when each of them lies down, gets up and moves.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.devices.people.night import NightPlan
from kinegraph.stream.chunk import NS
from tests.replay.replaying import NIGHT_HZ, bedroom_night, pressed, recording, signal

FRAMES, NIGHTS = bedroom_night(2, 36, 14)
SLEEPERS = ("left", "right")


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> kg.Results:
    depth = signal(FRAMES, NIGHT_HZ, (), ["mm"], invalid=0)
    night = recording(
        tmp_path_factory.mktemp("night") / "night.mcap",
        {"camera.depth": depth, "pause_switch": pressed([0.0], [False])},
    )
    return kg.load("bedside_two").run(night, keep=["presence", "activity.epochs", "breathing", "bed"])


def test_each_sleeper_has_half_of_the_bed(replayed: kg.Results) -> None:
    left, right = (replayed["bed"].data[replayed["bed"].data["sleeper"] == name][-1] for name in SLEEPERS)
    assert left["rows"] * left["columns"] == pytest.approx(right["rows"] * right["columns"], rel=0.25)


@pytest.mark.parametrize(("name", "night"), [*zip(SLEEPERS, NIGHTS, strict=True)])
def test_each_is_in_bed_from_lying_down_to_getting_up(replayed: kg.Results, name: str, night: NightPlan) -> None:
    rows = replayed["presence"].data
    rows = rows[rows["sleeper"] == name]
    assert rows["onset"][rows["state"] == "in"][0] / NS == pytest.approx(night.bed_s, abs=15.0)
    assert rows["onset"][rows["state"] == "out"][-1] / NS == pytest.approx(night.up_s, abs=20.0)


def test_movement_is_the_movers_and_not_the_others(replayed: kg.Results) -> None:
    """The left one moves in some epochs, the right one hardly. What may be the other one's counts for neither, so that much is lost."""
    rows = replayed["activity.epochs"].data
    rows = rows[(rows["bed"] == "in") & np.isfinite(rows["moved_s"])]
    left, right = (rows[rows["sleeper"] == name] for name in SLEEPERS)
    moved, still = (
        night.moved_s()[np.round(each["onset"] / NS / 30.0).astype(int)]
        for night, each in zip(NIGHTS, (left, right), strict=True)
    )
    assert 0.25 * moved.sum() < left["moved_s"].sum() < 1.1 * moved.sum()
    assert left["moved_s"][moved == 0].sum() == 0.0
    assert right["moved_s"].sum() <= still.sum() + 0.1 * moved.sum()
