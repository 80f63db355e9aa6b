"""Limbs as a dimension: two legs in one graph, each as it would be alone; footfalls and gaits; symmetry; stages; one report."""

from __future__ import annotations

import csv
import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from kinegraph.devices.people.treadmill import Treadmill
from kinegraph.devices.people.treadmill.both_legs import plates
from kinegraph.operators.contacts.limb_contacts import LIMB_CONTACT, LimbContacts
from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.operators.cycles.limb_cycles import LimbCycles, some_limbs
from kinegraph.operators.cycles.review import CycleReview
from kinegraph.operators.cycles.stages import ProtocolStage, Stages
from kinegraph.operators.cycles.statistics.operator import CycleStatistics
from kinegraph.operators.cycles.statistics.symmetry import LimbSymmetry
from kinegraph.operators.strides.footfalls import Footfalls
from kinegraph.operators.strides.gait_name import gait_name
from kinegraph.stream.chunk import NS, StreamSpec, grid
from kinegraph.stream.errors import InputError, ParameterError
from tests.support.emg_run import drive, stamps
from tests.support.real import needs_data

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "treadmill_both_legs.yaml"
DATA = os.environ.get("KINEGRAPH_DATA", "")
SIDES = {"left": "L_*", "right": "R_*"}
WALK = Treadmill(muscles=("TA", "SO"), legs="both", left_share=0.8, plate_drift_n_per_min=60.0, cross_talk_pct=5.0)
PLAN = (
    "stages.protocol=[{stage: warm-up, for_s: 10, speed_m_s: 0.8}, {stage: 1.2 m/s, cycles: 16, say: faster}, "
    "{stage: 1.5 m/s, cycles: 16}]"
)
DOG = {"left hind": 19, "right hind": 23, "left fore": 10, "right fore": 15}


