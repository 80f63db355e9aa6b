"""What is logged: a warning that is repeated is shown once a minute and counted; programs see nothing that they have not asked for."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
import structlog

import kinegraph as kg
from kinegraph.stream.cli.commands.logs import AGAIN_S, Repetitions, to_logging
from kinegraph.stream.errors import KinegraphError

FAILED = {"event": "source failed", "node": "board", "error": "no answer"}
GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 0.2}
  rect: {use: operators.filters.rectify.Rectify, from: board.emg}
  table: {use: devices.outlets.csv_file.CsvFile, from: rect, path: rows.csv}
record: [rect]
"""


def shown(repetitions: Repetitions, method: str = "error", **facts: object) -> dict[str, object] | None:
    try:
        return dict(repetitions(None, method, {**FAILED, **facts}))
    except structlog.DropEvent:
        return None


def test_a_repeated_warning_is_shown_once_a_minute_with_its_count() -> None:
    now = [0.0]
    repetitions = Repetitions(lambda: now[0])
    assert shown(repetitions, retry_in_s=0.25) == {**FAILED, "retry_in_s": 0.25}
    for retry in (0.5, 1.0, 2.0):
        assert shown(repetitions, retry_in_s=retry) is None
    assert shown(repetitions, error="another fault") and shown(repetitions, node="feet"), "each fault is shown"
    now[0] = AGAIN_S
    assert shown(repetitions) == {**FAILED, "times": 4}
    assert shown(repetitions) is None


def test_what_is_no_warning_is_always_shown() -> None:
    repetitions = Repetitions()
    assert shown(repetitions, "info") == shown(repetitions, "info") == FAILED


@pytest.fixture
def graph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    structlog.reset_defaults()
    (tmp_path / "graph.yaml").write_text(GRAPH)
    return tmp_path / "graph.yaml"


def test_a_live_session_writes_nothing_that_was_not_asked_for(graph: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with kg.live(graph) as session:
        assert sum(len(piece.series) for piece in session)
    assert capfd.readouterr() == ("", "")
    assert [path.name for path in graph.parent.iterdir()] == ["graph.yaml"]


def test_an_outlet_that_is_named_takes_part_and_the_log_is_heard_by_who_listens(
    graph: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "kinegraph")
    with kg.live(graph, outlets=["table"]) as session:
        assert list(session)
    assert (graph.parent / "rows.csv").read_text().count("\n") > 100
    assert "source ended" in caplog.text and "node=board" in caplog.text
    with pytest.raises(KinegraphError, match="there is no outlet 'tabel'; did you mean 'table'"):
        kg.live(graph, outlets=["tabel"])


def test_a_program_that_has_set_up_structlog_is_left_alone() -> None:
    structlog.configure(processors=[])
    to_logging()
    assert structlog.get_config()["processors"] == []
