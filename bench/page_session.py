"""A session with a page: its board, its meshes, an operator that notes how old samples are; each session is a process of its own."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import ClassVar

import numpy as np
from websockets.sync.client import ClientConnection

from kinegraph.devices.page.transfer.wire import decode
from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec, grid
from kinegraph.stream.domain.mesh import Topology
from kinegraph.stream.operator import Operator
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

HOUSE = Path(__file__).resolve().parent.parent
RATE_HZ, CHANNELS, CHUNK = 2000, 16, 10
VERTICES, MESHES_HZ = 8431, 30.0
WARM_S = 2.0
"""What comes in the first seconds is left out."""
PATIENCE_S = 60.0
BOARD = StreamSpec((CHANNELS,), rate_hz=float(RATE_HZ), channels=tuple(f"c{k}" for k in range(CHANNELS)), units=("uV",))
GRAPH = """
nodes:
  board: {use: bench.page_session.Board}
  envelope: {use: operators.emg.Envelope, from: board}
  rectified: {use: operators.filters.rectify.Rectify, from: board}
  aged: {use: bench.page_session.Aged, from: rectified, path: AGES}
"""
MESH = "nodes:\n  mesh: {use: bench.page_session.Meshes}\n"


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
        self.set_state(Ages())
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> None:
        if len(chunk.time):
            if len(self.ages) == RATE_HZ // CHUNK:  # a second of them: what came before was the warm-up's
                Path(self.path).with_suffix(".begun").touch()
            self.ages.append(time.time_ns() - int(chunk.time[-1]))

    def close(self) -> None:
        Path(self.path).write_text(json.dumps(self.ages))


@contextmanager
def session(folder: Path, graph: str, *, page: bool) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A session, ended by Ctrl-C; its page's address."""
    (folder / "g.yaml").write_text(graph.replace("AGES", str(folder / "ages.json")))
    log = folder / "said.txt"
    command = [sys.executable, "-m", "kinegraph", "run", str(folder / "g.yaml"), "--no-record", "--view", "none"]
    environment = {**os.environ, "PYTHONPATH": str(HOUSE)}
    with log.open("wb") as log_file, subprocess.Popen(
        [*command, *(["--page-at", ":0", "--no-token"] if page else [])],
        cwd=folder, stdout=log_file, stderr=log_file, stdin=subprocess.DEVNULL, env=environment,
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
