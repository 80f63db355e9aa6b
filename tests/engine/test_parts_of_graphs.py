"""Parts of graphs: a graph's file that another graph uses as a node, and settings, which say what a person may set."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.operators.filters.iir import Lowpass
from kinegraph.stream.errors import GraphError
from kinegraph.stream.graph import Graph
from kinegraph.stream.graph.reading.load import load, load_text
from tests.support.command_line import Command, kinegraph, refused

__all__ = ["kinegraph"]

LEG = """\
part:
  inputs: {emg: raw EMG, mirrored: {help: the other leg, optional: true}}
  outputs: {out: envelope, low: smooth.low, emg: emg}
settings:
  cutoff_hz: {label: Low-pass, unit: Hz, default: 20, min: 1, max: 60, feeds: [envelope.cutoff_hz, smooth.cut]}
record: [envelope]
page: {panels: [{kind: signal, of: [emg, smooth.low]}]}
nodes:
  envelope: {use: operators.emg.Envelope, from: emg}
  smooth: {use: parts/smooth.yaml, from: envelope}
"""
SMOOTH = """\
part: {inputs: {in: a signal}, outputs: {low: low}}
settings: {cut: {feeds: low.cutoff_hz, type: number}}
nodes:
  low: {use: operators.filters.iir.Lowpass, from: in}
"""
WALK = """\
# A walk.
settings:
  subject: {label: Subject, type: text}
  smoothness: {feeds: left.cutoff_hz, default: 10}
record: [left.low]
nodes:
  treadmill: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 2}
  left: {use: parts/leg.yaml, from: treadmill.emg}
  right: {use: parts/leg.yaml, from: {emg: treadmill.emg}, cutoff_hz: 30}
  more: {use: operators.filters.iir.Lowpass, from: right, cutoff_hz: 2}
