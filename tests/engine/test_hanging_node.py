"""A node that never comes back: it is named, and a second signal ends the session with what was recorded until then."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from kinegraph.stream.recording import Recording
from tests.support.command_line import BOARD, KINEGRAPH, wait_for
from tests.support.tiers import rest_nightly

NODE = '''
import ctypes
import signal
import time
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path

from kinegraph.stream.chunk import FOREVER
from kinegraph.stream.operator import Operator
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param


def in_python():
    while True:
        try:
            time.sleep(0.01)
        except BaseException:
            pass


def in_a_library():
    """Waits for a lock that it holds itself: no signal reaches the interpreter meanwhile."""
    c, mutex = ctypes.CDLL(None), ctypes.create_string_buffer(128)
    c.pthread_mutex_lock(mutex)
    c.pthread_mutex_lock(mutex)


def long():
    """In small pieces: a signal that comes just before a sleep begins does not end it. Notes the first that a replay has taken."""
    handler = signal.getsignal(signal.SIGINT)
    Path("closing").touch()
    while True:
        time.sleep(0.01)
        if signal.getsignal(signal.SIGINT) is not handler:
            Path("asked").touch()


def alone():
    """Lets no other thread run."""
    sum(repeat(0))


@dataclass(slots=True)
class State:
    samples: int


class Stuck:
    __slots__ = ()

    def process(self, port, chunk):
        self.state.samples += len(chunk.time)
        if self.state.samples > self.at:
            Path("there").touch()
            if self.how != "closing" and (self.how != "in_a_library" or chunk.until == FOREVER):
                globals()[self.how]()
        return chunk if self.outputs else None

    def close(self):
        if self.how == "closing":
            long()


@dataclass(frozen=True, slots=True)
class Node(Stuck, Operator):
    how: str = param("in_python")
    at: int = param(500)

    def open(self, specs):
        self.set_state(State(0))
        return {"out": specs["in"]}


@dataclass(frozen=True, slots=True)
class Out(Stuck, Outlet):
    how: str = param("in_python")
    at: int = param(500)

    def open(self, specs):
        self.set_state(State(0))
        return {}
'''
RUN = """
from kinegraph.stream.cli.commands import ending
ending.LOOK_S, ending.STUCK_S = %s
from kinegraph.stream.cli.main import main
main()
"""
GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill}
  stuck: {use: stuck.%s, from: board.emg, %s}
record: [board.emg]
"""


def started(folder: Path, node: str, options: str, look_s: float = 0.3, stuck_s: float = 0.1) -> subprocess.Popen[str]:
    (folder / "stuck.py").write_text(NODE)
    (folder / "g.yaml").write_text(GRAPH % (node, options))
    return subprocess.Popen(
        [sys.executable, "-c", RUN % ((look_s, stuck_s),), "run", "g.yaml", "-o", "s", "--view", "none"],
        cwd=folder, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CORE, (0, 0)),
    )  # fmt: skip


def said_until(process: subprocess.Popen[str], words: str) -> str:
    """Its output up to the line that holds these words."""
    assert process.stderr
    text = ""
    for line in process.stderr:
        text += line
        if words in line:
            return text
    raise AssertionError(f"it ended with {process.wait()}, and printed {text}")


@pytest.mark.parametrize(
    ("node", "options"),
    [
        pytest.param("Node", "how: in_python", id="on a source's thread"),
        pytest.param("Node", "how: in_python, worker: aside", id="on a worker"),
        pytest.param("Out", "how: in_python", id="in an outlet"),
    ],
)
def test_a_node_that_does_not_come_back_is_named_and_left(node: str, options: str, tmp_path: Path) -> None:
    process = started(tmp_path, node, options)
    wait_for((tmp_path / "there").exists)
    goes_on = (
        node == "Out" or "worker" in options
    )  # the rest of the graph does, so that nothing is wrong until it shall end
    text = "" if goes_on else said_until(process, "node does not return")
    process.send_signal(signal.SIGINT)
    text += said_until(process, "node does not return") if not text else ""
    assert "node=stuck" in text and "Ctrl-C" in text
    process.send_signal(signal.SIGTERM)
    ended = process.communicate(timeout=60)[1]
    assert process.returncode == 4, text + ended
    assert "node 'stuck': did not come back for" in ended and "at sample time" in ended
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished and recording.streams["board.emg"].samples > 500
        kinds = [entry["kind"] for entry in recording.log]
    assert kinds.count("node does not return") == 1 and "session failed" in kinds


