"""Hostile and clumsy users at the command line: a message that says what, where and what to do; the right exit code; nothing lost.

Commands are called in this process, through the same `main` that `kinegraph` calls. A user's mistake never shows a traceback: whatever
`main` lets through but SystemExit fails the test.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import structlog
from mcap.writer import Writer

import stream.cli
from stream.chunk import NS, Chunk, StreamSpec
from stream.engine.clock import SessionClock
from stream.graph import RecordingOptions
from stream.recording import Recorder, Recording
from stream.recording import part as part_module

KINEGRAPH = Path(sys.executable).parent / "kinegraph"
BOARD = "nodes:\n  board: {use: devices.treadmill.Treadmill, realtime: false, duration_s: %s}\n"
GRAPH = BOARD % 2 + "  rect: {use: operators.rectify.Rectify, from: board.emg}\nrecord: [rect]\n"
QUIET = ("--view", "none")

Told = tuple[int, str, str]
Command = Callable[..., Told]


@pytest.fixture
def kinegraph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Command]:
    """Call a command in an empty folder: (exit code, what it printed, what it complained of)."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> Told:
        monkeypatch.setattr(sys, "argv", ["kinegraph", *map(str, arguments)])
        capsys.readouterr()
        code: Any = 0
        try:
            stream.cli.main()
        except SystemExit as end:
            code = end.code or 0
        told = capsys.readouterr()
        assert "Traceback" not in told.out + told.err
        return code, told.out, told.err

    yield call
    structlog.reset_defaults()


def refused(told: Told, *words: str, code: int = 2) -> None:
    """The command ended with `code`, and its complaint holds all these words."""
    assert told[0] == code, told
    assert not [word for word in words if word not in told[2]], told[2]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a graph and a whole recording of it."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "graph.yaml").write_text(GRAPH)
    subprocess.run([KINEGRAPH, "run", "graph.yaml", "-o", "s", *QUIET], cwd=folder, check=True, capture_output=True)
    return folder


# -- graphs ------------------------------------------------------------------------------------------------------------

BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{new}: &{new} [{','.join([f'*{old}'] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
LOW = BOARD % 2 + "  low: {use: operators.iir.Lowpass, from: board.emg, cutoff_hz: %s}\n"
GRAPHS: list[tuple[str | bytes, list[str]]] = [
    ("", ["a graph is a mapping", "not empty"]),
    (b"\x00" * 4096, ["may not stand in YAML"]),
    (bytes(range(128, 256)), ["no text in UTF-8"]),
    (GRAPH.encode("utf-16"), ["no text in UTF-8"]),
    ("nodes:\n\tboard: 1\n", ["g.yaml:2:", "a tab"]),
    ("nodes: {a: [1, 2\n", ["lacks a ','"]),
    ("nodes: " + "[" * 300 + "]" * 300, ["too deep"]),
    ("nodes: " + "{a: " * 200 + "1" + "}" * 200, ["too deep"]),
    (BOMB + GRAPH, ["anchors", "grow without end"]),
    ("nodes: &n\n  board: *n\n", ["contain themselves"]),
    ("nodes: !!python/object/apply:os.system ['true']\n", ["is refused"]),
    (BOARD % "ten", ["g.yaml:2:", "node 'board'", "duration_s is 'ten'", "must be a number"]),
    (BOARD % ".nan", ["duration_s is nan"]),
    (BOARD % -5, ["duration_s is -5", "at least 0"]),
    (BOARD % "2, seed: 1.5", ["seed is 1.5", "a whole number"]),
    (BOARD % f"2, seed: {'9' * 5000}", ["g.yaml:2:", "9..."]),
    (BOARD % "2, duration: 3", ["no parameter 'duration'", "did you mean 'duration_s'?"]),
    (BOARD % "2, policy: maybe", ["policy is 'maybe'", "'drop_oldest'"]),
    ("nodes:\n  board: {use: devices.treadmill.Tredmill}\n", ["did you mean 'Treadmill'?"]),
    ("nodes:\n  board: {use: os.system}\n", ["must be a source, an operator or an outlet"]),
    ("nodes:\n  ../x: {use: devices.treadmill.Treadmill}\n", ["a node's name is made of letters"]),
    ("name: ../../evil\n" + GRAPH, ["g.yaml:1:", "name:", "without '/'"]),
    (f"name: {'n' * 300}\n" + GRAPH, ["g.yaml:1:", "short"]),
    (GRAPH.replace("board.emg", "bord.emg"), ["there is no node 'bord'", "did you mean 'board'?"]),
    (GRAPH.replace("board.emg", "board.touchdown"), ["node 'rect'", "must be a stream of numbers"]),
    (GRAPH.replace("board.emg", "rect"), ["runs in a circle"]),
    (LOW % 1200, ["cutoff_hz is 1200", "below 500"]),
    (LOW % "20 Hz", ["cutoff_hz is '20 Hz'", "a number"]),
    ("latency_budget_ms: 0\n" + GRAPH, ["latency_budget_ms is 0", "above 0"]),
]  # fmt: skip


@pytest.mark.parametrize(("text", "words"), GRAPHS, ids=[words[-1] for _, words in GRAPHS])
def test_a_graph_that_cannot_be(text: str | bytes, words: list[str], kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
    refused(kinegraph("check", "g.yaml"), "kinegraph: g.yaml", *words)
    refused(kinegraph("run", "g.yaml", *QUIET), *words)
    assert [p.name for p in tmp_path.iterdir()] == ["g.yaml"], "nothing is begun for a graph that cannot run"


SETTINGS = [
    ("x", "it must be NODE.PARAMETER=VALUE"),
    ("=5", "it must be NODE.PARAMETER=VALUE"),
    ("board.duration_s", "it must be NODE.PARAMETER=VALUE"),
    ("board.duration_s=", "duration_s is None"),
    ("board.duration_s=[1,", "this is not YAML"),
    ("board.seed=&a [*a]", "contain themselves"),
    ("board.seed=!!python/name:os.system", "is refused"),
    ("bord.duration_s=1", "did you mean 'board'?"),
    ("board.use=os.system", "must be a source"),
    ("record=[nope]", "there is no node 'nope'"),
    ("name=../x", "without '/'"),
]


@pytest.mark.parametrize(("setting", "words"), SETTINGS)
def test_a_setting_that_cannot_be(setting: str, words: str, kinegraph: Command, made: Path) -> None:
    refused(kinegraph("run", made / "graph.yaml", "--set", setting, *QUIET), "--set", words)


def test_arguments_that_cannot_be(kinegraph: Command, made: Path, tmp_path: Path) -> None:
    graph = made / "graph.yaml"
    (tmp_path / "file").write_text("x")
    refused(kinegraph(), "usage: kinegraph COMMAND")
    refused(kinegraph("runn"), "did you mean 'run'?")
    refused(kinegraph("run"), "Missing argument")
    refused(kinegraph("run", graph, "--nope"), "No such option")
    refused(kinegraph("run", "none.yaml"), "none.yaml: the graph cannot be read: No such file")
    refused(kinegraph("run", tmp_path), "cannot be read: Is a directory")
    refused(kinegraph("run", "x" * 5000), "File name too long")
    for seconds in ("nan", "inf", "-1", "soon"):
        refused(kinegraph("run", graph, "--for", seconds), "--for")
    refused(kinegraph("run", graph, "--view", "nope", "--no-record"), "there is no view 'nope'", "lines")
    refused(kinegraph("run", graph, *QUIET, "-o", "x.mcap"), "is a folder; name it without .mcap")
    refused(kinegraph("run", graph, *QUIET, "-o", "file"), "file: is a file; choose a folder")
    refused(kinegraph("run", graph, *QUIET, "-o", "file/below"), "file/below", "choose a folder")
    refused(kinegraph("run", graph, *QUIET, "-o", "n" * 300), "File name too long")
    refused(kinegraph("replay", graph, made / "s", "--speed", "-1"), "--speed")
    refused(kinegraph("replay", graph, made / "s", "--speak", "nope"), "--speak")
    refused(kinegraph("try", "no.such.Operator"), "no")
    refused(kinegraph("schema", "-o", "none/s.json"), "none/s.json cannot be written")
    assert [p.name for p in tmp_path.iterdir()] == ["file"] and (tmp_path / "file").read_text() == "x"


# -- sessions ----------------------------------------------------------------------------------------------------------


def test_resuming_what_is_not_there_or_not_ours(kinegraph: Command, made: Path, tmp_path: Path) -> None:
    graph = made / "graph.yaml"
    refused(kinegraph("run", graph, *QUIET, "-o", made / "s"), "holds a recording already")
    refused(kinegraph("run", graph, *QUIET, "-o", made / "s", "--resume"), "was ended properly")
    refused(kinegraph("run", graph, *QUIET, "-o", "none", "--resume"), "none: there is no such recording")
    refused(kinegraph("run", graph, *QUIET, "--resume"), "there is no session of 'graph'", "--out")
    (tmp_path / "foreign").mkdir()
    refused(kinegraph("run", graph, *QUIET, "-o", "foreign", "--resume"), "holds no recording")
    (tmp_path / "foreign" / "session.0000.mcap").write_bytes(b"hello")
    refused(kinegraph("run", graph, *QUIET, "-o", "foreign", "--resume"), "not an MCAP recording")
    assert sorted(p.name for p in (made / "s").iterdir()) == ["session.0000.mcap"], "no lock, no trial file is left"


RAISES = '''
from dataclasses import dataclass

import numpy as np

from stream.chunk import Chunk, Specs
from stream.operator import Operator


@dataclass(slots=True)
class State:
    seen: int = 0


@dataclass(frozen=True, slots=True)
class Raises(Operator[State]):
    """Raises in the middle of the stream."""

    def open(self, specs: Specs) -> Specs:
        self.hold(State())
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        self.state.seen += len(chunk.time)
        if self.state.seen > 1000:
            raise ZeroDivisionError("division by zero")
        return chunk
'''


def test_an_operator_that_raises_names_itself_and_loses_nothing(kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "raising.py").write_text(RAISES)
    (tmp_path / "g.yaml").write_text(BOARD % 2 + "  bad: {use: raising.Raises, from: board.emg}\nrecord: [bad]\n")
    told = kinegraph("run", "g.yaml", *QUIET, "-o", "s")
    refused(told, "bad", "ZeroDivisionError", "division by zero", code=4)
    assert re.search(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d", told[2]), "the sample's time is named"
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished and recording.streams["board.emg"].samples > 1000
        assert recording.streams["bad"].samples <= 1000


def test_two_sessions_on_one_output(kinegraph: Command, made: Path, tmp_path: Path) -> None:
    text = (BOARD % 0).replace("realtime: false, ", "")
    text += "  out: {use: devices.csv_file.CsvFile, from: board.emg, path: out.csv}\n"
    (tmp_path / "g.yaml").write_text(text)
    first = subprocess.Popen(
        [KINEGRAPH, "run", "g.yaml", "-o", "s", *QUIET], stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True
    )
    try:
        wait_for(lambda: (tmp_path / "s").is_dir() and (tmp_path / "out.csv").exists())
        refused(kinegraph("run", "g.yaml", *QUIET, "-o", "s", "--for", 1), "another kinegraph is recording there")
        refused(kinegraph("run", "g.yaml", *QUIET, "-o", "s", "--resume"), "another kinegraph is recording there")
        refused(kinegraph("recover", "s"), "is being recorded now")
        code, _, complaint = kinegraph("run", "g.yaml", *QUIET, "-o", "other", "--for", 1)
        assert code == 0 or (code == 3 and "out.csv" in complaint), "another file, or an error that names it"
        (tmp_path / "g.yaml").write_text("garbage: [")
    finally:
        first.send_signal(signal.SIGTERM)
        said = first.communicate(timeout=60)[1]
    assert first.returncode == 0, said
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished and recording.header["graph"] == text, "the graph as it ran, not as it was edited"


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize("moment", ["start", "warm-up", "running"])
def test_sigterm_ends_a_session_in_every_phase(moment: str, tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text((BOARD % 0).replace("realtime: false, ", "") + "record: [board.emg]\n")
    process = subprocess.Popen(
        [KINEGRAPH, "run", "g.yaml", "-o", "s"],
        cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    if moment == "start":
        time.sleep(0.3)
    elif moment == "warm-up":
        assert process.stdout and "getting ready" in process.stdout.readline()
    else:
        wait_for(lambda: any((tmp_path / "s").glob("session.*")))
    process.terminate()
    _, said = process.communicate(timeout=60)
    assert "Traceback" not in said
    if moment == "start":
        assert process.returncode in (0, 143, -signal.SIGTERM)
    else:
        assert process.returncode == 0, said
        with Recording.open(tmp_path / "s") as recording:
            assert recording.finished
    assert not list(tmp_path.glob("s/.*")), "no lock and no trial file is left"


def test_a_clock_that_is_set_back_does_not_turn_time_back(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SessionClock()
    before = clock.now()
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    assert clock.now() >= before
    again = SessionClock(after=before)
    assert again.utc_ns > before and again.now() > before
    monkeypatch.setattr(time, "time_ns", lambda: before + 3600 * NS)
    assert again.now() < before + 60 * NS, "nor does one that is set forward make it leap"
    assert SessionClock(after=before).utc_ns == before + 3600 * NS


def test_outputs_that_nobody_reads(made: Path, tmp_path: Path) -> None:
    """`| head`, closed outputs and a full disk behind them do not stop a session; other commands end at once, without a traceback."""
    run = f"{KINEGRAPH} run {made / 'graph.yaml'} --view lines -o"
    assert shell(f"{run} a >&- 2>&-", tmp_path).returncode == 0
    done = shell(f"{run} b <&- >/dev/full", tmp_path)
    assert done.returncode == 0 and "not shown any more" in done.stderr
    for name in "ab":
        with Recording.open(tmp_path / name) as recording:
            assert recording.finished and recording.streams["rect"].samples == 2000
    assert shell(f"{KINEGRAPH} info a --json | head -1", tmp_path).stdout == "{\n"
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}
    assert shell(f"{KINEGRAPH} draw {made / 'graph.yaml'}", tmp_path, ascii_only).returncode == 0


def shell(command: str, folder: Path, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        ["bash", "-c", command], cwd=folder, capture_output=True, text=True, env={**os.environ, **(env or {})}
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done


def test_a_cache_that_cannot_be_written_says_what_to_do(made: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = shell(f"{KINEGRAPH} check {made / 'graph.yaml'}", tmp_path, {"KINEGRAPH_CACHE": str(tmp_path / "file")})
    assert done.returncode == 2 and "set KINEGRAPH_CACHE to a folder that can be written" in done.stderr


# -- recordings --------------------------------------------------------------------------------------------------------


@pytest.fixture
def broken(made: Path, tmp_path: Path) -> Callable[..., Path]:
    """A copy of the recording, changed by a function of its bytes."""
    whole = (made / "s" / "session.0000.mcap").read_bytes()

    def make(change: Callable[[bytes], bytes], name: str = "broken.mcap") -> Path:
        path = tmp_path / name
        path.write_bytes(change(whole))
        return path

    return make


def test_recordings_that_cannot_be_read(
    kinegraph: Command, made: Path, tmp_path: Path, broken: Callable[..., Path]
) -> None:
    for name, profile in (("ros.mcap", "ros2"), ("other.mcap", "")):
        with (tmp_path / name).open("wb") as file:
            writer = Writer(file)
            writer.start(profile)
            writer.finish()  # type: ignore[no-untyped-call]
    newer = (b"\x06\x00\x00\x00format\x01\x00\x00\x001", b"\x06\x00\x00\x00format\x01\x00\x00\x009")
    (tmp_path / "empty").mkdir()
    cases = [
        (tmp_path / "none.mcap", "there is no such recording"),
        (tmp_path / "empty", "the folder holds no recording"),
        (made / "graph.yaml", "not an MCAP recording; CSV, NPZ and XDF files are read by `kinegraph import`"),
        (tmp_path / "ros.mcap", "not a kinegraph recording (profile 'ros2')"),
        (tmp_path / "other.mcap", "not a kinegraph recording (written by"),
        (broken(lambda b: b"", "nothing.mcap"), "the file is empty"),
        (broken(lambda b: b[:100], "short.mcap"), "truncated before anything was recorded"),
        (broken(lambda b: b.replace(*newer), "newer.mcap"), "format 9; this kinegraph reads formats up to 1"),
        (broken(lambda b: flipped(b, 150), "header.mcap"), "`kinegraph recover` rewrites what can be read"),
        (broken(lambda b: flipped(b, len(b) // 2), "middle.mcap"), "checksum is wrong"),
    ]
    for path, words in cases:
        for arguments in (("info", path), ("export", path, "-o", "out"), ("replay", made / "graph.yaml", path)):
            refused(kinegraph(*arguments), str(path), words)
    assert not any((tmp_path / "out").glob("*"))


def flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :]


def test_a_recording_that_was_cut_off_is_read_as_far_as_it_goes(
    kinegraph: Command, made: Path, broken: Callable[..., Path]
) -> None:
    for change in (lambda b: b[:-1], lambda b: b[:-1200], lambda b: flipped(b, len(b) - 2000)):
        path = broken(change)
        code, shown, _ = kinegraph("info", path)
        assert code == 0 and "kinegraph recover" in shown
        assert kinegraph("replay", made / "graph.yaml", path, "--verify", "-q")[0] == 0
        assert kinegraph("recover", path)[0] == 0
        with Recording.open(path) as recording:
            assert recording.finished and recording.streams["rect"].samples == 2000


def test_damage_anywhere_is_told_and_recovered_from(
    kinegraph: Command, broken: Callable[..., Path], tmp_path: Path
) -> None:
    """Recordings with bytes changed in their header, data or end: an error that names the file, never another."""
    chance = random.Random(5)
    recovered = 0
    for _ in range(60):
        n = (tmp_path / "broken.mcap").stat().st_size if (tmp_path / "broken.mcap").exists() else 10_000
        region = chance.choice([(8, 1400), (n - 4000, n - 8), (8, n - 8)])
        places = [chance.randrange(*region) for _ in range(chance.choice([1, 1, 3]))]

        def spoil(data: bytes, places: list[int] = places) -> bytes:
            for place in places:
                data = flipped(data, min(place, len(data) - 1))
            return data

        path = broken(spoil)
        code, _, complaint = kinegraph("info", path, "--json")
        assert code == 0 or (code == 2 and str(path) in complaint), complaint
        (tmp_path / "out.mcap").unlink(missing_ok=True)
        code, _, complaint = kinegraph("recover", path, "-o", "out.mcap")
        assert code == 0 or (code == 2 and str(path) in complaint), complaint
        recovered += code == 0
    assert recovered > 50


def test_a_recording_that_lacks_a_stream(kinegraph: Command, made: Path, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time,a\n" + "".join(f"{k / 100},{k}\n" for k in range(50)))
    assert kinegraph("import", "t.csv", "-o", "t.mcap", "--stream", "other=a", "--time", "other=time")[0] == 0
    refused(kinegraph("replay", made / "graph.yaml", "t.mcap"), "node 'rect'", "lacks the stream 'board.emg'")
    refused(kinegraph("export", "t.mcap", "--stream", "othre", "-o", "x"), "no stream 'othre'", "did you mean 'other'?")


# -- import and export -------------------------------------------------------------------------------------------------

TABLES: list[tuple[str | bytes, str]] = [
    ("", "the file is empty"),
    ("time,a\n", "there are no samples"),
    ("1,2\n3,4\n", "line 1: the first line must name the columns"),
    ("time,a\n0,1\n1,2,3\n", "line 3: 3 cells, but the header names 2 columns"),
    ("time,a\n0,1\n1\n", "line 3: 1 cells"),
    ("time,a\n0,1\n\n1,2\n", "line 3: 0 cells"),
    ("time,a\n0,1\n1,2\n1,3\n", "line 4: the time 1 s is repeated"),
    ("time,a\n0,1\n2,2\n1,3\n", "line 4: time runs backwards, from 2 s to 1 s"),
    ("time,a\n0,1\n,2\n", "line 3: 't:time' holds no time"),
    ("time,a\n0,1\n1e300,2\n", "line 3: 't:time' holds no time"),
    ("time,a\n0,x\n", "line 2: 'x' in column 'a' is no number"),
    ("time,a,a\n0,1,2\n", "every column needs a name of its own"),
    ("time\n0\n1\n", "no column for it beside the time"),
    ("a,b\n1,2\n", "when its samples were taken is not known"),
    (bytes(2000), "zero bytes"),
    (bytes(range(128, 256)), "not a text file in UTF-8"),
]


@pytest.mark.parametrize(("text", "words"), TABLES, ids=[words for _, words in TABLES])
def test_a_table_that_cannot_be(text: str | bytes, words: str, kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    refused(kinegraph("import", "t.csv", "-o", "t.mcap"), words)
    assert [p.name for p in tmp_path.iterdir()] == ["t.csv"]


WISHES = [
    (["--stream", "x=a"], "give --rate x=HZ or --time x=COLUMN"),
    (["--stream", "x=a", "--rate", "nan"], "must be a finite number"),
    (["--stream", "x=a", "--rate", "1e30"], "must be a positive number of Hz"),
    (["--stream", "x=,", "--rate", "1"], "there is no column"),
    (["--stream", "x=none", "--rate", "1"], "there is no column or array 'none'"),
    (["--stream", "x=hollow", "--rate", "1"], "has no channels"),
    (["--stream", "x=texts", "--rate", "1"], "holds no numbers"),
    (["--stream", "x=a", "--time", "texts"], "holds no time"),
    (["--stream", "x=a", "--rate", "1", "--counter", "texts"], "the counter holds something else than whole numbers"),
    (["--events", "e=texts"], "holds no time"),
    (["--stream", "x=a", "--rate", "1", "--scale", "inf"], "--scale x: inf must be a finite number"),
    (["--stream", "x=a", "--rate", "1", "--start", "9999-12-31"], "must lie between 1900 and 2100"),
    (["--stream", "x=a", "--rate", "1", "--chunk-ms", "nan"], "--chunk-ms"),
]


@pytest.mark.parametrize(("options", "words"), WISHES, ids=[words for _, words in WISHES])
def test_streams_that_cannot_be_made(options: list[str], words: str, kinegraph: Command, tmp_path: Path) -> None:
    np.savez(tmp_path / "t.npz", a=np.arange(50.0), texts=np.array(["x"] * 50), hollow=np.zeros((50, 0)))
    refused(kinegraph("import", "t.npz", "-o", "t.mcap", *options), words)
    assert [p.name for p in tmp_path.iterdir()] == ["t.npz"]


def test_files_that_are_not_what_their_names_say(kinegraph: Command, tmp_path: Path) -> None:
    junk = random.Random(1).randbytes(3000)
    for name, data in (("e.npz", b""), ("g.npz", junk), ("e.xdf", b""), ("g.xdf", junk), ("h.xdf", b"XDF:" + junk)):
        (tmp_path / name).write_bytes(data)
        refused(kinegraph("import", name, "-o", "t.mcap", "--stream", "x=a", "--rate", "1"), name)
    np.savez(tmp_path / "o.npz", a=np.array([{"a": 1}], object))
    refused(kinegraph("import", "o.npz", "-o", "t.mcap", "--stream", "x=a"), "array 'a'", "Object arrays")
    (tmp_path / "d.csv").mkdir()
    refused(kinegraph("import", "d.csv", "-o", "t.mcap"), "Is a directory")
    (tmp_path / "a").mkdir()
    for place in (tmp_path, tmp_path / "a"):
        (place / "t.csv").write_text("time,a\n0,1\n1,2\n2,3\n")
    refused(kinegraph("import", "t.csv", "a/t.csv", "-o", "t.mcap"), "has the same name; rename one")
    (tmp_path / "f.mcap").mkdir()
    refused(kinegraph("import", "t.csv", "-o", "f.mcap"), "f.mcap: is a folder")
    refused(kinegraph("import", "t.csv", "-o", "t.csv/t.mcap"), "t.csv: is a file")
    refused(kinegraph("import", "t.csv", "-o", "t"), "must end in .mcap")
    assert not (tmp_path / "t.mcap").exists()


def test_what_is_there_is_not_replaced(kinegraph: Command, made: Path, tmp_path: Path) -> None:
    whole = made / "s"
    assert kinegraph("export", whole, "-o", "tables", "--stream", "rect")[0] == 0
    table = tmp_path / "tables" / "rect.csv"
    table.write_text("mine")
    refused(kinegraph("export", whole, "-o", "tables", "--stream", "rect"), "rect.csv: is there already", "--overwrite")
    assert table.read_text() == "mine"
    assert kinegraph("export", whole, "-o", "tables", "--stream", "rect", "--overwrite")[0] == 0
    assert len(table.read_text()) > 1000
    (tmp_path / "x.xdf").write_text("mine")
    refused(kinegraph("export", whole, "-o", "x.xdf", "--format", "xdf"), "x.xdf: is there already")
    refused(kinegraph("export", whole, "-o", "x.xdf"), "x.xdf: is there already")
    (tmp_path / "rows").write_text("mine")
    refused(kinegraph("export", whole, "-o", "rows"), "rows: is a file; name a folder")
    assert kinegraph("import", table, "-o", "t.mcap")[0] == 0
    before = (tmp_path / "t.mcap").read_bytes()
    refused(kinegraph("import", table, "-o", "t.mcap"), "t.mcap: holds a recording already")
    assert (tmp_path / "t.mcap").read_bytes() == before
    refused(kinegraph("recover", whole, "-o", "t.mcap"), "holds a recording already")
    refused(kinegraph("replay", made / "graph.yaml", whole, "-o", "t.mcap"), "holds a recording already")


def test_streams_that_would_become_one_table_are_kept_apart(kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time,a\n0,1\n1,2\n2,3\n")
    both = ("--stream", "x/y=a", "--stream", "x_y=a", "--time", "time")
    assert kinegraph("import", "t.csv", "-o", "t.mcap", *both)[0] == 0
    refused(kinegraph("export", "t.mcap", "-o", "out"), "'x/y' and 'x_y' would both become out/x_y.csv")


SLOW = """
import sys, time
import stream.cli
import stream.convert.csv_write as csv_write
from stream.recording import recorder

def slowly(function):
    def call(*arguments, **options):
        time.sleep(0.005)
        return function(*arguments, **options)
    return call

csv_write._stamps = slowly(csv_write._stamps)
recorder.Recorder.write = slowly(recorder.Recorder.write)
sys.argv = ["kinegraph", *sys.argv[1:]]
stream.cli.main()
"""


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("command", ["import", "export"])
def test_killed_in_the_middle_no_half_file_bears_the_name(
    command: str, ending: signal.Signals, kinegraph: Command, made: Path, tmp_path: Path
) -> None:
    (tmp_path / "t.csv").write_text("time,a\n" + "".join(f"{k / 10},{k}\n" for k in range(20_000)))
    arguments, final = {
        "import": (["import", "t.csv", "-o", "t.mcap"], tmp_path / "t.mcap"),
        "export": (["export", str(made / "s"), "--stream", "rect", "-o", "out"], tmp_path / "out" / "rect.csv"),
    }[command]
    process = subprocess.Popen([sys.executable, "-c", SLOW, *arguments], stderr=subprocess.DEVNULL)
    wait_for(lambda: any(final.parent.glob(".*.draft*")) or process.poll() is not None)
    time.sleep(0.1)
    process.send_signal(ending)
    assert process.wait(60) == {signal.SIGKILL: -9, signal.SIGTERM: 143, signal.SIGINT: 130}[ending]
    assert not final.exists()
    if ending != signal.SIGKILL:
        assert not any(final.parent.glob(".*draft*")), "what was begun is cleared away"
    assert kinegraph(*arguments)[0] == 0 and final.exists()
    assert not any(p for p in final.parent.glob(".*draft*")), "and what a kill left, by the next try"


# -- disks -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The recorder's disk takes 20 KB."""
    room, write = 20_000, os.write

    def take(file: int, data: Any) -> int:
        nonlocal room
        if room <= 0:
            raise OSError(28, "No space left on device")
        n = write(file, data[:room])
        room -= n
        return n

    monkeypatch.setattr(part_module.os, "write", take)
    monkeypatch.setattr("stream.recording.recorder.GRACE_S", 0.2)
    yield


@pytest.mark.usefixtures("full_disk")
@pytest.mark.parametrize("command", ["import", "replay"])
def test_a_disk_that_fills_up_while_files_are_made(
    command: str, kinegraph: Command, made: Path, tmp_path: Path
) -> None:
    if command == "import":
        np.savez(tmp_path / "t.npz", a=np.random.default_rng(1).normal(size=(50_000, 2)))
        told = kinegraph("import", "t.npz", "-o", "t.mcap", "--stream", "x=a", "--rate", "1000")
        assert not (tmp_path / "t.mcap").exists()
    else:
        told = kinegraph("replay", made / "graph.yaml", made / "s", "-o", "again", "-q")
    refused(told, "not everything could be written (No space left on device)", "free some space")


@pytest.mark.usefixtures("full_disk")
def test_a_disk_that_fills_up_during_a_session(kinegraph: Command, made: Path) -> None:
    told = kinegraph("run", made / "graph.yaml", *QUIET, "-o", "s")
    refused(told, "the recording cannot be written; the session goes on", "No space left on device", code=5)


def test_a_recording_that_is_deleted_while_it_is_written_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stream.recording.recorder.SYNC_S", 0.0)
    spec = StreamSpec((1,), rate_hz=100.0)
    with Recorder(tmp_path / "s", {}, RecordingOptions(gather_s=0.01, flush_s=0.01)) as recorder:
        number = recorder.add_stream("board", spec, "input")

        def write(k: int) -> None:
            recorder.write(number, Chunk(np.array([k * NS]), np.array([[float(k)]]), k * NS), k * NS, k)
            assert recorder.flush(60.0)

        write(0)
        (tmp_path / "s").rename(tmp_path / "gone")  # at once: nothing new may appear in it meanwhile
        shutil.rmtree(tmp_path / "gone")
        for k in range(1, 50):  # the next writing notices; what comes after that is in a new part
            write(k)
    with Recording.open(tmp_path / "s") as recording:
        kept = recording.read("board")[1].ravel().tolist()
        assert recording.finished and kept[-1] == 49.0 and kept == sorted(kept)
        assert any(e["kind"] == "disk refused" and "the file was deleted" in e["error"] for e in recording.log)


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """A folder in which nobody may write, where we may mount one; it holds a file of ours."""
    place = tmp_path / "ro"
    place.mkdir()
    (place / "cal.json").write_text("{}")
    try:
        subprocess.run(["mount", "--bind", place, place], check=True, capture_output=True)
        subprocess.run(["mount", "-o", "remount,bind,ro", place, place], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("mounting a read-only folder needs root")
    yield place
    subprocess.run(["umount", "-l", place], check=True)


def test_folders_that_may_not_be_written(kinegraph: Command, made: Path, read_only: Path, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time,a\n0,1\n1,2\n2,3\n")
    graph, whole = made / "graph.yaml", made / "s"
    refused(kinegraph("run", graph, *QUIET, "-o", "ro/s"), "ro/s: cannot be created (Read-only file system)")
    refused(kinegraph("import", "t.csv", "-o", "ro/t.mcap"), "ro/t.mcap: cannot write there")
    refused(kinegraph("export", whole, "-o", "ro/out"), "ro/out: cannot be written (Read-only file system)")
    refused(kinegraph("recover", whole, "-o", "ro/t.mcap"), "cannot be written (Read-only file system)")
    refused(kinegraph("schema", "-o", "ro/s.json"), "ro/s.json cannot be written: Read-only file system")
    assert [p.name for p in read_only.iterdir()] == ["cal.json"]
