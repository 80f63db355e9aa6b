"""From YAML to a checked graph: what a good one becomes, and the error of each bad one, with its line."""

from __future__ import annotations

import sys
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import GraphError, KinegraphError
from kinegraph.stream.graph import Edge, Graph, NodeOptions
from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.graph.reading import overrides
from kinegraph.stream.graph.reading.draft import build_from
from kinegraph.stream.graph.reading.load import load, load_text
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.yaml_lines import Located

GOOD = """\
name: walking
latency_budget_ms: 200
checkpoint_s: 5
session: {subject: P07, speed_m_s: 1.2, sites: [TA, GM]}
record: [low, cycles.rejected]
recording: {folder: out, rotate_mb: 100}
nodes:
  cycles:
    use: graph_parts.Cycles
    from: {touchdown: board.touchdown, signal: low}
  screen: {use: graph_parts.Screen, from: cycles, policy: drop_oldest, queue: 16}
  low:
    use: graph_parts.Low
    from: board
    cutoff_hz: 10
    worker: slow
    queue: 4
  board:
    use: graph_parts.Board
    policy: drop_oldest
    required: false
"""


def nodes(text: str) -> str:
    """A graph of a board, in lines 1 to 3, and these nodes from line 4."""
    return "nodes:\n  board:\n    use: graph_parts.Board\n" + dedent(text).replace("\n", "\n  ").join(["  ", "\n"])


def refused(text: str, **kwargs: Any) -> list[GraphError]:
    with pytest.raises(GraphError) as caught:
        load_text(text, **kwargs)
    error = caught.value
    assert str(error) and error.exit_code == 2
    return list(getattr(error, "errors", [error]))


def test_a_graph() -> None:
    graph = load_text(GOOD)
    assert graph.name == "walking"
    assert (graph.latency_budget_ms, graph.checkpoint_s) == (200, 5)
    assert graph.session == {"subject": "P07", "speed_m_s": 1.2, "sites": ["TA", "GM"]}
    assert graph.record == (Edge("low", "out"), Edge("cycles", "rejected"))
    assert (graph.recording.folder, graph.recording.rotate_mb, graph.recording.gather_s) == ("out", 100, 0.1)
    assert graph.text == GOOD
    assert list(graph.nodes) == ["board", "low", "cycles", "screen", "annotations"]
    low = graph.nodes["low"]
    assert low.inputs == {"in": Edge("board", "emg")}
    assert (low.options.worker, low.options.queue) == ("slow", 4)
    assert low.given == {"cutoff_hz": 10} and low.part.cutoff_hz == 10
    assert low.use == "graph_parts.Low" and low.line == 12
    assert graph.nodes["board"].options.policy == "drop_oldest" and not graph.nodes["board"].options.required
    assert list(graph.nodes["cycles"].inputs) == ["signal", "touchdown"], "ports stand in the operator's order"
    assert graph.spec(Edge("cycles", "cycle")).channels == ("left", "right")
    assert graph.nodes["screen"].is_outlet and graph.nodes["screen"].specs == {}


def test_the_order_is_the_files_where_it_can_be() -> None:
    text = nodes(
        """
        c: {use: graph_parts.Low, from: a}
        b: {use: graph_parts.Low, from: board}
        a: {use: graph_parts.Low, from: board}"""
    )
    assert list(load_text(text).nodes) == ["board", "b", "a", "c", "annotations"]


def test_ways_to_say_from() -> None:
    text = nodes(
        """
        port: {use: graph_parts.Port, port: /dev/ttyUSB0}
        one: {use: graph_parts.Low, from: [board.emg]}
        named: {use: graph_parts.Low, from: {in: board.emg}}
        list: {use: graph_parts.Join, from: [board, port, one]}
        renamed: {use: graph_parts.Join, from: {emg: board, acc: port}}
        single: {use: graph_parts.Join, from: port}"""
    )
    graph = load_text(text)
    emg = Edge("board", "emg")
    assert graph.nodes["one"].inputs == graph.nodes["named"].inputs == {"in": emg}
    assert graph.nodes["list"].inputs == {"board.emg": emg, "port": Edge("port", "out"), "one": Edge("one", "out")}
    assert graph.nodes["renamed"].specs["out"].channels == ("emg/left", "emg/right", "acc/x", "acc/y", "acc/z")
    assert list(graph.nodes["single"].inputs) == ["port"]


