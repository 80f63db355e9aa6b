"""A node is opened once a run: where its graph is loaded. What checked it is what is tried, put back, and run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.oak import Oak
from kinegraph.stream.chunk import Chunk, Specs
from kinegraph.stream.engine import warmup
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph import Graph, Node
from kinegraph.stream.graph.components import is_ours
from kinegraph.stream.graph.reading.load import load, load_text
from kinegraph.stream.laws.play import through_file
from kinegraph.stream.operator import Operator
from kinegraph.stream.outlet import Outlet
from tests.support.pose_model import pose_network_or_skip
from tests.support.tiers import one_in_five

CONFIGS = sorted((Path(__file__).resolve().parents[2] / "configs").glob("*.yaml"))


@dataclass
class Openings:
    """Every operator that was opened, and on which inputs; an `open` that calls another one's is one."""

    found: list[tuple[Operator[Any], Specs]] = field(default_factory=list)

    def watch(self, graph: Graph, patch: pytest.MonkeyPatch) -> None:
        """Count what is opened of the graph's classes from now on."""
        inside: set[int] = set()

        def counted(open_: Any) -> Any:
            def opened(operator: Operator[Any], specs: Specs) -> Specs:
                if id(operator) in inside:
                    return open_(operator, specs)  # type: ignore[no-any-return]
                self.found.append((operator, specs))
                inside.add(id(operator))
                try:
                    return open_(operator, specs)  # type: ignore[no-any-return]
                finally:
                    inside.discard(id(operator))

            return opened

        for kind in {type(node.part) for node in graph.nodes.values() if isinstance(node.part, Operator)}:
            patch.setattr(kind, "open", counted(kind.open))

    def of(self, node: Node, graph: Graph) -> int:
        """How often the node was opened; of several that are alike, together."""
        specs = graph.input_specs(node)
        return sum(type(one) is type(node.part) and one == node.part and given == specs for one, given in self.found)


def alike(node: Node, graph: Graph) -> int:
    """How many nodes have this node's parameters and inputs' specs."""
    specs = graph.input_specs(node)
    return sum(
        type(n.part) is type(node.part) and n.part == node.part and graph.input_specs(n) == specs
        for n in graph.nodes.values()
    )


@pytest.fixture
def openings(monkeypatch: pytest.MonkeyPatch) -> Iterator[Openings]:
    monkeypatch.setattr(warmup, "run_cases", lambda part: None)  # other operators, with parameters of their own
    yield Openings()


def identical(a: Any, b: Any) -> bool:
    """Whether two arrays hold the same bits; what lies between the fields of a structured one does not count."""
    if a.dtype != b.dtype:
        return False
    return all(a[n].tobytes() == b[n].tobytes() for n in a.dtype.names) if a.dtype.names else a.tobytes() == b.tobytes()


@pytest.mark.parametrize("path", one_in_five(CONFIGS), ids=lambda path: path.stem)
def test_a_shipped_graphs_nodes_are_opened_once_and_put_back_after_they_were_tried(
    path: Path, openings: Openings, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "pose_network" in path.read_text(encoding="utf-8"):
        pose_network_or_skip()
    monkeypatch.setattr(Oak, "check_network", lambda self: None)  # its archive is the user's
    openings.watch(load(path), monkeypatch)
    graph = load(path)
    pipeline = Pipeline(graph, speaking=graph.outlets)
    before = {name: through_file(stage.operator.snapshot()) for name, stage in pipeline.stages.items()}
    warmup.warm_up(pipeline)
    for name, stage in pipeline.stages.items():
        assert openings.of(stage.node, graph) == alike(stage.node, graph), name
        after = stage.operator.snapshot()
        assert after.keys() == before[name].keys()
        assert all(identical(a, before[name][k]) for k, a in after.items())


GIVEN: list[float] = []


@dataclass(slots=True)
class Total:
    """The sum of what has come."""

    sum: float = 0.0


@dataclass(frozen=True)
class Sloppy(Operator[Total]):
    """A running sum that remembers beside its state what no snapshot holds: how many samples it has had."""

    def open(self, specs: Specs) -> Specs:
        self.set_state(Total())
        object.__setattr__(self, "count", [0])
        return {"out": specs["in"].derive(shape=(1,), channels=("sum",), units=("",))}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        out = np.zeros((len(chunk), 1))
        for i, row in enumerate(chunk.data):
            self.count[0] += 1  # type: ignore[attr-defined]
            self.state.sum += float(row[0])
            out[i] = self.state.sum + 1e6 * self.count[0]  # type: ignore[attr-defined]
        return Chunk(chunk.time, out, chunk.until, chunk.lost)


@dataclass(frozen=True, slots=True)
class Keeps(Outlet[None]):
    """Puts what it is given into GIVEN."""

    def open(self, specs: Specs) -> Specs:
        self.set_state(None)
        return {}

    def process(self, port: str, chunk: Chunk) -> None:
        GIVEN.extend(chunk.data[:, 0].tolist())


OUTSIDE = """
nodes:
  a: {use: parts.Counting, samples: 300}
  low: {use: operators.filters.iir.Lowpass, cutoff_hz: 20, from: a}
  total: {use: tests.engine.test_opened_once.Sloppy, from: a}
  kept: {use: tests.engine.test_opened_once.Keeps, from: total}
"""


def test_an_operator_from_outside_is_opened_once_to_run_and_once_to_be_tried(
    openings: Openings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it remembers beside its state cannot be put back, so that another one is tried; its output is that of a new one."""
    openings.watch(load_text(OUTSIDE), monkeypatch)
    graph = load_text(OUTSIDE)
    GIVEN.clear()
    assert Session(graph).run().exit_code == 0
    assert {name: openings.of(node, graph) for name, node in graph.nodes.items() if not node.is_source} == {
        "low": 1,
        "total": 2,
        "kept": 1,
    }
    assert [k * (k + 1) / 2 + 1e6 * (k + 1) for k in range(300)] == GIVEN


def test_a_graph_that_runs_again_opens_its_own(openings: Openings, monkeypatch: pytest.MonkeyPatch) -> None:
    openings.watch(load_text(OUTSIDE), monkeypatch)
    graph = load_text(OUTSIDE)
    first, second = Pipeline(graph), Pipeline(graph)
    assert first.stages["low"].operator is not second.stages["low"].operator
    assert openings.of(graph.nodes["low"], graph) == 2


def test_a_node_that_was_changed_after_the_graph_was_loaded_is_opened_as_it_is() -> None:
    graph, other = load_text(OUTSIDE), load_text(OUTSIDE.replace("cutoff_hz: 20", "cutoff_hz: 30"))
    graph.nodes["low"].part = other.nodes["low"].part
    operator = Pipeline(graph).stages["low"].operator
    assert operator.cutoff_hz == 30 and is_ours(operator)  # type: ignore[attr-defined]