"""
NODES = "nodes:\n  treadmill: {use: devices.people.treadmill.Treadmill}\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "leg.yaml").write_text(LEG)
    (tmp_path / "parts" / "smooth.yaml").write_text(SMOOTH)
    (tmp_path / "walk.yaml").write_text(WALK)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def walk(**overrides: object) -> Graph:
    return load(Path("walk.yaml"), overrides={name.replace("__", "."): value for name, value in overrides.items()})


def wrong(node: str, part: str = "") -> str:
    """The error of a graph with this node, which may use parts/mine.yaml."""
    Path("parts/mine.yaml").write_text(part)
    Path("bad.yaml").write_text(NODES + node)
    with pytest.raises(GraphError) as caught:
        load(Path("bad.yaml"))
    return str(caught.value)


def test_the_nodes_of_a_part_have_the_parts_name_before_theirs(folder: Path) -> None:
    graph = walk()
    computed = ["left.envelope", "left.smooth.low", "right.envelope", "right.smooth.low", "more"]
    assert sorted(graph.nodes) == sorted(["treadmill", "annotations", *computed])
    assert str(graph.nodes["left.smooth.low"].inputs["in"]) == "left.envelope"
    assert str(graph.nodes["more"].inputs["in"]) == "right.envelope", "a part's first output by default"
    assert [str(edge) for edge in graph.record] == ["left.smooth.low", "left.envelope", "right.envelope"]
    assert graph.page.panels[0]["of"] == ["treadmill.emg", "left.smooth.low"]


def test_what_is_recorded_needs_no_files_of_parts(folder: Path) -> None:
    graph = walk(smoothness=12, left__smooth__low__order=3)
    (folder / "parts" / "leg.yaml").unlink()
    again = load_text(graph.text)
    assert again.text == graph.text and graph.text.startswith("# A walk.\n")
    assert [node.part for node in again.nodes.values()] == [node.part for node in graph.nodes.values()]
    assert again.record == graph.record and again.page.panels == graph.page.panels
    assert load_text(graph.text, overrides={"smoothness": 8}).nodes["left.envelope"].given["cutoff_hz"] == 8


def test_a_setting_reaches_every_parameter_that_it_feeds(folder: Path) -> None:
    def cut(graph: Graph, leg: str) -> list[object]:
        return [graph.nodes[f"{leg}.{node}"].given["cutoff_hz"] for node in ("envelope", "smooth.low")]

    assert cut(walk(), "left") == [10, 10] and cut(walk(), "right") == [30, 30]
    assert cut(walk(smoothness=12), "left") == [12, 12]
    assert cut(walk(right__cutoff_hz=40), "right") == [40, 40]
    assert cut(walk(right__envelope__cutoff_hz=40), "right") == [40, 30], "a parameter of one node"
    assert walk(subject="P07").session["subject"] == "P07"


def test_a_value_that_a_setting_does_not_accept_is_refused(folder: Path) -> None:
    for name, value, words in (
        ("right__cutoff_hz", 61, "right.cutoff_hz is 61; it must be a number from 1 to 60 Hz"),
        ("right__cutoff_hz", True, "must be a number"),
        ("right__cutoff_hz", float("nan"), "must be a number"),
        ("subject", 7, "subject is 7; it must be a text"),
    ):
        with pytest.raises(GraphError, match=words):
            walk(**{name: value})


def test_the_help_of_run_shows_the_graphs_settings(kinegraph: Command, folder: Path) -> None:
    code, output, _ = kinegraph("run", "walk.yaml", "--help")
    assert code == 0 and "--set NAME=VALUE" in output
    rows = {line.split()[0]: line for line in output.partition("Settings of walk")[2].splitlines()[1:] if line.strip()}
    assert rows.keys() == {"subject", "smoothness", "right.cutoff_hz"}, "not what an outer setting feeds"
    assert "Low-pass (a number from 1 to 60 Hz; default 30)" in rows["right.cutoff_hz"]


def test_a_setting_that_a_part_lacks_is_named_with_the_nearest(kinegraph: Command, folder: Path) -> None:
    refused(
        kinegraph("check", "walk.yaml", "--set", "right.cutof_hz=3"),
        "the part 'right' has no setting 'right.cutof_hz'; did you mean 'right.cutoff_hz'?",
    )


def test_a_run_with_parts_is_replayed_bit_for_bit_from_its_recording_alone(kinegraph: Command, folder: Path) -> None:
    assert kinegraph("run", "walk.yaml", "-o", "session", "--view", "none")[0] == 0
    (folder / "recorded.yaml").write_text(kinegraph("info", "session", "--graph")[1])
    for file in (folder / "parts").iterdir():
        file.unlink()
    code, output, _ = kinegraph("replay", "recorded.yaml", "session", "--verify")
    assert code == 0 and output.count("identical to the recording") == 3


@pytest.mark.parametrize("command", ["check", "draw"])
def test_commands_show_the_nodes_of_parts(kinegraph: Command, folder: Path, command: str) -> None:
    code, output, _ = kinegraph(command, "walk.yaml")
    assert code == 0 and "left.smooth.low" in output and "right.envelope" in output


def test_errors_name_both_files_and_lines(folder: Path) -> None:
    part = "part: {inputs: {in: x}}\nnodes:\n  low: {use: operators.filters.iir.Lowpass, from: in, cutoff_hz: 5000}\n"
    reported = wrong("  slow: {use: parts/mine.yaml, from: treadmill.emg}\n", part)
    assert reported.startswith("parts/mine.yaml:3: node 'slow.low': cutoff_hz is 5000") and "bad.yaml:3" in reported
    part = LEG.replace("default: 20, min: 1, max: 60, ", "")
    reported = wrong("  leg: {use: parts/mine.yaml, from: treadmill.emg, cutoff_hz: 900}\n", part)
    assert "bad.yaml:3: node 'leg.envelope': cutoff_hz is 900" in reported and "parts/mine.yaml:9" in reported


@pytest.mark.parametrize(
    ("node", "part", "words"),
    [
        ("leg: {use: parts/lag.yaml, from: treadmill.emg}", "", "did you mean 'parts/leg.yaml'?"),
        ("leg: {use: parts/leg.yaml, from: treadmill.emg, cutof_hz: 20}", "", "did you mean 'cutoff_hz'?"),
        ("leg: {use: parts/leg.yaml, from: tredmill.emg}", "", "there is no node 'tredmill'; did you mean 'treadmill'?"),
        ("leg: {use: parts/leg.yaml, from: {egm: treadmill.emg}}", "", "no input 'egm'; did you mean 'emg'?"),
        ("leg: {use: parts/leg.yaml}", "", "nothing is connected to 'emg'"),
        ("leg: {use: parts/leg.yaml, from: treadmill.emg, cutoff_hz: 99}", "", "a number from 1 to 60 Hz"),
        ("leg: {use: parts/leg.yaml, from: [treadmill]}", "", "names parts"),
        ("leg: {use: walk.yaml}", "", "walk.yaml is not a part"),
        ("leg.a: {use: parts/leg.yaml, from: treadmill.emg}", "", "a part's name"),
        ("leg: {use: parts/mine.yaml}", "part:\nnodes:\n  a: {use: parts/mine.yaml}", "uses itself: parts/mine.yaml -> parts/mine.yaml"),
        ("leg: {use: parts/mine.yaml}", "part:\nnodes:\n  a: {use: b.C, from: emg}", "no input or node 'emg'"),
        ("leg: {use: parts/mine.yaml, from: treadmill.emg}", "part: {inputs: {a: x}}\nnodes:\n  a: {use: b.C}", "an input and a node"),
        ("leg: {use: parts/mine.yaml}", "part: {outputs: {a: b}}\nnodes:\n  a: {use: b.C}\n  b: {use: b.C}", "has the name of a node"),
        ("leg: {use: parts/mine.yaml}", "part:\nsettings: {x: {feeds: b.c}}\nnodes:\n  a: {use: b.C}", "x feeds 'b.c'; it must be"),
        ("leg: {use: parts/mine.yaml}", "part:\nmemory_mb: 5\nnodes:\n  a: {use: b.C}", "a part has no key 'memory_mb'"),
        ("leg: {use: parts/mine.yaml}", "part:\nnodes:\n  annotations: {use: stream.manual.Annotations}", "belongs to the graph"),
        ("leg: {use: parts/mine.yaml}", "part: [\n", "parts/mine.yaml:"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_part_or_its_use(folder: Path, node: str, part: str, words: str) -> None:
    assert words in wrong(f"  {node}\n", part)


def test_parts_that_feed_each_other_in_a_circle_are_refused(folder: Path) -> None:
    through = (
        "part: {inputs: {in: x}, outputs: {out: in}}\nnodes:\n  a: {use: operators.filters.rectify.Rectify, from: in}\n"
    )
    both = "  one: {use: parts/mine.yaml, from: two}\n  two: {use: parts/mine.yaml, from: one}\n"
    assert "parts feed each other in a circle" in wrong(both, through)


def test_a_part_is_no_graph(kinegraph: Command, folder: Path) -> None:
    refused(kinegraph("check", "parts/leg.yaml"), "parts/leg.yaml:1", "this file is a part")


def test_parts_that_grow_without_end_are_refused(folder: Path) -> None:
    uses = "".join(f"  n{i}: {{use: parts/%s.yaml}}\n" for i in range(40))
    for name, inner in (
        ("a", uses % (("b",) * 40)),
        ("b", uses % (("c",) * 40)),
        ("c", "  x: {use: stream.manual.Value}\n"),
    ):
        (folder / "parts" / f"{name}.yaml").write_text(f"part:\nnodes:\n{inner}")
    assert "more than 1000 nodes" in wrong("  all: {use: parts/a.yaml}\n")


def test_a_name_that_begins_with_another_nodes_name_is_refused() -> None:
    nodes = (
        NODES
        + "  a: {use: operators.filters.rectify.Rectify, from: treadmill.emg}\n  a.b: {use: operators.filters.rectify.Rectify, from: a}\n"
    )
    with pytest.raises(GraphError, match=r"the name of the node 'a.b' begins with that of the node 'a'"):
        load_text(nodes)


def test_an_optional_input_that_is_not_connected_is_left_out(folder: Path) -> None:
    part = """\