def test_annotations_are_always_there_unless_the_graph_has_its_own() -> None:
    graph = load_text(nodes("marks: {use: graph_parts.Join, from: annotations}"))
    assert graph.nodes["annotations"].is_source and graph.nodes["annotations"].line == 0
    own = load_text(nodes("annotations: {use: graph_parts.Port, port: /dev/x}"))
    assert own.nodes["annotations"].use == "graph_parts.Port"


NODE_ERRORS = [
    ("a: {use: graph_parts.Low, from: boad}", 4, ["node 'a'", "there is no node 'boad'", "did you mean 'board'?"]),
    ("a: {use: graph_parts.Low, from: board.egm}", 4, ["no output 'egm'", "did you mean 'emg'?"]),
    ("a: {use: graph_parts.Low, from: board, cutof_hz: 3}", 4, ["no parameter 'cutof_hz'", "'cutoff_hz'"]),
    ("a: {use: graph_parts.Low, from: board, form: board}", 4, ["no parameter 'form'", "did you mean 'from'?"]),
    (
        "a:\n  use: graph_parts.Low\n  from: board\n  cutoff_hz: fast",
        7,
        ["node 'a'", "cutoff_hz is 'fast'", "a number"],
    ),
    ("a: {use: graph_parts.Low, from: board, cutoff_hz: true}", 4, ["cutoff_hz is True", "a number"]),
    ("a: {use: graph_parts.Low, from: board, cutoff_hz: .nan}", 4, ["cutoff_hz is nan", "a finite number"]),
    ("a: {use: graph_parts.Low, from: board, cutoff_hz: 0}", 4, ["cutoff_hz is 0", "above 0"]),
    ("a: {use: graph_parts.Low, from: board, order: 2.5}", 4, ["order is 2.5", "a whole number"]),
    ("a: {use: graph_parts.Low, from: board, kind: lo}", 4, ["kind is 'lo'", "'low' or 'high'"]),
    ("a:\n  use: graph_parts.Low\n  from: board\n  cutoff_hz: 500", 7, ["node 'a': cutoff_hz is 500", "below 500"]),
    ("a:\n  use: graph_parts.Low\n  from: board.touchdown", 6, ["input 'in' is events (onset)", "'board.touchdown'"]),
    ("a: {use: graph_parts.Low}", 4, ["'from' is missing", "from: node.output"]),
    ("a: {use: graph_parts.Low, from: }", 4, ["'from' is missing"]),
    ("a: {use: graph_parts.Low, from: 3}", 4, ["the number 3 is not the name of a node"]),
    ("a: {use: graph_parts.Low, from: [board, board.touchdown]}", 4, ["2 inputs", "one input"]),
    ("a: {use: graph_parts.Cycles, from: board}", 4, ["one input is given", "named inputs", "liftoff may be left out"]),
    ("a: {use: graph_parts.Cycles, from: [board, board.touchdown]}", 4, ["a list is given", "named inputs"]),
    ("a: {use: graph_parts.Cycles, from: {signal: board}}", 4, ["nothing is connected to 'touchdown'"]),
    (
        "a:\n  use: graph_parts.Cycles\n  from:\n    signal: board\n    touchdown: board.touchdown\n    lifof: board.touchdown",
        9,
        ["no input 'lifof'", "did you mean 'liftoff'?"],
    ),
    ("a: {use: graph_parts.Cycles, from: {signal: board, touchdown: board}}", 4, ["'board.emg' is connected twice"]),
    ("a: {use: graph_parts.Join, from: [board, board.emg]}", 4, ["'board.emg' is connected twice"]),
    ("s: {use: graph_parts.Screen, from: board}\na: {use: graph_parts.Low, from: s}", 5, ["'s' is an outlet"]),
    ("p: {use: graph_parts.Port, from: board, port: /dev/x}", 4, ["Port is a source", "it takes no 'from'"]),
    ("p: {use: graph_parts.Port}", 4, ["node 'p'", "port is missing"]),
    ("p:\n  use: graph_parts.Port\n  port: COM1", 6, ["port is 'COM1'", "a path below /dev"]),
    ("p: {use: graph_parts.Port, port: /dev/x, worker: a}", 4, ["'worker' is an option of an operator"]),
    ("a: {use: graph_parts.Low, from: board, stale_s: 3}", 4, ["'stale_s' is an option of a source"]),
    ("a: {use: graph_parts.Low, from: board, queue: 3}", 4, ["'queue' needs a 'worker'"]),
    ("p: {use: graph_parts.Port, port: /dev/x, queue: 0}", 4, ["queue is 0", "at least 1"]),
    ("p: {use: graph_parts.Port, port: /dev/x, policy: drop}", 4, ["policy is 'drop'", "'drop_oldest'"]),
    ("a: {from: board}", 4, ["'use' is missing"]),
    ("a: board", 4, ["a node is a mapping with 'use', not the text 'board'"]),
    ("a b: {use: graph_parts.Low, from: board}", 4, ["a node's name is made of letters"]),
    ("a..b: {use: graph_parts.Low, from: board}", 4, ["a node's name is made of letters"]),
    ("a: {use: Low, from: board}", 4, ["use is 'Low'", "a dotted path"]),
    ("a: {use: 3, from: board}", 4, ["use is the number 3"]),
    ("a: {use: graph_parts.Lo, from: board}", 4, ["graph_parts has no 'Lo'", "did you mean 'Low'?"]),
    ("a: {use: graph_parts.np, from: board}", 4, ["must be a source, an operator or an outlet"]),
    ("a: {use: graph_parts.NoDataclass, from: board}", 4, ["is not a dataclass"]),
    ("a: {use: stream.operator.Operator, from: board}", 4, ["must be a source, an operator or an outlet"]),
    (
        "a: {use: stream.manuel.Value, initial: 1}",
        4,
        ["no module 'stream.manuel'", "did you mean 'stream.manual.Value'?"],
    ),
    ("a: {use: nowhere.to.be.Found, from: board}", 4, ["there is no module 'nowhere'"]),
    ("a: {use: graph_parts.Broken, from: board}", 4, ["ZeroDivisionError: division by zero", "graph_parts.py, line"]),
    ("a: {use: graph_parts.Broken, from: board, fault: outputs}", 4, ["declares the outputs ['out']", "['other']"]),
    ("a: {use: graph_parts.Broken, from: board, fault: state}", 4, ["must call set_state"]),
    ("a: {use: graph_parts.Greedy, from: board}", 4, ["has a parameter 'queue'", "must be renamed"]),
    (
        "a: {use: graph_parts.Shadow, from: board}",
        4,
        ["has a parameter 'outputs'", "to every Operator", "must be renamed"],
    ),
    (
        "a: {use: graph_parts.Low, from: c}\nb: {use: graph_parts.Low, from: a}\nc: {use: graph_parts.Low, from: b}",
        4,
        ["cycle: a -> b -> c -> a"],
    ),
    ("a: {use: graph_parts.Low, from: a}", 4, ["cycle: a -> a"]),
    (
        "a: {use: graph_parts.Low, from: board}\na: {use: graph_parts.Low, from: board}",
        5,
        ["'a' is given twice", "line 4"],
    ),
    ("a: {use: graph_parts.Low, use: graph_parts.Low, from: board}", 4, ["'use' is given twice"]),
]


