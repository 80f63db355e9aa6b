"""Promises that are broken live: an operator or a source that goes wrong after the warm-up ends its session, and loses no data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest

from kinegraph.stream.chunk import FOREVER, NS, Chunk
from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.status import Outcome
from kinegraph.stream.errors import GraphError, RunError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.operator import Emitted
from kinegraph.stream.params import param
from kinegraph.stream.recording import Recording
from kinegraph.stream.source import Feed

HOUR = 3600 * NS
LATE = 500
"""The sample at which operators begin to go wrong, long after the warm-up."""


@dataclass(frozen=True, slots=True)
class Breaks(parts.Identity):
    """Gives something else than it promised, from a sample on."""

    how: str = param("")

    def process(self, port: str, chunk: Chunk) -> Emitted:
        time, data, until = chunk.time, chunk.data, chunk.until
        n = len(time)
        if not n or data[0, 0] < LATE or data.shape != (n, 2):
            return Chunk(time, data, until, chunk.lost)
        given: dict[str, Any] = {
            "wide": lambda: Chunk(time, np.tile(data, 500), until),
            "narrow": lambda: Chunk(time, data[:, :1].copy(), until),
            "fewer samples than stamps": lambda: Chunk(time, data[1:].copy(), until),
            "float32": lambda: Chunk(time, data.astype(np.float32), until),
            "a list": lambda: Chunk(time, data.tolist(), until),
            "stamps in floats": lambda: Chunk(time / 1.0, data, until),
            "until as text": lambda: Chunk(time, data, "now"),  # type: ignore[arg-type]
            "watermark back": lambda: Chunk(time[:0], data[:0], until - 10 * NS),
            "behind the watermark": lambda: Chunk(time - 10 * NS, data, until),
            "an hour ahead": lambda: Chunk(time + HOUR, data, until + HOUR),
            "backwards": lambda: Chunk(time[::-1].copy(), data, until),
        }
        return given[self.how]()  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class Scribbles(parts.Identity):
    """Writes into what it is given, from a sample on."""

    since: int = param(LATE)

    def process(self, port: str, chunk: Chunk) -> Emitted:
        if len(chunk) and chunk.data[0, 0] >= self.since:
            chunk.data[:] = -1.0
        return Chunk(chunk.time, chunk.data, chunk.until, chunk.lost)


@dataclass(frozen=True, slots=True)
class BadSource(parts.Counting):
    """Gives one chunk that no session can take."""

    how: str = param("")

    def read(self, feed: Feed) -> None:
        time, data = parts.START + np.arange(5), np.zeros((5, 2))
        feed.emit(Chunk(time, data, int(time[-1])))
        feed.wait(0.4)
        time = time + 10
        last = int(time[-1])
        if self.how == "stamp":
            time[-1] = FOREVER
        until = 2**62 + 1 if self.how == "until" else last
        lost = {"lost": 2**62, "owing": -7}.get(self.how, 0)
        feed.emit(Chunk(time, data, until, lost))


PATHS = {
    "before a compiled segment": "",
    "on a worker": ", worker: other",
}
GRAPH = """
nodes:
  board: {use: parts.Counting}
  bad: {use: tests.engine.test_promises.%s, from: board%s}
  rectify: {use: operators.filters.rectify.Rectify, from: bad}
  lowpass: {use: operators.filters.iir.Lowpass, from: rectify, cutoff_hz: 20}
  sibling: {use: parts.Collect, from: board, policy: block}
record: [bad, lowpass]
"""


def run(part: str, options: str, folder: Path) -> Outcome:
    parts.seen.clear()
    return Session(load_text(GRAPH % (part, options), path=__file__), folder).run()


def whole(folder: Path) -> None:
    """The source's recording, as far as it goes, is what the source gave."""
    with Recording.open(folder) as recording:
        assert recording.finished
        numbers = np.concatenate([chunk.data[:, 0] for chunk in recording.chunks("board")])
    assert len(numbers) > LATE and (numbers == np.arange(len(numbers))).all()


