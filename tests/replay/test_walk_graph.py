"""configs/walk_graph.yaml: an avatar walks on a motion graph.

Recording: the graph that comes with kinegraph, of 40 s of the simulated performer.
Truth: the performer's own joints: no step of the walk is larger than the largest there, but for the blends.
"""

from __future__ import annotations

import numpy as np

import kinegraph as kg
from kinegraph.operators.synthesis.source import EXAMPLE
from kinegraph.operators.synthesis.walker import GraphWalk
from kinegraph.stream.domain.motion_graph import MotionGraph
from kinegraph.stream.domain.skeleton import joints_of


def test_a_walk_is_as_smooth_as_the_recording_that_it_is_made_of() -> None:
    graph = MotionGraph.read(EXAMPLE)
    walker = GraphWalk(graph, [], np.empty((0, 3)), 3)
    poses = []
    for _ in range(900):
        walker.step()
        poses.append(walker.pose.copy())
    series = kg.Series("", kg.load("walk_graph").specs["walk.pose"], np.arange(900) * 33_333_333, np.array(poses))
    joints = joints_of(graph.tree, series.data)[1]
    recorded = joints_of(graph.tree, graph.poses.astype(np.float64))[1]
    steps, largest = (np.linalg.norm(np.diff(x, axis=0), axis=2).max(axis=1) for x in (joints, recorded))
    assert np.quantile(steps, 0.99) < 1.2 * np.quantile(largest, 0.999) and steps.max() < 0.3


def test_the_shipped_graph_and_the_default_of_the_shipped_yaml_are_one() -> None:
    loaded = kg.load("walk_graph")
    assert loaded.specs["walk.pose"].rate_hz == MotionGraph.read(EXAMPLE).rate_hz