@pytest.mark.parametrize(("text", "line", "words"), NODE_ERRORS, ids=[words[-1] for _, _, words in NODE_ERRORS])
def test_what_is_wrong_with_a_node(text: str, line: int, words: list[str]) -> None:
    (error,) = refused(nodes(text), path="here/graph.yaml")
    assert error.line == line
    assert str(error).startswith(f"here/graph.yaml:{line}: ")
    for word in words:
        assert word in str(error)


BOARD = "nodes: {board: {use: graph_parts.Board}}"
TOP_ERRORS = [
    ("", 1, ["a graph is a mapping that holds 'nodes:', not empty"]),
    ("- a\n", 1, ["not a list"]),
    ("name: x\n", 1, ["'nodes' is missing or empty"]),
    ("nodes:\n", 1, ["'nodes' is missing or empty"]),
    ("nodes: [a]\n", 1, ["nodes is a list; it must be a mapping"]),
    (f"latency_budget: 3\n{BOARD}", 1, ["unknown key 'latency_budget'", "did you mean 'latency_budget_ms'?"]),
    (f"{BOARD}\nlatency_budget_ms: soon\n", 2, ["latency_budget_ms is 'soon'", "a number"]),
    (f"{BOARD}\ncheckpoint_s: 0\n", 2, ["checkpoint_s is 0", "above 0"]),
    (f"{BOARD}\nname: 3\n", 2, ["name is 3", "a text"]),
    (f"{BOARD}\nsession: P07\n", 2, ["session is the text 'P07'; it must be a mapping"]),
    (f"{BOARD}\nsession:\n  speed: .inf\n", 3, ["speed is inf", "finite"]),
    (f"{BOARD}\nrecord: boad\n", 2, ["there is no node 'boad'"]),
    (f"{BOARD}\nrecord:\n- board\n- board.emg\n", 4, ["record names 'board.emg' twice"]),
    (f"{BOARD}\nrecording:\n  fodler: x\n", 3, ["recording: unknown key 'fodler'", "did you mean 'folder'?"]),
    (f"{BOARD}\nrecording:\n  quota_mb: -1\n", 3, ["recording: quota_mb is -1", "at least 0"]),
    ("nodes:\n  a: {use: graph_parts.Join, from: annotations}\n", 1, ["no source"]),
    ("nodes:\n\tboard: 1\n", 2, ["indented with a tab"]),
    ("nodes: [\n\nboard: 1\n", 4, ["the '[' opened in line 1 lacks a ','"]),
    ("nodes: {board: 1\n", 2, ["the '{' opened in line 1 lacks"]),
    ("nodes:\n  board: 'x\n", 3, ["the quotation mark opened in line 2 is never closed"]),
    ("nodes:\n  a: b: c\n", 2, ["unexpected ':'"]),
    ("nodes:\n  a: 1\n b: 2\n", 3, ["the indentation does not fit"]),
    ("name: @x\n", 1, ["needs quotes"]),
    ("name: *x\n", 1, ["no anchor is called", "x"]),
    ("nodes: {}\n---\nnodes: {}\n", 2, ["one file holds one graph"]),
    ("nodes:\n  a: !!python/object/apply:os.system ['true']\n", 2, ["the tag", "is refused"]),
    ("nodes:\n  a: !!python/name:os.system\n", 2, ["is refused"]),
    ("nodes:\n  1: {use: graph_parts.Board}\n", 2, ["a key must be text"]),
    ("nodes: &a\n  x: *a\n", 1, ["anchors"]),
    ("name: \x07\n", 1, ["the character"]),
    ("name: !!int fast\n", 1, ["is not what its tag"]),
]