def test_signals_are_heard_while_the_main_thread_is_in_a_library(tmp_path: Path) -> None:
    process = started(tmp_path, "Node", "how: in_a_library")
    wait_for((tmp_path / "there").exists)
    process.send_signal(signal.SIGTERM)
    said_until(process, "node does not return")
    process.send_signal(signal.SIGTERM)
    ended = process.communicate(timeout=60)[1]
    assert process.returncode == 4 and "node 'stuck': did not come back for" in ended, ended
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished


def test_a_second_signal_breaks_off_what_takes_long_and_closes_the_recording(tmp_path: Path) -> None:
    """As long as nothing is taken for stuck: the main thread ends what it does."""
    process = started(tmp_path, "Node", "how: closing", stuck_s=1000.0)
    wait_for((tmp_path / "there").exists)
    process.send_signal(signal.SIGINT)
    wait_for((tmp_path / "closing").exists)
    process.send_signal(signal.SIGINT)
    emitted = process.communicate(timeout=60)[1]
    assert process.returncode == 130, emitted
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished


def test_where_nothing_else_can_run_a_quit_tells_where_it_is_stuck(tmp_path: Path) -> None:
    process = started(tmp_path, "Node", "how: alone, at: 2000")
    wait_for((tmp_path / "there").exists)
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGQUIT)
    emitted = process.communicate(timeout=60)[1]
    assert process.returncode == -signal.SIGQUIT
    assert 'stuck.py", line' in emitted and "in alone" in emitted, emitted
    with Recording.open(tmp_path / "s") as recording:
        assert not recording.finished and recording.streams["board.emg"].samples > 0


@pytest.mark.parametrize("how", rest_nightly("long", "closing"))
def test_signals_break_off_a_replay(how: str, made: Path, tmp_path: Path) -> None:
    (tmp_path / "stuck.py").write_text(NODE)
    (tmp_path / "g.yaml").write_text(BOARD % 2 + f"  stuck: {{use: stuck.Node, from: board.emg, how: {how}}}\n")
    process = subprocess.Popen([KINEGRAPH, "replay", "g.yaml", made / "s"], cwd=tmp_path, stdin=subprocess.DEVNULL)
    wait_for((tmp_path / "closing").exists)
    process.send_signal(signal.SIGINT)
    wait_for((tmp_path / "asked").exists)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 130
    (tmp_path / "closing").unlink()
    command = [KINEGRAPH, "replay", "g.yaml", made / "s"]
    process = subprocess.Popen(command, cwd=tmp_path, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE)
    wait_for((tmp_path / "closing").exists)
    process.send_signal(signal.SIGTERM)
    emitted = process.communicate(timeout=60)[1]
    assert process.returncode == 143 and emitted == b"kinegraph: stopped\n", emitted


COMPILING = """
@dataclass(slots=True)
class Nothing:
    n: int = 0


@dataclass(frozen=True, slots=True)
class Slow(Operator[Nothing]):
    def open(self, specs):
        self.set_state(Nothing())
        return {{"out": specs["in"]}}
{process}
"""
COMPILES = """
    def process(self, port, chunk):
        Path("compiling").touch()
        try:
            time.sleep(60)
        except BaseException as error:
            raise ValueError("Failed in nopython mode pipeline") from error
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_while_kernels_compile_ends_at_once_and_blames_nobody(number: int, code: int, tmp_path: Path) -> None:
    """A compiler makes an error of its own of whatever is raised within it."""
    head = NODE.partition("def in_python")[0]
    (tmp_path / "slow.py").write_text(head + COMPILING.format(process=COMPILES))
    (tmp_path / "g.yaml").write_text(BOARD % 60 + "  slow: {use: slow.Slow, from: board.emg}\n")
    command = [KINEGRAPH, "run", "g.yaml", "--view", "none", "-o", "s"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True)
    try:
        wait_for(lambda: (tmp_path / "compiling").exists())
        process.send_signal(number)
        _, emitted = process.communicate(timeout=100)
    finally:
        process.kill()
    assert process.returncode == code and "stopped" in emitted and "slow" not in emitted, emitted
    assert not (tmp_path / "s").exists()
