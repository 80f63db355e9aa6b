"""CMU 86_03 as a motion graph, by commands: nine runs and two transitions, as the segmentation cuts them (thesis, figure 10.1)."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from kinegraph.stream.chunk import Array, Samples, StreamSpec, grid
from kinegraph.stream.domain.motion_graph import TRANSITION, MotionGraph
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.command_line import Command, kinegraph
from tests.support.motion_made import RATE, TREE, bend, bent
from tests.support.real import DATA_MARKS

__all__ = ["kinegraph"]

pytestmark = DATA_MARKS
JOINTS = ("LeftUpperArm", "RightUpperArm", "LeftUpperLeg", "RightUpperLeg")
CUT = """
nodes:
  trial: {use: devices.recorded.RecordedStreams, path: trial.mcap, of: trial, speed: 0}
  stack: {use: operators.features.stack.Stack, from: trial.angles}
  segment: {use: operators.segmentation.Segment, from: stack}
record: [trial.pose, segment.primitive, segment.merge]
"""


def trial() -> tuple[Samples, Array, list[str]]:
    """Shoulders and hips (n, 4), degrees at 30 Hz; what the annotators call each frame (-1: a transition), and these names."""
    with np.load(Path(os.environ["KINEGRAPH_DATA"]) / "segmentation/cmu86_4ch/86_03.npz") as z:
        angles = np.rad2deg(np.unwrap(np.deg2rad(z["angles_deg"].astype(float)), axis=0))[::4]
        return angles, z["label"][::4], z["label_names"].tolist()


def body(angles: Samples) -> Samples:
    """A body on the spot that these four joints move, all others at rest."""
    poses = bent(len(angles))
    for joint, turned in zip(JOINTS, angles.T, strict=True):
        bend(poses, joint, 1, np.deg2rad(turned))
    return poses


def test_the_graph_of_figure_10_1(kinegraph: Command) -> None:
    """Cut by four channels, as in the thesis: from the first run to several others, from several of these on to the jump."""
    angles, label, names = trial()
    time = grid(RATE, len(angles), 0)
    write_recording(
        Path("trial.mcap"),
        [
            Series("trial.angles", StreamSpec((4,), rate_hz=RATE, channels=JOINTS, units=("deg",)), time, angles),
            Series("trial.pose", TREE.spec(RATE), time, body(angles)),
        ],
        {},
        chunk_s=0.5,
    )
    Path("cut.yaml").write_text(CUT)
    assert kinegraph("replay", "cut.yaml", "trial.mcap", "-o", "cut", "-q")[0] == 0
    code, out, wrong = kinegraph(
        "motion", "train", "graph", "cut", "--no-mirror", "--within-cm", "8", "--call", "walk=1-6", "--call", "run=9-14", "-o", "graph.npz"
    )  # fmt: skip
    assert code == 0, wrong
    assert "segmenting" not in out, "its primitives are those of the segmentation, as they come"
    graph = MotionGraph.read(Path("graph.npz"))
    runs = np.flatnonzero(graph.cluster == graph.names.index("run"))
    assert len(runs) == 9 and (np.diff(runs) == 1).all(), "nine primitives, one after the other"
    before, after = int(runs[0]) - 1, int(runs[-1]) + 1
    assert graph.cluster[before] == graph.cluster[after] == TRANSITION

    def called(node: int) -> set[str]:
        """What the annotators call its frames."""
        return {names[k] for k in label[graph.first[node] : graph.last[node]].tolist() if k >= 0}

    assert called(before) == {"walk"} and "jump" in called(after), "from walking to running, from running to jumping"
    assert all(called(k) <= {"run"} for k in runs.tolist())
    assert graph.core[before : after + 1].all()
    on = {k: set(graph.target[graph.source == k].tolist()) for k in range(len(graph.first))}
    assert len(on[int(runs[0])] & set(runs.tolist())) >= 3, "several ways on from the first run"
    assert sum(after in on[k] for k in runs.tolist()) >= 2, "and several out of running"
