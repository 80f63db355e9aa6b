"""The page: how old a sample is when a client has it, what the page costs the session, meshes, and how soon an hour can be looked at.

    python -m bench.page

A board of 16 channels at 2000 Hz in 10-sample chunks, its envelope, and an operator that notes how old samples are there; the
session is a process of its own, its clients are headless WebSocket clients in this one. Rounds without a page, with one client and
with five take turns. Processor time is of the session's process and of the server's, from /proc.
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
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import ClassVar

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from bench.report import Goal, Section, short, whole
from devices.outlets.page.pyramid import Pyramid
from devices.outlets.page.viewing import RecordingHub
from devices.outlets.page.wire import Look, decode
from stream.chunk import NS, Chunk, Specs, StreamSpec, grid
from stream.graph import RecordingOptions
from stream.mesh import Topology
from stream.operator import Operator
from stream.params import param
from stream.recording import Recorder, Recording
from stream.source import Feed, Source

HOUSE = Path(__file__).resolve().parent.parent
RATE_HZ, CHANNELS, CHUNK = 2000, 16, 10
VERTICES, MESHES_HZ = 8431, 30.0
WARM_S = 2.0
"""What comes in the first seconds is left out."""
PATIENCE_S = 60.0
TICKS_S = os.sysconf("SC_CLK_TCK")
BOARD = StreamSpec((CHANNELS,), rate_hz=float(RATE_HZ), channels=tuple(f"c{k}" for k in range(CHANNELS)), units=("uV",))
GRAPH = """
nodes:
  board: {use: bench.page.Board}
  envelope: {use: operators.emg.Envelope, from: board}
  aged: {use: bench.page.Aged, from: envelope, path: AGES}
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
            if not self.ages:
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
    """Processor time of a process so far, children apart."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_S


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


def drain(url: str, stop: threading.Event) -> None:
    """Take messages and look at none."""
    with connect(url, max_size=None, compression=None, ping_interval=None) as client:
        looks(client, 0)
        while not stop.is_set():
            try:
                client.recv(timeout=PATIENCE_S)
            except (TimeoutError, ConnectionClosed):
                return


def take_turn(graph: str, kind: str, clients: int, seconds: float, *, page: bool = True) -> Turn:
    """One session with so many clients."""
    turn, stop = Turn(), threading.Event()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        with session(folder, graph, page=page) as (process, url):
            first = [threading.Thread(target=watch, args=(url, turn, kind, stop))] if clients else []
            others = [threading.Thread(target=drain, args=(url, stop)) for _ in range(clients - 1)]
            for thread in (*first, *others):
                thread.start()
            if clients:
                turn.begun.wait(PATIENCE_S)
            time.sleep(WARM_S)
            told = subprocess.run(
                ["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True, check=False
            )
            pids = [process.pid, *map(int, told.stdout.split())]
            before, began = [cpu_s(pid) for pid in pids], time.monotonic()
            time.sleep(seconds)
            lasted = time.monotonic() - began
            shares = [(cpu_s(pid) - then) / lasted for pid, then in zip(pids, before, strict=True)]
            stop.set()
            for thread in (*first, *others):
                thread.join()
        turn.session, turn.server, turn.updates = shares[0], sum(shares[1:]), len(turn.ages) / lasted
        ages = folder / "ages.json"
        turn.graph = [age / 1e6 for age in json.loads(ages.read_text())[RATE_HZ // CHUNK :]] if ages.exists() else []
    return turn


def live(rounds: int, seconds: float) -> Section:
    """Without a page, with one client, with five: in turns."""
    kinds = {
        "no page": (False, 0),
        "a page, nobody looks": (True, 0),
        "one client": (True, 1),
        "five clients": (True, 5),
    }
    turns: dict[str, list[Turn]] = {name: [] for name in kinds}
    for _ in range(rounds):
        for name, (page, clients) in kinds.items():
            turns[name].append(take_turn(GRAPH, "signal", clients, seconds, page=page))
    none = turns["no page"]
    rows = []
    for name, taken in turns.items():
        ages, graph = np.concatenate([t.ages for t in taken]), np.concatenate([t.graph for t in taken])
        rows.append([
            name, f"{short(np.percentile(graph, 50))}, {short(np.percentile(graph, 99))}",
            f"{short(np.percentile(ages, 50))}, {short(np.percentile(ages, 99))}" if len(ages) else "",
            short(float(np.median([t.updates for t in taken]))) if len(ages) else "",
            short(100 * float(np.median([t.session for t in taken]))), short(100 * float(np.median([t.server for t in taken]))),
        ])  # fmt: skip
    one, five = turns["one client"], turns["five clients"]
    ages = np.concatenate([t.ages for t in one])
    ratio = float(np.median([a.session / b.session for a, b in zip(one, none, strict=True)]))
    slower = float(
        np.median([np.percentile(a.graph, 99) / np.percentile(b.graph, 99) for a, b in zip(one, none, strict=True)])
    )
    goals = [
        Goal("page: sample to message, p50", float(np.percentile(ages, 50)), 40, "ms"),
        Goal("page: sample to message, p99", float(np.percentile(ages, 99)), 100, "ms"),
        Goal("page: session's processor time with one client, against none", ratio, 1.1, "times"),
        Goal("page: graph's p99 latency with one client, against none", slower, 1.1, "times"),
        Goal("page: server, one client", 100 * float(np.median([t.server for t in one])), 10, "% of a core"),
        Goal("page: server, five clients", 100 * float(np.median([t.server for t in five])), 25, "% of a core"),
    ]
    header = ["", "graph ms p50, p99", "client ms p50, p99", "updates/s", "session %", "server %"]
    return Section(f"The page of 16 channels at 2000 Hz, {rounds} rounds of {seconds:g} s", header, rows, goals=goals)


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


def recorded(path: Path, minutes: float) -> None:
    """A recording of 16 channels at 2000 Hz: an offset that wanders, and noise of a converter's steps."""
    recorder = Recorder(path, {"graph": ""}, RecordingOptions(), wait=True)
    spec = StreamSpec((CHANNELS,), np.dtype("<f4"), float(RATE_HZ), channels=BOARD.channels, units=("uV",))
    number = recorder.add_stream("board", spec, "input")
    noise = np.random.default_rng(1).integers(-40, 40, (RATE_HZ, CHANNELS)).astype(np.float32)
    for second in range(round(60 * minutes)):
        time_ns = grid(RATE_HZ, RATE_HZ, start_ns=second * NS)
        chunk = Chunk(time_ns, noise + np.float32(50 * np.sin(second / 100)), int(time_ns[-1]))
        recorder.write(number, chunk, int(time_ns[-1]), second)
    recorder.close()
    recorder.check()


