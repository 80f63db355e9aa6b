"""`python -m tests.golden_commands --write [WORDS]`: renew the golden answers of the commands in whose name one of the words stands.

What commands that learn, evaluate and tabulate make of made-up recordings: all that they print, and a summary of every file that they
write. One file a command, in tests/laws/golden/commands; `tests/laws/test_golden_commands.py` compares. Without `--write` nothing is
written; either way it prints what has changed: give the reason in the commit.
"""

from __future__ import annotations

import argparse
import io
import re
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from unittest import mock

import numpy as np
from matplotlib.figure import Figure

import stream.cli
from stream.chunk import NS, Array, StreamSpec, grid
from stream.recording import Recording
from stream.recording.series import Series, write_recording
from tests import drawn, golden

ANSWERS = golden.ANSWERS / "commands"
RELATIVE = 2e-3
"""How far numbers may be off: what is learned sums up how processors differ, and what is printed is rounded."""
NUMBER = re.compile(r"(?<![\w.#])[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", re.ASCII)
CHANGING = re.compile(
    r'"(?:made_by|versions?|hash|sha256|made|created)": ?"[^"]*"|data:image/png;base64,[A-Za-z0-9+/=]+'
    r'|(?<="bytes": )\d+|\d+\.\d MB|(?<=^replayed 15\.0 s) .*'
    r'|(?<=url\(#)[a-z][0-9a-f]+|(?<=id=")[a-z][0-9a-f]{5,}'
)
"""What differs from one run, or version, or processor, to the next: a plot's names of its parts come from the last digits of where they
are."""
CLOCK = re.compile(r"^\d\d:\d\d:\d\d ")
"""Before a line of the log."""
NOTHING = 1e-9
"""Of an array's largest number, what is taken for 0: what rounding leaves of a difference."""
SIGNLESS, FREE = ("basis", "weights"), ("modes", "own", "theirs")
"""Arrays of models that hold singular vectors, or numbers by them: their signs are those of the processor's library; and where singular
values are equal, any rotation of the vectors is as good, so these are left out."""

Scene = Callable[[], Iterator[str]]
"""Writes files in the current folder, and gives the words of one command after the other."""


def _train_pose() -> Iterator[str]:
    from tests.avatar.test_pose_training import acclaim
    from tests.avatar.test_whole_pose import POSES, RATE, TREE, N

    write_recording(Path("walk.mcap"), [Series("walk", TREE.spec(RATE), grid(RATE, N), POSES)], {})
    yield "train pose walk.mcap -o walk.npz --centres 50"
    acclaim(Path())
    yield "import 9.asf 9_01.amc --rate 9_01=30 -o acclaim.mcap"
    yield "train pose walk.mcap acclaim.mcap -o both.npz --centres 60"
    yield "train pose walk.mcap -o few.npz --centres 50 --markers head,shoulder_l,shoulder_r,hip_l,hip_r --noise-mm 10"


def _train_steering() -> Iterator[str]:
    from devices.simulators.quadruped import marked, topology
    from tests.avatar.test_steering_adapt import LIMBS, NAMES, REFERENCE, STRIDE, pacing

    write_recording(Path("mesh.mcap"), [Series("mesh", topology().spec(24.0), grid(24.0, 24), STRIDE)], {})
    spec = StreamSpec((len(NAMES), 3), rate_hz=30.0, channels=NAMES, units=("cm",))
    marks = 40.0 * pacing(np.arange(60) / 30)
    write_recording(Path("walk.mcap"), [Series("walk", spec, grid(30.0, 60), marks)], {})
    text = "markers: {" + ", ".join(f"{n}: {v}" for n, v in marked().items()) + "}\n"
    text += f"reference: [{', '.join(REFERENCE)}]\nheading: [croup, withers]\n"
    Path("m.yaml").write_text(text)
    Path("limbs.yaml").write_text(f"{text}limbs: [{', '.join(LIMBS)}]\n")
    train = "train steering mesh.mcap --markers m.yaml --parts 6"
    yield f"{train} -o chosen.npz --report chosen.html"
    yield f"{train} -o thesis.npz --pose angles --regression linear --skeleton --alignment greedy --method parts"
    yield f"{train} -o local.npz --method local --modes 2"
    yield f"{train} -o straight.npz --pose directions --method straight"
    yield "train steering mesh.mcap --markers limbs.yaml --parts 6 -o limbs.npz --shapes optimised --blend shared"
    yield f"{train} -o few.npz --performer walk.mcap"


