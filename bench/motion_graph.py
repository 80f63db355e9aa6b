"""`python -m bench.motion_graph`: motion graphs of one CMU recording, cut in several ways, and how smooth a walk on them is; Markdown.

`--building` measures only how long a graph of ten minutes takes: all CMU sequences, then their mirror images until the time is full.
`--runs` says only how aligned cluster analysis cuts CMU 86_03, of which the thesis draws nine runs.
`--frames` measures only how long a frame takes, the search for the way on included: processor time of one thread, and by the clock.
`--minutes` says only how rough each minute of a walk is, beside the very frames of the recording that it plays.
`--following` measures only how near a walk keeps to a path: on a graph of made-up walks, and on one of all CMU sequences.

Needs the folder of recordings that the environment variable KINEGRAPH_DATA names.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from bench.aligned_clusters import aligned_clusters
from bench.report import table
from kinegraph.operators.maps.motion_graph.build import build_graph
from kinegraph.operators.maps.motion_graph.measures import measure
from kinegraph.operators.maps.motion_graph.primitives import segmented
from kinegraph.operators.maps.motion_graph.takes import Take, mirrored_poses
from kinegraph.operators.synthesis.goals import Aim
from kinegraph.operators.synthesis.matching_kernel import heading_of
from kinegraph.operators.synthesis.walker import LEGS, GraphWalk
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.motion_graph import MotionGraph
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.errors import KinegraphError
from tests.support import motion_made
from tests.support.motion_made import RATE, cmu_takes

NAME, WITHIN_M, BLEND = "13_29", 0.12, 5
ACTIONS = 12
"""The annotated exercises."""
BUILDING_S = 600.0
FRAMES = 10_800
FOLLOWED_S, SEEDS = 90.0, 5
"""A walk along a path ends after so long, if it has not arrived."""
ROUND = "round, 2 m from the middle"
_ROUND = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
PATHS = {
    "straight, 8 m": np.array([[0.0, 0.0], [0.0, 8.0]]),
    "a corner, 4 and 4 m": np.array([[0.0, 0.0], [0.0, 4.0], [4.0, 4.0]]),
    ROUND: np.column_stack([2.0 - 2.0 * np.cos(_ROUND), 2.0 * np.sin(_ROUND)]),
}
"""x, z in m."""


def main() -> None:
    if not os.environ.get("KINEGRAPH_DATA"):
        sys.exit("KINEGRAPH_DATA must name the folder that holds body/cmu_mocap_30hz.npz")
    if "--building" in sys.argv:
        print(building())
        return
    if "--runs" in sys.argv:
        print(aligned_runs())
        return
    for word, made in {"--following": following, "--frames": frames, "--minutes": minutes}.items():
        if word in sys.argv:
            print(made())
            return
    tree, (take,) = cmu_takes([NAME])
    began = time.perf_counter()
    ours = segmented(tree, [take], RATE)[0]
    cuts: dict[str, Callable[[], Take]] = {
        "as segmented": lambda: ours,
        "fixed windows, 1 s": lambda: cut(take, np.arange(0, len(take.poses), int(RATE))),
        "annotated actions": lambda: labelled(take),
        "aligned clusters, known number": lambda: aligned(tree, take),
        "KernelCPD, as many cuts": lambda: cut(take, kernel_cpd(tree, take, len(ours.spans) - 1)),
    }
    rows = []
    for name, taken in cuts.items():
        try:
            graph = build(tree, taken())
        except (KinegraphError, ImportError) as error:
            rows.append([name, *["-"] * 6, str(error)[:80]])
            continue
        m = measure(graph)
        rows.append([
            name, str(m.nodes), str(m.core), f"{m.branching:.1f}", f"{100 * m.coverage:.0f} %", str(m.clusters),
            f"{m.reach_s[0]:.1f} / {m.reach_s[1]:.1f}", "",
        ])  # fmt: skip
    print(table(["cut", "nodes", "core", "ways on", "kept", "clusters", "reach s, median / p95", ""], rows))
    graph = build(tree, ours)
    print(
        f"\nsegmented and built in {time.perf_counter() - began:.1f} s with all above; {len(take.poses) / RATE:.0f} s of motion\n"
    )
    rows = [["recorded", *facts(graph, graph.poses[graph.take == 0], graph.contacts[graph.take == 0])]]
    for name, how in {
        "walked": {},
        "feet not held": {"feet": False},
        "plain concatenation": {"feet": False, "smooth": False},
    }.items():
        poses, stood, took = walk(graph, **how)
        rows.append(
            [
                name,
                *facts(graph, poses, stood),
                f"{np.median(took):.0f} / {np.quantile(took, 0.99):.0f} / {took.max():.0f}",
            ]
        )
    print(
        table(
            [
                "",
                "skate cm, median / p95",
                "velocity jump m/s, p99 / max",
                "step m, max",
                "us a frame, median / p99 / max",
            ],
            rows,
        )
    )


def building() -> str:
    """How long ten minutes take to be segmented and built, kernels compiled before; processor time, which other work hardly changes."""
    with np.load(Path(os.environ["KINEGRAPH_DATA"]) / "body" / "cmu_mocap_30hz.npz") as z:
        names = sorted(name.removeprefix("rot_") for name in z.files if name.startswith("rot_"))
    tree, takes = cmu_takes(names)
    whole = list(takes)
    for take in takes:
        room = round(BUILDING_S * RATE) - sum(len(one.poses) for one in whole)
        if room > 2 * RATE:
            whole.append(replace(take, name=f"{take.name} mirrored", poses=mirrored_poses(take.poses)[:room]))
    rows = []
    for some in (cmu_takes(["02_01", NAME])[1], whole):
        began, wall = time.process_time(), time.perf_counter()
        cut_up = segmented(tree, some, RATE)
        half = time.process_time()
        clusters = range(1 + max(int(t.cluster.max()) for t in cut_up))
        made = build_graph(tree, cut_up, [f"c{c}" for c in clusters], RATE, WITHIN_M, BLEND)
        done = time.process_time()
        lasts = sum(len(t.poses) for t in some) / RATE
        rows.append([
            f"{lasts:.0f}", f"{half - began:.1f}", f"{done - half:.1f}", f"{time.perf_counter() - wall:.1f}",
            str(len(made.first)), str(len(made.source)),
        ])  # fmt: skip
    return table(
        ["motion, s", "segmented, s of processor", "built, s of processor", "both, wall s", "nodes", "ways"], rows[1:]
    )


def all_sequences() -> MotionGraph:
    """The graph of all CMU sequences."""
    with np.load(Path(os.environ["KINEGRAPH_DATA"]) / "body" / "cmu_mocap_30hz.npz") as z:
        names = sorted(name.removeprefix("rot_") for name in z.files if name.startswith("rot_"))
    return motion_made.recorded(*names, within_m=WITHIN_M)


def frames() -> str:
    """How long a frame takes: six minutes by chance, in the first cluster, and round a circle, again and again; kernels compiled before."""
    warm = GraphWalk(motion_made.recorded(NAME, within_m=WITHIN_M), [Aim(path=PATHS[ROUND])])
    for _ in range(300):
        warm.step()
    rows = []
    for name, graph in {
        f"CMU {NAME}": motion_made.recorded(NAME, within_m=WITHIN_M),
        "17 CMU sequences": all_sequences(),
    }.items():
        size = f"{name}: {len(graph.first)} nodes, {len(graph.source)} ways"
        for what, aim in {
            "by chance": None,
            "in a cluster": Aim(0, 0),
            "round a circle": Aim(path=PATHS[ROUND]),
        }.items():
            walker = GraphWalk(graph, [aim] if aim else [])
            took = np.empty((FRAMES, 2))
            for i in range(FRAMES):
                if aim and walker.progress.over:
                    walker.go([aim])
                wall, own = time.perf_counter(), time.thread_time()
                walker.step()
                took[i] = time.thread_time() - own, time.perf_counter() - wall
            own, wall = 1e3 * took.T
            rows.append([
                f"{size}, {what}", *(f"{1e3 * typical(own):.0f} us" for typical in (np.median, np.mean)),
                *(f"{q:.2f}" for q in np.quantile(own, (0.99, 0.999))),
                f"{own.max():.2f}", f"{wall.max():.2f}",
            ])  # fmt: skip
    return table(["", "median", "mean", "p99, ms", "p99.9, ms", "longest, ms", "longest by the clock, ms"], rows)


def minutes() -> str:
    """The 99th percentile of velocity jumps of each minute of walks by chance, as a share of that of the frames that it plays."""
    graph = motion_made.recorded(NAME, within_m=WITHIN_M)
    recorded = joints_of(graph.tree, graph.poses)[1]
    own = np.zeros(recorded.shape[:2])
    own[1:-1] = np.linalg.norm(np.diff(recorded, n=2, axis=0), axis=2) * RATE
    shares, most = list[float](), float(np.quantile(own[1:-1][graph.take[2:] == graph.take[:-2]], 0.99))
    whole = list[float]()
    n = round(60 * RATE)
    for seed in range(SEEDS):
        walker = GraphWalk(graph, seed=seed)
        for _ in range(3):
            poses, plays = list[Array](), list[Array]()
            for _ in range(n):
                plays.append(own[played(walker)].max(axis=0))
                walker.step()
                poses.append(walker.pose.copy())
            jump = np.linalg.norm(np.diff(joints_of(graph.tree, np.array(poses))[1], n=2, axis=0), axis=2) * RATE
            whole.append(float(np.quantile(jump, 0.99)))
            shares.append(whole[-1] / float(np.quantile(np.array(plays)[1:-1], 0.99)))
    rows = [
        [
            f"{len(shares)}",
            f"{most:.2f}",
            f"{min(whole):.2f} to {max(whole):.2f}",
            f"{min(shares):.2f} to {max(shares):.2f}",
        ]
    ]
    return table(["minutes", "recorded p99, m/s", "walked p99, m/s", "walked by what it plays"], rows)


def played(walker: GraphWalk) -> list[int]:
    """The frames of the recordings that the next pose is made of, as far as is decided: one, or two in a blend."""
    if not walker._blending:
        return [walker.frame]
    g, edge = walker.graph, walker._edge
    return [walker.frame, int(g.enter[edge]) + walker.frame - int(g.leave[edge])]


def following() -> str:
    """How far from a path its walks lie, along all of each, how many of them arrive, and how rough they are beside the recording."""
    turns = (0.0, 15.0, -15.0, 30.0, -30.0)
    made = [
        motion_made.take(f"turning {turn:g} deg", motion_made.walking(6, np.radians(turn), sway=0.1), 0)
        for turn in turns
    ]
    graphs = {
        "made-up walks": build_graph(motion_made.TREE, made, ["walk"], RATE, WITHIN_M, BLEND),
        "17 CMU sequences": all_sequences(),
    }
    rows = []
    for graph_name, graph in graphs.items():
        alone = np.concatenate(
            [jumps(graph, graph.poses[graph.take == k]) for k in np.unique(graph.take) if (graph.take == k).sum() > 2]
        )
        for name, path in PATHS.items():
            walks = [followed(graph, path, seed) for seed in range(SEEDS)]
            off = 100 * np.concatenate([off for off, _, _ in walks])
            rough = np.concatenate([jumps(graph, poses) for _, poses, _ in walks])
            rows.append([
                graph_name, name, f"{np.median(off):.0f} / {np.quantile(off, 0.95):.0f}",
                f"{sum(arrived for _, _, arrived in walks)} of {SEEDS}",
                f"{np.quantile(rough, 0.99):.2f} / {np.quantile(alone, 0.99):.2f}",
            ])  # fmt: skip
    return table(
        ["graph", "path", "off by cm, median / p95", "arrived", "jump of velocity, m/s, p99, walked / recorded"], rows
    )


def jumps(graph: MotionGraph, poses: Samples) -> Samples:
    """Changes of velocity of every joint from frame to frame, m/s."""
    made: Samples = np.linalg.norm(np.diff(joints_of(graph.tree, poses)[1], n=2, axis=0), axis=2).ravel() * RATE
    return made


def followed(graph: MotionGraph, path: Samples, seed: int) -> tuple[Samples, Samples, bool]:
    """How far each pose's root lies from the path (m), the poses, and whether the walk came to the path's end.

    It walks by chance for 7 s times `seed` first; the path begins where it is then, straight ahead.
    """
    walker = GraphWalk(graph, seed=seed)
    for _ in range(round(7 * seed * RATE)):
        walker.step()
    turn, (x, z) = heading_of(walker.pose), walker.pose[[0, 2]]
    cos, sin = np.cos(turn), np.sin(turn)
    path = path @ np.array([[cos, -sin], [sin, cos]]) + (x, z) if seed else path
    walker.go([Aim(path=path)])
    poses = list[Samples]()
    while len(poses) < FOLLOWED_S * RATE and len(walker.progress.path):
        walker.step()
        poses.append(walker.pose.copy())
    begins, steps = path[:-1], np.diff(path, axis=0)
    away = np.array(poses)[:, None, [0, 2]] - begins
    share = np.clip((away * steps).sum(2) / (steps**2).sum(1), 0.0, 1.0)
    off = np.linalg.norm(away - share[..., None] * steps, axis=2).min(axis=1)
    return off, np.array(poses), not len(walker.progress.path)


def build(tree: JointTree, take: Take) -> MotionGraph:
    names = [chr(65 + c) for c in range(1 + max(0, int(take.cluster.max())))]
    return build_graph(tree, [take], names, RATE, WITHIN_M, BLEND)


def cut(take: Take, at: Times) -> Take:
    """A take cut at these frames, all of one cluster."""
    borders = np.unique(np.concatenate([[0], at, [len(take.poses)]]))
    return replace(take, spans=np.array(list(pairwise(borders.tolist()))), cluster=np.zeros(len(borders) - 1, np.int64))


def labelled(take: Take) -> Take:
    """A take cut where the annotators did, a cluster per action."""
    with np.load(Path(os.environ["KINEGRAPH_DATA"]) / "segmentation/mocap6" / f"{NAME}.npz") as z:
        label = z["label_cut"].astype(np.int64)
    made = cut(take, np.flatnonzero(np.diff(label)) + 1)
    return replace(made, cluster=label[made.spans[:, 0]])


def aligned(tree: JointTree, take: Take) -> Take:
    """A take cut by aligned cluster analysis at 10 Hz, with the number of annotated actions; segments last 0.4 to 4 s."""
    joints = joints_of(tree, take.poses)[1]
    found = aligned_clusters((joints - joints[:, :1]).reshape(len(joints), -1)[::3], ACTIONS, 4, 40)
    made = cut(take, found.starts * 3)
    return replace(made, cluster=found.cluster)


def aligned_runs() -> str:
    """How aligned cluster analysis cuts the four channels of CMU 86_03 at 10 Hz, for seven actions."""
    with np.load(Path(os.environ["KINEGRAPH_DATA"]) / "segmentation/cmu86_4ch/86_03.npz") as z:
        angles = np.unwrap(np.deg2rad(z["angles_deg"].astype(float)), axis=0)[::12]
        run = z["label"][::12] == z["label_names"].tolist().index("run")
    rows = []
    for max_s in (2, 4):
        found = aligned_clusters(angles, 7, 5, 10 * max_s)
        pairs = zip(found.starts, found.ends, strict=True)
        runs = found.cluster[int(np.argmax([run[a:b].mean() for a, b in pairs]))]
        rows.append([f"{max_s}", str(len(found.starts)), str(int((found.cluster == runs).sum()))])
    return table(["longest segment, s", "segments", "in the cluster of the runs"], rows)


def kernel_cpd(tree: JointTree, take: Take, cuts: int) -> Times:
    """Cuts of ruptures' KernelCPD for a known number."""
    import ruptures  # type: ignore[import-not-found]

    joints = joints_of(tree, take.poses)[1]
    seen = (joints - joints[:, :1]).reshape(len(joints), -1)
    return np.array(ruptures.KernelCPD("rbf", min_size=12).fit(seen).predict(n_bkps=cuts)[:-1])


