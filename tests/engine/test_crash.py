"""Killed without warning, at any moment: what was recorded is there, and `--resume` goes on where it was, nothing doubled or missing."""

from __future__ import annotations

import csv
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.lines.indexed_simulator import Indexed
from kinegraph.stream.engine.replay import Replay
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.format import checkpoint
from kinegraph.stream.recording.format.checkpoint import Checkpoint
from tests.support import SUPPORT
from tests.support.tiers import rest_nightly

GRAPH = """
checkpoint_s: 0.3
record: [sum, slow, crest.interval]
recording: {flush_s: 0.2}
nodes:
  board: {use: parts.Counting, samples: 1000000, realtime: true}
  crest: {use: operators.filters.threshold.Threshold, from: board, channel: wave, level: 0.5}
  sum: {use: parts.RunningSum, from: board}
  slow: {use: parts.RunningSum, from: board, worker: side}
  table: {use: devices.outlets.csv_file.CsvFile, from: sum, path: PATH}
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "graph.yaml"
    path.write_text(GRAPH.replace("PATH", str(tmp_path / "table.csv")))
    (tmp_path / "parts.py").symlink_to(SUPPORT / "parts.py")
    return path


def live(config: Path, folder: Path, *options: str) -> subprocess.Popen[str]:
    """Start a session as a process and wait until it goes."""
    process = subprocess.Popen(
        [sys.executable, str(SUPPORT / "night.py"), str(config), str(folder), *options],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout
    assert process.stdout.readline() == "going\n"
    return process


def wait_for(process: subprocess.Popen[str], folder: Path, samples: int) -> None:
    """Until so many samples are on the disk."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            with Recording.open(folder) as recording:
                if recording.last_samples("board") >= samples:
                    return
        except KinegraphError:
            pass
        time.sleep(0.1)
    process.kill()
    raise AssertionError("nothing was recorded within a minute")