def _train_graph() -> Iterator[str]:
    from operators.segmentation.outputs import PRIMITIVE
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
    yield "train graph walk.mcap curve.mcap wave.mcap -o all.npz --within-cm 6 --call walk=0-5"
    yield "train graph walk.mcap curve.mcap -o near.npz --no-mirror --within-cm 8 --rate-hz 15"


def _train_map() -> Iterator[str]:
    from tests.support.horses_made import NAMES, YAML, horse, record

    record(Path("walk.mcap"), horse("walk", 6), gait="walk", name="Ida")
    record(Path("trot.mcap"), horse("trot", 6, seed=1), gait="trot")
    data = 1000 * horse("trot", 4, seed=2, lame=0.5)[::2]
    record(Path("lame.mcap"), data[:, [0, 1, 3, 4, 5, 6]], 30.0, ("T6", "sacrum", *NAMES[3:]), "mm", gait="trot")
    Path("m.yaml").write_text(YAML)
    yield "train map walk.mcap trot.mcap lame.mcap --markers m.yaml -o all.npz --rows 5"
    yield "train map walk.mcap trot.mcap --markers m.yaml -o two.npz --rows 4 --rate-hz 20"


def _emg_sessions() -> Iterator[str]:
    from tests.gait.test_emg_compare import bursts, session

    for k, (name, centres) in enumerate(
        {"a": (10.0, 40.0, 99.0), "b": (10.0, 41.0, 99.0), "c": (10.0, 48.0, 95.0)}.items()
    ):
        session(Path(f"{name}.mcap"), bursts(20, centres=centres, seed=k))
    yield "compare a.mcap b.mcap c.mcap -o compared"
    yield "train emg-model a.mcap b.mcap -o model.npz"
    yield "compare a.mcap c.mcap -o two"


def _train_steps() -> Iterator[str]:
    from tests.gait.test_steps import recorded

    files = " ".join(map(str, recorded(Path(), [f"r{k}" for k in range(6)])))
    for target, people in (("gender", range(6)), ("person", (0, 0, 1, 1, 2, 2))):
        rows = "".join(f"r{k}.mcap,p{p},{'fm'[p % 2]}\n" for k, p in enumerate(people))
        Path(f"{target}.csv").write_text(f"recording,person,gender\n{rows}")
        yield f"train steps {target}.csv {files} --target {target} -o {target}.npz --trees 8"


def _evaluate_sleep() -> Iterator[str]:
    from tests.sleep.test_evaluate_sleep import write_csv

    rng, lines = np.random.default_rng(5), ["estimate,reference,person"]
    for k in range(5):
        truth = np.repeat(np.array(["W", "N2", "N3", "W", "R", "N1", "W"]), rng.integers(4, 60, 7))
        told = np.where(rng.random(len(truth)) < 0.1, "wake", np.where(truth == "W", "wake", "sleep"))
        told[: int(rng.integers(0, 6))] = "sleep"
        write_csv(Path(f"psg{k}.csv"), truth.tolist())
        write_csv(Path(f"told{k}.csv"), told.tolist())
        lines.append(f"told{k}.csv,psg{k}.csv,P{k // 2}")
    Path("nights.csv").write_text("\n".join(lines) + "\n")
    yield "evaluate sleep --nights nights.csv -o all"
    yield "evaluate sleep told1.csv psg1.csv"
    yield "evaluate sleep told1.csv psg2.csv"