@pytest.mark.parametrize(("text", "line", "words"), TOP_ERRORS, ids=[words[-1] for _, _, words in TOP_ERRORS])
def test_what_is_wrong_with_a_graph(text: str, line: int, words: list[str]) -> None:
    (error,) = refused(text, path="graph.yaml")
    assert error.line == line
    for word in words:
        assert word in str(error)


def test_anchors_and_merge_keys_are_plain_values() -> None:
    text = nodes(
        """
        a: &a {use: graph_parts.Low, from: board, cutoff_hz: 7, order: 2}
        b: {<<: *a, order: 3}"""
    )
    given = load_text(text).nodes["b"].given
    assert given == {"cutoff_hz": 7, "order": 3}


def test_anchors_that_grow_without_end_are_refused() -> None:
    rows = ["a0: &a0 [x]"] + [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)]
    (error,) = refused("session:\n  " + "\n  ".join(rows) + f"\n{BOARD}\n")
    assert "grow without end" in str(error)


def test_everything_that_is_wrong_is_told_at_once_in_the_files_order() -> None:
    text = """
        low: {use: graph_parts.Low, from: board, cutoff_hz: -1, order: 0}
        next: {use: graph_parts.Low, from: low}
        lost: {use: graph_parts.Low, from: nowhere}
        join: {use: graph_parts.Join, from: board.touchdow}
        deaf: {use: graph_parts.Lo, from: board}
        after: {use: graph_parts.Low, from: deaf.anything}"""
    errors = refused(nodes(text) + "record: [nix]\n")
    assert [error.line for error in errors] == [5, 5, 7, 8, 9, 11]
    assert "cutoff_hz" in str(errors[0]) and "order" in str(errors[1])
    assert not any(error.node in ("next", "after") for error in errors), (
        "what follows from another fault is not reported"
    )


def test_settings_of_the_command_line_replace_the_files() -> None:
    given = overrides.read(
        ["low.cutoff_hz=5", "session.speed_m_s=1.5", "latency_budget_ms=90", "low.worker=x", "name=w: 1"[:6]]
    )
    graph = load_text("# kept\n" + GOOD, overrides=given)
    assert graph.nodes["low"].part.cutoff_hz == 5
    assert graph.session["speed_m_s"] == 1.5 and graph.session["subject"] == "P07"
    assert (graph.latency_budget_ms, graph.name) == (90, "w")
    assert graph.text.startswith("# kept")
    again = load_text(graph.text)
    assert again.nodes["low"].part == graph.nodes["low"].part and again.session == graph.session


