"""Motion graphs: edges are those of all pairs, walks follow their commands, seams and feet are sound, bad data is refused."""

from __future__ import annotations

import os
import re
import socket
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from kinegraph.operators.features.stack import Stack
from kinegraph.operators.maps.motion_graph.build import Nodes, build_graph, find_edges
from kinegraph.operators.maps.motion_graph.clouds import cloud_distance, placement
from kinegraph.operators.maps.motion_graph.commands.train import name_clusters, read_shown
from kinegraph.operators.maps.motion_graph.measures import measure, travel_s
from kinegraph.operators.maps.motion_graph.primitives import spans_of
from kinegraph.operators.maps.motion_graph.takes import Take, mirrored_poses, pieces, standing
from kinegraph.operators.synthesis.goals import Aim
from kinegraph.operators.synthesis.path_search import MAX, WaySearch
from kinegraph.operators.synthesis.source import NODE, Synthesis
from kinegraph.operators.synthesis.walker import LEGS, GraphWalk
from kinegraph.stream.chunk import NS, Array, Samples
from kinegraph.stream.data.model_file import ModelError, read_model, write_model
from kinegraph.stream.domain.motion_graph import KIND, MotionGraph
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.errors import KinegraphError, ParameterError
from kinegraph.stream.recording import Recording
from tests.support.command_line import Command, kinegraph, refused
from tests.support.heard import Heard
from tests.support.motion_made import CYCLE, RATE, TREE, recorded, take, walking, waving
from tests.support.real import needs_data

__all__ = ["kinegraph"]

BLEND = 5


@pytest.fixture(scope="module")
def graph() -> MotionGraph:
    """Walks straight on and in curves to the left; to the right they are mirrored."""
    takes = [
        take("straight", walking(8, sway=0.1), 0),
        take("curve", walking(8, np.radians(30), sway=0.1), 1),
        take("narrow", walking(8, np.radians(60)), 1),
    ]
    return build_graph(TREE, takes, ("straight", "curve"), RATE, 0.10, BLEND)


def walked(walker: GraphWalk, frames: int) -> tuple[Samples, Array]:
    """Poses (n, 91), and which feet stood (n, 2)."""
    poses, stood = [], []
    for _ in range(frames):
        walker.step()
        poses.append(walker.pose.copy())
        stood.append(walker.stands.copy())
    return np.array(poses), np.array(stood)


def skates(joints: Samples, stood: Array) -> list[float]:
    """How far the toes slide on the floor in each stand of 4 frames or more, m."""
    found = []
    for side in range(2):
        toes = joints[:, LEGS[side, 3]][:, [0, 2]]
        edges = np.flatnonzero(np.diff(np.r_[0, stood[:, side].astype(int), 0]))
        found += [
            float(np.linalg.norm(toes[a:b] - toes[a], axis=1).max())
            for a, b in zip(edges[::2], edges[1::2], strict=True)
            if b - a >= 4
        ]
    return found


def jumps(joints: Samples) -> Samples:
    """Changes of velocity from frame to frame, m/s, of every joint."""
    made: Samples = np.linalg.norm(np.diff(joints, n=2, axis=0), axis=2) * RATE
    return made


def test_the_placement_is_the_best_one() -> None:
    rng = np.random.default_rng(4)
    for _ in range(5):
        p, q, out = rng.normal(size=(40, 3)), rng.normal(size=(40, 3)), np.empty(4)
        q = q + 2.0 * p[:, [2, 1, 0]]
        placement(p, q, out)

        def rms(x: Samples, p: Samples = p, q: Samples = q) -> float:
            c, s = np.cos(x[0]), np.sin(x[0])
            moved = np.stack([q[:, 0] * c + q[:, 2] * s + x[1], q[:, 1], q[:, 2] * c - q[:, 0] * s + x[2]], 1)
            return float(np.sqrt(((moved - p) ** 2).sum(1).mean()))

        assert rms(out[:3]) == pytest.approx(out[3], abs=1e-12)
        best = min(minimize(rms, [a, 0.0, 0.0]).fun for a in (-2.0, 0.0, 2.0))
        assert out[3] == pytest.approx(best, abs=1e-5)


