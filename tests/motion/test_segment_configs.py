"""The configurations that segment muscles and a Kinect's skeleton, run as they stand; and the simulated person they run on."""

import os
from pathlib import Path

import numpy as np
import pytest
from structlog.testing import capture_logs

from bench.motion import Series
from bench.sensors import told_by
from kinegraph.devices.people.exerciser import EXERCISES, JOINTS, Exerciser, Routine, skeleton
from kinegraph.operators.segmentation.evaluation.found import read_found
from kinegraph.operators.segmentation.evaluation.scores import score
from kinegraph.operators.segmentation.evaluation.truth import Truth, read_truth
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.graph.reading.load import read_expanded
from kinegraph.stream.recording import Recording
from tests.support.command_line import call_command, succeeding
from tests.support.real import needs_data, real_file

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
DATA = Path(os.environ.get("KINEGRAPH_DATA", "/nowhere"))


def kinegraph(*arguments):
    with succeeding():
        call_command(*arguments)


SEGMENT = ["count_repetitions", "segment_emg", "segment_emg_acc", "segment_imu", "segment_kinect", "segment_mocap"]
SHOWN_BY = {
    "devices.outlets.terminal.exercise_panel.ExercisePanel",
    "devices.reports.training.TrainingReport",
    "devices.lsl.LslOutlet",
    "devices.mqtt.MqttOutlet",
    "operators.segmentation.names.naming.NameRepetitions",
    "stream.manual.Annotations",
}


@pytest.mark.parametrize("name", SEGMENT)
def test_the_configurations_show_name_report_and_pass_on_what_is_found(name):
    graph = read_expanded(CONFIGS / f"{name}.yaml").plain()
    assert {what["use"] for what in graph["nodes"].values()} >= SHOWN_BY
    assert "repetitions.named.repetition" in graph["record"]


@pytest.mark.parametrize("name", SEGMENT)
def test_the_configurations_record_what_is_believed_as_well_as_what_is_final(name):
    graph = read_expanded(CONFIGS / f"{name}.yaml").plain()
    (node,) = [n for n, what in graph["nodes"].items() if what["use"] == "operators.segmentation.Segment"]
    outputs = ("activity", "primitive", "count", "provisional", "rest")
    assert {f"{node}.{output}" for output in outputs} <= set(graph["record"])


def test_the_simulated_person_is_the_same_whoever_asks_and_moves_smoothly():
    one, other = Routine(Exerciser(noise_mm=0.0)), Routine(Exerciser(noise_mm=0.0))
    later = other.joints(900)
    frames = np.array([one.joints(i) for i in range(901)])
    assert np.array_equal(frames[900], later) and frames.shape == (901, 20, 3)
    one.starts(3000)
    assert max(np.size(value) for value in vars(one).values()) < 10, "what is over is not remembered"
    assert np.array_equal(one.joints(3), frames[3])
    assert np.abs(np.diff(frames, axis=0)).max() < 0.15
    for exercise in EXERCISES:
        assert (
            np.allclose(skeleton(exercise, 0.0), skeleton("arms", 0.0)) and np.isfinite(skeleton(exercise, 0.4)).all()
        )
    at = {joint: frames[0, i] for i, joint in enumerate(JOINTS)}
    assert at["head"][1] > at["hip_center"][1] > at["ankle_l"][1] and at["wrist_l"][0] < at["wrist_r"][0]


def test_muscles_of_a_simulated_walk_repeat_once_a_stride(tmp_path):
    fast = ("--set", "board.realtime=false", "--set", "board.duration_s=25", "--set", f"report.path={tmp_path}/r.html")
    kinegraph("run", CONFIGS / "segment_emg.yaml", *fast, "--view", "none", "-o", tmp_path / "walk")
    found = read_found(tmp_path / "walk")
    strides = np.diff(found.primitives[found.repetition > 0], axis=1)
    assert len(strides) >= 8 and 0.9 < np.median(strides) < 1.3


def test_exercises_of_a_simulated_person_are_told_apart_by_their_symmetry(tmp_path):
    fast = ("--set", "mocap.realtime=false", "--set", "mocap.duration_s=65", "--set", f"report.path={tmp_path}/r.html")
    kinegraph("run", CONFIGS / "segment_mocap.yaml", *fast, "--view", "none", "-o", tmp_path / "move")
    with Recording.open(next(tmp_path.glob("move*"))) as recording:
        segmented = {
            name: np.concatenate([entry[0].data for entry in recording.entries(f"segment.{name}")])
            for name in ("activity", "primitive")
        }
        zero = min(s.first for s in recording.streams.values() if s.role == "input" and s.first is not None)
    routine, expected = Routine(Exerciser()), {"arms": 1, "squat": 1, "knees": 2, "wave": 3}
    for number, exercise in enumerate(EXERCISES):
        starts = routine.starts(number) * 1e9 + zero
        actions, parts = (
            e[(e["onset"] < starts[-1]) & (e["end"] > starts[0]) & (e["cluster"] >= 0)] for e in segmented.values()
        )
        done = [a["symmetry"] for a in actions if starts[0] < (a["onset"] + a["end"]) / 2 < starts[-1]]
        assert done == [expected[exercise]]
        steps = parts[parts["side"] > 0]
        assert (len(steps) >= 8) == (exercise == "knees")
        wrong = 0
        for step in steps[steps["onset"] >= starts[0]]:
            times = np.linspace(step["onset"], min(step["end"], starts[-1]), 20)
            share = np.interp(times, starts, np.arange(len(starts))) % 1.0
            wrong += (np.sin(2 * np.pi * share).sum() > 0) != (step["side"] == 1)  # the left knee is raised first
        assert not wrong


