"""Answers of the shipped graphs: every page begins with what its use is for, of streams that the graph has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.lab.results import result_of, shown
from kinegraph.devices.page.transfer.catalogue import offered, panels_of
from kinegraph.stream.errors import GraphError
from kinegraph.stream.graph.reading.load import load, load_text
from kinegraph.stream.graph.shipped import shipped

BOARD = (
    "nodes:\n  board: {use: devices.people.treadmill.Treadmill}\npage:\n  panels:\n    - {kind: answer, show: [%s]}\n"
)


@pytest.mark.parametrize("name", shipped())
def test_the_first_panel_of_every_graph_is_its_answer_of_streams_and_fields_that_it_has(name: str) -> None:
    graph = load(Path(name))
    specs = offered(graph, outside=False)
    first, *others = panels_of(graph, specs)
    assert first["kind"] == "answer" and not first["missing"] and first["show"]
    for item in first["show"]:
        assert item["of"] in specs and item["of"] in first["of"]
        spec = specs[item["of"]]
        names = spec.dtype.names or spec.channels
        assert {item.get("field", names[0]), *item.get("where", {}), *item.get("between", ())} <= set(names), item
    assert all(panel.get("folded") for panel in others if panel["kind"] == "table"), "tables are among the signals"


def test_without_a_section_signals_on_the_way_to_what_is_wanted_are_folded() -> None:
    graph = load_text(
        "nodes:\n  board: {use: devices.people.treadmill.Treadmill}\n"
        "  rect: {use: operators.filters.rectify.Rectify, from: board.emg}\n"
        "  chain: {use: operators.emg.Envelope, from: rect}\nrecord: [chain]\n"
    )
    panels = panels_of(graph, offered(graph, outside=False))
    signals = {panel["of"][0]: panel.get("folded", False) for panel in panels if panel["kind"] == "signal"}
    assert signals == {"board.emg": True, "rect": True, "board.force": False, "chain": False}


def test_an_answer_of_a_stream_that_is_not_there_is_refused_with_its_line() -> None:
    with pytest.raises(GraphError, match=r"(?s):5: .*'bord'.*did you mean 'board'"):
        load_text(BOARD % "{of: bord.touchdown, count: true}")
    with pytest.raises(GraphError, match="decimals"):
        load_text(BOARD % "{of: board.touchdown, field: onset, decimals: 9}")


def test_a_result_in_words_is_the_newest_that_fits() -> None:
    rows = np.array(
        [(1, "sleep", True), (2, "wake", False), (3, "sleep", True)], [("n", "i8"), ("state", "U7"), ("final", "?")]
    )
    time = np.arange(3, dtype=np.int64)
    assert shown({"field": "state", "values": {"sleep": "asleep"}}, time, rows) == "asleep"
    assert shown({"field": "state", "where": {"final": False}}, time, rows) == "wake"
    assert shown({"count": True, "where": {"state": ["sleep"]}}, time, rows) == "2"
    assert shown({"field": "n"}, time[:0], rows[:0]) == ""


def test_the_result_of_a_night_that_was_not_recorded_is_its_reports_sentence(tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text(
        '<h1>Night</h1>\n<p class="sentence">Asleep <b>7 h</b>, awake 20&nbsp;min.</p>'
    )
    assert result_of(tmp_path) == "Asleep 7 h, awake 20 min."
