"""Every shipped graph makes the same envelope of the same raw EMG, so that figures of different devices compare."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinegraph.operators.emg.envelope import Envelope
from kinegraph.operators.filters.channels import Select
from kinegraph.stream.graph import Graph, Node
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.source import Source

CONFIGS = sorted((Path(__file__).resolve().parents[2] / "configs").glob("*.yaml"))
WITH_EMG = [path for path in CONFIGS if any(isinstance(node.part, Envelope) for node in load(path).nodes.values())]
SLOW = "segment_"
"""Graphs that find repetitions smooth to 10 Hz at 30 Hz (thesis, chapter 4); nothing else of the chain is theirs."""


def before(graph: Graph, node: Node) -> list[Node]:
    """The chain of nodes that leads to the node's input."""
    (of,) = node.inputs.values()
    origin = graph.nodes[of.node]
    return [origin] if isinstance(origin.part, Source) else [*before(graph, origin), origin]


def test_there_are_graphs_of_every_emg_device() -> None:
    assert {"bitalino_emg", "cyton_emg", "lsl_emg", "myoware", "overground_emg", "segment_emg", "segment_emg_acc", "shimmer_emg",
            "treadmill_both_legs", "treadmill_emg", "trigno_emg"} <= {path.stem for path in WITH_EMG}  # fmt: skip


@pytest.mark.parametrize("path", WITH_EMG, ids=lambda path: path.stem)
def test_shipped_graphs_filter_emg_once_and_alike(path: Path) -> None:
    graph = load(path)
    usual = Envelope(cutoff_hz=10.0, rate_hz=30.0) if path.stem.startswith(SLOW) else Envelope()
    for node in graph.nodes.values():
        if isinstance(node.part, Envelope):
            assert node.part == usual
            assert all(isinstance(one.part, Source | Select) for one in before(graph, node)), (
                "raw EMG goes into the envelope"
            )
