"""The page: how old a sample is when a client has it, what the page costs the session, meshes, and how soon an hour can be looked at.

    python -m bench.page

A board of 16 channels at 2000 Hz in 10-sample chunks, its envelope, and an operator that notes how old samples are there; the
session is a process of its own; the client whose messages are timed is a headless WebSocket client in this one, those beside it are in
another of low priority, for people look from machines of their own. Rounds without a page (twice: what these differ by is noise), with
one client, five, twenty, one that reads nothing, and a server that is killed every second take turns; so do timeflux_ui and the Foxglove
SDK's server, where they install. Processor time is of the session's process and of the server's, by their own clocks. `--write` puts it
all into docs/page.md.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from bench.report import Goal, Section, marks, publish, short, whole
from devices.outlets.page.wire import decode
from stream.chunk import NS, Chunk, Specs, StreamSpec, grid
from stream.mesh import Topology
from stream.operator import Operator
from stream.params import param
from stream.source import Feed, Source

HOUSE = Path(__file__).resolve().parent.parent
RATE_HZ, CHANNELS, CHUNK = 2000, 16, 10
VERTICES, MESHES_HZ = 8431, 30.0
WARM_S = 2.0
"""What comes in the first seconds is left out."""
PATIENCE_S = 60.0
PROCESS_CLOCK = 2
"""CPUCLOCK_SCHED: of the clocks that Linux keeps of a process, the exact one."""
BOARD = StreamSpec((CHANNELS,), rate_hz=float(RATE_HZ), channels=tuple(f"c{k}" for k in range(CHANNELS)), units=("uV",))
GRAPH = """
nodes:
  board: {use: bench.page.Board}
  envelope: {use: operators.emg.Envelope, from: board}
  rectified: {use: operators.rectify.Rectify, from: board}
  aged: {use: bench.page.Aged, from: rectified, path: AGES}
