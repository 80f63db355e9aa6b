"""Nights in a simulated bedroom: the frames show what is known of them; and whole nights through the graph of the depth operators."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.bedside import START, Run, graph, hypnograms, kappa, night
from kinegraph.devices.people.bedroom import BED_MM, FLOOR_MM, Bedroom, Extras
from kinegraph.devices.people.bedside import Bedside, read_stages
from kinegraph.devices.people.night import EPOCH_S, made_up, plan
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import ParameterError
from tests.support.real import needs_data

SMALL = {"width": 96, "height": 72}


def test_a_night_goes_along_its_hypnogram() -> None:
    stages = made_up(6.0, seed=3)
    made = plan(stages, exits=2, seed=3)
    moved = made.moved_s()[10 : 10 + len(stages)]
    assert len(stages) == 720 and set(stages) == {"W", "N1", "N2", "N3", "R"}
    awake = np.array(stages) == "W"
    assert (moved[awake] > 0).mean() > 5 * (moved[~awake] > 0).mean() > 0
    assert len(made.absent) == 4, "the evening, two exits, the morning"
    for leave, back in made.absent[1:-1]:
        assert made.stage(leave) == "W" and 60 < back - leave < 420 and not made.in_bed(leave + 1)
    onsets = [act.onset_s for act in made.acts]
    ends = [act.end_s for act in made.acts]
    assert onsets == sorted(onsets) and all(a < b for a, b in zip(ends, onsets[1:], strict=False)), (
        "they do not overlap"
    )
    assert 11 < made.breaths_per_min(1000, 1030) < 17
    assert plan(stages, exits=2, seed=3).acts == made.acts != plan(stages, exits=2, seed=4).acts


def test_frames_are_functions_of_time_with_the_noise_of_a_kinect() -> None:
    night = plan(made_up(1.0), seed=1)
    one, other = Bedroom(**SMALL, plans=(night,)), Bedroom(**SMALL, plans=(night,))
    late = other.frame(3000, 1500.0)
    frames = np.array([one.frame(k, 100 + k / 30) for k in range(32)])
    assert np.array_equal(one.frame(3000, 1500.0), late)
    assert abs((frames == 0).mean() - 0.1) < 0.03 and len({f.tobytes() for f in frames}) == 32
    seen = (frames > 0).mean(axis=0)
    assert seen.min() > 0.3 and (seen < 1).mean() > 0.8, "other pixels flicker in every frame"
    floor, bed = (np.where(part > 0, part, np.nan) for part in (frames[:, 30:40, 2:8], frames[:, 8:16, 40:56]))
    assert abs(np.nanmean(floor) - FLOOR_MM) < 5 and abs(np.nanmean(bed) - BED_MM) < 5
    assert 2 < np.nanstd(bed) < 8 and len(np.unique(bed[np.isfinite(bed)])) < 8, "depths come in steps of disparity"


def test_what_is_known_to_move_is_seen_moving() -> None:
    night = plan(made_up(2.0), seed=2)
    room = Bedroom(**SMALL, plans=(night,), extras=Extras(pet=False, lamp=False, invalid=0.0, noise=0.0))

    def change(a: float, b: float) -> float:
        return float(np.abs(room.frame(0, a).astype(int) - room.frame(0, b)).max())

    limbs = [act for act in night.acts if act.part not in ("in", "out", "turn")]
    assert all(change(act.onset_s - 0.01, act.onset_s + act.duration_s / 2) > act.size_mm / 2 for act in limbs)
    busy = [(act.onset_s - 1, act.end_s + 1) for act in night.acts]
    still = [s for s in np.arange(400, 7000, 97.3) if not any(a < s < b for a, b in busy)]
    assert len(still) > 30 and max(change(s, s + 2) for s in still) < 25, "breath, in steps of disparity"


def test_who_lies_down_breathes_at_once() -> None:
    night = plan(made_up(1.0), seed=1)
    room = Bedroom(**SMALL, plans=(night,), extras=Extras(pet=False, lamp=False, invalid=0.0))
    chest = [room.frame(k, 310 + k / 5)[22:30, 44:52].astype(float).mean() for k in range(50)]
    before = [room.frame(k, 100 + k / 5)[22:30, 44:52].astype(float).mean() for k in range(50)]
    assert np.std(chest) > 2 > 1 > np.std(before) and min(a.onset_s for a in night.acts[1:]) > 321


def test_a_hypnogram_is_read_from_a_table(tmp_path: Path) -> None:
    path = tmp_path / "stages.csv"
    path.write_text("onset,stage\n0,W\n90,N2\n120,3\n150,R\n", encoding="utf-8")
    assert read_stages(path) == ("W", "W", "W", "N2", "N3", "R")
    path.write_text("onset,stage\n0,?\n30,n2\n", encoding="utf-8")
    assert read_stages(path) == ("W", "N2")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,stage\n0,W\n", "line 2: '0,W' is not an onset"),
        ("onset,stage\n0,W\n30,Q\n", "line 3: '30,Q' is not an onset"),
        ("onset,stage\n0,W\n30\n", "line 3"),
        ("onset,stage\n0,W\n60,N2\n30,N2\n", "line 4: onset is 30 s"),
        ("onset,stage\n0,W\nnan,N2\n", "line 3: onset is nan"),
        ("onset,stage\n0,W\n1e9,N2\n", "at most 24 h"),
        ("onset,stage\n", "no stage"),
    ],
)
def test_a_table_that_is_no_hypnogram_is_refused_before_anything_starts(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "stages.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ParameterError, match=message):
        Bedside(hypnogram=str(path)).specs()
    with pytest.raises(ParameterError, match="cannot be read"):
        Bedside(hypnogram=str(tmp_path / "none.csv")).specs()


def test_an_evening_is_a_time_of_day() -> None:
    with pytest.raises(ParameterError, match="22:30"):
        Bedside(evening="half past ten").specs()


@pytest.mark.parametrize(("late_s", "first"), [(-600.0, 0.0), (0.0, 0.0), (1000.2, 1000.5), (86_400 - 30.0, 86_400.0)])
def test_with_an_evening_a_camera_that_starts_late_goes_on_with_the_night(late_s: float, first: float) -> None:
    text = "width: 32, height: 24, fps: 2, bed_h: 0.3, evening: '20:00'"
    run = Run(graph(text), ["camera.depth", "camera.truth"], START + round(late_s * NS)).run()
    time = (run.time("camera.depth") - START) / NS
    assert time[0] == first and np.allclose(np.diff(time), 0.5)
    assert run["camera.truth"]["onset"][0] == START + round(first // EPOCH_S * EPOCH_S) * NS
    length = 300 + 0.3 * 3600 + 6 + 300
    assert time[-1] - (first if first == 86_400 else 0) == pytest.approx(length, abs=1)


# nights through the graph --------------------------------------------------------------------------------------------


def test_scores_from_frames_agree_with_those_of_the_true_movement() -> None:
    made = night("bed_h: 0.9, seed: 1")
    assert made.agreed >= 0.9 and made.agreed - made.agreed_raw > -0.02
    assert made.unknown <= 5 and made.false == 0 and made.found == made.exits
    assert made.near >= 0.5 * made.still and made.known - made.near <= 0.05 * made.known


@pytest.mark.nightly
def test_what_is_seen_does_not_hang_on_the_frame_rate() -> None:
    """At 12 fps a limb moves less from frame to frame than the noise; and breath is seen."""
    made = night("bed_h: 0.5, seed: 1, fps: 12")
    assert made.agreed >= 0.9 and made.unknown <= 5 and made.near >= 0.5 * made.still


@needs_data
def test_hours_of_a_real_hypnogram_with_two_components(tmp_path: Path) -> None:
    [(_, source)] = hypnograms(tmp_path, 1)
    table = tmp_path / "subj00_stage.csv"
    table.write_text("".join(table.read_text(encoding="utf-8").splitlines(keepends=True)[:421]), encoding="utf-8")
    made = night(f"{source}, fps: 1", components=2)
    assert made.epochs == 420 and made.unknown <= 5
    assert made.agreed >= 0.9 and abs(made.agreed - made.agreed_raw) < 0.02
    assert made.found == made.exits and not made.false
    assert made.near >= 0.5 * made.still


def test_faults_of_the_camera_are_not_scored() -> None:
    """The picture freezes for 5 min, no pixel is valid for 5 min, the camera is gone for 10 min."""
    faults = "faults: [[frozen, 900, 300], [blind, 1500, 300], [gone, 2100, 600]]"
    run = Run(
        graph(f"bed_h: 0.8, seed: 2, {faults}"), ["scorer", "presence", "activity", "camera.truth", "breathing"]
    ).run()
    finals = run["scorer"][run["scorer"]["final"]]
    seconds = (finals["onset"] - START) / NS
    for begin, length in ((900, 300), (1500, 300), (2100, 600)):
        inside = (seconds >= begin) & (seconds < begin + length)
        assert inside.sum() == length / EPOCH_S and np.isnan(finals["activity"][inside]).all()
        deep = inside & (seconds >= begin + 60) & (seconds < begin + length - 60)
        assert (finals["state"][deep] == "unknown").all()
    rates = run["breathing"]
    at = (rates["onset"] - START) / NS
    unseen = (at >= 900) & (at < 1200) | (at >= 1500) & (at < 1800)
    assert unseen.sum() == 20 and np.isnan(rates["rate"][unseen]).all()
    states = [(str(e["state"]), round((int(e["onset"]) - START) / NS)) for e in run["presence"]]
    assert [state for state, _ in states] == ["out", "in", *["unknown", "in"] * 3, "out", "unknown"]
    assert [second for _, second in states[2:8]] == [900, 1200, 1500, 1800, 2100, 2700]


def test_two_sleepers_are_told_apart() -> None:
    text = "bed_h: 0.6, seed: 4, sleepers: 2, width: 192, height: 120"
    halves = "[[8, 32, 104, 64], [8, 96, 104, 64]]"
    run = Run(
        graph(text, sleepers="[left, right]", regions=halves), ["activity.epochs", "presence", "camera.truth"]
    ).run()
    epochs, truth = run["activity.epochs"], run["camera.truth"]
    for k, name in enumerate(("left", "right")):
        mine, true = epochs[epochs["sleeper"] == name], truth[truth["sleeper"] == k]
        n = min(len(mine), len(true))
        both = (mine["bed"][:n] == "in") & np.isfinite(mine["moved_s"][:n]) & (true["in_bed_s"][:n] == EPOCH_S)
        assert both.sum() > 60
        own = both & (mine["crosstalk"][:n] < 0.5)
        assert own.sum() > 0.8 * both.sum()
        assert kappa(mine["moved_s"][:n][own] >= 1, true["moved_s"][:n][own] >= 1) > 0.8
    leaving = [(str(e["sleeper"]), str(e["state"])) for e in run["presence"]]
    assert leaving.count(("left", "in")) == leaving.count(("right", "in")) == 1
