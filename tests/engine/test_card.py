"""The project's own sentence, clause by clause, through shipped graphs: "a dataflow graph connects device sources through filters and
windowed incremental kd-tree neighbours to online segmentation, sleep/wake scoring, step classification and mesh steering"."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from kinegraph.operators.neighbours import Index
from kinegraph.operators.neighbours.returning import Returning
from kinegraph.stream.graph.model import Graph, Node
from kinegraph.stream.graph.reading.load import load

FILTERS = ("operators.filters.", "operators.timing.align.", "operators.emg.", "operators.bed.frames.")
SIMULATED = ("devices.people.", "devices.simulation.")
ANSWERS = {
    "online segmentation": ("segment_imu", "operators.segmentation.Segment"),
    "online segmentation, by muscles and motion": ("segment_emg_acc", "operators.segmentation.Segment"),
    "sleep/wake scoring": ("bedside_sleep", "operators.sleep.scorer.SleepScorer"),
    "step classification": ("shimmer_steps", "operators.steps.classifier.StepClassifier"),
    "step classification, by a declared device": ("witmotion", "operators.steps.classifier.StepClassifier"),
}


@cache
def graph(name: str) -> Graph:
    return load(Path(name))


def above(of: Graph, node: Node) -> list[Node]:
    """Everything that a node's answer is made of, itself included."""
    found, waiting = dict[str, Node](), [node]
    while waiting:
        one = waiting.pop()
        if one.name not in found:
            found[one.name] = one
            waiting += [of.nodes[edge.node] for edge in one.inputs.values()]
    return list(found.values())


@pytest.mark.parametrize("clause", ANSWERS)
def test_a_device_leads_through_filters_to_the_answer(clause: str) -> None:
    name, use = ANSWERS[clause]
    of = graph(name)
    (answer,) = (node for node in of.nodes.values() if node.use == use)
    path = above(of, answer)
    sources = [node for node in path if node.is_source and not node.use.startswith("stream.")]
    assert sources and not any(node.use.startswith(SIMULATED) for node in sources), "a device, not a simulated person"
    assert any(node.use.startswith(FILTERS) for node in path), [node.use for node in path]
    assert any(answer.name in {edge.node for edge in node.inputs.values()} for node in of.nodes.values()), "it is shown"


def test_windowed_incremental_neighbours_answer_on_what_a_segmentation_finds() -> None:
    """Which activity came back; and, of a motion graph that grows, where one may go on: by the same index."""
    of = graph("segment_mocap")
    (again,) = (node for node in of.nodes.values() if isinstance(node.part, Returning))
    assert "operators.segmentation.Segment" in {node.use for node in above(of, again)}
    growing = graph("grow_graph")
    assert any(node.use.endswith("GrowingGraph") for node in growing.nodes.values())
    index = Index(width=2, window=3, most=1)
    for x in ([0.0, 0.0], [5.0, 5.0], [1.0, 0.0], [0.1, 0.0]):
        index.insert(x)
    assert index.first == 1, "windowed: the first frame left when the fourth came"
    assert index.nearest(1)[0].tolist() == [2], "incremental: each frame is searched when it comes"


@pytest.mark.parametrize("name", ["steer_by_one", "steer_by_two"])
def test_whoever_is_before_a_depth_camera_steers_a_mesh(name: str) -> None:
    of = graph(name)
    (steer,) = (node for node in of.nodes.values() if type(node.part).__name__ == "SteerMesh")
    path = above(of, steer)
    assert [node.use for node in path if node.is_source and node.use.startswith("devices.oak.")]
    assert any(node.use.startswith(("operators.filters.", "operators.body.")) for node in path)
