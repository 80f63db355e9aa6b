"""Sessions that are resumed wrongly, run into each other, are ended at any moment, or print to a closed output."""

from __future__ import annotations

import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from kinegraph.stream.chunk import NS
from kinegraph.stream.recording import Recording
from kinegraph.stream.system.clock import BOOTTIME, SessionClock
from kinegraph.stream.system.memory_limit import taken
from tests.support.command_line import BOARD, KINEGRAPH, QUIET, Command, refused, shell, wait_for


def test_resuming_what_is_not_there_or_not_ours(kinegraph: Command, made: Path, tmp_path: Path) -> None:
    graph = made / "graph.yaml"
    refused(kinegraph("run", graph, *QUIET, "-o", made / "s"), "already holds a recording")
    refused(kinegraph("run", graph, *QUIET, "-o", made / "s", "--resume"), "ended normally")
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

from kinegraph.stream.chunk import Chunk, Specs
from kinegraph.stream.operator import Operator


@dataclass(slots=True)
class State:
    seen: int = 0


@dataclass(frozen=True, slots=True)
class Raises(Operator[State]):
    """Raises in the middle of the stream."""

    def open(self, specs: Specs) -> Specs:
        self.set_state(State())
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
    output = kinegraph("run", "g.yaml", *QUIET, "-o", "s")
    refused(output, "bad", "ZeroDivisionError", "division by zero", code=4)
    assert re.search(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d", output[2]), "the sample's time is named"
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished and recording.streams["board.emg"].samples > 1000
        assert recording.streams["bad"].samples <= 1000


@pytest.mark.parametrize(
    ("nonsense", "words"),
    [
        ("sys.exit(0)", ["node 'bad'", "SystemExit"]),
        ("raise KeyboardInterrupt", ["node 'bad'", "KeyboardInterrupt", "at sample time"]),
        ("raise BaseException('of its own')", ["node 'bad'", "BaseException: of its own", "at sample time"]),
        ("return 'hello'", ["node 'bad'", "gave back a str", "a Chunk", "'out'"]),
        ("return [('ouch', chunk)]", ["node 'bad'", "gave back a list", "'ouch'", "'out'"]),
        ("return self.process(port, chunk)", ["node 'bad'", "RecursionError"]),
    ],
)
def test_an_operator_that_returns_nonsense(nonsense: str, words: list[str], kinegraph: Command, tmp_path: Path) -> None:
    module = re.sub(r"\W", "", nonsense)
    text = RAISES.replace('raise ZeroDivisionError("division by zero")', nonsense)
    (tmp_path / f"{module}.py").write_text("import sys\n" + text.lstrip())
    (tmp_path / "g.yaml").write_text(BOARD % 2 + f"  bad: {{use: {module}.Raises, from: board.emg}}\nrecord: [bad]\n")
    refused(kinegraph("run", "g.yaml", *QUIET, "-o", "s"), *words, code=4)
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished and recording.streams["bad"].samples <= 1000


@pytest.mark.parametrize("where", ["open", "close"])
@pytest.mark.parametrize("error", ["KeyboardInterrupt", "BaseException('of its own')", "SystemExit(0)"])
def test_what_an_operator_raises_elsewhere_ends_nothing_else(
    where: str, error: str, kinegraph: Command, tmp_path: Path
) -> None:
    module = re.sub(r"\W", "", f"{where}{error}")
    text = RAISES.replace('raise ZeroDivisionError("division by zero")', "pass")
    closing = f"\n    def close(self) -> None:\n        if self.state.seen > 1000:\n            raise {error}\n"
    text = (
        text.replace("self.set_state", f"raise {error}\n        self.set_state") if where == "open" else text + closing
    )
    (tmp_path / f"{module}.py").write_text(text)
    (tmp_path / "g.yaml").write_text(BOARD % 2 + f"  bad: {{use: {module}.Raises, from: board.emg}}\n")
    output = kinegraph("run", "g.yaml", *QUIET, "-o", "s")
    refused(output, "node 'bad'", error.partition("(")[0], code=2 if where == "open" else 4)
    if where == "close":
        with Recording.open(tmp_path / "s") as recording:
            assert recording.finished and recording.streams["board.emg"].samples == 2000


def test_an_operator_that_grows_without_bound_is_named_before_the_memory_is_gone(
    kinegraph: Command, tmp_path: Path
) -> None:
    text = RAISES.replace("seen: int = 0", "seen: int = 0\n    kept: list[np.ndarray] = field(default_factory=list)")
    text = text.replace("import dataclass", "import dataclass, field")
    text = text.replace('raise ZeroDivisionError("division by zero")', "self.state.kept.append(np.ones(1 << 18))")
    (tmp_path / "growing.py").write_text(text)
    board = (BOARD % 60).replace("realtime: false, ", "")
    most = round(taken() / 1e6) + 60
    (tmp_path / "g.yaml").write_text(f"memory_mb: {most}\n{board}  bad: {{use: growing.Raises, from: board.emg}}\n")
    refused(kinegraph("run", "g.yaml", *QUIET, "-o", "s"), "node 'bad' has grown by", f"at most {most} MB", code=7)
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished and recording.streams["board.emg"].samples > 1000


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a limit that Linux keeps")
def test_one_call_that_asks_for_all_memory_is_refused_and_named(kinegraph: Command, tmp_path: Path) -> None:
    text = RAISES.replace('raise ZeroDivisionError("division by zero")', "np.ones(1 << 29)")
    (tmp_path / "greedy.py").write_text(text)
    board = (BOARD % 60).replace("realtime: false, ", "")
    most = round(taken() / 1e6) + 60
    (tmp_path / "g.yaml").write_text(f"memory_mb: {most}\n{board}  bad: {{use: greedy.Raises, from: board.emg}}\n")
    refused(
        kinegraph("run", "g.yaml", *QUIET, "-o", "s"), "node 'bad' asked for more memory than memory_mb leaves", code=7
    )
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished and recording.streams["board.emg"].samples


def test_stamps_within_a_chunk_that_run_backwards_are_found_by_verify(kinegraph: Command, tmp_path: Path) -> None:
    """Live, the ends of a chunk's stamps are checked; what lies between them, a replay that is asked to."""
    given = "replace(chunk, time=np.concatenate([chunk.time[:1], chunk.time[-2:0:-1], chunk.time[-1:]]))"
    text = RAISES.replace('raise ZeroDivisionError("division by zero")', f"return {given}")
    (tmp_path / "inner.py").write_text("from msgspec.structs import replace\n" + text.lstrip())
    board = (BOARD % 2).replace(
        "realtime: false, ", ""
    )  # at its pace, so that it is recorded in several pieces, and replayed so
    (tmp_path / "g.yaml").write_text(board + "  bad: {use: inner.Raises, from: board.emg}\nrecord: [bad]\n")
    assert kinegraph("run", "g.yaml", *QUIET, "-o", "s")[0] == 0
    code, output, _ = kinegraph("replay", "g.yaml", "s", "--verify", "-q")
    assert code == 1 and "bad: BREAKS ITS SPEC" in output and "stamps that run backwards" in output, output


def test_two_sessions_on_one_output(kinegraph: Command, made: Path, tmp_path: Path) -> None:
    text = (BOARD % 0).replace("realtime: false, ", "")
    text += "  out: {use: devices.outlets.csv_file.CsvFile, from: board.emg, path: out.csv}\n"
    (tmp_path / "g.yaml").write_text(text)
    first = subprocess.Popen(
        [KINEGRAPH, "run", "g.yaml", "-o", "s", *QUIET], stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True
    )
    try:
        wait_for(lambda: (tmp_path / "s").is_dir() and (tmp_path / "out.csv").exists())
        refused(kinegraph("run", "g.yaml", *QUIET, "-o", "s", "--for", 1), "another kinegraph is recording there")
        refused(kinegraph("run", "g.yaml", *QUIET, "-o", "s", "--resume"), "another kinegraph is still recording there")
        refused(kinegraph("recover", "s"), "is being recorded now")
        code, _, complaint = kinegraph("run", "g.yaml", *QUIET, "-o", "other", "--for", 1)
        assert code == 0 or (code == 3 and "out.csv" in complaint), "another file, or an error that names it"
        (tmp_path / "g.yaml").write_text("garbage: [")
    finally:
        first.send_signal(signal.SIGTERM)
        reported = first.communicate(timeout=60)[1]
    assert first.returncode == 0, reported
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished and recording.header["graph"] == text, "the graph as it ran, not as it was edited"


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
    _, emitted = process.communicate(timeout=60)
    assert "Traceback" not in emitted
    if moment == "start":
        assert process.returncode in (0, 143, -signal.SIGTERM)
    elif moment == "warm-up":
        assert process.returncode in (0, 143), emitted
    else:
        assert process.returncode == 0, emitted
    if process.returncode == 0 and moment != "start":
        with Recording.open(tmp_path / "s") as recording:
            assert recording.finished
    assert not list(tmp_path.glob("s/.*")), "no lock and no trial file is left"


@pytest.mark.skipif(shutil.which("setsid") is None, reason="no setsid here (Linux has it: util-linux)")
def test_a_terminal_that_goes_away_leaves_a_whole_session(tmp_path: Path) -> None:
    """As when its window is closed: a hang-up is reported, and nothing can be read or written there any more."""
    (tmp_path / "g.yaml").write_text((BOARD % 0).replace("realtime: false, ", ""))
    ours, theirs = pty.openpty()
    command = ["setsid", "-c", str(KINEGRAPH), "run", "g.yaml", "-o", "s"]
    process = subprocess.Popen(command, cwd=tmp_path, stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    end = time.monotonic() + 60
    while time.monotonic() < end and not any((tmp_path / "s").glob("session.*")):
        if select.select([ours], [], [], 0.05)[0]:
            os.read(ours, 65536)
    os.close(ours)
    assert process.wait(60) == 0
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished


@pytest.mark.parametrize("ignored", [False, True])
def test_a_terminal_that_is_closed_ends_a_session_in_order(ignored: bool, tmp_path: Path) -> None:
    """Not one that `nohup` started."""
    (tmp_path / "g.yaml").write_text((BOARD % 2).replace("realtime: false, ", ""))
    process = subprocess.Popen(
        [*(["nohup"] if ignored else []), KINEGRAPH, "run", "g.yaml", "-o", "s"],
        cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    wait_for(lambda: any((tmp_path / "s").glob("session.*")))
    for _ in range(2):
        process.send_signal(signal.SIGHUP)
    assert process.wait(60) == 0
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished and (recording.streams["board.emg"].samples == 2000) == ignored


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
    assert done.returncode == 0 and "no longer shown" in done.stderr
    for name in "ab":
        with Recording.open(tmp_path / name) as recording:
            assert recording.finished and recording.streams["rect"].samples == 2000
    done = shell(f"{KINEGRAPH} info a --json | head -1; echo ${{PIPESTATUS[0]}}", tmp_path)
    assert done.stdout in ("{\n141\n", "{\n0\n"), "1 would say that a comparison found a difference"
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}
    assert shell(f"{KINEGRAPH} draw {made / 'graph.yaml'}", tmp_path, ascii_only).returncode == 0


def test_a_cache_that_cannot_be_written_says_what_to_do(made: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    run = f"{KINEGRAPH} run {made / 'graph.yaml'} --view none"
    done = shell(run, tmp_path, {"KINEGRAPH_CACHE": str(tmp_path / "file")})
    assert done.returncode == 2 and "set KINEGRAPH_CACHE to a folder that can be written" in done.stderr


def test_a_machine_that_was_suspended_leaves_a_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    """Linux' monotonic clock stands still meanwhile; what comes afterwards is recorded at the time that it is, as if it had not."""
    if BOOTTIME is None:
        pytest.skip("this system's monotonic clock goes on while it is suspended, or there is no clock that does")
    clock, gettime = SessionClock(), time.clock_gettime_ns
    before, anchor = clock.now(), clock.to_json()
    monkeypatch.setattr(time, "clock_gettime_ns", lambda which: gettime(which) + 600 * NS)
    stamped_before = time.monotonic_ns() - NS
    after = clock.now()
    assert 600 * NS <= after - before < 660 * NS
    assert 599 * NS <= clock.at(stamped_before) - before < 660 * NS and clock.now() >= after
    assert clock.to_json() == anchor