def test_a_setting_changes_no_other_node_that_shares_an_anchor() -> None:
    text = nodes("a: &a {use: graph_parts.Low, from: board}\nb: *a\nc: {<<: *a, order: 2}")
    graph = load_text(text, overrides={"a.order": 3})
    for loaded in (graph, load_text(graph.text)):
        assert [loaded.nodes[name].part.order for name in "abc"] == [3, 4, 2]


def test_a_setting_without_a_node_is_that_of_the_one_node_that_has_it() -> None:
    graph = load_text(GOOD, overrides=overrides.read(["cutoff_hz=7", "name=other"]))
    assert graph.nodes["low"].part.cutoff_hz == 7 and graph.name == "other"  # type: ignore[union-attr]
    assert "cutoff_hz: 7" in graph.text and load_text(graph.text).nodes["low"].part == graph.nodes["low"].part
    two = "nodes: {board: {use: graph_parts.Board}, a: {use: graph_parts.Low, from: board}, b: {use: graph_parts.Low, from: board}}"
    (error,) = refused(two, overrides=overrides.read(["cutoff_hz=7"]))
    assert "set as NODE.cutoff_hz, with one of the nodes a, b, board" in str(error)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("low.cutoff_hz=0", ["--set low.cutoff_hz: node 'low'", "above 0"]),
        ("low.cutoff_hz=600", ["--set low.cutoff_hz: node 'low'", "below 500"]),
        ("lo.cutoff_hz=6", ["--set lo.cutoff_hz", "there is no node 'lo'", "did you mean 'low'?"]),
        ("low.cutof=6", ["--set low.cutof", "no parameter 'cutof'", "'cutoff_hz'"]),
        ("latency=6", ["--set latency", "unknown key 'latency'", "set as NODE.latency"]),
        ("low.from=nowhere", ["--set low.from", "there is no node 'nowhere'"]),
    ],
)
def test_wrong_settings_of_the_command_line_are_named(setting: str, words: list[str]) -> None:
    (error,) = refused(GOOD, path="graph.yaml", overrides=overrides.read([setting]))
    for word in words:
        assert word in str(error)
    assert error.line is None


@pytest.mark.parametrize("setting", ["low.cutoff_hz", "=3", "a=[", "a=b: c: d"])
def test_settings_that_cannot_be_read(setting: str) -> None:
    with pytest.raises(KinegraphError, match="--set"):
        overrides.read([setting])


def recorded(**streams: StreamSpec) -> dict[str, StreamSpec]:
    return {name.replace("__", "."): spec for name, spec in streams.items()}


EMG = StreamSpec((3,), rate_hz=2000.0, channels=("TA", "GM", "VL"), units=("uV",))
CONTACT = StreamSpec((), np.dtype([("onset", "<i8")]), units=("ns",))


def test_a_recording_stands_in_for_the_sources() -> None:
    graph = load_text(GOOD, recorded=recorded(board__emg=EMG, board__touchdown=CONTACT, other=EMG))
    assert graph.nodes["low"].specs["out"].channels == ("TA", "GM", "VL")
    assert graph.nodes["annotations"].specs == {}, "an unread source may be absent"


def test_a_recording_that_lacks_a_stream_is_refused() -> None:
    (error,) = refused(GOOD, path="g.yaml", recorded=recorded(board__emg=EMG, other=EMG))
    for word in ("g.yaml:10: node 'cycles'", "lacks the stream 'board.touchdown'", "'board.emg', 'other'"):
        assert word in str(error)


def test_a_recorded_source_is_not_asked() -> None:
    text = nodes("port: {use: graph_parts.Port, port: elsewhere}\nlow: {use: graph_parts.Low, from: port}")
    assert "a path below /dev" in str(refused(text)[0])
    graph = load_text(text, recorded=recorded(port=EMG))
    assert graph.nodes["low"].specs["out"] == EMG and graph.nodes["board"].specs == {}


def test_recorded_edges_that_the_recording_lacks_are_left_out() -> None:
    text = nodes("low: {use: graph_parts.Low, from: board}") + "record: [board.touchdown, low]\n"
    graph = load_text(text, recorded=recorded(board__emg=EMG))
    assert graph.record == (Edge("low", "out"),)


