"""What the tests of session share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import parts
import pytest

from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.status import Outcome
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.support import SUPPORT

opened: list[Recording] = []


@pytest.fixture(autouse=True)
def clean() -> Iterator[None]:
    parts.seen.clear()
    parts.openings.clear()
    yield
    while opened:
        opened.pop().close()


def recorded(folder: Path) -> Recording:
    """The recording in a folder; closed after the test."""
    opened.append(Recording.open(folder))
    return opened[-1]


def run(nodes: str, folder: Path | None = None, top: str = "", **options: object) -> Outcome:
    """Run a graph given as YAML nodes, to its end."""
    return session_of(nodes, folder, top, **options).run()


def session_of(nodes: str, folder: Path | None = None, top: str = "", **options: object) -> Session:
    graph = load_text(f"{top}\nnodes:\n{nodes}", path=str(SUPPORT / "graph.yaml"))
    return Session(graph, folder, **options)  # type: ignore[arg-type]
