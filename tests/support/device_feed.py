"""A feed that keeps all that a source hands over, and sources read in threads as the engine does it."""

from __future__ import annotations

import random
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise

import numpy as np
import psutil

from kinegraph.stream.chunk import FOREVER, NEVER, Array, Chunk, Times
from kinegraph.stream.source import Source
from tests.support.queued import check_queued


class Kept:
    """A feed; `error` is what the source raised in the end."""

    def __init__(self) -> None:
        self.chunks: dict[str, list[Chunk]] = {}
        self.problems: Counter[str] = Counter()
        self.reports: list[tuple[str, dict[str, str | float]]] = []
        self.clocks: list[dict[str, float]] = []
        self.again = False
        self.error: Exception | None = None
        self.identity: dict[str, str | float] = {}
        self._stop = threading.Event()
        self._offset = time.time_ns() - time.monotonic_ns()

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        self.chunks.setdefault(output, []).append(chunk)

    def now(self) -> int:
        return time.monotonic_ns() + self._offset

    def wait(self, seconds: float) -> bool:
        return self._stop.wait(seconds)

    @property
    def stopped(self) -> bool:
        return self._stop.is_set()

    def stop(self) -> None:
        self._stop.set()

    def ready(self) -> None: ...

    def listen(self, timeout_s: float) -> str | None:
        return None

    def identify(self, device: str, **facts: str | float) -> None:
        self.identity = {"device": device, **facts}

    def problem(self, kind: str, count: int = 1) -> None:
        self.problems[kind] += count

    def tell(self, kind: str, **facts: str | float) -> None:
        self.reports.append((kind, facts))

    def position(self, output: str = "out") -> int:
        chunks = self.chunks.get(output)
        return chunks[-1].until if chunks else NEVER

    def saved(self) -> int:
        return FOREVER

    def device_clock(self, **facts: float) -> None:
        self.clocks.append(facts)

    def count(self, output: str) -> int:
        return sum(len(c) for c in self.chunks.get(output, ()))

    def time(self, output: str) -> Times:
        return np.concatenate([c.time for c in self.chunks[output]])

    def data(self, output: str) -> Array:
        return np.concatenate([c.data for c in self.chunks[output]])

    def lost(self, output: str) -> dict[int, int]:
        """By sample index: how many are missing before it."""
        at, found = 0, {}
        for chunk in self.chunks.get(output, ()):
            if chunk.lost:
                found[at] = chunk.lost
            at += len(chunk)
        return found


@contextmanager
def reading(source: Source) -> Iterator[Kept]:
    """Within: the source is being read; at the end it is stopped, and must stop. What it gave would be the same from a queue."""
    specs = source.specs()
    source.prepare()
    feed = Kept()

    def work() -> None:
        try:
            source.read(feed)
        except Exception as error:  # noqa: BLE001 - looked at by the test
            feed.error = error

    thread = threading.Thread(target=work, name="source under test", daemon=True)
    thread.start()
    try:
        yield feed
    finally:
        feed.stop()
        thread.join(60)
        assert not thread.is_alive(), "the source does not stop"
    for output, chunks in feed.chunks.items():
        check_queued(specs[output], chunks)


def free_udp_port() -> int:
    """One that no other test is given by the system meanwhile: below those that it hands out."""
    while True:
        port = random.SystemRandom().randrange(20_000, 32_000)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one, suppress(OSError):
            one.bind(("127.0.0.1", port))
            return port


def is_bound(port: int) -> bool:
    """Whether this process has the UDP port: asked of the system, for a look by binding it could take it from the source."""
    return any(c.laddr.port == port for c in psutil.Process().net_connections("udp"))


def wait_for(true: Callable[[], bool], within_s: float = 20.0) -> None:
    """Wait until it is so."""
    deadline = time.monotonic() + within_s
    while not true():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.005)


def check(source: Source, feed: Kept) -> None:
    """Every chunk is as the source's specs promise, and stamps never run backwards."""
    specs = source.specs()
    for output, chunks in feed.chunks.items():
        spec = specs[output]
        for chunk in chunks:
            assert chunk.data.shape == (len(chunk), *spec.shape) and chunk.data.dtype == spec.dtype
            assert not len(chunk) or chunk.until >= chunk.time[-1]
        assert (np.diff(feed.time(output)) >= 0).all(), output


def cut(data: bytes, places: list[int]) -> list[bytes]:
    """The bytes in pieces."""
    edges = [0, *sorted(p % (len(data) + 1) for p in places), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]