def kill(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.wait()
    assert process.stdout
    process.stdout.close()


def end(process: subprocess.Popen[str]) -> None:
    """Ended as a person would."""
    process.send_signal(signal.SIGTERM)
    process.wait(60)
    assert process.stdout
    process.stdout.close()
    assert process.returncode == 0


def check_whole(folder: Path, config: Path) -> None:
    """What is recorded is gapless in itself, agrees with a replay of all of it, and the table agrees with the recording."""
    with Recording.open(folder) as recording:
        times, board = recording.read("board")
        sums = recording.read("sum")[1]
        assert (np.diff(times) > 0).all()
        for name in recording.streams:
            watermarks = [chunk.until for chunk in recording.chunks(name)]
            assert watermarks == sorted(watermarks), f"{name}: recorded once more after the session was resumed"
        n = min(len(board), len(sums))
        assert n > 500
        finished = recording.finished
        np.testing.assert_array_equal(np.cumsum(board[:n, 0]), sums[:n, 0])
        graph = load(config, recorded={name: s.spec for name, s in recording.streams.items()})
        assert Replay(graph, recording).run().differing == []
    with (config.parent / "table.csv").open() as file:
        rows = list(csv.reader(file))
    written = [
        float(row[-2]) for row in rows if row and row[-1].replace(".", "").replace("-", "").replace("e", "").isdigit()
    ]
    assert len(written) > 200
    n = min(len(written), len(sums))  # what was last handed to the disk may have reached one file and not the other
    assert abs(len(written) - len(sums)) < 1000
    np.testing.assert_array_equal(written[:n], sums[:n, 0])
    if finished:
        assert len(written) == len(sums) == len(board)


def test_killed_while_recording(config: Path, tmp_path: Path) -> None:
    folder = tmp_path / "s"
    process = live(config, folder)
    wait_for(process, folder, 1200)
    kill(process)
    with Recording.open(folder) as recording:
        assert not recording.finished
    check_whole(folder, config)


def test_killed_and_resumed_three_times(config: Path, tmp_path: Path) -> None:
    folder = tmp_path / "s"
    process = live(config, folder)
    wait_for(process, folder, 900)
    kill(process)
    for again in range(3):
        with Recording.open(folder) as recording:
            before = recording.last_samples("board")
        process = live(config, folder, "--resume")
        wait_for(process, folder, before + 600)
        kill(process)
        check_whole(folder, config)
        with Recording.open(folder) as recording:
            gaps = [chunk.lost for chunk in recording.chunks("board") if chunk.lost]
            assert gaps == [-1] * (again + 1)
            kinds = [entry["kind"] for entry in recording.log]
            assert kinds.count("session resumed") == again + 1
    process = live(config, folder, "--resume")
    wait_for(process, folder, before + 900)
    end(process)
    check_whole(folder, config)


def test_resumed_while_a_cable_is_out(config: Path, tmp_path: Path) -> None:
    """The others go on at once, however long a device is away that was there before, and nothing of theirs is lost."""
    folder = tmp_path / "s"
    with Indexed(rate_hz=100.0).serving() as port:
        text = config.read_text()
        lines = (
            f"nodes:\n  lines: {{use: devices.lines.AsciiLines, port: {port}, columns: [i, t, n], deadline_s: 0.5}}\n"
        )
        config.write_text(text.replace("nodes:\n", lines))
        process = live(config, folder)
        wait_for(process, folder, 900)
        kill(process)
    with Recording.open(folder) as recording:
        before, of_lines = recording.last_samples("board"), recording.last_samples("lines")
    assert of_lines > 10
    process = live(config, folder, "--resume")
    wait_for(process, folder, before + 3000)
    end(process)
    with Recording.open(folder) as recording:
        failed = [entry for entry in recording.log if entry["kind"] == "source failed"]
        assert failed and "does not exist" in failed[-1]["error"]
        numbers = np.sort(recording.read("board")[1][before:, 0])
        assert numbers[0] == 0 and (np.diff(numbers) == 1).all(), "a device that counts from 0 when it is opened"
    check_whole(folder, config)


def test_killed_while_a_checkpoint_is_written(config: Path, tmp_path: Path) -> None:
    folder = tmp_path / "s"
    process = live(config, folder, "--slow-checkpoints")
    wait_for(process, folder, 1500)
    assert process.stdout
    assert process.stdout.readline() == "writing checkpoint\n"
    kill(process)
    process = live(config, folder, "--resume")
    wait_for(process, folder, 2500)
    kill(process)
    check_whole(folder, config)


@pytest.mark.parametrize("after_s", rest_nightly(0.0, 0.2, 0.5, 1.0))
def test_killed_while_resuming(after_s: float, config: Path, tmp_path: Path) -> None:
    folder = tmp_path / "s"
    process = live(config, folder)
    wait_for(process, folder, 1500)
    kill(process)
    process = live(config, folder, "--resume")
    time.sleep(after_s)
    kill(process)
    with Recording.open(folder) as recording:
        before = recording.last_samples("board")
    process = live(config, folder, "--resume")
    wait_for(process, folder, before + 500)
    kill(process)
    check_whole(folder, config)


DROPPING = """
checkpoint_s: CHECKPOINT
record: [slow]
recording: {flush_s: 0.2}
nodes:
  board: {use: parts.Counting, samples: 1000000, realtime: true}
  other: {use: parts.Counting, samples: 1000000, realtime: true, key: other, chunk: 3}
  both: {use: parts.Beside, from: {a: board, b: other}}
  slow: {use: parts.RunningSum, from: both, worker: side, slow_s: 0.01, queue: 1, policy: drop_oldest}
"""


@pytest.mark.parametrize("checkpoint_s", [0.3, 60])
@pytest.mark.nightly
def test_killed_while_a_lane_drops(checkpoint_s: float, config: Path, tmp_path: Path) -> None:
    """What a queue drops after the session was resumed stands in the log by its place in all that ever came."""
    config.write_text(DROPPING.replace("CHECKPOINT", str(checkpoint_s)))
    folder = tmp_path / "s"
    process = live(config, folder)
    wait_for(process, folder, 500)
    kill(process)
    with Recording.open(folder) as recording:
        before = recording.last_samples("board")
    process = live(config, folder, "--resume")
    wait_for(process, folder, before + 500)
    end(process)
    with Recording.open(folder) as recording:
        kinds = [entry["kind"] for entry in recording.log]
        assert "queue dropped" in kinds[: (resumed := kinds.index("session resumed"))]
        assert "queue dropped" in kinds[resumed:]
        assert Replay(load(config), recording).run().differing == []


def test_another_graph_cannot_resume_a_session(config: Path, tmp_path: Path) -> None:
    folder = tmp_path / "s"
    process = live(config, folder)
    wait_for(process, folder, 500)
    kill(process)
    config.write_text(config.read_text() + "\n# changed\n")
    with pytest.raises(KinegraphError, match="was recorded with another graph"):
        Session(load(config), folder, resume=True)


OWN = """
from dataclasses import dataclass

from own_filters import doubled
from kinegraph.stream.operator import Operator


@dataclass(slots=True)
class State:
    sum: float = 0.0


@dataclass(frozen=True, slots=True)
class Sum(Operator[State]):
    def open(self, specs):
        self.set_state(State())
        return {"out": specs["in"]}

    def process(self, port, chunk):
        self.state.sum += doubled(chunk.data.sum())
        return chunk
"""
OWN_FILTERS = "def doubled(x):\n    return 2 * x\n"
RESUMED = """
import sys
from pathlib import Path
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import load
try:
    Session(load(Path("graph.yaml")), Path("s"), resume=True)
except KinegraphError as error:
    sys.exit(str(error))
"""


@pytest.mark.parametrize(("changed", "refused"), [("own.py", True), ("own_filters.py", True), ("unrelated.py", False)])
def test_a_session_of_which_the_code_has_changed_is_refused(changed: str, refused: bool, tmp_path: Path) -> None:
    """Under the same version, too: a file of the operator's, or one that its methods call."""
    for name, text in (("own.py", OWN), ("own_filters.py", OWN_FILTERS), ("unrelated.py", "")):
        (tmp_path / name).write_text(text)
    graph = tmp_path / "graph.yaml"
    graph.write_text(
        "nodes:\n  board: {use: devices.people.treadmill.Treadmill}\n  own: {use: own.Sum, from: board.emg}\n"
    )
    process = live(graph, tmp_path / "s")
    deadline = time.monotonic() + 60
    while not (tmp_path / "s" / checkpoint.NAME).exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    kill(process)
    (tmp_path / changed).write_text((tmp_path / changed).read_text() + "\nADDED = 1\n")
    done = subprocess.run([sys.executable, "-c", RESUMED], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == (1 if refused else 0), done.stderr
    if refused:
        assert "another version of the code of node 'own' (own.Sum)" in done.stderr
        assert "can be replayed: start a new session" in done.stderr


def test_a_session_that_ended_well_cannot_be_resumed(config: Path, tmp_path: Path) -> None:
    outcome = Session(load(config), tmp_path / "s", duration_s=1.0).run()
    assert outcome.exit_code == 0
    with pytest.raises(KinegraphError, match="ended normally"):
        Session(load(config), tmp_path / "s", resume=True)


@pytest.mark.parametrize("what", ["the format", "kinegraph"])
def test_a_checkpoint_of_another_version_is_refused_with_what_to_do(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After an upgrade the same names may mean something else."""
    with monkeypatch.context() as older:
        older.setattr(
            checkpoint, *(("VERSION", checkpoint.VERSION - 1) if what == "the format" else ("release", lambda: "0.0.9"))
        )
        Checkpoint(3, 5, "g", {"board": 5}, arrays={"n.z": np.zeros(2)}).save(tmp_path)
        assert Checkpoint.load(tmp_path)
    with pytest.raises(KinegraphError, match=r"another version of kinegraph .*can be replayed: start a new session"):
        Checkpoint.load(tmp_path)


def test_a_damaged_checkpoint_is_named(tmp_path: Path) -> None:
    (tmp_path / "checkpoint.npz").write_bytes(b"not a checkpoint")
    with pytest.raises(KinegraphError, match="is damaged"):
        Checkpoint.load(tmp_path)
