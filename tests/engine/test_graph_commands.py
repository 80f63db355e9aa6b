"""check, draw, components and schema; the schema is held against what `load` accepts."""

from __future__ import annotations

import json
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from kinegraph.stream.cli.commands.check import _narrow, check
from kinegraph.stream.cli.commands.components import components, reflowed
from kinegraph.stream.cli.commands.draw import DrawingFormat, draw
from kinegraph.stream.cli.commands.schema import schema
from kinegraph.stream.errors import GraphError, KinegraphError
from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.graph.plan import plan
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.graph.reading.schema import graph_schema, unit_of
from kinegraph.stream.graph.reading.yaml_lines import parse
from tests.engine.test_load import GOOD, NODE_ERRORS, TOP_ERRORS, nodes

CONFIGS = sorted((Path(__file__).resolve().parents[2] / "configs").glob("*.yaml"))


@pytest.fixture
def good(tmp_path: Path) -> Path:
    path = tmp_path / "walking.yaml"
    path.write_text(GOOD)
    return path


def test_check_shows_nodes_and_paths(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check(good)
    shown = capsys.readouterr().out
    rows = [" ".join(line.split()) for line in shown.splitlines()]
    assert "low graph_parts.Low board.emg 2 channels float64 at 1000 Hz in µV" in rows
    assert "touchdown: board.touchdown" in shown and "rejected: events (onset), irregular" in shown
    assert "board -> low -> cycles -> screen" in shown and "low 4 ms + cycles 50 ms = 54 ms" in shown
    assert "OK: delay at most 54 ms (budget 200 ms)" in shown
    assert "annotations" not in shown


def test_check_fits_a_narrow_terminal(good: Path) -> None:
    graph = load_text(good.read_text(), path=str(good))
    reported = _narrow(graph, plan(graph), 50)
    assert max(map(len, reported.splitlines())) <= 50
    assert all(f"\n{name}  {node.use}" in reported for name, node in graph.nodes.items() if name != "annotations")
    assert "\n  delay " in reported and "; memory " in " ".join(reported.split())


def test_check_points_at_what_nobody_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "g.yaml"
    path.write_text(nodes("cycles: {use: graph_parts.Cycles, from: {signal: board, touchdown: board.touchdown}}"))
    check(path)
    shown = capsys.readouterr().out
    assert "nothing reads or records 'cycles.cycle'" in shown and "'board" not in shown.partition("note:")[2]


def test_check_shows_the_paths_of_a_late_graph_too(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(GraphError, match="latency_budget_ms is 20") as caught:
        check(good, ["latency_budget_ms=20"])
    assert caught.value.exit_code == 2
    assert "54 ms" in (shown := capsys.readouterr().out) and "OK" not in shown


def test_draw_a_tree(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    draw(good, settings=["low.order=3"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "walking"
    assert lines[1] == "└── board graph_parts.Board()"
    text = "\n".join(lines)
    assert "low graph_parts.Low(cutoff_hz=10, order=3) worker slow" in text
    assert "recorded" in text and "cycles (into touchdown) see above" in text
    assert "annotations" not in text


def test_draw_mermaid_and_dot(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    draw(good, DrawingFormat.mermaid)
    text = capsys.readouterr().out
    assert text.startswith("flowchart LR\n") and 'n0(["board<br/>graph_parts.Board"])' in text
    assert 'n0 -- "emg: 2 channels float64 at 1000 Hz in µV" --> n1' in text
    draw(good, DrawingFormat.dot)
    text = capsys.readouterr().out
    assert text.startswith('digraph "walking" {') and text.endswith("}\n")
    assert 'n0 -> n1 [label="emg: 2 channels float64 at 1000 Hz in µV"];' in text
    draw(good, DrawingFormat.dot, ['name=the "big" walk'])
    assert capsys.readouterr().out.startswith(r'digraph "the \"big\" walk" {')


@cache
def the_schema() -> dict[str, Any]:
    return graph_schema(catalogue(("graph_parts", "stream.manual", "operators", "devices"))[0])


@cache
def validator() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(the_schema())


def faults(text: str) -> list[Any]:
    return list(validator().iter_errors(parse(text, "graph").plain()))


def test_the_schema_is_one() -> None:
    jsonschema.Draft202012Validator.check_schema(the_schema())


@pytest.mark.parametrize(
    "text", [GOOD, *(path.read_text() for path in CONFIGS)], ids=["good", *(p.stem for p in CONFIGS)]
)
def test_the_schema_takes_what_load_takes(text: str) -> None:
    assert faults(text) == []


@pytest.mark.parametrize(
    "text",
    [
        "list: {use: graph_parts.Join, from: [board, board.touchdown]}",
        "one: {use: graph_parts.Low, from: [board.emg]}",
        "named: {use: graph_parts.Low, from: {in: board.emg}}",
        "mine: {use: my_package.my_module.Mine, from: board, anything: [1, 2]}",
    ],
)
def test_the_schema_takes_every_way_to_write_a_node(text: str) -> None:
    assert faults(nodes(text)) == []


def test_a_graph_may_have_one_node_and_must_have_one() -> None:
    assert faults("nodes: {board: {use: graph_parts.Board}}") == []
    assert faults("nodes: {}") != []


BY_LOAD_ALONE = (
    "there is no", "no output", "no module", "cycle:", "connected twice", "an outlet", "below 500", "(onset)", "/dev", "given twice",
    "graph_parts has no", "must be a source", "is not a dataclass", "set_state", "other", "ZeroDivision", "must be renamed", "record names",
    "no source", "finite",
)  # fmt: skip
"""What takes the whole graph, or the classes themselves, to see."""


def for_the_schema() -> list[Any]:
    """The bad graphs of test_load that are YAML, and wrong in a way that a schema can see."""
    found = []
    for text, words in [(nodes(text), words) for text, _, words in NODE_ERRORS] + [(t, w) for t, _, w in TOP_ERRORS]:
        with suppress(GraphError):
            parse(text, "graph")
            if not any(alone in word for alone in BY_LOAD_ALONE for word in words):
                found.append(pytest.param(text, id=words[-1]))
    return found


@pytest.mark.parametrize("text", for_the_schema())
def test_the_schema_refuses_what_load_refuses(text: str) -> None:
    assert faults(text)


def test_most_bad_graphs_are_for_the_schema() -> None:
    assert len(for_the_schema()) > 35


def test_the_schema_tells_an_editor_what_a_parameter_is() -> None:
    low = the_schema()["$defs"]["graph_parts.Low"]
    assert low["properties"]["cutoff_hz"] == {
        "default": 20.0, "exclusiveMinimum": 0.0, "type": "number", "description": "where it cuts (Hz)",
    }  # fmt: skip
    assert low["properties"]["kind"]["enum"] == ["low", "high"]
    assert low["required"] == ["use", "from"] and low["description"] == "A filter in name only: it checks like one."
    board = the_schema()["$defs"]["graph_parts.Board"]["properties"]
    assert board["rate_hz"]["description"] == "samples per second (Hz)", "a line of the docstring will do"
    assert board["queue"]["minimum"] == 1 and "from" not in board and "worker" not in board
    offered = the_schema()["$defs"]["node"]["properties"]["use"]["anyOf"][0]["enum"]
    assert "graph_parts.Low" in offered and "stream.manual.Value" in offered


@pytest.mark.parametrize(
    ("name", "unit"),
    [("cutoff_hz", "Hz"), ("speed_m_s", "m/s"), ("window_s", "s"), ("share_percent", "%"), ("order", ""), ("s", "")],
)
def test_units_stand_in_names(name: str, unit: str) -> None:
    assert unit_of(name) == unit


def test_schema_writes_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    schema(Path("kinegraph.schema.json"), ["graph_parts"])
    written = json.loads(Path("kinegraph.schema.json").read_text())
    assert "graph_parts.Low" in written["$defs"] and "stream.manual.Value" in written["$defs"]
    assert "kinegraph.schema.json:" in capsys.readouterr().out
    with pytest.raises(KinegraphError, match="cannot be written"):
        schema(Path("missing/kinegraph.schema.json"))


def test_parts_lists_what_there_is_and_shows_one(capsys: pytest.CaptureFixture[str]) -> None:
    components()
    listed = capsys.readouterr().out
    assert all(path in listed for path in catalogue()[0])
    components("operators.filters.iir.Lowpass")
    shown = " ".join(capsys.readouterr().out.split())
    assert (
        "inputs in outputs out" in shown and "cutoff_hz (must be given) number > 0" in shown and "zero | first" in shown
    )
    assert "order 4 integer >= 1 <= 20" in shown and "reset_gap_s 0.1 number >= 0" in shown
    components("operators.filters.channels.Select")
    shown = " ".join(capsys.readouterr().out.split())
    assert "channels array names" in shown and "rename object new names" in shown  # an empty default is not shown
    components("graph_parts.Cycles")
    assert "graph_parts.Cycles (operator)" in " ".join(capsys.readouterr().out.split())
    with pytest.raises(KinegraphError, match="no component matches 'Lowpas5'; did you mean 'Lowpass'"):
        components("Lowpas5")
    with pytest.raises(
        KinegraphError, match=r"no component matches 'Xyz'; `kinegraph components` lists all components$"
    ):
        components("Xyz")


def test_an_example_keeps_its_lines() -> None:
    assert reflowed("Doubles.\n\n>>> double(1)\n2", 30).split("\n\n") == ["Doubles.", ">>> double(1)\n2"]


def test_a_description_is_laid_out_again_for_a_narrow_terminal() -> None:
    ports = "in     what comes in, in a line that goes on\n       here\nout    what goes out\n- an item\n  of two lines"
    text = f"One sentence that\ngoes on.\n\n{ports}"
    assert reflowed(text, 30).split("\n") == [
        "One sentence that goes on.",
        "",
        "in     what comes in, in a",
        "       line that goes on here",
        "out    what goes out",
        "- an item of two lines",
    ]