def walked(seconds: int, drift: float = WALK.plate_drift_n_per_min) -> dict[str, Any]:
    """Both legs' signal and contacts from the belts' forces, with drift (N/min) and cross-talk."""
    both, n = WALK.both(), seconds * 1000
    emg, force = both.read(0, n)
    loads = plates(force, np.arange(n) / 1000, drift, WALK.cross_talk_pct)
    spec = StreamSpec((2,), rate_hz=1000.0, channels=("Fz_left", "Fz_right"), units=("N",))
    limbs = {
        "left": {"channels": ["Fz_left"], "other": ["Fz_right"]},
        "right": {"channels": ["Fz_right"], "other": ["Fz_left"]},
    }
    feet = drive(LimbContacts("force", limbs), {"in": (spec, stamps(n), loads)}, 100)
    envelope = np.abs(emg[::10])
    channels = ("L_TA", "L_SO", "R_TA", "R_SO")
    signal = StreamSpec((4,), rate_hz=100.0, channels=channels, units=("uV",))
    return {"signal": (signal, stamps(n // 10, 100.0), envelope), **{k: feet[k] for k in ("touchdown", "liftoff")}}


@pytest.fixture(scope="module")
def walk() -> dict[str, Any]:
    return walked(40)


def test_each_limb_is_cut_as_it_would_be_alone() -> None:
    given = some_limbs(3)
    found = drive(LimbCycles(SIDES), given, 7)
    spec, time, curves = found["cycles"]
    closed = found["closed"][2]
    assert len(set(closed["number"].tolist())) == len(closed) and set(closed["limb"]) == {"left", "right"}
    for i, (limb, mine) in enumerate((("left", ["L_TA", "L_SO", "ES"]), ("right", ["R_TA", "R_SO"]))):
        places = [spec.channels.index(name) for name in mine]
        signal, at, data = given["signal"]
        alone = {"signal": (signal.derive(shape=(len(mine),), channels=tuple(mine)), at, data[:, places])}
        for port in ("touchdown", "liftoff"):
            contact, when, rows = given[port]
            here = rows["limb"] == limb
            alone[port] = (contact, when[here], rows[here])
        single = drive(Cycles(), alone, 11)
        here = np.isfinite(curves[:, 0, places[0]])
        assert here.sum() > 5 and np.array_equal(curves[here][:, :, places], single["cycles"][2])
        assert np.array_equal(time[here], single["cycles"][1])
        rows = closed[closed["limb"] == limb]
        assert rows["number"].tolist() == [2 * (n - 1) + i + 1 for n in single["closed"][2]["number"]]
        for name in ("onset", "end", "duration_s", "stance_pct", "rejected"):
            assert np.array_equal(rows[name], single["closed"][2][name], equal_nan=name == "stance_pct"), name
    assert spec.meta["muscles"] == {"L_TA": "TA", "R_TA": "TA", "L_SO": "SO", "R_SO": "SO", "ES": "ES"}


@pytest.mark.parametrize(
    ("seconds", "drift"), [(40, 60.0), (80, 100.0)], ids=["40 N", "133 N, more than an offset may have"]
)
def test_drifting_plates_of_two_belts_lose_no_contact(walk: dict[str, Any], seconds: int, drift: float) -> None:
    _, _, rows = (walk if seconds == 40 else walked(seconds, drift))["touchdown"]
    end = seconds - 0.2
    true, sides = WALK.both().contacts("touchdown", 0, round(1000 * end))
    for side in ("left", "right"):
        truth = true[np.array(sides) == side] / 1000
        found = rows["onset"][rows["limb"] == side] / NS
        found = found[found < end]
        assert len(found) == len(truth) - (truth[0] < 0.2) or len(found) == len(truth), side
        assert np.abs(found - truth[-len(found) :]).max() < 0.01


def test_footfalls_are_the_simulated_ones(walk: dict[str, Any]) -> None:
    contacts = {port: walk[port] for port in ("touchdown", "liftoff")}
    found = drive(Footfalls(reference="left"), contacts, 3)
    limbs, gait = found["limbs"][2].reshape(-1, 2), found["gait"][2]
    touch = walk["touchdown"][2]
    left, right = (touch["onset"][touch["limb"] == side] for side in ("left", "right"))
    for (_, other), stride in zip(limbs, gait, strict=True):
        inside = right[(right >= stride["onset"]) & (right < stride["end"])]
        assert len(inside) == 1
        expected = 100 * (inside[0] - stride["onset"]) / (stride["end"] - stride["onset"])
        assert abs(other["phase_pct"] - expected) < 1e-9
    assert len(gait) == len(left) - 1 and set(gait["gait"]) == {"walk"}
    assert abs(np.nanmean(limbs["duty_pct"]) - 63) < 1.0
    assert np.nanmax(np.abs(gait["double_support_pct"] - (limbs["duty_pct"].sum(axis=1) - 100))) < 1e-6


@pytest.mark.parametrize(
    ("phase", "duty", "tolerance", "name"),
    [
        ((0, 50, 75, 25), 65, 12.5, "walk"), ((0, 50, 25, 75), 65, 12.5, "walk"), ((0, 50, 50, 0), 42, 12.5, "trot"),
        ((0, 52, 2, 51), 60, 12.5, "pace"), ((0, 15, 60, 75), 40, 12.5, "gallop"),
        ((0, 15, 60, 75), 60, 12.5, "unknown"), ((0, 50, 25, 75), 45, 12.5, "unknown"), ((0, 50, 37, 87), 60, 12.5, "unknown"),
        ((0, 50, 19.5, 69.5), 60, 20.0, "unknown"), ((0, 50, 20.5, 70.5), 60, 20.0, "walk"),
    ],
)  # fmt: skip
def test_gaits_of_four_hooves_are_named(phase: tuple[float, ...], duty: int, tolerance: float, name: str) -> None:
    """In the last two what is allowed of a pace and of a walk overlaps; at the end of a pace it is neither for sure."""
    hooves = ("left hind", "right hind", "left fore", "right fore")
    assert gait_name(hooves, np.array(phase, float), np.full(4, float(duty)), 0.0, tolerance)[0] == name


@needs_data
def test_real_dogs_pace_trot_and_gallop() -> None:
    """Four paws from markers; what the clips are called says walk or run only, and both dogs that walk do so in a pace."""
    clips = np.load(Path(DATA) / "steering" / "dog_mocap_joints.npz")
    named = {}
    for clip in ("dog_walk00", "dog_run00", "dog_run04"):
        joints = clips[clip].astype(float)
        spec = StreamSpec((27, 3), rate_hz=60.0, channels=tuple(f"j{i}" for i in range(27)), units=("m",))
        paws = {limb: {"marker": f"j{i}"} for limb, i in DOG.items()}
        detector = LimbContacts("marker", paws, {"up": "y", "reference": "j0"})
        feet = drive(detector, {"in": (spec, grid(60.0, len(joints)), joints)}, 50)
        found = drive(Footfalls(), {port: feet[port] for port in ("touchdown", "liftoff")}, 20)
        named[clip] = Counter(found["gait"][2]["gait"].tolist())
    assert named["dog_walk00"] == {"pace": 12}
    assert named["dog_run00"]["gallop"] == 3 and set(named["dog_run00"]) == {"gallop", "unknown"}
    assert named["dog_run04"]["trot"] == 4 and not {"gallop", "pace"} & set(named["dog_run04"])


def test_the_symmetry_index_agrees_with_a_slow_computation(walk: dict[str, Any]) -> None:
    cycles = drive(LimbCycles(SIDES), walk, 50)
    both = {name: cycles[name] for name in ("closed", "cycles")}
    statistics = drive(CycleStatistics(), both, 5)["out"]
    rows = drive(LimbSymmetry(), {"closed": cycles["closed"], "statistics": statistics}, 4)["out"][2]
    closed = {int(row["number"]): row for row in cycles["closed"][2] if not row["rejected"]}
    peaks = {(int(row["number"]), str(row["name"])): float(row["peak"]) for row in statistics[2]}
    indices = []
    for row in rows[(rows["name"] == "TA") & (rows["measure"] == "peak")]:
        mine = closed[int(row["number"])]
        others = [r for r in closed.values() if r["limb"] == "left" and r["onset"] < mine["onset"]]
        near = max(others, key=lambda r: int(r["onset"]))
        left, right = peaks[(int(near["number"]), "L_TA")], peaks[(int(mine["number"]), "R_TA")]
        indices.append(200 * (right - left) / (right + left))
        assert abs(row["index_pct"] - indices[-1]) < 1e-9 and row["pairs"] == len(indices)
        assert abs(row["mean_pct"] - np.mean(indices)) < 1e-9
        if len(indices) > 2:
            low, high = stats.t.interval(0.95, len(indices) - 1, np.mean(indices), stats.sem(indices))
            assert abs(row["low_pct"] - low) < 1e-9 and abs(row["high_pct"] - high) < 1e-9
    assert len(indices) > 25


def test_a_cycle_that_is_left_out_leaves_the_symmetry() -> None:
    text = np.dtype([("onset", "<i8"), ("text", "U64")])
    made = walked(20)
    cycles = drive(LimbCycles(SIDES), made, 50)
    notes_in = (StreamSpec((), text), np.array([15 * NS]), np.array([(0, "leave out 11")], text))
    given = {"annotations": notes_in, **{name: cycles[name] for name in ("closed", "cycles")}}
    last = []
    nothing = (notes_in[0], notes_in[1][:0], notes_in[2][:0])
    for review, notes in ((CycleReview(), notes_in), (CycleReview(left_out=("11",)), nothing)):
        reviewed = drive(review, {**given, "annotations": notes}, 5)
        both = {name: reviewed[name] for name in ("closed", "cycles")}
        statistics = drive(CycleStatistics(), both, 5)["out"]
        rows = drive(LimbSymmetry(), {"closed": both["closed"], "statistics": statistics}, 5)["out"][2]
        last.append(rows[rows["measure"] == "duration_s"][-1])
    assert last[0]["pairs"] == last[1]["pairs"] and abs(last[0]["mean_pct"] - last[1]["mean_pct"]) < 1e-9


def test_stages_by_protocol_annotation_and_measured_speed() -> None:
    from kinegraph.operators.cycles.cycle import CLOSED

    onset = NS + np.arange(30) * NS
    rows = np.zeros(30, CLOSED)
    rows["onset"], rows["end"], rows["number"] = onset, onset + NS, np.arange(1, 31)
    text = np.dtype([("onset", "<i8"), ("text", "U64")])
    inputs = {
        "signal": (StreamSpec((1,), rate_hz=10.0), grid(10.0, 320), np.zeros((320, 1))),
        "speed": (StreamSpec((1,), units=("km/h",)), onset[:4] + 1, np.full((4, 1), 3.6)),
        "annotations": (StreamSpec((), text), np.array([25 * NS]), np.array([(0, "stage 1.5 m/s")], text)),
        "closed": (StreamSpec((), CLOSED, units=("",)), onset + NS + 1, rows),
    }
    plan = (
        ProtocolStage("warm-up", for_s=5.5, speed_m_s=0.8),
        ProtocolStage("fast", cycles=6, speed_m_s=1.6, say="faster"),
    )
    found = drive(Stages(plan), inputs, 4)
    began = found["stages"][2]
    assert began["stage"].tolist() == ["warm-up", "fast", "", "1.5 m/s"]
    assert began["onset"].tolist() == [NS, round(6.5 * NS), 13 * NS + 1, 25 * NS]
    assert began["cycles"].tolist() == [0, 5, 6, 10]
    closed = found["closed"][2]
    assert closed["stage"].tolist()[:12] == ["warm-up"] * 5 + [""] + ["fast"] * 6
    assert closed["stage"].tolist()[12:] == [""] * 12 + ["1.5 m/s"] * 6
    assert np.allclose(closed["speed_m_s"][:12], [1.0] * 4 + [0.8, np.nan] + [1.6] * 6, equal_nan=True)
    assert closed["speed_m_s"][-1] == 1.5
    with pytest.raises(InputError, match="its first sample begins it"):
        Stages(plan).open({"closed": inputs["closed"][0]})


def test_a_stage_that_is_paused_keeps_its_time_and_its_cycles() -> None:
    from kinegraph.operators.cycles.cycle import CLOSED

    onset = NS + np.arange(40) * NS
    rows = np.zeros(40, CLOSED)
    rows["onset"], rows["end"], rows["number"] = onset, onset + NS, np.arange(1, 41)
    text = np.dtype([("onset", "<i8"), ("text", "U64")])
    notes = np.array([(0, "pause stage"), (0, "resume stage"), (0, "pause stage"), (0, "resume stage")], text)
    inputs = {
        "signal": (StreamSpec((1,), rate_hz=10.0), grid(10.0, 420), np.zeros((420, 1))),
        "annotations": (StreamSpec((), text), (np.array([3.5, 8.5, 20.5, 24.5]) * NS).astype(np.int64), notes),
        "closed": (StreamSpec((), CLOSED, units=("",)), onset + NS + 1, rows),
    }
    plan = (ProtocolStage("slow", for_s=10, speed_m_s=0.8), ProtocolStage("fast", cycles=9, speed_m_s=1.6))
    found = drive(Stages(plan), inputs, 4)
    began, closed = found["stages"][2], found["closed"][2]
    assert began["stage"].tolist() == ["slow", "", "slow", "fast", "", "fast", ""]
    assert began["onset"][3] == NS + 15 * NS, "10 s of slow walking, and 5 s of pause"
    assert began["cycles"].tolist()[4:] == [4, 4, 9]
    assert closed["stage"].tolist()[:2] == ["slow"] * 2 and set(closed["stage"][3:7].tolist()) == {""}
    assert closed["speed_m_s"][9] == 0.8, "its speed is known again"


def test_limbs_that_fit_no_channel_are_refused() -> None:
    specs = {port: given[0] for port, given in some_limbs(1).items()}
    with pytest.raises(ParameterError, match="X_"):
        LimbCycles({"left": "L_*", "right": "X_*"}).open(specs)
    bare = StreamSpec((), np.dtype([("onset", "<i8")]), units=("ns",))
    with pytest.raises(InputError, match="LimbContacts"):
        LimbCycles(SIDES).open({**specs, "touchdown": bare})
    assert LIMB_CONTACT.names == ("onset", "limb")


def kinegraph(*arguments: str | Path) -> str:
    command = [str(Path(sys.executable).parent / "kinegraph"), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The shipped graph with an electrode that falls off, faster than real time, and what it printed."""
    folder = tmp_path_factory.mktemp("both")
    faults = "treadmill.faults=[{kind: flat, muscle: L_SO, from_s: 20, for_s: 10}]"
    quick = ["treadmill.realtime=false", "treadmill.duration_s=32", f"report.path={folder / 'live.html'}", faults, PLAN]
    sets = [part for setting in quick for part in ("--set", setting)]
    return folder, kinegraph("run", CONFIG, *sets, "-o", folder / "rec", "--view", "lines")


@pytest.mark.nightly
def test_the_bilateral_session_from_end_to_end(session: tuple[Path, str]) -> None:
    """Drifting plates, three stages, one electrode off: reported, no good cycle lost, and the table's means are those of its own rows."""
    folder, shown = session
    assert "ALARM L_SO: flat line" in shown and "stage 2: 1.2 m/s" in shown and "faster" in shown
    with (folder / "live.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["limb"] for row in rows} == {"left", "right"} and not any(row["rejected"] for row in rows)
    true, sides = WALK.both().contacts("touchdown", 0, 31_500)
    for side in ("left", "right"):
        starts = true[np.array(sides) == side]
        assert sum(row["limb"] == side for row in rows) >= len(starts) - 2
    page = (folder / "live.html").read_text()
    for words in ("Limb by limb", "Footfalls", "Symmetry", "Stage by stage", "Robinson", "strides/min", "walk"):
        assert words in page, words
    assert "left out of" in page and page.count("TA, left and right") == 1
    fast = [float(row["R_TA peak (uV)"]) for row in rows if row["stage"] == "1.2 m/s" and row["limb"] == "right"]
    cell = f"{np.mean(fast):.1f} ± {np.std(fast, ddof=1):.1f}"
    assert cell in re.sub(r"<[^>]*>", "", page)
    with (folder / "live-curves.csv").open(newline="") as file:
        curves = [row for row in csv.DictReader(file) if row["stage"] == "1.2 m/s" and row["muscle"] == "R_TA"]
    assert len(curves) == 100 and int(curves[0]["cycles"]) == len(fast)


@pytest.mark.nightly
def test_the_bilateral_session_replays_to_the_same(session: tuple[Path, str]) -> None:
    kinegraph("replay", CONFIG, session[0] / "rec", "--set", PLAN, "--verify", "-q")
