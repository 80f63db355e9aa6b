"""Golden answers of commands that learn, evaluate and tabulate: what they print of made-up recordings; tests/golden.py compares."""

from __future__ import annotations

import io
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from unittest import mock

import numpy as np

import kinegraph.stream.cli.main
from kinegraph.stream.chunk import NS, StreamSpec, grid
from kinegraph.stream.recording.series import Series, write_recording
from tests.golden import ANSWERS

RELATIVE = 2e-3
"""How far numbers may be off: what is learned sums up how processors differ."""
CHANGING = re.compile(r"\d+\.\d MB|(?<=^replayed 15\.0 s) .*|^\d\d:\d\d:\d\d |(?<=^versions: ).*")
"""What differs from one run or machine to the next: sizes of files, speeds, the clock before a line of the log, versions."""

Scene = Callable[[], Iterator[str]]
"""Writes files in the current folder, and gives the words of one command after the other."""


def _train_pose() -> Iterator[str]:
    from tests.avatar.test_pose_training import acclaim
    from tests.avatar.test_whole_pose import POSES, RATE, TREE, N

    write_recording(Path("walk.mcap"), [Series("walk", TREE.spec(RATE), grid(RATE, N), POSES)], {})
    yield "motion train pose walk.mcap -o walk.npz --centres 50"
    acclaim(Path())
    yield "files import 9.asf 9_01.amc --rate 9_01=30 -o acclaim.mcap"


def _train_steering() -> Iterator[str]:
    from kinegraph.devices.people.quadruped import marked, topology
    from tests.avatar.adapt_runs import REFERENCE, STRIDE

    write_recording(Path("mesh.mcap"), [Series("mesh", topology().spec(24.0), grid(24.0, 24), STRIDE)], {})
    text = "markers: {" + ", ".join(f"{n}: {v}" for n, v in marked().items()) + "}\n"
    Path("m.yaml").write_text(f"{text}reference: [{', '.join(REFERENCE)}]\nheading: [croup, withers]\n")
    yield "motion train steering mesh.mcap --markers m.yaml --parts 6 -o chosen.npz"
    yield "motion train steering mesh.mcap --markers m.yaml --parts 6 -o straight.npz --pose directions --method straight"


