"""configs/grow_graph.yaml: a motion graph that grows while somebody moves.

Recording: a workout of CMU's motion capture (subject 13; labels of mocap6, BSD-2).
Truth: the annotators' labels: what goes over into one another is of one exercise for the most part.
"""

from __future__ import annotations

import numpy as np

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import cmu_joints, signal
from tests.support.real import real_arrays

LABELS = real_arrays("segmentation/mocap6/13_29.npz")["label"]


def test_stretches_join_and_lead_to_others_of_their_own_exercise() -> None:
    graph = kg.load("grow_graph")
    names = graph.specs["performer.markers"].channels
    markers = signal(cmu_joints("13_29", names), 30.0, names, ["m"])
    pose = kg.Series("", graph.specs["performer.pose"], markers.time[:1], np.zeros((1, 91)))
    made = graph.run({"performer.markers": markers, "performer.pose": pose}, keep=["graph.node", "graph.edge"])
    node, edge = made["graph.node"].data, made["graph.edge"].data
    assert (np.diff(node["node"]) == 1).all() and len(node) >= 15 and node["nodes"][-1] == len(node)
    jumps = edge[edge["distance"] > 0]
    at = [LABELS[np.minimum(jumps[end] // (NS // 30), len(LABELS) - 1)] for end in ("leave", "enter")]
    share = np.mean([(one == LABELS).mean() for one in at[0]])
    assert len(jumps) > 20 and (at[0] == at[1]).mean() > 1.5 * share