def test_the_index_finds_the_edges_of_all_pairs(graph: MotionGraph) -> None:
    """For every pair of nodes that some pair of windows at the seam brings within reach, an edge is found, hardly longer than the best."""
    poses = np.concatenate([walking(3, sway=0.1), walking(3, np.radians(30))])
    joints = joints_of(TREE, poses)[1]
    first = np.arange(6) * CYCLE
    low = np.repeat([0, 3 * CYCLE], 3)
    nodes = Nodes(first, first + CYCLE, np.zeros(6, np.int64), np.zeros(6, bool), low, low + 3 * CYCLE)
    found = find_edges(joints, nodes, 0.1, BLEND)
    got = {(a, b): d for a, b, d in zip(found.source, found.target, found.placed[:, 3], strict=True)}
    for a in range(6):
        for b in range(6):
            ends = range(
                max(first[a] + CYCLE - 8, low[a] + BLEND), min(first[a] + CYCLE, low[a] + 3 * CYCLE - BLEND - 1) + 1
            )
            starts = range(max(first[b], low[b] + BLEND), first[b] + 9)
            every = [cloud_distance(joints, e, s, BLEND)[3] for e in ends for s in starts if abs(e - s) > BLEND]
            if min(every) <= 0.1:
                assert (a, b) in got
                assert got[a, b] <= min(every) + 0.02
    assert all(a + 1 == b or d > 0 for (a, b), d in got.items())


def test_the_core_is_strongly_connected_and_the_rest_is_named(graph: MotionGraph) -> None:
    inner = graph.core[graph.source] & graph.core[graph.target]
    for start in np.flatnonzero(graph.core)[:3]:
        seen, todo = {int(start)}, [int(start)]
        while todo:
            at = todo.pop()
            for b in graph.target[inner & (graph.source == at)].tolist():
                if b not in seen:
                    seen.add(b)
                    todo.append(b)
        assert seen == set(np.flatnonzero(graph.core).tolist())
    m = measure(graph)
    assert m.clusters == 2 and m.core <= m.nodes and 0.5 < m.coverage <= 1.0 and m.branching > 1.0
    assert np.isfinite(travel_s(graph)[graph.core]).all()


