"""What a source gives is put right, or refused by name, before it enters the graph."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import parts

from stream.engine.session import Session
from stream.engine.status import Outcome
from stream.engine.supervisor import StartBarrier
from stream.graph.load import load_text
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


def test_only_sources_that_were_there_before_are_excused() -> None:
    options = SimpleNamespace(required=True)
    old, new = (
        SimpleNamespace(node=SimpleNamespace(options=options), source=SimpleNamespace(background=False), ready=False)
        for _ in range(2)
    )
    barrier = StartBarrier[Any]([old, new])  # type: ignore[list-item]
    barrier.excuse([old])  # type: ignore[list-item]
    new.ready = True
    assert barrier.ready
