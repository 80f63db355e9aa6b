"""A real nats-server for tests, and graphs of beds and of a centre that use it."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.nats import StreamInlet, StreamOutlet
from kinegraph.devices.nats import link as links
from kinegraph.devices.nats.link import Link, make_streams
from kinegraph.devices.nats.local_server import LocalServer, program
from kinegraph.devices.nats.messages import spec_text
from kinegraph.devices.nats.server import NatsServer
from kinegraph.stream.chunk import NS, Array, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.status import Outcome
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.support.device_feed import Kept
from tests.support.mosquitto import eventually, free_port

START = 1_767_000_000 * NS
SPEC = StreamSpec((2,), rate_hz=100.0, channels=("x", "y"), units=("g",))


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalServer]:
    """One server for the tests of a module; each test uses beds of its own."""
    try:
        program()
    except KinegraphError:
        pytest.skip("no nats-server here (Debian: apt install nats-server)")
    pytest.importorskip("nats")
    made = LocalServer(tmp_path_factory.mktemp("nats"), free_port()).start()
    make(made)
    yield made
    made.stop()


@pytest.fixture(autouse=True)
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Spools and positions in the test's own folder."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def make(server: LocalServer) -> None:
    """Make the server's streams."""
    link = Link(NatsServer(server.url), "tests")
    try:
        assert link.wait(100)
        link.call(make_streams(link))
    finally:
        link.close()


def samples(first: int, n: int, lost: int = 0) -> Chunk:
    """Samples first..first+n-1 of a stream of SPEC: their values are their numbers."""
    index = np.arange(first, first + n)
    time = START + index * (NS // 100)
    return Chunk(time, np.stack([index, -index], axis=1).astype(float), int(time[-1]), lost)


def session(text: str, folder: Path | None = None, **options: object) -> Session:
    return Session(load_text(text), folder, **options)  # type: ignore[arg-type]


class Running(threading.Thread):
    """A session on a thread of its own."""

    def __init__(self, made: Session) -> None:
        super().__init__(daemon=True)
        self.session = made
        self.outcome: Outcome | None = None
        self.start()

    def run(self) -> None:
        self.outcome = self.session.run()

    def ended(self, timeout_s: float = 60.0) -> Outcome:
        self.join(timeout_s)
        assert self.outcome is not None, "the session does not end"
        if self.outcome.error:
            raise self.outcome.error
        return self.outcome


@contextmanager
def sending(
    bed: str,
    server: LocalServer,
    *,
    clock_ahead_ns: int = 0,
    begun: bool = True,
    specs: Specs | None = None,
    account: dict[str, str] | None = None,
    **given: Any,
) -> Iterator[StreamOutlet]:
    """An outlet of one stream `x` as a session runs it."""
    made = StreamOutlet(bed=bed, server=NatsServer(server.url, **(account or {})), **given)
    made.open(specs or {"x": SPEC})
    made.runtime.now = lambda: time.time_ns() + clock_ahead_ns
    if begun:
        made.begin()
        if server.runs:
            eventually(lambda: made.runtime.sender is not None and made.runtime.sender.introduced)
    try:
        yield made
    finally:
        made.close()


def vanish(made: StreamOutlet) -> None:
    """As a killed process does: what is in memory is gone."""
    runtime = made.runtime
    assert runtime.sender and runtime.link
    sender = runtime.sender
    sender._stop.set()
    sender._thread.join()
    sender._spool.close()
    links.release(runtime.link)
    runtime.sender = runtime.link = None


@contextmanager
def receiving(
    bed: str,
    server: LocalServer,
    feed: Kept | None = None,
    *,
    declared: StreamSpec = SPEC,
    account: NatsServer | None = None,
    **given: Any,
) -> Iterator[Kept]:
    """An inlet of the stream `x` of a bed, read in a thread until the context ends."""
    feed, spec = feed or Kept(), Path(os.environ["XDG_STATE_HOME"]) / "x.json"
    spec.parent.mkdir(exist_ok=True)
    spec.write_text(spec_text(declared))
    given = {"start": "all", "spec": str(spec), **given}
    source = StreamInlet(bed=bed, stream="x", server=account or NatsServer(server.url), **given)
    thread = threading.Thread(target=_read, args=(source, feed), daemon=True)
    thread.start()
    try:
        yield feed
    finally:
        feed.stop()
        thread.join(30)
        assert not thread.is_alive()
        if feed.error:
            raise feed.error


def _read(source: StreamInlet, feed: Kept) -> None:
    try:
        source.read(feed)
    except Exception as error:  # noqa: BLE001 - the test's own thread raises it
        feed.error = error


def numbers(feed: Kept) -> list[int]:
    """The numbers of the samples that came, as `samples` makes them."""
    return [int(x) for chunk in feed.chunks.get("out", []) for x in chunk.data[:, 0]]


def stream_of(folder: Path, name: str) -> tuple[Times, Array, list[tuple[int, int]]]:
    """Stamps, samples and gaps (index, lost) of a recorded stream."""
    with Recording.open(folder) as recording:
        chunks = list(recording.chunks(name))
    gaps, at = [], 0
    for chunk in chunks:
        if chunk.lost:
            gaps.append((at, chunk.lost))
        at += len(chunk)
    return np.concatenate([c.time for c in chunks]), np.concatenate([c.data for c in chunks]), gaps


__all__ = ["folders", "links", "server"]