@pytest.mark.parametrize("where", PATHS)
@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("wide", "(10, 1000) float64"),
        ("narrow", "(10, 1) float64"),
        ("fewer samples than stamps", "(9, 2) float64"),
        ("float32", "(10, 2) float32"),
        ("a list", "list"),
        ("stamps in floats", "float64 stamps"),
        ("until as text", "'now'"),
        ("watermark back", "watermark"),
        ("behind the watermark", "watermark"),
        ("an hour ahead", "ahead"),
        ("backwards", "backwards"),
    ],
)
def test_an_operator_that_breaks_its_promise_ends_the_session_by_name(
    how: str, words: str, where: str, tmp_path: Path
) -> None:
    outcome = run("Breaks", f", how: {how}{PATHS[where]}", tmp_path / "s")
    assert isinstance(outcome.error, RunError) and outcome.exit_code == 4
    reported = str(outcome.error)
    assert "node 'bad', output 'out'" in reported and words in reported and "2023-11-14T22:13:2" in reported, reported
    whole(tmp_path / "s")


@pytest.mark.parametrize("where", PATHS)
def test_an_operator_from_outside_cannot_write_into_its_input(where: str, tmp_path: Path) -> None:
    outcome = run("Scribbles", PATHS[where], tmp_path / "s")
    reported = str(outcome.error)
    assert (
        outcome.exit_code == 4 and "node 'bad'" in reported and "read-only" in reported and "input 'in'" in reported
    ), reported
    whole(tmp_path / "s")
    assert all(v >= 0 for v in parts.numbers())


def test_what_an_operator_does_to_its_input_never_reaches_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where nothing keeps it from writing: the recorder has its own copy."""
    monkeypatch.setattr("kinegraph.stream.graph.components.is_ours", lambda part: True)
    run("Scribbles", "", tmp_path / "s")
    whole(tmp_path / "s")


def test_an_operator_that_always_writes_is_refused_by_the_warm_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kinegraph.stream.graph.components.is_ours", lambda part: True)
    with pytest.raises(GraphError, match=r"node 'bad'.* writes into its input 'in'"):
        run("Scribbles", ", since: -1000000", tmp_path / "s")


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("stamp", "stamps up to 9223372036854775807"),
        ("until", "until=4611686018427387905"),
        ("lost", "lost=4611686018427387904"),
        ("owing", "lost=-7"),
    ],
)
def test_a_source_that_gives_what_cannot_be_ends_the_session_by_name(how: str, words: str, tmp_path: Path) -> None:
    graph = load_text(
        f"nodes:\n  board: {{use: tests.engine.test_promises.BadSource, how: {how}}}\n"
        "  same: {use: parts.Identity, from: board}\n  out: {use: parts.Collect, from: same, policy: block}\n",
        path=__file__,
    )
    outcome = Session(graph, tmp_path / "s").run()
    reported = str(outcome.error)
    assert outcome.exit_code == 4 and "source 'board', output 'out'" in reported and words in reported, reported
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished and recording.streams["board"].samples == 5


UNRECORDED = """
nodes:
  board: {use: parts.Counting}
  bad: {use: tests.engine.test_promises.Breaks, from: board, how: an hour ahead}
  %s
  sibling: {use: parts.Collect, from: board, policy: block}
record: [board]
"""


@pytest.mark.parametrize(
    ("ours", "reader", "found"),
    [
        (False, "rectify: {use: operators.filters.rectify.Rectify, from: bad}", True),
        (True, "out: {use: parts.Collect, from: bad}", True),
        (True, "rectify: {use: operators.filters.rectify.Rectify, from: bad}", False),
    ],
)
def test_stamps_ahead_are_found_where_nothing_is_recorded(
    ours: bool, reader: str, found: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After an operator from outside, and before an outlet; our own operators are trusted between themselves, for the laws try them."""
    if ours:
        monkeypatch.setattr("kinegraph.stream.engine.pipeline.is_ours", lambda part: True)
    parts.seen.clear()
    outcome = Session(load_text(UNRECORDED % reader, path=__file__), tmp_path / "s").run()
    assert (outcome.exit_code == 4) == found
    if found:
        assert "node 'bad', output 'out'" in str(outcome.error) and "ahead" in str(outcome.error)
