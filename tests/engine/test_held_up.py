"""A graph that is held up for a while by its own work: that is no silence of its sources, and costs none of their samples."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

import numpy as np
import parts
import pytest

from stream.chunk import Chunk
from stream.engine.ingress import Ingress
from stream.engine.queues import BoundedQueue
from stream.engine.session import Session
from stream.engine.supervisor import not_inline
from stream.graph.load import load_text
from stream.operator import Emitted
from stream.params import param

GRAPH = """
nodes:
  board: {use: parts.Counting, samples: 2500, realtime: true, patience_s: 0.3, silence_s: 0.6, stale_s: 0.5}
  stall: {use: tests.engine.test_held_up.Stall, from: board}
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
