"""configs/grow_graph.yaml: a motion graph that grows while somebody moves.

Recording: a workout of CMU's motion capture (subject 13; labels of mocap6, BSD-2).
Truth: the annotators' labels: what goes over into one another is of one exercise for the most part.
"""

from __future__ import annotations

import numpy as np

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import cmu_joints, signal
from tests.support.motion_made import bent
from tests.support.real import real_arrays

LABELS = real_arrays("segmentation/mocap6/13_29.npz")["label"]


def test_stretches_join_and_lead_to_others_of_their_own_exercise() -> None:
    graph = kg.load("grow_graph")
    names = graph.specs["performer.markers"].channels
    markers = signal(cmu_joints("13_29", names), 30.0, names, ["m"])
    poses = bent(len(markers.data))  # where the hips are is what is walked; the recording here holds no rotations
    poses[:, :3] = markers.data[:, [names.index("hip_l"), names.index("hip_r")]].mean(axis=1)
    pose = kg.Series("", graph.specs["performer.pose"], markers.time, poses)
    kept = ["graph.node", "graph.edge", "walk.pose", "walk.transition"]
    made = graph.run({"performer.markers": markers, "performer.pose": pose}, keep=kept)
    node, edge = made["graph.node"].data, made["graph.edge"].data
    assert (np.diff(node["node"]) == 1).all() and len(node) >= 15 and node["nodes"][-1] == len(node)
    jumps = edge[edge["distance"] > 0]
    at = [LABELS[np.minimum(jumps[end] // (NS // 30), len(LABELS) - 1)] for end in ("leave", "enter")]
    share = np.mean([(one == LABELS).mean() for one in at[0]])
    assert len(jumps) > 20 and (at[0] == at[1]).mean() > 1.5 * share
    walk, entered = made["walk.pose"].data, made["walk.transition"].data
    assert len(walk) == len(poses) and len(entered) > 10
    stretches = [(row["onset"], row["end"]) for row in node]
    assert all(any(a <= plays - NS // 30 <= b for a, b in stretches) for plays in entered["plays"])
