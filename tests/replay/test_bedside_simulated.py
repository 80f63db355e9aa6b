"""configs/bedside_simulated.yaml: a simulated bedroom in the camera's place: in bed, moving, breathing, asleep.

Recording: simulated, as the graph's name says; the sleeper follows twelve minutes of a real hypnogram (Walch 2019; PhysioNet).
Truth: when the simulated sleeper lies down and gets up, moves, and how often breathes.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import NIGHT_HZ, bedroom_night, signal

FRAMES, (NIGHT,) = bedroom_night(1, 36, 24)
KEPT = ["presence", "activity.epochs", "breathing", "scorer", "bed"]


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    return kg.load("bedside_simulated").run(
        {"camera.depth": signal(FRAMES, NIGHT_HZ, (), ["mm"], invalid=0)}, keep=KEPT
    )


def test_the_sleeper_is_in_bed_from_lying_down_to_getting_up(replayed: kg.Results) -> None:
    rows = replayed["presence"].data
    began = {state: rows["onset"][rows["state"] == state] / NS for state in ("in", "out")}
    assert len(began["in"]) == 1 and began["in"][0] == pytest.approx(NIGHT.bed_s, abs=15.0)
    assert began["out"][-1] == pytest.approx(NIGHT.up_s, abs=20.0)


def test_movement_is_seen_in_the_epochs_in_which_the_sleeper_moves(replayed: kg.Results) -> None:
    epochs = replayed["activity.epochs"].data
    epochs = epochs[(epochs["bed"] == "in") & np.isfinite(epochs["moved_s"])]
    truth = NIGHT.moved_s()[np.round(epochs["onset"] / NS / 30.0).astype(int)]
    assert np.corrcoef(truth, epochs["moved_s"])[0, 1] > 0.7
    assert epochs["moved_s"][truth == 0].mean() < 1.0 < epochs["moved_s"][truth > 4.0].mean()


def test_the_breathing_rate_is_the_sleepers(replayed: kg.Results) -> None:
    rows = replayed["breathing"].data
    rows = rows[np.isfinite(rows["rate"]) & (rows["confidence"] > 0.7)]
    truth = [NIGHT.breaths_per_min(row["onset"] / NS, row["end"] / NS) for row in rows]
    assert len(rows) >= 5
    assert np.median(np.abs(rows["rate"] - truth)) < 1.0


def test_who_lies_still_for_minutes_is_taken_to_sleep_and_who_moves_or_is_up_is_not(replayed: kg.Results) -> None:
    """That is all that a score from movement can say: the sleeper lies still awake at first, and that is scored as sleep, too."""
    rows = replayed["scorer"].data
    rows = rows[rows["final"] & (rows["state"] != "unknown")]
    epoch, asleep = np.round(rows["onset"] / NS / 30.0).astype(int), rows["state"] == "sleep"
    away = (rows["end"] / NS <= NIGHT.bed_s) | (rows["onset"] / NS >= NIGHT.up_s)
    assert not asleep[away].any()
    moved = NIGHT.moved_s()
    assert not asleep[moved[epoch] > 3.0].any()
    stages = np.array([NIGHT.stage(30.0 * k + 15.0) for k in epoch])
    assert asleep[(stages == "N2") & (moved[epoch] == 0)].mean() > 0.8