def test_the_reach_is_of_ways_to_other_clusters(graph: MotionGraph, monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = np.random.default_rng(5).exponential(size=(len(graph.first), len(graph.names)))
    seconds[::7] = np.inf
    monkeypatch.setattr("kinegraph.operators.maps.motion_graph.measures.travel_s", lambda _: seconds)
    there = set(graph.cluster[graph.core].tolist())
    ways = [
        seconds[k, c]
        for k in np.flatnonzero(graph.core)
        for c in range(seconds.shape[1])
        if c in there and c != graph.cluster[k] and np.isfinite(seconds[k, c])
    ]
    assert ways and measure(graph).reach_s == pytest.approx((np.median(ways), np.quantile(ways, 0.95)))


def test_motion_that_never_comes_back_is_refused_and_told_what_would_close_it() -> None:
    once = [Take("once", 0, walking(4), np.array([[0, 3 * CYCLE // 4]]), np.array([-1]))]
    with pytest.raises(KinegraphError, match=r"comes back.*would close a cycle: --within-cm \d"):
        build_graph(TREE, once, (), RATE, 0.13, BLEND, mirror=False)
    with pytest.raises(KinegraphError, match="nothing to make nodes of"):
        build_graph(TREE, [Take("short", 0, walking(1)[:8], np.array([[0, 8]]), np.array([-1]))], (), RATE, 0.1, BLEND)
    still = [Take("still", 0, np.repeat(waving(1)[:1], 90, 0), np.array([[0, 90]]), np.array([-1]))]
    kept = build_graph(TREE, still, (), RATE, 0.1, BLEND)
    poses, _ = walked(GraphWalk(kept), 200)
    assert np.ptp(poses, axis=0).max() < 1e-3  # who stood still goes on standing


def test_a_walk_is_smooth_and_its_feet_stand(graph: MotionGraph) -> None:
    recorded = np.concatenate([jumps(joints_of(graph.tree, graph.poses[graph.take == k])[1]).ravel() for k in range(3)])
    poses, stood = walked(GraphWalk(graph, seed=2), 1500)
    joints = joints_of(graph.tree, poses)[1]
    assert np.abs(np.linalg.norm(poses[:, 3:].reshape(len(poses), -1, 4), axis=2) - 1).max() < 1e-6
    assert np.median(skates(joints, stood)) < 0.01 and len(skates(joints, stood)) > 20
    assert np.quantile(jumps(joints), 0.99) <= 1.05 * np.quantile(recorded, 0.99)
    assert np.linalg.norm(np.diff(joints, axis=0), axis=2).max() < 0.25


@pytest.mark.nightly
def test_a_seed_says_all(graph: MotionGraph) -> None:
    first, again, other = (walked(GraphWalk(graph, seed=s), 400)[0] for s in (3, 3, 4))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_clusters_come_in_the_order_and_as_often_as_they_are_told(graph: MotionGraph) -> None:
    walker = GraphWalk(graph, [Aim(0, 2), Aim(1, 3), Aim(0, 1)])
    nodes = [int(graph.cluster[walker.node])]
    while not walker.progress.over:
        if walker.step():
            nodes.append(int(graph.cluster[walker.node]))
        assert len(nodes) < 40
    assert nodes[:2] == [0, 0] and [c for c in nodes if c == 1].__len__() >= 3 and nodes[-1] == 0


def test_a_path_is_followed_and_a_target_reached_around_what_is_forbidden(graph: MotionGraph) -> None:
    path = np.array([[0.0, 0.0], [0.0, 4.0], [3.0, 8.0]])
    walker = GraphWalk(graph, [Aim(path=path)])
    off = []
    for _ in range(1500):
        walker.step()
        x, z = walker.pose[0], walker.pose[2]
        off.append(min(_beside(path[k], path[k + 1], x, z) for k in range(2)))
        if walker.progress.over:
            break
    assert walker.progress.over and np.hypot(x - 3.0, z - 8.0) < 0.5
    assert np.mean(off) < 0.5
    straight = GraphWalk(graph, [Aim(path=np.array([[0.0, 0.0], [0.0, 6.0]]))])
    around = GraphWalk(graph, [Aim(path=np.array([[0.0, 0.0], [0.0, 6.0]]))], np.array([[0.0, 3.0, 0.6]]))
    for one in (straight, around):
        frames = 0
        while not one.progress.over and frames < 2500:
            one.step()
            within = float(np.hypot(one.pose[0], one.pose[2] - 3.0))
            frames += 1
            if one is around:
                assert within > 0.45, "it may graze the border by a step, not walk in"
        assert one.progress.over


def test_a_search_is_spread_over_frames(graph: MotionGraph, monkeypatch: pytest.MonkeyPatch) -> None:
    """No frame does a large part of one, once under way."""
    looks, begun = list[int](), list[int]()
    go_on, begin_at = WaySearch.go_on, WaySearch.begin_at

    def counted(search: WaySearch, frames: int) -> int:
        looks.append(go_on(search, frames))
        return looks[-1]

    def noted(search: WaySearch, *what: Any) -> None:
        begun.append(len(looks))
        begin_at(search, *what)

    walker = GraphWalk(graph, [], np.array([[0.0, 5.0, 0.5]]))
    for _ in range(2 * CYCLE):
        walker.step()
    monkeypatch.setattr(WaySearch, "go_on", counted)
    monkeypatch.setattr(WaySearch, "begin_at", noted)
    for _ in range(1000):
        walker.step()
    whole = [sum(looks[a:b]) for a, b in pairwise(begun)]
    assert max(whole) > 1000, "there is something to be spread"
    assert max(looks) <= 0.25 * max(whole) and max(looks) <= MAX
    assert np.diff(begun).max() <= 4 * CYCLE, "each ends"


def _beside(a: Samples, b: Samples, x: float, z: float) -> float:
    share = np.clip(((x - a[0]) * (b - a)[0] + (z - a[1]) * (b - a)[1]) / ((b - a) ** 2).sum(), 0, 1)
    return float(np.hypot(*(a + share * (b - a) - (x, z))))


def test_a_mirror_image_is_one() -> None:
    poses = walking(2, np.radians(30))
    mine, image = joints_of(TREE, poses)[1], joints_of(TREE, mirrored_poses(poses))[1]
    swap = [
        TREE.joints.index(n.replace("Left", "?").replace("Right", "Left").replace("?", "Right")) for n in TREE.joints
    ]
    assert np.abs(image - mine[:, swap] * [-1.0, 1.0, 1.0]).max() < 1e-9
    assert np.array_equal(standing(TREE, mirrored_poses(poses), RATE), standing(TREE, poses, RATE)[:, ::-1])


def test_poses_at_any_stamps_become_even_runs() -> None:
    poses = walking(3)
    time = (np.arange(len(poses)) * NS / RATE).astype(np.int64)
    bad = poses.copy()
    bad[20] = np.nan
    keep = np.r_[0:40, 60:96]
    runs = pieces(time[keep], bad[keep], 15.0)
    assert [len(p) for _, p in runs] == [20, 18] and [t for t, _ in runs] == [0, time[60]]
    assert np.isfinite(runs[0][1]).all() and np.abs(runs[0][1][5] - poses[10]).max() < 1e-9
    assert pieces(time[:1], poses[:1], 30.0) == []


def test_clusters_are_named_by_what_is_shown() -> None:
    one = take("a", walking(4), 5)
    one = replace(one, cluster=np.array([5, 5, -1, 9]))
    made, names = name_clusters([one], [read_shown("walk=0-2")], RATE)
    assert names == ["walk", "A"] and made[0].cluster.tolist() == [0, 0, -1, 1]
    for words, complaint in (
        ("walk", "NAME=FROM-TO"),
        ("walk=3-1", "a later one"),
        ("<b>=0-1", "letters and digits"),
        ("x=0-nan", "a later one"),
    ):
        with pytest.raises(KinegraphError, match=complaint):
            read_shown(words)
    with pytest.raises(KinegraphError, match="nothing repeats"):
        name_clusters([one], [read_shown("rest=2.3-3")], RATE)
    with pytest.raises(KinegraphError, match="one cluster has one name"):
        name_clusters([one], [read_shown("walk=0-1"), read_shown("run=1.2-2")], RATE)


def test_primitives_cover_a_take() -> None:
    events = np.array(
        [(NS, 2 * NS, 3), (5 * NS // 2, 99 * NS, 4)], [("onset", "<i8"), ("end", "<i8"), ("cluster", "<i8")]
    )
    spans, cluster = spans_of(events, 0, 120, 30.0)
    assert spans.tolist() == [[0, 30], [30, 61], [61, 75], [75, 120]] and cluster.tolist() == [-1, 3, -1, 4]


def test_a_model_survives_the_disk_and_a_spoilt_one_is_refused(graph: MotionGraph, tmp_path: Path) -> None:
    path = tmp_path / "graph.npz"
    graph.write(path, {"trained_on": ["a.mcap"]})
    again = MotionGraph.read(path)
    assert np.array_equal(walked(GraphWalk(graph, seed=1), 100)[0], walked(GraphWalk(again, seed=1), 100)[0])
    model = read_model(path, KIND)
    header = {k: v for k, v in model.header.items() if k not in ("kinegraph", "version", "kind", "made")}
    far = np.array(model.arrays["target"])
    far[0] = 10_000
    zero = np.zeros_like(model.arrays["poses"])
    late = np.array(model.arrays["leave"])
    late[~graph.natural] = len(zero) - 1
    for changed, complaint in (
        ({"target": far}, "a node that is not there"),
        ({"poses": zero}, "quaternions of another length than 1"),
        ({"leave": late}, "frames that are not there"),
        ({"last": np.array(model.arrays["first"])}, "outside"),
    ):
        write_model(tmp_path / "bad.npz", KIND, header, {**model.arrays, **changed})
        with pytest.raises(ModelError, match=complaint):
            MotionGraph.read(tmp_path / "bad.npz")
    write_model(tmp_path / "bad.npz", KIND, {**header, "clusters": 3}, dict(model.arrays))
    with pytest.raises(ModelError, match="does not describe"):
        MotionGraph.read(tmp_path / "bad.npz")


def test_a_word_changes_what_is_done(graph: MotionGraph, tmp_path: Path) -> None:
    path = tmp_path / "graph.npz"
    graph.write(path, {})
    feed = Heard({10: "curve", 400: "<script>", 500: "2 nan", 600: "stop"})
    Synthesis(model=path).read(feed)  # type: ignore[arg-type]
    assert len(feed.poses) == 600 and sum("not understood" in t for t in feed.reports) == 2
    nodes = np.array(feed.nodes, NODE)
    entered = (nodes["onset"] - 1000 * NS) / NS * RATE
    assert set(nodes["cluster"][entered > 200]) == {"curve"}
    feed = Heard({5: "0 3"}, most=3000)
    Synthesis(model=path, then="wander").read(feed)  # type: ignore[arg-type]
    assert min(np.hypot(p[0], p[2] - 3.0) for p in feed.poses) < 0.5


def test_what_cannot_be_done_is_said_before_it_starts(graph: MotionGraph, tmp_path: Path) -> None:
    path = tmp_path / "graph.npz"
    graph.write(path, {})
    for words, complaint in (
        ({"order": (("strait", 1),)}, "straight"),
        ({"path": ((0.0, 1.0),)}, "two points or more"),
        ({"target": (0.0, 5.0), "forbidden": ((0.0, 5.0, 1.0),)}, "outside of forbidden"),
        ({"forbidden": ((0.0, 0.2, 1.0),)}, "where every walk begins"),
        ({"then": "dance"}, "stop or wander"),
    ):
        with pytest.raises(ParameterError, match=complaint):
            Synthesis(model=path, **words).specs()
    dead = replace(graph, core=graph.core & (graph.cluster == 0))
    dead.write(tmp_path / "dead.npz", {})
    with pytest.raises(ParameterError, match="a way back from: straight"):
        Synthesis(model=tmp_path / "dead.npz", order=(("curve", 1),)).specs()


def test_a_target_out_of_reach_ends_the_walk_and_says_so(tmp_path: Path) -> None:
    """Somebody who only waves cannot go anywhere."""
    spot = build_graph(TREE, [take("wave", waving(4), 0)], ("wave",), RATE, 0.1, BLEND)
    spot.write(tmp_path / "spot.npz", {})
    feed = Heard({}, most=4000)
    Synthesis(model=tmp_path / "spot.npz", target=(5.0, 5.0), realtime=False).read(feed)  # type: ignore[arg-type]
    assert feed.reports and "not reached" in feed.reports[-1] and not feed.stopped
    left = float(re.search(r"'left_m': ([0-9.]+)", feed.reports[-1])[1])  # type: ignore[index]
    assert left <= 5.0 * 2**0.5 + 0.5  # the way was counted twice: along the path, and straight to its end


def test_a_target_far_beyond_the_paths_end_is_walked_to(
    graph: MotionGraph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """How near the path's end came does not count for the target."""
    monkeypatch.setattr("kinegraph.operators.synthesis.source.NOWHERE_S", 5.0)
    graph.write(tmp_path / "graph.npz", {})
    feed = Heard({}, most=1200)
    path = ((0.0, 0.0), (0.0, 2.0))
    Synthesis(model=tmp_path / "graph.npz", path=path, target=(0.0, 12.0), realtime=False).read(feed)  # type: ignore[arg-type]
    assert not feed.reports and not feed.stopped
    assert np.hypot(feed.poses[-1][0], feed.poses[-1][2] - 12.0) < 1.0


def test_from_a_recording_to_an_avatar_and_a_bvh_file(tmp_path: Path, kinegraph: Command) -> None:
    """The whole way, by commands: a recorded pose, its graph, a walk on it, out by VMC and as BVH; the replay is the same."""
    Path("someone.yaml").write_text(
        "nodes:\n  someone: {use: devices.people.performer.Performer, realtime: false, duration_s: 40}\nrecord: [someone.pose]\n"
    )
    assert kinegraph("run", "someone.yaml", "--view", "none", "-o", "someone")[0] == 0
    trained = kinegraph("motion", "train", "graph", "someone", "-o", "graph.npz")
    assert trained[0] == 0 and "in the core" in trained[1], trained
    refused(kinegraph("motion", "train", "graph", "someone", "-o", "graph.npz"), "--overwrite")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as avatar:
        avatar.bind(("127.0.0.1", 0))
        avatar.settimeout(10)
        Path("walk.yaml").write_text(
            "nodes:\n"
            "  walk: {use: operators.synthesis.Synthesis, model: graph.npz, duration_s: 5, realtime: false}\n"
            "  file: {use: devices.outlets.bvh_file.BvhFile, from: {pose: walk.pose}, path: walk.bvh}\n"
            f"  avatar: {{use: devices.osc.vmc_outlet.VmcOutlet, from: {{pose: walk.pose}}, port: {avatar.getsockname()[1]}}}\n"
            "record: [walk.pose, walk.node]\n"
        )
        assert kinegraph("run", "walk.yaml", "--view", "none", "-o", "walk")[0] == 0
        assert b"/VMC/Ext/Bone/Pos" in avatar.recv(65536)
    assert "Frames:        150" in Path("walk.bvh").read_text()
    Path("alone.yaml").write_text(
        "nodes:\n  walk: {use: operators.synthesis.Synthesis, model: graph.npz, duration_s: 2}\nrecord: [walk.pose]\n"
    )
    assert (
        kinegraph("run", "alone.yaml", "--view", "none", "-o", "alone")[0] == 0
    )  # in real time, though no node waits for it
    with Recording.open(Path("alone")) as opened:
        assert len(opened.read("walk.pose")[0]) == 60


@needs_data
def test_the_runs_of_figure_10_1() -> None:
    """CMU 86_03, from its four channels: a cluster of runs between two transitions.

    The thesis counts nine runs, and so does this; the first and the last lie in the transitions on both sides for the most part.
    """

    from bench.motion import regular, segment

    with np.load(Path(os.environ["KINEGRAPH_DATA"]) / "segmentation/cmu86_4ch/86_03.npz") as z:
        angles, label, names = z["angles_deg"], z["label"][::4], z["label_names"].tolist()
    found = segment(regular(np.rad2deg(np.unwrap(np.deg2rad(angles.astype(float)), axis=0))[::4]).through(Stack()))
    frames = np.round(found.primitives * RATE).astype(int)
    runs = [
        k
        for k, (a, b) in enumerate(frames)
        if found.cluster[k] >= 0 and (label[a:b] == names.index("run")).mean() > 0.5
    ]
    whole = [k for k in range(len(frames)) if found.cluster[k] == found.cluster[runs[0]]]
    assert len(whole) == 9 and whole == list(range(whole[0], whole[0] + 9))
    assert found.cluster[whole[0] - 1] == found.cluster[whole[-1] + 1] == -1
    a, b = frames[whole[0] - 1]
    assert (label[a:b] == -1).mean() > 0.5


@needs_data
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_real_motion_goes_on_without_a_seam(seed: int) -> None:
    """CMU 13_29, three minutes: jumps of velocity no larger than recorded, in all and at the seams alone, unlike plain concatenation.

    Standing feet do not slide.
    """
    made = recorded("13_29")
    walker, poses, stood, seam = GraphWalk(made, seed=seed), [], [], []
    for _ in range(5400):
        seam.append(walker._blending)
        walker.step()
        poses.append(walker.pose.copy())
        stood.append(walker.stands.copy())
    plain, _ = walked(GraphWalk(made, seed=seed, feet=False, smooth=False), 5400)
    joints, bare = joints_of(made.tree, np.array(poses))[1], joints_of(made.tree, plain)[1]
    alone = joints_of(made.tree, made.poses[made.take == 0])[1]
    most = np.quantile(jumps(alone), 0.99)
    assert np.median(skates(joints, np.array(stood))) < 0.01
    assert np.quantile(jumps(joints), 0.99) <= most < np.quantile(jumps(bare), 0.99)
    assert np.quantile(jumps(joints)[np.array(seam)[1:-1]], 0.99) <= most
    steps, was = (np.linalg.norm(np.diff(x, axis=0), axis=2).max() for x in (joints, bare))
    assert steps < 1.2 * np.linalg.norm(np.diff(alone, axis=0), axis=2).max() < was


def test_chance_comes_to_all_that_was_recorded(graph: MotionGraph) -> None:
    """A chance walk prefers near seams and nodes that were entered less often: it enters every node of the core without repeating one."""
    walker = GraphWalk(graph, seed=5)
    entered = np.zeros(len(graph.first))
    far = list[float]()
    while entered.sum() < 12 * graph.core.sum():
        edge = walker._edge
        if walker.step():
            entered[walker.node] += 1
            far.append(float(graph.distance[edge]))
    often = entered[graph.core]
    assert often.min() >= 3 and often.max() <= 36
    inner = graph.core[graph.source] & graph.core[graph.target]
    assert np.mean(far) < 0.8 * graph.distance[inner].mean()


@pytest.mark.parametrize(
    ("spans", "clusters", "nodes"),
    [
        ([(0, 20), (20, 40), (40, 60)], [-1, -1, -1], [(0, 60, -1)]),  # what does not repeat and touches is one
        ([(0, 20), (21, 40)], [-1, -1], [(0, 20, -1), (21, 40, -1)]),  # but not across a gap
        ([(0, 20), (20, 40)], [-1, 3], [(0, 20, -1), (20, 40, 3)]),
        (
            [(0, 20), (20, 25), (25, 45)],
            [3, 4, 5],
            [(0, 25, 3), (25, 45, 5)],
        ),  # what is too short goes to what is before it
        ([(0, 5), (5, 25)], [3, 4], [(0, 25, 4)]),
        ([(0, 5), (6, 26)], [3, 4], [(6, 26, 4)]),
    ],
)
def test_what_touches_is_one_node_where_it_is_short_or_does_not_repeat(
    spans: list[tuple[int, int]], clusters: list[int], nodes: list[tuple[int, int, int]]
) -> None:
    still = np.repeat(walking(1)[:1], 60, axis=0)  # any node can follow any other one
    whole = Take("a", 0, still, np.array(spans), np.array(clusters))
    graph = build_graph(TREE, [whole], [], RATE, 0.06, 4, mirror=False)
    assert list(zip(graph.first.tolist(), graph.last.tolist(), graph.cluster.tolist(), strict=True)) == nodes