def _evaluate_segmentation() -> Iterator[str]:
    from tests.motion.test_evaluate_segmentation import recording

    recording(Path("walk.mcap"))
    Path("walk.csv").write_text("start_s,end_s,label,repetitions\n0,5,walk,3\n5,5.4,,\n5.4,10,run,2\n6,,,\n")
    Path("late.csv").write_text("start_s,end_s,label,repetitions\n0.3,4.2,walk,4\n4.2,7.1,run,1\n7.1,9.7,walk,2\n")
    Path("other.csv").write_text("start_s,end_s,activity,cluster,repetition\n0,2.5,0,1,1\n2.5,5,0,1,2\n5,10,1,2,1\n")
    Path("all.csv").write_text(
        "result,truth,offset_s\nwalk.mcap,walk.csv,0\nwalk.mcap,late.csv,0.2\nother.csv,late.csv,\n"
    )
    yield "evaluate segmentation --table all.csv -o all"
    yield "evaluate segmentation walk.mcap late.csv --features stack -o late"


def _sessions() -> Iterator[str]:
    rng = np.random.default_rng(2)
    pulses = np.cumsum(0.5 + rng.random(40))
    for name, times in (("a", pulses), ("b", (np.delete(pulses, [7, 21]) - 7.5) / (1 + 40e-6))):
        Path(f"{name}.csv").write_text("sync_s\n" + "".join(f"{t:.6f}\n" for t in times if t > 0))
        yield f"import {name}.csv -o {name}.mcap --events box.sync=sync_s --fact subject=S0{name} --fact speed_m_s=1.2"
    Path("broken.mcap").write_bytes(b"no recording")
    yield "sessions . -o index.csv"
    yield "sessions . --subject S0a"
    yield "pulses a.mcap b.mcap --stream box.sync"


def _electrodes() -> Iterator[str]:
    from tests.gait.test_emg_normalise import emg, recorded

    board = (
        "nodes:\n  board: {use: devices.simulators.treadmill.Treadmill, realtime: false, duration_s: 16, faults: %s}\n"
    )
    Path("good.yaml").write_text(board % "[]")
    Path("bad.yaml").write_text(board % "[{kind: hum, muscle: SO}, {kind: weak, muscle: TA}]")
    yield "check-electrodes good.yaml"
    yield "check-electrodes bad.yaml"
    recorded(Path("walk.mcap"), {"treadmill.emg": emg()})
    yield "calibrate mvc walk.mcap -o mvc.json"
    yield "calibrate rest walk.mcap -o rest.json"


def _nights() -> Iterator[str]:
    from operators.sleep.scorer import EPOCH

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
    yield "evaluate sleep n.mcap psg.csv -o night"


def _teach() -> Iterator[str]:
    from tests.motion.test_evaluate_segmentation import recording

    recording(Path("walk.mcap"))
    yield "teach walk.mcap walk=0-5.1 run=5.4-9.97 -o two.npz"
    yield "teach walk.mcap walk=0-3.4 walk=5-9.97 -o one.npz"
    for wrong in ("walk=5-4", "walk=20-30", "walk=5.1-5.2", "walk", "=0-5", "walk=0-x", "walk=0-5 run=4-8"):
        yield f"teach walk.mcap {wrong} -o wrong.npz"
    yield "teach walk.mcap walk=0-5 -o two.npz"
    yield "teach walk.mcap -o said.npz"
    yield "teach walk.mcap walk=0-5 -o other.npz --features nothing"
    yield "teach walk.mcap walk=0-5 -o other.npz --node nobody"