OPERATOR = """
from dataclasses import dataclass
from kinegraph.stream.operator import Operator
from kinegraph.stream.params import param

@dataclass(slots=True)
class State:
    n: int

@dataclass(frozen=True, slots=True)
class Mine(Operator[State]):
    factor: float = param({factor})

    def open(self, specs):
        self.set_state(State(0))
        return {{"out": specs["in"]}}
"""


def beside(folder: Path, factor: float) -> Graph:
    folder.mkdir()
    (folder / "my_operators.py").write_text(OPERATOR.format(factor=factor))
    (folder / "walk.yaml").write_text(nodes("mine: {use: my_operators.Mine, from: board}"))
    return load(folder / "walk.yaml")


def test_a_file_beside_the_graph_is_enough(tmp_path: Path) -> None:
    first = beside(tmp_path / "first", 1.0)
    assert first.name == "walk" and first.path.endswith("walk.yaml")
    assert first.nodes["mine"].part.factor == 1.0
    assert beside(tmp_path / "second", 2.0).nodes["mine"].part.factor == 2.0, "each graph has its own"


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (
            "import numby\n",
            ["could not be imported", "ModuleNotFoundError: No module named 'numby'", "faulty.py, line 1"],
        ),
        ("x = 1\nx.y\n", ["AttributeError", "faulty.py, line 2"]),
        ("def f(:\n", ["SyntaxError", "faulty.py, line 1"]),
    ],
)
def test_a_module_that_cannot_be_imported_says_why(tmp_path: Path, code: str, words: list[str]) -> None:
    (tmp_path / "faulty.py").write_text(code)
    path = tmp_path / "graph.yaml"
    path.write_text(nodes("a: {use: faulty.Thing, from: board}"))
    with pytest.raises(GraphError) as caught:
        load(path)
    assert "graph.yaml:4: node 'a'" in str(caught.value) and caught.value.__cause__ is not None
    for word in words:
        assert word in str(caught.value)
    assert "faulty" not in sys.modules


@pytest.mark.parametrize(
    ("given", "problems"), [({"queue": 7}, 0), ({"queue": 0}, 1), ({"queue": 0, "silence_s": -1.0}, 2)]
)
def test_what_one_value_is_wrong_of_is_not_made_and_all_wrong_ones_are_told(
    given: dict[str, Any], problems: int
) -> None:
    found = Problems("g.yaml")
    made = build_from(NodeOptions, {key: Located(value, 3) for key, value in given.items()}, found)
    assert len(found) == problems and (made is None) == bool(problems)
    assert made is None or made.queue == 7


def test_an_error_names_the_file_or_else_the_graph() -> None:
    text = nodes("a: {use: graph_parts.Nothing, from: board}")
    assert [str(error)[:6] for error in refused(text, name="walk")] == ["walk:4"]
    assert "/x/walk.yaml:4" in str(refused(text, name="walk", path="/x/walk.yaml")[0])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("gaph.yaml", ["No such file", "did you mean 'graph.yaml'?"]),
        ("", ["directory"]),
        ("latin.yaml", ["not UTF-8 text"]),
    ],
)
def test_files_that_cannot_be_read(tmp_path: Path, name: str, words: list[str]) -> None:
    (tmp_path / "graph.yaml").write_text(GOOD)
    (tmp_path / "latin.yaml").write_bytes("name: Fuß\n".encode("latin-1"))
    with pytest.raises(GraphError) as caught:
        load(tmp_path / name)
    for word in words:
        assert word in str(caught.value)


def test_the_catalogue_finds_parts_and_names_what_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "some_parts"
    (package / "deep").mkdir(parents=True)
    (package / "__init__.py").write_text("from some_parts.deep.one import Mine\n")
    (package / "deep" / "__init__.py").write_text("")
    (package / "deep" / "one.py").write_text(OPERATOR.format(factor=1.0))
    (package / "faulty.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    parts, failed = catalogue(("some_parts", "nowhere"))
    assert list(parts) == ["some_parts.Mine"], "by the shortest path, and only its own"
    assert list(failed) == ["some_parts.faulty"] and "ZeroDivisionError" in failed["some_parts.faulty"]


def test_every_part_of_ours_can_be_imported() -> None:
    parts, failed = catalogue()
    assert failed == {}
    assert "stream.manual.Annotations" in parts
