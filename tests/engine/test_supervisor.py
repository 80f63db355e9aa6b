"""What a source gives is put right, or refused by name, before it enters the graph."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import parts

from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec, empty
from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.status import Outcome
from kinegraph.stream.engine.supervisor import StartBarrier
from kinegraph.stream.graph.reading.load import load_text
from tests.support import SUPPORT


def run(nodes: str) -> Outcome:
    parts.seen.clear()
    parts.openings.clear()
    return Session(load_text(f"nodes:\n{nodes}", path=str(SUPPORT / "graph.yaml")), None).run()


def test_samples_that_run_backwards_are_refused_and_counted() -> None:
    outcome = run(
        "  board: {use: parts.Counting, samples: 5000, chunk: 7, trouble: backwards, at: 2002}\n"
        "  out: {use: parts.Collect, from: board}\n"
    )
    assert outcome.table["board"]["problems"] == {"time ran backwards": 4}
    assert len(parts.numbers()) == 4996


def test_the_end_of_a_live_source_that_is_over_before_the_start_is_not_left_out() -> None:
    """Else the session would wait for it for ever."""

    def supervisor(required: bool) -> Any:
        options = SimpleNamespace(required=required)
        source = SimpleNamespace(background=False)
        return SimpleNamespace(ready=not required, live=True, source=source, node=SimpleNamespace(options=options))

    late, short = supervisor(True), supervisor(False)
    barrier: StartBarrier[str] = StartBarrier([late, short])
    spec = StreamSpec((1,), rate_hz=100.0)
    assert barrier.pass_on("short", short, Chunk(np.array([1]), np.zeros((1, 1)), 1), 1) == []
    assert barrier.pass_on("short", short, empty(spec, FOREVER), 2) == []
    late.ready = True
    assert [(port, chunk.until) for port, chunk, _ in barrier.release()] == [("short", FOREVER)]
