"""What a source gives is put right, or refused by name, before it enters the graph."""

from __future__ import annotations

import parts

from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.status import Outcome
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
