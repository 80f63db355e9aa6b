"""configs/bedside_sleep.yaml: a depth camera over a bed, with a switch that pauses it.

Recording: the simulated bedroom of test_bedside_simulated.py in the camera's place (of a real bedroom there is no recording that may be
kept), and the pause as somebody presses it. The night is too short for a row of numbers: test_actigraphy_sleep.py has one.
Truth: when it is pressed, and when the simulated sleeper lies down and gets up.
"""

from __future__ import annotations

import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import NIGHT_HZ, bedroom_night, pressed, recording, signal

FRAMES, (NIGHT,) = bedroom_night(1, 36, 24)
PAUSED_S, AGAIN_S = 720.0, 780.0


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> kg.Results:
    night = recording(
        tmp_path_factory.mktemp("night") / "night.mcap",
        {
            "camera.depth": signal(FRAMES, NIGHT_HZ, (), ["mm"], invalid=0),
            "pause_switch": pressed((0.0, PAUSED_S, AGAIN_S), (False, True, False)),
            "lights": pressed([0.0], [True]),
        },
    )
    kept = ["seen", "presence", "scorer"]
    return kg.load("bedside_sleep").run(night, keep=kept)


def test_no_frame_passes_during_a_pause(replayed: kg.Results) -> None:
    seconds = replayed["seen"].time / NS
    assert not ((seconds > PAUSED_S) & (seconds < AGAIN_S)).any()
    assert len(seconds) == pytest.approx(len(FRAMES) - (AGAIN_S - PAUSED_S) * NIGHT_HZ, abs=3)


def test_an_epoch_of_the_pause_is_unknown_and_is_not_taken_for_sleep(replayed: kg.Results) -> None:
    rows = replayed["scorer"].data
    rows = rows[rows["final"]]
    paused = (rows["onset"] / NS >= PAUSED_S) & (rows["end"] / NS <= AGAIN_S)
    assert paused.any() and set(rows["state"][paused]) == {"unknown"}


def test_the_sleeper_is_in_bed_from_lying_down_to_getting_up(replayed: kg.Results) -> None:
    rows = replayed["presence"].data
    assert rows["onset"][rows["state"] == "in"][0] / NS == pytest.approx(NIGHT.bed_s, abs=15.0)
    assert rows["onset"][rows["state"] == "out"][-1] / NS == pytest.approx(NIGHT.up_s, abs=20.0)
