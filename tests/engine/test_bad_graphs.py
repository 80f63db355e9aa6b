"""Graphs, settings and arguments that cannot be: a message that says what, where and what to do; the right exit code; nothing lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.command_line import BOARD, GRAPH, QUIET, Command, refused

BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{new}: &{new} [{','.join([f'*{old}'] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
LOW = BOARD % 2 + "  low: {use: operators.filters.iir.Lowpass, from: board.emg, cutoff_hz: %s}\n"
MEAN = BOARD % 2 + "  mean: {use: operators.filters.moving.MovingMean, from: board.emg, window_s: %s}\n"
CHAIN = "".join(f"  n{i}: {{use: operators.filters.rectify.Rectify, from: n{i - 1}}}\n" for i in range(1, 1001))
GRAPHS: list[tuple[str | bytes, list[str]]] = [
    ("", ["a graph is a mapping", "not empty"]),
    (b"\x00" * 4096, ["is not allowed in YAML"]),
    ("\n\nnodes:\n  board: \x01\n", ["g.yaml:4:", "is not allowed in YAML"]),
    (bytes(range(128, 256)), ["not UTF-8 text"]),
    (GRAPH.encode("utf-16"), ["not UTF-8 text"]),
    ("nodes:\n\tboard: 1\n", ["g.yaml:2:", "a tab"]),
    ("nodes: {a: [1, 2\n", ["lacks a ','"]),
    ("nodes: " + "[" * 300 + "]" * 300, ["too deep"]),
    ("nodes: " + "{a: " * 200 + "1" + "}" * 200, ["too deep"]),
    (BOMB + GRAPH, ["anchors", "grow without end"]),
    ("nodes: &n\n  board: *n\n", ["contain themselves"]),
    ("nodes: !!python/object/apply:os.system ['true']\n", ["is refused"]),
    (BOARD % "ten", ["g.yaml:2:", "node 'board'", "duration_s is 'ten'", "must be a number"]),
    (BOARD % ".nan", ["duration_s is nan"]),
    (BOARD % -5, ["duration_s is -5", "at least 0"]),
    (BOARD % "2, seed: 1.5", ["seed is 1.5", "a whole number"]),
    (BOARD % f"2, seed: {'9' * 5000}", ["g.yaml:2:", "9..."]),
    (BOARD % "2, duration: 3", ["no parameter 'duration'", "did you mean 'duration_s'?"]),
    (BOARD % "2, policy: maybe", ["policy is 'maybe'", "'drop_oldest'"]),
    ("nodes:\n  board: {use: devices.people.treadmill.Tredmill}\n", ["did you mean 'Treadmill'?"]),
    ("nodes:\n  board: {use: os.system}\n", ["must be a source, an operator or an outlet"]),
    ("nodes:\n  ../x: {use: devices.people.treadmill.Treadmill}\n", ["a node's name is made of letters"]),
    ("name: ../../evil\n" + GRAPH, ["g.yaml:1:", "name:", "without '/'"]),
    (f"name: {'n' * 300}\n" + GRAPH, ["g.yaml:1:", "short"]),
    (GRAPH.replace("board.emg", "bord.emg"), ["there is no node 'bord'", "did you mean 'board'?"]),
    (GRAPH.replace("board.emg", "board.touchdown"), ["node 'rect'", "must be a stream of numbers"]),
    (GRAPH.replace("board.emg", "rect"), ["contains a cycle"]),
    (LOW % 1200, ["cutoff_hz is 1200", "below 500"]),
    (LOW % "", ["cutoff_hz is empty", "a number"]),
    (MEAN % 1e12, ["g.yaml:3:", "node 'mean'", "MovingMean", "make its windows and rates smaller"]),
    (MEAN % 1e300, ["g.yaml:3:", "node 'mean'", "MovingMean", "make its windows and rates smaller"]),
    (LOW % "20 Hz", ["cutoff_hz is '20 Hz'", "a number"]),
    ("memory_mb: 1\n" + MEAN % 3000, ["g.yaml", "most of it 'mean'", "at most 1 MB may be taken (memory_mb)"]),
    (BOARD % 2 + CHAIN, ["g.yaml:", "the graph has 1001 nodes", "at most 1000"]),
    ("# " + "x" * (512 << 10) + "\n" + GRAPH, ["characters", "at most 524288"]),
    ("latency_budget_ms: 0\n" + GRAPH, ["latency_budget_ms is 0", "above 0"]),
]  # fmt: skip


@pytest.mark.parametrize(("text", "words"), GRAPHS, ids=[words[-1] for _, words in GRAPHS])
def test_a_graph_that_cannot_be(text: str | bytes, words: list[str], kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
    refused(kinegraph("check", "g.yaml"), "kinegraph: g.yaml", *words)
    refused(kinegraph("run", "g.yaml", *QUIET), *words)
    assert [p.name for p in tmp_path.iterdir()] == ["g.yaml"], "nothing is begun for a graph that cannot run"


SETTINGS = [
    ("x", "it must be NAME=VALUE"),
    ("=5", "it must be NAME=VALUE"),
    ("board.duration_s", "it must be NAME=VALUE"),
    ("board.duration_s=", "duration_s is empty"),
    ("board.duration_s=[1,", "this is not YAML"),
    ("board.seed=&a [*a]", "contain themselves"),
    ("board.seed=!!python/name:os.system", "is refused"),
    ("bord.duration_s=1", "did you mean 'board'?"),
    ("board.use=os.system", "must be a source"),
    ("record=[nope]", "there is no node 'nope'"),
    ("name=../x", "without '/'"),
]


@pytest.mark.parametrize(("setting", "words"), SETTINGS)
def test_a_setting_that_cannot_be(setting: str, words: str, kinegraph: Command, made: Path) -> None:
    refused(kinegraph("run", made / "graph.yaml", "--set", setting, *QUIET), "--set", words)


def test_arguments_that_cannot_be(kinegraph: Command, made: Path, tmp_path: Path) -> None:
    graph = made / "graph.yaml"
    (tmp_path / "file").write_text("x")
    refused(kinegraph(), "usage: kinegraph COMMAND")
    refused(kinegraph("runn"), "did you mean 'kinegraph run'?")
    refused(kinegraph("run"), "kinegraph: missing argument 'CONFIG'; `kinegraph run --help` describes it")
    refused(kinegraph("run", graph, "--nope"), "kinegraph: no such option: --nope")
    refused(kinegraph("run", "none.yaml"), "none.yaml: the graph cannot be read: No such file")
    refused(kinegraph("run", "bedside"), "did you mean 'bedside_simulated' or 'bedside_sleep' or 'bedside_two'?")
    (tmp_path / "folder.yaml").mkdir()
    output = kinegraph("run", "folder.yaml")
    refused(output, "cannot be read: Is a directory")
    assert "did you mean" not in output[2]
    (tmp_path / "folder.yaml").rmdir()
    refused(kinegraph("run", "x" * 5000), "File name too long")
    for seconds in ("nan", "inf", "-1", "soon"):
        refused(kinegraph("run", graph, "--for", seconds), "--for")
    refused(kinegraph("run", graph, "--view", "nope", "--no-record"), "there is no view 'nope'", "lines")
    refused(kinegraph("run", graph, *QUIET, "-o", "x.mcap"), "is a folder; name it without .mcap")
    refused(kinegraph("run", graph, *QUIET, "-o", "file"), "file: is a file; choose a folder")
    refused(kinegraph("run", graph, *QUIET, "-o", "file/below"), "file/below", "choose a folder")
    refused(kinegraph("run", graph, *QUIET, "-o", "n" * 300), "File name too long")
    refused(kinegraph("replay", graph, made / "s", "--speed", "-1"), "--speed")
    refused(kinegraph("replay", graph, made / "s", "--speak", "nope"), "--speak")
    refused(kinegraph("dev", "try", "no.such.Operator"), "no")
    refused(kinegraph("dev", "schema", "-o", "none/s.json"), "none/s.json cannot be written")
    assert [p.name for p in tmp_path.iterdir()] == ["file"] and (tmp_path / "file").read_text() == "x"
