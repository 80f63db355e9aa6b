"""A graph that is held up for a while by its own work: that is no silence of its sources, and loses no samples."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

import numpy as np
import parts
import pytest

from kinegraph.stream.chunk import Chunk
from kinegraph.stream.engine.flow.queues import BoundedQueue
from kinegraph.stream.engine.ingress import Ingress
from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.supervisor import not_inline
from kinegraph.stream.graph.backpressure import LIVE_BYTES, MIN_CHUNKS, OTHER_BYTES, Policy, max_bytes, queued_bytes
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.operator import Emitted
from kinegraph.stream.params import param

GRAPH = """
nodes:
  board: {use: parts.Counting, samples: 2500, realtime: true, patience_s: 0.3, silence_s: 0.6, stale_s: 0.5}
  stall: {use: tests.engine.test_stalled_graph.Stall, from: board}
  out: {use: parts.Collect, from: stall, policy: block}
"""


@dataclass(frozen=True, slots=True)
class Stall(parts.Identity):
    """Takes long once."""

    at: int = param(600)
    takes_s: float = param(1.2)

    def process(self, port: str, chunk: Chunk) -> Emitted:
        if self.at in chunk.data[:, 0]:
            time.sleep(self.takes_s)
        return chunk


@pytest.mark.parametrize("way", ["inline", "queue"])
def test_what_the_graph_takes_is_no_silence_of_a_source(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if way == "queue":
        monkeypatch.setattr(Ingress, "inline", lambda *_: not_inline)
    parts.seen.clear()
    parts.openings.clear()
    outcome = Session(load_text(GRAPH, path=str(Path(__file__))), tmp_path / "s").run()
    assert outcome.exit_code == 0, outcome.error
    assert outcome.table["board"]["late"] == 0 and parts.openings == {"counting": 1}
    assert parts.numbers() == list(range(2500)) and parts.lost() == []


def test_a_ready_queue_holds_no_more_than_waits() -> None:
    """However long a thread is behind a queue that drops: the ready queue does not pile up."""
    queue = BoundedQueue("camera", SimpleQueue(), 3, "drop_oldest")
    for i in range(50):
        queue.put(Chunk(np.array([i]), np.array([[float(i)]]), i))
        if i % 10 == 5:
            assert queue.ready.get() is queue and queue.take() is not None
    assert queue.ready.qsize() == queue.depth == 3
    taken = [queue.take() for _ in range(queue.ready.qsize())]
    assert [item[0].time[0] for item in taken if item] == [47, 48, 49]
    assert queue.index == queue.chunks == 50 and queue.dropped == 50 - 5 - 3


def images(n: int, size: int) -> list[Chunk]:
    return [Chunk(np.array([i]), np.zeros((1, size), np.uint8), i) for i in range(n)]


@pytest.mark.parametrize(
    ("size", "policy", "live", "waits"),
    [
        (1 << 18, "block", False, OTHER_BYTES >> 18),
        (1 << 18, "block", True, LIVE_BYTES >> 18),
        (1 << 23, "block", True, MIN_CHUNKS),
        (100, "block", False, 90),
        (1 << 18, "drop_oldest", False, 90),
    ],
    ids=["of a file", "of a camera", "huge", "small", "that drops"],
)
def test_images_wait_by_their_bytes_where_waiting_loses_nothing(
    size: int, policy: Policy, live: bool, waits: int
) -> None:
    """256 images in each queue were several hundred MB in the session of an avatar with a network slower than its frames."""
    queue = BoundedQueue("camera", SimpleQueue(), 90, policy, bound=max_bytes(policy, live=live))
    chunks = images(100, size)
    writer = threading.Thread(target=lambda: [queue.put(chunk) for chunk in chunks])
    writer.start()
    taken: list[int] = []
    while policy == "block" and len(taken) < 100:
        while queue.depth < waits and writer.is_alive():
            time.sleep(0.001)
        assert queue.depth <= waits
        item = queue.take()
        assert item is not None
        taken.append(int(item[0].time[0]))
    writer.join()
    assert taken == list(range(100 if policy == "block" else 0))
    assert queue.depth == (0 if policy == "block" else waits)
    assert queued_bytes(90, size, max_bytes(policy, live=live)) == waits * size


def test_what_a_queue_dropped_no_longer_counts() -> None:
    queue = BoundedQueue("camera", SimpleQueue(), 20, "drop_oldest", bound=3 << 20)
    for chunk in images(100, 1 << 18):
        queue.put(chunk)
    full = []
    while queue.take() is not None:
        full.append(queue.full)
    assert full == [True] * 8 + [False] * 12, "until less than 12 of a quarter MiB wait"