def _train_graph() -> Iterator[str]:
    from kinegraph.operators.segmentation.outputs import PRIMITIVE
    from tests.support.motion_made import CYCLE, RATE, TREE, bend, walking, waving

    fallen = waving(2)
    bend(fallen, "Hips", 1, np.linspace(0.0, 1.5, len(fallen)))
    takes = {
        "walk": (walking(8, sway=0.1), 3), "curve": (np.concatenate([fallen[::-1], walking(8, 0.5, 0.1)]), 3),
        "wave": (np.concatenate([waving(4), fallen]), 5),
    }  # fmt: skip
    for name, (poses, cluster) in takes.items():
        time_ = grid(RATE, len(poses))
        cut = np.zeros(len(poses) // CYCLE, PRIMITIVE)
        cut["onset"], cut["end"], cut["cluster"] = time_[::CYCLE], time_[CYCLE - 1 :: CYCLE], cluster
        primitive = Series("segment.primitive", StreamSpec((), PRIMITIVE), cut["end"].copy(), cut)
        write_recording(Path(f"{name}.mcap"), [Series("pose", TREE.spec(RATE), time_, poses), primitive], {})
    yield "motion train graph walk.mcap curve.mcap wave.mcap -o all.npz --within-cm 6 --call walk=0-5"


def _train_map() -> Iterator[str]:
    from tests.support.horses_made import NAMES, YAML, horse, record

    record(Path("walk.mcap"), horse("walk", 6), gait="walk", name="Ida")
    record(Path("trot.mcap"), horse("trot", 6, seed=1), gait="trot")
    data = 1000 * horse("trot", 4, seed=2, lame=0.5)[::2]
    record(Path("lame.mcap"), data[:, [0, 1, 3, 4, 5, 6]], 30.0, ("T6", "sacrum", *NAMES[3:]), "mm", gait="trot")
    Path("m.yaml").write_text(YAML)
    yield "motion train map walk.mcap trot.mcap lame.mcap --markers m.yaml -o all.npz --rows 5"


def _emg_sessions() -> Iterator[str]:
    from tests.gait.test_emg_compare import bursts, session

    for k, (name, centres) in enumerate(
        {"a": (10.0, 40.0, 99.0), "b": (10.0, 41.0, 99.0), "c": (10.0, 48.0, 95.0)}.items()
    ):
        session(Path(f"{name}.mcap"), bursts(20, centres=centres, seed=k))
    yield "emg compare a.mcap b.mcap c.mcap -o compared"
    yield "emg train-model a.mcap b.mcap -o model.npz"


def _evaluate_sleep() -> Iterator[str]:
    from tests.sleep.test_evaluate_sleep import write_csv

    rng, lines = np.random.default_rng(5), ["estimate,reference,person"]
    for k in range(5):
        truth = np.repeat(np.array(["W", "N2", "N3", "W", "R", "N1", "W"]), rng.integers(4, 60, 7))
        reported = np.where(rng.random(len(truth)) < 0.1, "wake", np.where(truth == "W", "wake", "sleep"))
        reported[: int(rng.integers(0, 6))] = "sleep"
        write_csv(Path(f"psg{k}.csv"), truth.tolist())
        write_csv(Path(f"reported{k}.csv"), reported.tolist())
        lines.append(f"reported{k}.csv,psg{k}.csv,P{k // 2}")
    Path("nights.csv").write_text("\n".join(lines) + "\n")
    yield "sleep evaluate --nights nights.csv -o all"


def _evaluate_segmentation() -> Iterator[str]:
    from tests.motion.test_evaluate_segmentation import recording

    recording(Path("walk.mcap"))
    Path("walk.csv").write_text("start_s,end_s,label,repetitions\n0,5,walk,3\n5,5.4,,\n5.4,10,run,2\n6,,,\n")
    Path("late.csv").write_text("start_s,end_s,label,repetitions\n0.3,4.2,walk,4\n4.2,7.1,run,1\n7.1,9.7,walk,2\n")
    Path("other.csv").write_text("start_s,end_s,activity,cluster,repetition\n0,2.5,0,1,1\n2.5,5,0,1,2\n5,10,1,2,1\n")
    Path("all.csv").write_text(
        "result,truth,offset_s\nwalk.mcap,walk.csv,0\nwalk.mcap,late.csv,0.2\nother.csv,late.csv,\n"
    )
    yield "motion evaluate --table all.csv -o all"


def _sessions() -> Iterator[str]:
    rng = np.random.default_rng(2)
    pulses = np.cumsum(0.5 + rng.random(40))
    for name, times in (("a", pulses), ("b", (np.delete(pulses, [7, 21]) - 7.5) / (1 + 40e-6))):
        Path(f"{name}.csv").write_text("sync_s\n" + "".join(f"{t:.6f}\n" for t in times if t > 0))
        yield f"files import {name}.csv -o {name}.mcap --events box.sync=sync_s --fact subject=S0{name} --fact speed_m_s=1.2"
    Path("broken.mcap").write_bytes(b"no recording")
    yield "emg sessions . -o index.csv"
    yield "emg sessions . --subject S0a"
    yield "files compare-clocks a.mcap b.mcap --stream box.sync"


def _electrodes() -> Iterator[str]:
    from tests.gait.test_emg_normalise import emg, recorded

    faults = "[{kind: hum, muscle: SO}, {kind: weak, muscle: TA}]"
    board = f"use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 16, faults: {faults}"
    Path("bad.yaml").write_text(f"nodes:\n  board: {{{board}}}\n")
    yield "emg check-electrodes bad.yaml"
    recorded(Path("walk.mcap"), {"treadmill.emg": emg()})
    yield "emg calibrate mvc walk.mcap -o mvc.json"
    yield "emg calibrate rest walk.mcap -o rest.json"


def _nights() -> Iterator[str]:
    from kinegraph.operators.sleep.scorer import EPOCH

    rows = np.zeros(900, EPOCH)
    rows["onset"] = np.int64(1_700_000_000) * NS + np.arange(900) * 30 * NS
    rows["end"], rows["final"] = rows["onset"] + 30 * NS, True
    rows["state"] = np.repeat(
        np.array([b"wake", b"sleep", b"wake", b"sleep", b"unknown", b"sleep", b"wake"]), [40, 300, 20, 250, 10, 260, 20]
    )
    write_recording(Path("n.mcap"), [Series("scorer", StreamSpec((), EPOCH), rows["end"].copy(), rows)], {})
    Path("psg.csv").write_text(
        "\n".join(
            [
                "time (UTC),state",
                *(
                    f"{np.datetime64(int(r['onset']), 'ns')}Z,{'W' if k < 45 or k > 850 else 'N2'}"
                    for k, r in enumerate(rows)
                ),
            ]
        )
    )
    yield "sleep evaluate n.mcap psg.csv -o night"


def _teach() -> Iterator[str]:
    from tests.motion.test_evaluate_segmentation import recording

    recording(Path("walk.mcap"))
    yield "motion label walk.mcap walk=0-5.1 run=5.4-9.97 -o two.npz"
    yield "motion label walk.mcap walk=0-3.4 walk=5-9.97 -o one.npz"
    for wrong in ("walk=5-4", "walk=20-30", "walk", "=0-5", "walk=0-5 run=4-8"):
        yield f"motion label walk.mcap {wrong} -o wrong.npz"
    yield "motion label walk.mcap walk=0-5 -o two.npz"
    yield "motion label walk.mcap -o said.npz"
    yield "motion label walk.mcap walk=0-5 -o other.npz --features nothing"


def _laboratory() -> None:
    """A recording in which samples are missing, and graphs that read it: a good one and some that are wrong."""
    rng = np.random.default_rng(4)
    time_ = np.delete(grid(100.0, 1500, start_ns=3 * NS), slice(400, 430))
    lost = np.zeros(len(time_), np.int64)
    lost[400] = 30
    emg = StreamSpec((2,), rate_hz=100.0, channels=("TA", "SO"), units=("uV",))
    pulse = np.zeros(7, [("onset", "<i8"), ("text", "<U8")])
    pulse["onset"], pulse["text"] = 3 * NS + np.arange(7) * 2 * NS, [f"p{k}" for k in range(7)]
    series = [
        Series("a.emg", emg, time_, rng.normal(size=(len(time_), 2)), lost),
        Series("a.pulse", StreamSpec((), pulse.dtype, units=("ns", "")), pulse["onset"].copy(), pulse),
    ]
    write_recording(Path("a.mcap"), series, {"session": {"subject": "S1", "speed_m_s": 1.2}})
    source = "nodes:\n  a: {use: devices.recorded.recorded_streams.RecordedStreams, path: a.mcap, of: a, speed: 0}\n"
    chain = """  low: {use: operators.filters.iir.Lowpass, from: a.emg, cutoff_hz: 6}
  rms: {use: operators.filters.moving.MovingRms, from: a.emg, window_s: 0.5}
  loud: {use: operators.filters.threshold.Threshold, from: rms, level: 1.0, channel: TA, release: 0.9}
  gate: {use: operators.timing.gate.Gate, from: {in: low, pulses: a.pulse}, start: p2}
  table: {use: devices.outlets.csv_file.CsvFile, from: gate, path: gate.csv}
record: [low, rms, loud.onset, loud.interval, gate]
"""
    Path("g.yaml").write_text(source + chain)
    Path("bad.yaml").write_text(source + chain.replace("cutoff_hz: 6", "cutoff_hz: 60"))
    Path("port.yaml").write_text(source + chain.replace("a.pulse", "a.pulses"))
    Path("typo.yaml").write_text(source + chain.replace("window_s", "windows_s"))


def _info() -> Iterator[str]:
    _laboratory()
    yield "info a.mcap"
    yield "replay g.yaml a.mcap -o made.mcap -q"
    yield "info made.mcap"
    yield "replay g.yaml a.mcap -q --set loud.min_duration_s=-1"


def _check() -> Iterator[str]:
    _laboratory()
    yield "check g.yaml"
    for wrong in ("bad", "port", "typo", "none"):
        yield f"check {wrong}.yaml"


def _draw() -> Iterator[str]:
    _laboratory()
    for form in ("tree", "mermaid"):
        yield f"draw g.yaml --format {form}"


SCENES: dict[str, Scene] = {
    "train-pose": _train_pose,
    "train-steering": _train_steering,
    "train-graph": _train_graph,
    "train-map": _train_map,
    "compare": _emg_sessions,
    "evaluate-sleep": _evaluate_sleep,
    "evaluate-sleep-of-a-night": _nights,
    "evaluate-segmentation": _evaluate_segmentation,
    "sessions": _sessions,
    "electrodes": _electrodes,
    "teach": _teach,
    "info-and-replay": _info,
    "check": _check,
    "draw": _draw,
}


def scenes() -> dict[str, Path]:
    """By scene, the file of its golden answer."""
    return {name: ANSWERS / "commands" / f"{name}.txt" for name in SCENES}


def answer(name: str) -> str:
    """What the commands of a scene print, each after its words."""
    lines = []
    with tempfile.TemporaryDirectory(prefix="golden-") as folder, chdir(folder):
        for words in SCENES[name]():
            code, out, err = call(words.split())
            lines += [
                f"$ kinegraph {words}",
                *_lines(out, folder),
                *_lines(err, folder),
                *[f"exit code {code}"] * bool(code),
            ]
    return "".join(f"{line}\n" for line in lines)


def call(words: list[str]) -> tuple[object, str, str]:
    """The exit code of a command, what it printed, and what it complained of."""
    out, err, code = io.StringIO(), io.StringIO(), None
    environment = {"COLUMNS": "120", "NO_COLOR": "1", "TERM": "dumb"}
    with (
        mock.patch.object(sys, "argv", ["kinegraph", *words]),
        mock.patch.dict("os.environ", environment),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            kinegraph.stream.cli.main.main()
        except SystemExit as end:
            code = end.code or 0
    return code, out.getvalue(), err.getvalue()


def _lines(text: str, folder: str) -> Iterator[str]:
    for line in text.replace(folder, "FOLDER").splitlines():
        if line.strip():
            yield CHANGING.sub("", line).rstrip()
