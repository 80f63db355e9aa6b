"""Cameras that start late, drift, lose USB every minute or change their resolution: what was not seen is not scored. Epochs that cannot be.

A picture that freezes, pixels that are all invalid and a camera that is gone: tests/sleep/test_bedside.py. A broker that comes and goes:
tests/outlets/test_mqtt.py. A full disk: tests/sleep/test_night_log.py. A clock that is set back: tests/sleep/test_bedside_night.py.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.bedside import KEPT, RAW, START, Agreement, Run, agreement, graph
from kinegraph.devices.oak.adapter import Frames, Message
from kinegraph.devices.people.bedside import Bedside
from kinegraph.devices.people.night import EPOCH_S
from kinegraph.devices.reports.night import archive
from kinegraph.devices.reports.night.numbers import quality
from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.engine import supervisor
from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.status import Outcome
from kinegraph.stream.errors import GraphError
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.operator import grid
from tests.sleep.depth_frames import frames_spec
from tests.sleep.failing_camera import BEGUN, FailingCamera
from tests.support.tiers import rest_nightly

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
NIGHT = """
  nights: {use: operators.sleep.nights.Nights, from: {bed: presence}, shortest_h: 0.1}
  statistics: {use: operators.sleep.statistics.SleepStatistics, from: {epochs: scorer, periods: nights}}
  log:
    use: devices.reports.night.NightLog
    from: {epochs: scorer, nights: statistics, bed: presence, seen: activity.epochs}
    path: PATH
    timezone: UTC
    report: false
