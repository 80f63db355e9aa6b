"""Every shipped graph makes the same envelope of the same raw EMG, so that figures of different devices compare."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinegraph.operators.emg.envelope import Envelope
from kinegraph.operators.filters.channels import Select
from kinegraph.stream.graph import Graph, Node
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.source import Source

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
WITH_EMG = (
    "bitalino_emg", "cyton_emg", "lsl_emg", "myoware", "overground_emg", "segment_emg", "segment_emg_acc", "shimmer_emg",
    "treadmill_both_legs", "treadmill_emg", "trigno_emg",
)  # fmt: skip
SLOW = "segment_"
"""Graphs that find repetitions smooth to 10 Hz at 30 Hz (thesis, chapter 4); nothing else of the chain is theirs."""


def before(graph: Graph, node: Node) -> list[Node]:
    """The chain of nodes that leads to the node's input."""
    (of,) = node.inputs.values()
    origin = graph.nodes[of.node]
    return [origin] if isinstance(origin.part, Source) else [*before(graph, origin), origin]


def test_these_are_the_graphs_of_emg() -> None:
    graphs = {path.stem: load(path) for path in CONFIGS.glob("*.yaml")}
    found = {name for name, graph in graphs.items() if any(isinstance(n.part, Envelope) for n in graph.nodes.values())}
    assert found == set(WITH_EMG)


@pytest.mark.parametrize("name", WITH_EMG)
def test_shipped_graphs_filter_emg_once_and_alike(name: str) -> None:
    graph = load(CONFIGS / f"{name}.yaml")
    usual = Envelope(cutoff_hz=10.0, rate_hz=30.0) if name.startswith(SLOW) else Envelope()
    for node in graph.nodes.values():
        if isinstance(node.part, Envelope):
            assert node.part == usual
            assert all(isinstance(one.part, Source | Select) for one in before(graph, node)), (
                "raw EMG goes into the envelope"
            )