@pytest.mark.parametrize("each", ["frame", "joint"])
@pytest.mark.parametrize(("config", "source"), [("segment_kinect", "kinect"), ("segment_mocap", "mocap")])
def test_what_is_lost_one_by_one_is_filled_in_and_costs_no_repetition(config, source, each):
    """With a fifth of the frames NaN 10, 21 and 12 repetitions were counted of ten each: nothing filled them in. With a fifth of each
    joint's values half of the frames lack the root or a hip, and had no pose: joints are filled in before it is made of them."""
    routine = Routine(Exerciser(seed=4, exercises=("arms", "squat", "knees"), repetitions=10, pause_s=4.0))
    x = np.array([routine.joints(i) for i in range(round(30 * (routine.starts(2)[-1] + 3.0)))])
    x[np.random.default_rng(1004).random(len(x) if each == "frame" else x.shape[:2]) < 0.2] = np.nan
    spec = StreamSpec((20, 3), channels=JOINTS, units=("m",))
    segmented = told_by(config, source, Series(spec, np.arange(len(x)) * NS // 30, x))
    counted = segmented["primitive"][segmented["primitive"]["repetition"] > 0]
    middle = (counted["onset"] + counted["end"]) / 2 / NS
    for number in range(3):
        begins, ends = routine.starts(number)[[0, -1]]
        inside = counted[(middle > begins - 1.0) & (middle < ends + 1.0)]
        assert (
            len(set(inside["repetition"].tolist()))
            == len(set(zip(inside["activity"], inside["repetition"], strict=True)))
            == 10
        )


def test_muscles_of_a_real_treadmill_walk_repeat_with_every_touchdown(tmp_path):
    file = real_file("emg/emg_santuz_tw12.npz")
    source = ("--stream", "board.emg=emg_uV", "--time", "t_s", "--names", "names", "--unit", "uV")
    kinegraph("files", "import", file, "-o", tmp_path / "walk.mcap", *source)
    kinegraph("replay", CONFIGS / "segment_emg.yaml", tmp_path / "walk.mcap", "-q", "-o", tmp_path / "out.mcap")
    with np.load(file) as archive:
        keys = archive["touchdown_s"] - archive["t_s"][0]
    empty = np.empty(0)
    scores = score(read_found(tmp_path / "out.mcap"), Truth(empty, empty, [], empty, keys))
    assert scores.repetitions <= 1 and scores.key_sd <= 0.05


@needs_data
def test_a_real_kinect_recording_is_counted(tmp_path):
    file = DATA / "segmentation" / "msrc12" / "P3_2_10_p17.npz"
    source = ("--stream", "kinect.joints=joints_m", "--time", "t_us", "--names", "joint_names", "--unit", "m")
    kinegraph("files", "import", file, "-o", tmp_path / "hop.mcap", *source)
    kinegraph("replay", CONFIGS / "segment_kinect.yaml", tmp_path / "hop.mcap", "-q", "-o", tmp_path / "out.mcap")
    scores = score(read_found(tmp_path / "out.mcap"), read_truth(file))
    assert scores.repetitions <= 2


@needs_data
@pytest.mark.parametrize(("walk", "warned"), [("S4_NO_FLOAT", True), ("S4_FLOAT", True), ("treadmill", False)])
def test_a_short_walk_seen_by_four_muscles_ends_with_a_warning(walk: str, warned: bool) -> None:
    with np.load(DATA / "emg" / ("emg_santuz_tw12.npz" if walk == "treadmill" else f"emg_epfl_{walk}.npz")) as archive:
        x = archive["emg_uV" if walk == "treadmill" else "T_02_emg"].astype(np.float64)
    raw = Series(StreamSpec((x.shape[1],), rate_hz=1000.0, units=("uV",)), np.arange(len(x)) * NS // 1000, x)
    with capture_logs() as logs:
        told_by("segment_emg", "board", raw)
    assert [entry["event"].startswith("too little motion to tell what repeats") for entry in logs] == [True] * warned