"""


def held(source: str) -> tuple[Run, Agreement]:
    run = Run(graph(source, more=RAW), KEPT).run()
    return run, agreement(run)


def finals(run: Run) -> tuple[Array, Array]:
    """(s since the beginning, events) of all final epochs."""
    events = run["scorer"][run["scorer"]["final"]]
    return (events["onset"] - START) / NS, events


# USB that is lost every minute ---------------------------------------------------------------------------------------


def lost_every_minute(seconds: float, minutes: int = 58) -> str:
    return f"faults: {[['gone', 70 + 60 * k, seconds] for k in range(minutes)]}".replace("'", "")


def test_a_camera_that_is_lost_for_a_moment_every_minute_still_tells_the_night() -> None:
    run, made = held(f"bed_h: 0.9, seed: 1, {lost_every_minute(6)}")
    assert made.agreed >= 0.9 and made.unknown <= 5 and made.false == 0 and made.found == made.exits
    seen = run["activity.epochs"]["seen"]
    assert 0.75 < seen[4:-4].min() < 0.85 and seen.max() == 1.0, "every other epoch lacks 6 s, and says so"
    assert [str(e["state"]) for e in run["presence"]].count("unknown") == 1, "at the end"


def test_of_epochs_that_were_hardly_seen_nothing_is_said() -> None:
    run, made = held(f"bed_h: 0.9, seed: 1, {lost_every_minute(20)}")
    at, events = finals(run)
    lost = np.isin(at % 60, 0 if (START // NS) % 60 == 0 else 30) & (at >= 60) & (at < 58 * 60)
    states = {str(state) for state in events["state"][lost]}
    assert np.isnan(events["activity"][lost]).all() and states == {"unknown"}, "10 of 30 s were seen"
    assert made.unknown >= 50 and made.agreed >= 0.85


# sessions with a camera that fails -----------------------------------------------------------------------------------


def night_of(
    camera: FailingCamera, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[Outcome, archive.Facts, archive.LoggedEpochs]:
    """A whole session with the night's log; the supervisor does not wait long before it opens the camera again."""
    monkeypatch.setattr(supervisor, "FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(supervisor, "LONGEST_PAUSE_S", 0.01)
    made = graph("bed_h: 0.4", more=NIGHT.replace("PATH", str(folder / "nights")))
    made.nodes["camera"].part = camera
    outcome = Session(made, folder / "session").run()
    ((path, facts),) = archive.nights(folder / "nights")
    return outcome, facts, archive.read_epochs(path)


@pytest.mark.nightly
def test_usb_that_fails_every_minute_is_opened_every_time_and_no_epoch_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    losses = tuple((100.0 + 60 * k, 104.0 + 60 * k, "unplugged") for k in range(25))
    outcome, facts, epochs = night_of(FailingCamera(Bedside(bed_h=0.4, seed=1), losses), tmp_path, monkeypatch)  # type: ignore[arg-type]
    assert outcome.error is None and outcome.table["camera.depth"]["openings"] == 26
    assert set(np.diff(epochs.onset)) == {30 * NS} and (epochs.texts["state"] == "unknown").sum() <= 6
    assert 0.8 < np.nanmin(epochs.numbers["seen"][1:-1]) < 0.9 and facts.closed
    bed = epochs.texts["bed"]
    assert (bed[: int((facts.numbers["end"] - epochs.onset[0]) / NS / 30)] == "in").all(), "the bed was left"


@pytest.mark.nightly
def test_a_camera_that_changes_its_resolution_is_an_error_of_the_camera_and_no_movement(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = FailingCamera(Bedside(bed_h=0.4, seed=1), ((900.0, 1200.0, "size"),))
    outcome, facts, epochs = night_of(camera, tmp_path, monkeypatch)
    assert outcome.error is None and outcome.table["camera.depth"]["openings"] == 2
    assert "write width: 160 and height: 112" in capsys.readouterr().out
    at = (epochs.onset - BEGUN) / NS
    within = (at >= 900) & (at + EPOCH_S <= 1200)
    assert within.sum() == 10 and (epochs.texts["state"][within] == "unknown").all()
    assert np.isnan(epochs.numbers["activity"][within]).all()
    assert (epochs.texts["state"][at >= 1290][:10] != "unknown").all(), "the night goes on"
    assert "20:15–20:20 (5 min)" in dict(quality(facts, epochs))["Not scored"]


# clocks, and cameras that come late ----------------------------------------------------------------------------------


@pytest.mark.parametrize("ppm", rest_nightly(-300, 300))
def test_a_camera_whose_clock_drifts_loses_and_doubles_no_epoch(ppm: int) -> None:
    run, made = held(f"bed_h: 0.9, seed: 1, drift_ppm: {ppm}")
    at, _ = finals(run)
    assert set(np.diff(at)) == {30.0} and made.agreed >= 0.9 and made.unknown <= 5
    assert run["activity.epochs"]["seen"][1:-1].min() > 0.97


def test_stamps_of_a_clock_that_runs_away_stay_with_their_arrival() -> None:
    """1000 ppm fast for an hour: depthai no longer keeps the clocks in step."""
    frames = Frames(frames_spec(4, 6), BEGUN)
    rows = np.random.default_rng(1).integers(1, 200, (2, 4, 12)).astype(np.uint8)
    arrivals = BEGUN + grid(1.0, 3600, 0)
    stamps, wrong = [], 0
    for k, arrival in enumerate(arrivals.tolist()):
        host = round((arrival - BEGUN) * 1.001)
        taken = frames.take(Message(k, host, host, 6, rows[k % 2]), arrival)
        assert taken.chunk
        stamps.append(int(taken.chunk.time[0]))
        wrong += "wrong time" in taken.problems
    ahead = np.array(stamps) - arrivals
    assert (np.diff(stamps) > 0).all() and ahead.max() < 50_000_000 and ahead[-1] == 0 and wrong == 3550


def test_a_camera_that_starts_in_the_middle_of_the_night_tells_what_it_saw() -> None:
    source = "bed_h: 1.2, seed: 1, evening: '20:00', morning_min: 8, exits: 0"
    late_s, up_s = 2500.0, 300 + 1.2 * 3600
    made = graph(source, regions="[[6, 45, 108, 70]]")
    run = Run(made, ("scorer", "presence"), START + round(late_s * NS)).run()
    at, events = finals(run)
    assert at[0] == late_s // EPOCH_S * EPOCH_S, "no report of the time before"
    assert "unknown" in events["state"][:4] and (events["state"][8:60] != "unknown").all()
    bed = [(str(e["state"]), round((int(e["onset"]) - START) / NS)) for e in run["presence"]]
    assert [state for state, _ in bed] == ["in", "out", "unknown"] and bed[0][1] >= late_s
    assert abs(bed[1][1] - up_s) < 60, "though it has never seen the empty bed before"


# epochs that cannot be -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("activity.epoch_s", 0, "must be above 0"),
        ("activity.epoch_s", -30, "must be above 0"),
        ("activity.epoch_s", math.nan, "finite"),
        ("activity.epoch_s", 1e12, "at most 3600"),
        ("activity.epoch_s", 1, "at least 2 .four frames"),
        ("activity.epoch_s", 45, "epochs of 45 s; it must be in epochs of 30 s for thesis"),
        ("motion.epoch_s", 1e6, "at most 30000"),
        ("motion.epoch_s", 60, "epoch_s 60.0 in both nodes"),
        ("breathing.epoch_s", 60, "epochs of 30 s"),
        ("scorer.method", "sadeh", "in epochs of 60 s for sadeh"),
        ("statistics.convention", "ours", "AASM"),
    ],
)
def test_a_config_with_epochs_that_cannot_be_is_refused(name: str, value: Any, words: str) -> None:
    with pytest.raises(GraphError, match=words):
        load(CONFIGS / "bedside_simulated.yaml", overrides={name: value})