def looked(minutes: float, scrubs: int) -> Section:
    """How soon a recording can be looked at, with and without the recorder's overview, and how long a look takes."""
    rows, opened = [], {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s"
        recorded(path, minutes)
        for name in ("overview", "none"):
            began = time.monotonic()
            with Recording.open(path) as recording:
                hub = RecordingHub(recording)
                hub.seen(0, Look([0], 0.0, 10.0, 5.0, 1000))
                first = time.monotonic() - began
                if name == "overview":
                    hub.build(lambda message: None)
                else:
                    source = recording.streams["board"]
                    hub.pyramids[0] = Pyramid(source.spec, source.first or 0, source.last or 0)
                    hub.pyramids[0].build(recording.chunks("board"), lambda share: None)
                opened[name] = time.monotonic() - began
                rows.append([f"opened, {name}", short(1000 * first), short(1000 * opened[name])])
                if name == "overview":
                    rows += scrubbed(hub, minutes, scrubs)
    goal = Goal(f"page: {minutes:g} min of 16 channels at 2000 Hz, opened", opened["overview"], 2.0, "s")
    return Section(
        f"A recording of {minutes:g} min",
        ["", "first picture ms; a look's p50", "whole ms; a look's p99"],
        rows,
        goals=[goal],
    )


def scrubbed(hub: RecordingHub, minutes: float, scrubs: int) -> list[list[str]]:
    """Looks at random moments, by how much is looked at."""
    rng, rows = np.random.default_rng(1), []
    for span in (1.0, 10.0, 60.0, 600.0):
        took = []
        for at in rng.uniform(0, 60 * minutes, scrubs):
            began = time.perf_counter()
            hub.seen(0, Look([0], at - span / 2, at + span / 2, at, 1000))
            took.append(1000 * (time.perf_counter() - began))
        rows.append(
            [f"a look at {span:g} s", short(float(np.percentile(took, 50))), short(float(np.percentile(took, 99)))]
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.page", description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each turn")
    parser.add_argument("--minutes", type=float, default=60.0, help="of the recording that is looked at")
    given = parser.parse_args()
    load = os.getloadavg()[0]
    sections = [live(given.rounds, given.seconds), meshes(given.seconds), looked(given.minutes, 50)]
    print(
        whole(
            sections,
            f"Load average at the start {load:.1f}, at the end {os.getloadavg()[0]:.1f}, on {os.cpu_count()} cores.",
        )
    )


if __name__ == "__main__":
    main()