part: {inputs: {emg: x, more: {optional: true}}, outputs: {out: both}}
nodes:
  both: {use: operators.timing.align.Align, from: {a: emg, b: more}, rate_hz: 100}
"""
    (folder / "parts" / "mine.yaml").write_text(part)
    for reads, ports in (("treadmill.emg", {"a"}), ("{emg: treadmill.emg, more: treadmill.force}", {"a", "b"})):
        graph = load_text(f"{NODES}  it: {{use: parts/mine.yaml, from: {reads}}}\n")
        assert graph.nodes["it.both"].inputs.keys() == ports


def test_a_list_connects_the_outputs_of_parts_to_inputs_of_the_same_names(folder: Path) -> None:
    part = "part: {inputs: {emg: x, low: y}}\nnodes:\n  both: {use: operators.timing.align.Align, from: [emg, low], rate_hz: 100}\n"
    (folder / "parts" / "mine.yaml").write_text(part)
    text = WALK + "  it: {use: parts/mine.yaml, from: [left]}\n"
    assert [str(edge) for edge in load_text(text).nodes["it.both"].inputs.values()] == [
        "treadmill.emg",
        "left.smooth.low",
    ]
    with pytest.raises(GraphError, match=r"'left.emg' and 'right.emg' would both feed 'emg'"):
        load_text(text.replace("[left]", "[left, right]"))


def test_a_shipped_part_is_found_from_anywhere(kinegraph: Command) -> None:
    Path("mine.yaml").write_text(NODES + "  leg: {use: parts/emg.yaml, from: treadmill.emg}\n")
    assert kinegraph("check", "mine.yaml")[0] == 0
    refused(kinegraph("configs", "parts/emmg.yaml"), "did you mean 'parts/emg.yaml'?")
    assert "parts/emg.yaml" in kinegraph("configs")[1]
    assert kinegraph("configs", "parts/emg.yaml")[0] == 0 and Path("parts/emg.yaml").is_file()


def test_a_graph_in_python_uses_parts_and_declares_settings(folder: Path) -> None:
    graph = kg.Graph("walk")
    graph.add("board", kg.Input(channels=["TA", "SO"], rate_hz=1000, units=["uV"]))
    graph.add("left", "parts/leg.yaml", "board", cutoff_hz=25)
    graph.add("more", Lowpass(cutoff_hz=2), "left.low", record=True)
    graph.setting("smoothness", feeds="left.cutoff_hz", label="Smoothness")
    graph.record("left.low")
    assert list(graph.nodes) == ["board", "left.envelope", "left.smooth.low", "more"]
    results = graph.run(np.random.default_rng(1).normal(size=(2000, 2)))
    assert len(results["left.smooth.low"].data) == len(results["left.envelope"].data) > 0
    made: dict[str, kg.Graph] = {}
    exec(graph.to_python(), made)
    assert made["graph"].to_yaml() == graph.to_yaml() and "use: parts/leg.yaml" in graph.to_yaml()
    again = kg.Graph.from_yaml(graph.to_yaml())
    assert list(again.nodes) == list(graph.nodes)
    with pytest.raises(GraphError, match="must be a number from 1 to 60 Hz"):
        graph.add("right", "parts/leg.yaml", "board", cutoff_hz=99)
    with pytest.raises(GraphError, match="already has a node"):
        graph.add("left", "parts/leg.yaml", "board")
    assert list(graph.nodes) == list(again.nodes), "what is refused is not added"