"""
MESH = "nodes:\n  mesh: {use: bench.page.Meshes}\n"


@dataclass(frozen=True, slots=True)
class Board(Source):
    """Noise, as a board would send it."""

    live: ClassVar[bool] = True

    def specs(self) -> Specs:
        return {"out": BOARD}

    def read(self, feed: Feed) -> None:
        data = np.random.default_rng(1).normal(scale=50, size=(CHUNK, CHANNELS))
        begun = feed.now()
        feed.ready()
        for k in count():
            time_ns = grid(RATE_HZ, CHUNK, start_ns=begun + k * CHUNK * NS // RATE_HZ)
            if feed.wait(max(0, int(time_ns[-1]) - feed.now()) / NS) or feed.stopped:
                return
            feed.emit(Chunk(time_ns, data.copy(), int(time_ns[-1])))


@dataclass(frozen=True, slots=True)
class Meshes(Source):
    """A sheet that waves."""

    live: ClassVar[bool] = True

    def specs(self) -> Specs:
        faces = np.arange(3 * (VERTICES // 3), dtype=np.int32).reshape(-1, 3)
        return {"out": Topology(VERTICES, faces).spec(MESHES_HZ)}

    def read(self, feed: Feed) -> None:
        sheet = np.random.default_rng(1).normal(size=(VERTICES, 3))
        begun = feed.now()
        feed.ready()
        for k in count():
            stamp = begun + round(k * NS / MESHES_HZ)
            if feed.wait(max(0, stamp - feed.now()) / NS) or feed.stopped:
                return
            feed.emit(Chunk(np.array([stamp]), (sheet + np.sin(k / 10))[None], stamp))


@dataclass(slots=True)
class Ages:
    """What was noted."""

    seen: int = 0


@dataclass(frozen=True, slots=True)
class Aged(Operator[Ages]):
    """Notes how old the last sample of each chunk is (wall clock: a bench's operator, no part of any graph that is replayed)."""

    path: str = param("", help="where the ages go")
    ages: ClassVar[list[int]] = []

    def open(self, specs: Specs) -> Specs:
        self.hold(Ages())
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> None:
        if len(chunk.time):
            if len(self.ages) == RATE_HZ // CHUNK:  # a second of them: what came before was the warm-up's
                Path(self.path).with_suffix(".begun").touch()
            self.ages.append(time.time_ns() - int(chunk.time[-1]))

    def close(self) -> None:
        Path(self.path).write_text(json.dumps(self.ages))


@dataclass(slots=True)
class Turn:
    """What one turn of a session came to.

    ages        ms, of every message of the first client: of its last sample, when it was there
    graph       ms, of every chunk at the graph's last operator
    begun       set when the first message is there
    session, server   share of a processor
    updates     messages per second
    """

    ages: list[float] = field(default_factory=list)
    graph: list[float] = field(default_factory=list)
    begun: threading.Event = field(default_factory=threading.Event)
    session: float = 0.0
    server: float = 0.0
    updates: float = 0.0


def cpu_s(pid: int) -> float:
    """Processor time of a process so far, children apart, to the nanosecond (Linux's clock of another process); 0 for one that is gone."""
    try:
        return time.clock_gettime(~pid << 3 | PROCESS_CLOCK)
    except OSError:
        return 0.0


@contextmanager
def session(folder: Path, graph: str, *, page: bool) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A session, ended by Ctrl-C; its page's address."""
    (folder / "g.yaml").write_text(graph.replace("AGES", str(folder / "ages.json")))
    log = folder / "said.txt"
    command = [sys.executable, "-m", "stream", "run", str(folder / "g.yaml"), "--no-record", "--view", "none"]
    environment = {**os.environ, "PYTHONPATH": str(HOUSE)}
    with log.open("wb") as said, subprocess.Popen(
        [*command, *(["--page-at", ":0"] if page else [])], cwd=folder, stdout=said, stderr=said, stdin=subprocess.DEVNULL, env=environment
    ) as process:  # fmt: skip
        try:
            found, begun = None, folder / "ages.begun"
            while (page and not (found := re.search(r"page: http(\S+)", log.read_text()))) or not (
                "AGES" not in graph or begun.exists()
            ):
                if process.poll() is not None:
                    raise RuntimeError(log.read_text())
                time.sleep(0.1)
            yield process, f"ws{found[1]}socket" if found else ""
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(30)


def looks(client: ClientConnection, width_ns: int) -> None:
    """See all streams."""
    hello, _ = decode(client.recv(decode=False))
    client.send(json.dumps({"do": "see", "streams": {str(i): width_ns for i in range(len(hello["streams"]))}}))


def watch(url: str, turn: Turn, kind: str, stop: threading.Event) -> None:
    """Take messages, and note how old the newest sample of each is."""
    with connect(url, max_size=None, compression=None, ping_interval=None) as client:
        hello, _ = decode(client.recv(decode=False))
        client.send(json.dumps({"do": "see", "streams": {"0": 0}}))
        began = float("inf")
        while not stop.is_set():
            try:
                header, numbers = decode(client.recv(timeout=PATIENCE_S, decode=False))
            except (TimeoutError, ConnectionClosed):
                return
            if header["t"] != kind:
                continue
            if not turn.begun.is_set():
                began = time.monotonic()
                turn.begun.set()
            if time.monotonic() - began < WARM_S:
                continue
            at = header["at"] if kind == "mesh" else float(np.frombuffer(numbers, np.float64, header["n"])[-1])
            turn.ages.append(1000 * (time.time() - hello["t0_ms"] / 1000 - at))


def stall(url: str, stop: threading.Event) -> None:
    """See everything, and read none of it."""
    with connect(url, max_size=None, max_queue=1, compression=None, ping_interval=None) as client:
        looks(client, 0)
        stop.wait()


def servers(process: subprocess.Popen[bytes]) -> list[int]:
    """The processes that a session has started."""
    told = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True, check=False)
    return [*map(int, told.stdout.split())]


