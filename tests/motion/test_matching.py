"""Motion matching: paths are walked in recorded motion, and in motion that is still being recorded."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from bench.motion_graph import all_sequences, followed
from kinegraph.operators.maps.motion_graph.build import build_graph
from kinegraph.operators.maps.motion_graph.takes import Take
from kinegraph.operators.synthesis.goals import Aim, around
from kinegraph.operators.synthesis.live import LiveWalk
from kinegraph.operators.synthesis.matching import Matching
from kinegraph.operators.synthesis.source import Synthesis
from kinegraph.operators.synthesis.walker import GraphWalk
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, StreamSpec, Times, grid
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.errors import ParameterError
from tests.support.motion_made import RATE, TREE, take, walking, waving
from tests.support.real import needs_data

STRETCH = np.dtype([("onset", "<i8"), ("end", "<i8")])


def lived(time: Times, poses: Samples, operator: LiveWalk, stretches: Array | None = None) -> tuple[Samples, Array]:
    """The walk and its transitions, of poses that come one by one; `stretches` are reported two seconds after their ends."""
    specs = {"pose": TREE.spec(RATE)}
    if stretches is not None:
        specs["node"] = StreamSpec((), STRETCH, units=("ns", "ns"))
    operator.open(specs)
    walk, jumps = list[Samples](), list[Array]()
    for k, stamp in enumerate(time):
        if stretches is not None and len(due := stretches[np.abs(stretches["end"] + 2 * NS - stamp) < NS / RATE / 2]):
            operator.process("node", Chunk(np.full(len(due), stamp), due, int(stamp)))
        for name, chunk in operator.process("pose", Chunk(time[k : k + 1], poses[k : k + 1], int(stamp))):  # type: ignore[union-attr]
            (walk if name == "pose" else jumps).append(chunk.data)  # type: ignore[union-attr, arg-type]
    return np.concatenate(walk), np.concatenate(jumps)


def walks_about() -> tuple[Times, Samples]:
    """Straight on, in a curve to the left and in one to the right, again and again; each at the same place, after a second."""
    parts = [walking(5, np.radians(a), sway=0.1) for a in (0, 25, -25, 40) * 2]
    time = [grid(RATE, len(part)) + k * (len(part) / RATE + 1.0) * NS for k, part in enumerate(parts)]
    return np.concatenate(time).astype(np.int64), np.concatenate(parts)


def test_a_path_is_walked_in_motion_that_is_still_being_recorded() -> None:
    turns = 2.0 * np.pi * np.arange(12) / 12
    corners = np.column_stack([2.5 - 2.5 * np.cos(turns), 2.5 * np.sin(turns)])
    path = tuple((float(x), float(z)) for x, z in corners)
    walk, jumps = lived(*walks_about(), LiveWalk(path=path, speed_m_s=0.8))
    later = walk[640:, [0, 2]]
    far = np.abs(np.linalg.norm(later - [2.5, 0.0], axis=1) - 2.5)
    assert np.median(far) < 0.3 and len(jumps) > 15
    assert jumps["ago_s"].min() > 1.0 - 1.5 / RATE
    assert np.ptp(later, axis=0).min() > 3.0, "it comes round"
    steps = np.linalg.norm(np.diff(joints_of(TREE, walk[200:])[1], axis=0), axis=2).max(axis=1)
    assert steps.max() < 0.3


def test_only_stretches_of_the_graph_are_entered() -> None:
    time, poses = walks_about()
    stretches = np.array([(time[150], time[249]), (time[300], time[420])], STRETCH)
    walk, jumps = lived(time, poses, LiveWalk(), stretches)
    assert len(jumps) > 5
    inside = [((stretches["onset"] <= at) & (at <= stretches["end"])).any() for at in jumps["plays"] - NS // 30]
    assert all(inside)
    assert np.array_equal(walk[:300], poses[:300]), "until then the avatar does what the person does"


def test_a_pose_is_held_while_no_frame_is_left_to_enter() -> None:
    time, poses = walks_about()
    time, poses = time[:960], poses[:960]
    stretches = np.array([(time[20], time[90]), (time[800], time[880])], STRETCH)
    walk, jumps = lived(time, poses, LiveWalk(memory_s=8.0), stretches)
    gone, back = 20 + 320, np.searchsorted(time, stretches["end"][1] + 2 * NS)
    assert (jumps["plays"] <= stretches["end"][0]).any()
    held = walk[gone + 160 : back]
    assert np.array_equal(held, np.broadcast_to(held[:1], held.shape)), "nothing is played that was never given"
    assert ((stretches["onset"][1] <= jumps["plays"]) & (jumps["plays"] <= stretches["end"][1] + NS)).any()
    assert np.abs(np.diff(walk[back - 1 :], axis=0)).max() < 0.3


@pytest.mark.parametrize("path", [(), ((0.0, 0.0), (0.0, 0.5))])
def test_a_path_that_is_too_short_to_walk_is_refused(path: tuple[tuple[float, float], ...]) -> None:
    with pytest.raises(ParameterError, match="a way of 2 m or more"):
        LiveWalk(path=path).open({"pose": TREE.spec(RATE)})


def test_a_path_bends_around_what_is_forbidden() -> None:
    made = around(np.array([[0.0, 0.0], [0.0, 6.0]]), np.array([[0.1, 3.0, 0.6], [5.0, 3.0, 0.6]]))
    assert len(made) == 5 and made[0].tolist() == [0.0, 0.0] and made[-1].tolist() == [0.0, 6.0]
    fine = np.concatenate([a + np.linspace(0, 1, 50)[:, None] * (b - a) for a, b in pairwise(made)])
    assert np.linalg.norm(fine - [0.1, 3.0], axis=1).min() > 0.9


def test_after_a_path_the_walk_goes_on_in_the_graph_without_a_leap() -> None:
    takes = [take("straight", walking(8, sway=0.1), 0), take("wave", waving(4), 1), take("curve", walking(8, 0.5), 0)]
    graph = build_graph(TREE, takes, ("walk", "wave"), RATE, 0.12, 5)
    walker = GraphWalk(graph, [Aim(0, path=np.array([[0.0, 0.0], [0.0, 3.0]])), Aim(0, 2)], seed=1)
    poses = []
    while not walker.progress.over:
        walker.step()
        poses.append(walker.pose.copy())
        assert len(poses) < 1000
    for _ in range(60):
        walker.step()
        poses.append(walker.pose.copy())
    steps = np.linalg.norm(np.diff(joints_of(graph.tree, np.array(poses))[1], axis=0), axis=2).max(axis=1)
    assert steps.max() < 0.3
    assert not Matching(graph).joins[~np.isin(Matching(graph).node, np.flatnonzero(graph.core))].any()


@needs_data
@pytest.mark.nightly
def test_straight_paths_arrive_on_the_cmu_sequences() -> None:
    """17 sequences, mostly exercises on the spot: paths from five places in a chance walk, straight ahead."""
    graph = all_sequences()
    for seed in range(5):
        off, _, arrived = followed(graph, np.array([[0.0, 0.0], [0.0, 8.0]]), seed)
        assert arrived and np.median(off) < 0.2


def test_a_graph_of_one_stretch_on_the_spot_gets_ready(tmp_path: Path) -> None:
    """Nothing in it leads along a path."""
    still = Take("still", 0, np.repeat(waving(1)[:1], 90, 0), np.array([[0, 90]]), np.array([-1]))
    build_graph(TREE, [still], (), RATE, 0.1, 5, mirror=False).write(tmp_path / "still.npz", {})
    Synthesis(model=tmp_path / "still.npz").prepare()