def walk(graph: MotionGraph, feet: bool = True, smooth: bool = True) -> tuple[Samples, Array, Samples]:
    """Three minutes: poses, which feet stood, microseconds a frame."""
    walker = GraphWalk(graph, seed=1, feet=feet, smooth=smooth)
    n = round(180 * RATE)
    poses, stood, took = np.empty((n, graph.tree.width)), np.empty((n, 2), bool), np.empty(n)
    for _ in range(300):
        walker.step()
    for i in range(n):
        began = time.perf_counter()
        walker.step()
        took[i] = 1e6 * (time.perf_counter() - began)
        poses[i], stood[i] = walker.pose, walker.stands
    return poses, stood, took


def facts(graph: MotionGraph, poses: Samples, stood: Array) -> list[str]:
    joints = joints_of(graph.tree, poses)[1]
    jump = np.linalg.norm(np.diff(joints, n=2, axis=0), axis=2) * RATE
    slid = []
    for side in range(2):
        toes = joints[:, LEGS[side, 3]][:, [0, 2]]
        edges = np.flatnonzero(np.diff(np.r_[0, stood[:, side].astype(int), 0]))
        slid += [
            100 * np.linalg.norm(toes[a:b] - toes[a], axis=1).max()
            for a, b in zip(edges[::2], edges[1::2], strict=True)
            if b - a > 3
        ]
    step = np.linalg.norm(np.diff(joints, axis=0), axis=2).max()
    return [
        f"{np.median(slid):.2g} / {np.quantile(slid, 0.95):.2g}",
        f"{np.quantile(jump, 0.99):.2f} / {jump.max():.2f}",
        f"{step:.2f}",
    ]


if __name__ == "__main__":
    main()