def kill(process: subprocess.Popen[bytes], stop: threading.Event) -> None:
    """End the page's server every second."""
    while not stop.wait(1.0):
        for pid in servers(process):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


def take_turn(graph: str, kind: str, clients: int, seconds: float, *, page: bool = True, harm: str = "") -> Turn:
    """One session with so many clients; `harm`: one more "stalls", or the server is "killed" again and again."""
    from bench.page_clients import company

    turn, stop = Turn(), threading.Event()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        with session(folder, graph, page=page) as (process, url):
            stack.enter_context(company(url, clients - 1 if clients else 0))
            jobs: list[tuple[Callable[..., None], tuple[Any, ...]]]
            jobs = [(watch, (url, turn, kind, stop))] if clients else []
            jobs += (
                [(stall, (url, stop))] if harm == "stalls" else [(kill, (process, stop))] if harm == "killed" else []
            )
            threads = [threading.Thread(target=job, args=given) for job, given in jobs]
            for thread in threads:
                thread.start()
            if clients:
                turn.begun.wait(PATIENCE_S)
            time.sleep(WARM_S)
            turn.session, turn.server, lasted = shares(process, seconds)
            stop.set()
            for thread in threads:
                thread.join()
        turn.updates = len(turn.ages) / lasted
        ages = folder / "ages.json"
        turn.graph = [age / 1e6 for age in json.loads(ages.read_text())[RATE_HZ // CHUNK :]] if ages.exists() else []
    return turn


def shares(process: subprocess.Popen[bytes], seconds: float) -> tuple[float, float, float]:
    """Processor time of a session and of its servers over so many seconds, as shares of a core, and how long that was."""
    pids = [process.pid, *servers(process)]
    before, began = [cpu_s(pid) for pid in pids], time.monotonic()
    time.sleep(seconds)
    lasted = time.monotonic() - began
    own, *others = [max(0.0, cpu_s(pid) - then) / lasted for pid, then in zip(pids, before, strict=True)]
    return own, sum(others), lasted


KINDS: dict[str, dict[str, Any]] = {
    "no page": {"page": False, "clients": 0},
    "a page, nobody looks": {"clients": 0},
    "one client": {"clients": 1},
    "five clients": {"clients": 5},
    "twenty clients": {"clients": 20},
    "one client, and one that reads nothing": {"clients": 1, "harm": "stalls"},
    "the server killed every second": {"clients": 0, "harm": "killed"},
    "no page, again": {"page": False, "clients": 0},
}


def live(rounds: int, seconds: float) -> Section:
    """Every kind of company, in turns."""
    turns: dict[str, list[Turn]] = {name: [] for name in KINDS}
    for _ in range(rounds):
        for name, kind in KINDS.items():
            turns[name].append(take_turn(GRAPH, "signal", seconds=seconds, **kind))
    none = [float(np.percentile(t.graph, 99)) for t in turns["no page"]]
    against = {
        name: float(np.median([np.percentile(t.graph, 99) / p99 for t, p99 in zip(taken, none, strict=True)]))
        for name, taken in turns.items()
    }
    header = ["", "graph ms p50, p99", "p99 against none", "client ms p50, p99", "updates/s", "session %", "server %"]
    rows = [row(name, taken, against[name]) for name, taken in turns.items()]
    noise = apart(float(np.percentile(turn.graph, 99)) for turn in [*turns["no page"], *turns["no page, again"]])
    cost = apart(turn.session for turn in [*turns["no page"], *turns["no page, again"]])
    notes = [
        f"Without a page the turns' p99 differ by up to {short(noise)} times, their processor time by up to {short(cost)} times."
    ]
    return Section(
        f"The page of 16 channels at 2000 Hz, {rounds} rounds of {seconds:g} s",
        header,
        rows,
        notes,
        promises(turns, against, noise),
    )


def apart(values: Iterable[float]) -> float:
    """How many times the largest is the smallest."""
    found = [*values]
    return max(found) / min(found)


def row(name: str, taken: list[Turn], against: float) -> list[str]:
    """A line of the table."""
    ages, graph = np.concatenate([t.ages for t in taken]), np.concatenate([t.graph for t in taken])
    middle = [100 * float(np.median([getattr(t, what) for t in taken])) for what in ("session", "server")]
    seen = [both(ages), short(float(np.median([t.updates for t in taken])))] if len(ages) else ["", ""]
    return [name, both(graph), short(against), *seen, *map(short, middle)]


def both(values: Any) -> str:
    """The median and the 99th percentile."""
    return f"{short(float(np.percentile(values, 50)))}, {short(float(np.percentile(values, 99)))}"


def promises(turns: dict[str, list[Turn]], against: dict[str, float], noise: float) -> list[Goal]:
    """What was promised of all that."""
    none, one, five = (turns[name] for name in ("no page", "one client", "five clients"))
    ages = np.concatenate([t.ages for t in one])
    ratio = float(np.median([a.session / b.session for a, b in zip(one, none, strict=True)]))
    harmless = [name for name in KINDS if name.startswith(("twenty", "one client, and", "the server killed"))]
    return [
        Goal("page: sample to message, p50", float(np.percentile(ages, 50)), 40, "ms"),
        Goal("page: sample to message, p99", float(np.percentile(ages, 99)), 100, "ms"),
        Goal("page: updates", float(np.median([t.updates for t in one])), 29.0, "/s", least=True),
        Goal("page: session's processor time with one client, against none", ratio, 1.1, "times"),
        Goal("page: graph's p99 latency with one client, against none", against["one client"], 1.1, "times"),
        *(
            Goal(f"page: graph's p99 latency, {name}, against none", against[name], max(1.1, noise), "times")
            for name in harmless
        ),
        Goal("page: server, one client", 100 * float(np.median([t.server for t in one])), 10, "% of a core"),
        Goal("page: server, five clients", 100 * float(np.median([t.server for t in five])), 25, "% of a core"),
    ]


def meshes(seconds: float) -> Section:
    """One client, every mesh."""
    turn = take_turn(MESH, "mesh", 1, seconds)
    ages = [short(float(np.percentile(turn.ages, q))) for q in (50, 99)]
    row = [
        f"{VERTICES} vertices at {MESHES_HZ:g}/s",
        ", ".join(ages),
        short(turn.updates),
        short(100 * turn.session),
        short(100 * turn.server),
    ]
    goal = Goal("page: meshes to a client", turn.updates, 29.0, "/s", least=True)
    return Section("Meshes", ["", "client ms p50, p99", "updates/s", "session %", "server %"], [row], goals=[goal])


def main() -> None:
    from bench import page_peers, page_recording, page_screen

    parser = argparse.ArgumentParser(prog="python -m bench.page", description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each turn")
    parser.add_argument("--minutes", type=float, default=60.0, help="of the recording that is looked at")
    parser.add_argument("--no-peers", action="store_true", help="without timeflux_ui and the Foxglove SDK's server")
    parser.add_argument("--write", action="store_true", help="write goals and tables into docs/page.md")
    given = parser.parse_args()
    load = os.getloadavg()[0]
    sections = [live(given.rounds, given.seconds), meshes(given.seconds)]
    sections += [] if given.no_peers else [page_peers.beside(given.rounds, given.seconds)]
    sections += [page_screen.drawn(given.seconds), page_recording.looked(given.minutes, 50)]
    about = f"Load average at the start {load:.1f}, at the end {os.getloadavg()[0]:.1f}, on {os.cpu_count()} cores."
    print(whole(sections, about))
    if given.write:
        publish(sections, about, "page.md", *marks("bench.page"))


if __name__ == "__main__":
    main()