def _graphs() -> Iterator[str]:
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
    source = "nodes:\n  a: {use: devices.files.recorded_streams.RecordedStreams, path: a.mcap, of: a, speed: 0}\n"
    chain = """  low: {use: operators.iir.Lowpass, from: a.emg, cutoff_hz: 6}
  rms: {use: operators.moving.MovingRms, from: a.emg, window_s: 0.5}
  loud: {use: operators.threshold.Threshold, from: rms, level: 1.0, channel: TA, release: 0.9}
  gate: {use: operators.gate.Gate, from: {in: low, pulses: a.pulse}, start: p2}
  table: {use: devices.outlets.csv_file.CsvFile, from: gate, path: gate.csv}
record: [low, rms, loud.onset, loud.interval, gate]
"""
    Path("g.yaml").write_text(source + chain)
    Path("bad.yaml").write_text(source + chain.replace("cutoff_hz: 6", "cutoff_hz: 60"))
    Path("port.yaml").write_text(source + chain.replace("a.pulse", "a.pulses"))
    Path("typo.yaml").write_text(source + chain.replace("window_s", "windows_s"))
    yield "info a.mcap"
    yield "info a.mcap --json"
    yield "check g.yaml"
    for wrong in ("bad", "port", "typo", "none"):
        yield f"check {wrong}.yaml"
    yield "check g.yaml --set low.cutoff_hz=12 --set rms.window_s=0.01"
    for form in ("tree", "mermaid", "dot"):
        yield f"draw g.yaml --format {form}"
    yield "parts wavelet"
    yield "replay g.yaml a.mcap -o made.mcap -q"
    yield "info made.mcap --graph"
    yield "replay g.yaml a.mcap -q --set loud.min_duration_s=-1"


SCENES: dict[str, tuple[str, Scene]] = {
    "train-pose": ("operators.whole_pose.commands.train", _train_pose),
    "train-steering": ("operators.steering.commands.train", _train_steering),
    "train-graph": ("operators.motion_graph.commands.train", _train_graph),
    "train-map": ("operators.pose_map.commands.train", _train_map),
    "emg-sessions": ("operators.emg.commands.compare", _emg_sessions),
    "train-steps": ("operators.steps.commands.train", _train_steps),
    "evaluate-sleep": ("operators.sleep.evaluation.command", _evaluate_sleep),
    "evaluate-segmentation": ("operators.segmentation.evaluation.command", _evaluate_segmentation),
    "sessions": ("operators.gait.commands.pulses", _sessions),
    "electrodes": ("operators.emg.commands.check_electrodes", _electrodes),
    "teach": ("operators.segmentation.commands.teach", _teach),
    "graphs": ("stream.commands.check", _graphs),
    "nights": ("operators.sleep.evaluation.command", _nights),
}
"""By name, the module of the command, and what it is called with."""


def answers(name: str) -> golden.Answers:
    """What the commands of a scene print, and a summary of what they write."""
    found: golden.Answers = {}
    with tempfile.TemporaryDirectory(prefix="golden-") as folder, chdir(folder):
        scene = SCENES[name][1]()
        for words in scene:
            before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
            figures: list[str] = []
            with mock.patch.object(Figure, "savefig", drawn.saved(figures)):
                code, out, err = call(words.split())
            found[f"{words} | code"] = str(code)
            found |= {f"{words} | drawn {k}": text for k, text in enumerate(figures)}
            for stream_name, text in (("out", out), ("err", err)):
                for k, line in enumerate(_lines(text, folder)):
                    found[f"{words} | {stream_name} {k}"] = line
            for path in sorted(Path().rglob("*")):
                if path.is_file() and before.get(path) != path.read_bytes():
                    for part, text in _of_file(path):
                        found[f"{words} | {path} {part}".strip()] = text
    return found


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
            stream.cli.main()
        except SystemExit as end:
            code = end.code or 0
    return code, out.getvalue(), err.getvalue()


def _lines(text: str, folder: str) -> Iterator[str]:
    for line in text.replace(folder, "FOLDER").splitlines():
        if line.strip():
            yield " ".join(CHANGING.sub("", CLOCK.sub("", line)).split())


def _of_file(path: Path) -> Iterator[tuple[str, str]]:
    match path.suffix:
        case ".npz":
            with np.load(path) as arrays:
                for name in sorted(n for n in arrays.files if n.partition(".")[2] not in FREE):
                    if name == "header":
                        yield name, _text(arrays[name].tobytes().decode())
                    elif arrays[name].dtype.kind in "US":
                        yield name, _text(str(arrays[name]))
                    elif name.rpartition(".")[2] in SIGNLESS:
                        yield name, _array(np.abs(arrays[name]))
                    else:
                        yield name, _array(arrays[name])
        case ".mcap":
            with Recording.open(path) as recording:
                for name in sorted(recording.streams):
                    time_, data = recording.read(name)
                    yield name, f"{recording.streams[name].spec.describe()} n={len(time_)} {_array(data)}"
        case ".png":
            yield "", "a picture"
        case _:
            text = path.read_text(encoding="utf-8")
            yield "", _text(text)


def _array(data: Array) -> str:
    if data.dtype.kind == "f" and data.size:
        size = np.abs(data)
        data = np.where(size <= NOTHING * np.max(size, initial=0.0, where=np.isfinite(size)), 0.0, data)
    columns = " ".join(
        f"{name}={golden._sums(c)}" if c.dtype.kind in "biuf" else f"{name}=#{zlib.crc32(c.tobytes())}"
        for name, c in golden._columns(np.atleast_1d(data))
    )
    return f"{'x'.join(map(str, data.shape))} {columns}"


def _text(text: str) -> str:
    """The words as a checksum, and sums of the numbers among them."""
    text = CHANGING.sub("", text)
    numbers = np.array([float(n.replace("−", "-")) for n in NUMBER.findall(text)])
    return f"words=#{zlib.crc32(NUMBER.sub('#', text).encode())} numbers={golden._sums(numbers) if len(numbers) else 'none'}"


def alike(one: str, other: str) -> bool:
    """Whether two answers are the same words, with numbers that differ by no more than what rounding does."""
    if golden.alike(one, other, RELATIVE):
        return True
    if NUMBER.sub("#", one) != NUMBER.sub("#", other):
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
    return all(a == b or _near(a, b) for a, b in pairs)


def _near(one: str, other: str) -> bool:
    a, b = float(one.replace("−", "-")), float(other.replace("−", "-"))
    last = 10.0 ** -len(one.partition(".")[2])
    return "." in one and abs(a - b) <= max(RELATIVE * max(abs(a), abs(b)), 1.01 * last)


def read(name: str) -> golden.Answers:
    path = ANSWERS / f"{name}.txt"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {asked: text for asked, _, text in (line.partition(" => ") for line in lines)}


def write(name: str, found: golden.Answers) -> None:
    ANSWERS.mkdir(exist_ok=True)
    (ANSWERS / f"{name}.txt").write_text(
        "".join(f"{asked} => {text}\n" for asked, text in found.items()), encoding="utf-8"
    )


def changes(kept: golden.Answers, found: golden.Answers) -> list[str]:
    """What differs, one line an answer."""
    names = [*kept, *(n for n in found if n not in kept)]
    pairs = ((n, kept.get(n, "nothing"), found.get(n, "nothing")) for n in names)
    return [f"{name}: {old} -- was, is -- {new}" for name, old, new in pairs if not alike(old, new)]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.golden_commands", description=__doc__)
    parser.add_argument("words", nargs="*", help="commands in whose name one of these stands; all, where none is given")
    parser.add_argument("--write", action="store_true", help="keep the answers that are given now")
    given = parser.parse_args()
    differing = 0
    for name in SCENES:
        if given.words and not any(word in name for word in given.words):
            continue
        began = time.process_time()
        found = answers(name)
        told = changes(read(name), found)
        differing += len(told)
        print(
            f"{name}: {len(found)} answers in {time.process_time() - began:.1f} s, {len(told)} changed",
            *told[: golden.MOST],
            sep="\n  ",
            flush=True,
        )
        if given.write and told:
            write(name, found)
    return 0 if given.write or not differing else 1


if __name__ == "__main__":
    sys.exit(main())
