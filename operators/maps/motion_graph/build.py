"""From takes and their primitives to a motion graph: nodes, edges found through the neighbour index, the strongly connected core."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from kinegraph.operators.maps.motion_graph.clouds import SIDES, cloud_distance, window_features
from kinegraph.operators.maps.motion_graph.takes import Take, mirrored_poses, on_floor, standing
from kinegraph.operators.neighbours.index import Index
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.motion_graph import TRANSITION, MotionGraph
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.errors import KinegraphError

SHORTEST_S = 0.4
"""A shorter stretch is no node: it is added to the one before it, or after it."""
ROOM = 1.5
"""Clouds that are turned to the front lie at most this much further apart than those that are placed best (see docs)."""
FARTHEST = 2.0
"""This much further than `within` edges are looked for, to say which would close a cycle."""


@dataclass(frozen=True, slots=True)
class Edges:
    """Where one node may go over into another; see MotionGraph."""

    source: Times
    target: Times
    leave: Times
    enter: Times
    placed: Samples

    def part(self, mine: Array) -> Edges:
        return Edges(self.source[mine], self.target[mine], self.leave[mine], self.enter[mine], self.placed[mine])


@dataclass(frozen=True, slots=True)
class Nodes:
    """first, last, cluster, mirrored (k,), as in MotionGraph, and the bounds low, high (k,) of each node's take in frames."""

    first: Times
    last: Times
    cluster: Times
    mirrored: Array
    low: Times
    high: Times


def build_graph(
    tree: JointTree, takes: Sequence[Take], names: Sequence[str], rate_hz: float, within_m: float, blend: int, mirror: bool = True
) -> MotionGraph:  # fmt: skip
    """The motion graph of takes of humanoid poses at `rate_hz`.

    within_m  two clouds, of the joints over 2 `blend` + 1 frames, may differ by this much (rms) for an edge
    Raises KinegraphError where nothing can be walked for ever, and says what is missing.
    """
    floored = [on_floor(tree, take.poses) for take in takes]
    poses = np.concatenate(floored)
    contacts = np.concatenate([standing(tree, p, rate_hz) for p in floored])
    number = np.repeat(np.arange(len(takes)), [len(take.poses) for take in takes])
    nodes = _nodes(takes, rate_hz)
    if mirror:
        poses = np.concatenate([poses, *map(mirrored_poses, floored)])
        contacts = np.concatenate([contacts, contacts[:, ::-1]])
        number = np.concatenate([number, number + len(takes)])
        nodes = _with_images(nodes, len(number) // 2)
    poses = poses.astype(np.float32).astype(np.float64)
    if not len(nodes.first):
        raise KinegraphError(
            f"no stretch of {SHORTEST_S:g} s or more in these recordings: there is nothing to make nodes of"
        )
    joints = joints_of(tree, poses)[1]
    near, core = walkable(nodes, find_edges(joints, nodes, within_m, blend), blend)
    if not core.any():
        edges = find_edges(joints, nodes, within_m * FARTHEST, blend)
        raise KinegraphError(_open_ended(nodes, edges, within_m, blend, rate_hz, takes))
    return MotionGraph(
        tree, rate_hz, tuple(names), blend, poses, contacts, number, nodes.first, nodes.last, nodes.cluster, nodes.mirrored, core,
        near.source, near.target, near.leave, near.enter, near.placed[:, 0].copy(), near.placed[:, 1:3].copy(), near.placed[:, 3].copy(),
    )  # fmt: skip


def _nodes(takes: Sequence[Take], rate_hz: float) -> Nodes:
    """The primitives, those that are too short added to a neighbour: of the same kind if there is one, else the one before."""
    rows: list[tuple[int, int, int, int, int]] = []
    begun, shortest = 0, round(SHORTEST_S * rate_hz)
    for take in takes:
        parts: list[list[int]] = []
        for (first, last), cluster in zip(take.spans.tolist(), take.cluster.tolist(), strict=True):
            joins = parts and parts[-1][1] == first and cluster == TRANSITION == parts[-1][2]
            short = parts and parts[-1][1] == first and min(last - first, parts[-1][1] - parts[-1][0]) < shortest
            if joins or short:
                longer = parts[-1][2] if parts[-1][1] - parts[-1][0] >= last - first else cluster
                parts[-1][1:] = [last, longer]
            elif last > first:
                parts.append([first, last, cluster])
        rows += [(begun + a, begun + b, c, begun, begun + len(take.poses)) for a, b, c in parts if b - a >= shortest]
        begun += len(take.poses)
    table = np.array(rows, np.int64).reshape(-1, 5).T
    return Nodes(table[0], table[1], table[2], np.zeros(table.shape[1], np.bool_), table[3], table[4])


def _with_images(nodes: Nodes, frames: int) -> Nodes:
    """The nodes, and their mirror images, `frames` further on."""
    moved = [np.concatenate([x, x + frames]) for x in (nodes.first, nodes.last, nodes.low, nodes.high)]
    sides = np.repeat([False, True], len(nodes.first))
    return Nodes(moved[0], moved[1], np.tile(nodes.cluster, 2), sides, moved[2], moved[3])


def _natural(edges: Edges) -> Array:
    return np.asarray((edges.leave == edges.enter) & (edges.placed[:, 3] == 0.0))


def find_edges(joints: Samples, nodes: Nodes, max_m: float, blend: int) -> Edges:
    """All edges up to `max_m`, ordered by source: the recordings' own, and for each pair of nodes the nearest windows at its seam.

    joints  (n, j, 3) of all frames. Windows are looked for up to a quarter of a node from its end, or beginning, and not beyond the take.
    """
    offsets = np.array([-blend, 0, blend], np.int64)
    left, right = (BONES.index(name) for name in SIDES[::-1])
    enters = [_around(nodes, k, int(nodes.first[k]), blend) for k in range(len(nodes.first))]
    leaves = [_around(nodes, k, int(nodes.last[k]), blend) for k in range(len(nodes.first))]
    owner = np.repeat(np.arange(len(enters)), [len(e) for e in enters])
    at = np.concatenate(enters)
    rows: list[tuple[int, int, int, int, Samples]] = []
    if len(at):
        seen = _features(joints, at, offsets, left, right)
        index = Index(seen.shape[1], len(seen), most=0)
        index.follow(seen, 0)
        radius = ROOM * max_m * np.sqrt(seen.shape[1] / 3)
        for k, ends in enumerate(leaves):
            best = np.full(len(enters), np.inf)
            seams = np.zeros((len(enters), 2), np.int64)
            for leave, row in zip(ends.tolist(), _features(joints, ends, offsets, left, right), strict=True):
                found, far = index.within(radius, row, band=-1)
                apart = np.abs(at[found] - leave) > blend
                found, far = found[apart], far[apart]
                order = np.lexsort(
                    (far, owner[found])
                )  # of each node the nearest window first, of two as near the earlier one
                nodes_found, first = np.unique(owner[found][order], return_index=True)
                nearest = order[first]
                better = far[nearest] < best[nodes_found]
                best[nodes_found[better]] = far[nearest][better]
                seams[nodes_found[better]] = np.stack([np.full(better.sum(), leave), at[found[nearest[better]]]], 1)
            for other in np.flatnonzero(np.isfinite(best)).tolist():
                leave, enter = (int(frame) for frame in seams[other])
                placed = cloud_distance(joints, leave, enter, blend)
                if placed[3] <= max_m:
                    rows.append((k, other, leave, enter, placed))
    follows = {(int(a), int(b)): k for k, (a, b) in enumerate(zip(nodes.first, nodes.low, strict=True))}
    for k, (last, low) in enumerate(zip(nodes.last.tolist(), nodes.low.tolist(), strict=True)):
        if (last, low) in follows:
            rows.append((k, follows[last, low], last, last, np.zeros(4)))
    rows.sort(key=lambda row: row[:2])
    table = np.array([row[:4] for row in rows], np.int64).reshape(-1, 4).T
    return Edges(table[0], table[1], table[2], table[3], np.array([row[4] for row in rows]).reshape(-1, 4))


def _features(joints: Samples, at: Times, offsets: Times, left: int, right: int) -> Samples:
    out = np.empty((len(at), len(offsets) * joints.shape[1] * 3))
    window_features(joints, at, offsets, left, right, out)
    return out


def _around(nodes: Nodes, k: int, seam: int, blend: int) -> Times:
    """The frames near a seam of a node at which a blend may have its middle."""
    slack = int(nodes.last[k] - nodes.first[k]) // 4
    inner = (seam, seam + slack) if seam == nodes.first[k] else (seam - slack, seam)
    low, high = max(inner[0], int(nodes.low[k]) + blend), min(inner[1], int(nodes.high[k]) - blend - 1)
    return np.arange(low, high + 1, dtype=np.int64)


def walkable(nodes: Nodes, edges: Edges, blend: int) -> tuple[Edges, Array]:
    """The edges after which there is time for another one, and the core that they make.

    A node that is entered late (blend and all) must still have a way out that leaves later, by two frames of its own blend at least.
    """
    while True:
        core = strongest(nodes, edges)
        inner = core[edges.source] & core[edges.target]
        latest = np.full(len(nodes.first), -1)
        np.maximum.at(latest, edges.source[inner], edges.leave[inner])
        late = inner & ~_natural(edges) & (edges.enter + blend + 3 > latest[edges.target])
        if not late.any():
            return edges, core
        edges = edges.part(~late)


def strongest(nodes: Nodes, edges: Edges) -> Array:
    """(k,) which nodes lie in the strongly connected component that lasts longest; empty where nothing leads back."""
    k = len(nodes.first)
    links = csr_array((np.ones(len(edges.source), np.int8), (edges.source, edges.target)), shape=(k, k))
    _, label = connected_components(links, directed=True, connection="strong")
    inner = edges.source[label[edges.source] == label[edges.target]]
    if not len(inner):
        return np.zeros(k, np.bool_)
    lasts = np.bincount(label, (nodes.last - nodes.first) * np.isin(label, label[inner]))
    return np.asarray(label == lasts.argmax())


def _open_ended(nodes: Nodes, edges: Edges, within_m: float, blend: int, rate_hz: float, takes: Sequence[Take]) -> str:
    """That no walk comes back to where it was, and what would make one."""
    text = f"no walk on this graph comes back: no node of its {len(nodes.first)} can be reached from itself"
    order = np.argsort(edges.placed[:, 3], kind="stable")
    for m in order[edges.placed[order, 3] > within_m].tolist():
        upto = edges.part(edges.placed[:, 3] <= edges.placed[m, 3])
        if walkable(nodes, upto, blend)[1].any():
            a, b = int(edges.source[m]), int(edges.target[m])
            return (
                f"{text}. The end of node {a} ({_place(nodes, a, takes, rate_hz)}) and the start of node {b} "
                f"({_place(nodes, b, takes, rate_hz)}) are {100 * edges.placed[m, 3]:.1f} cm apart, and would close a cycle: "
                f"--within-cm {np.ceil(1000 * edges.placed[m, 3]) / 10:g}"
            )
    return f"{text}, nor with clouds {100 * FARTHEST * within_m:g} cm apart; record motion that comes back to a pose it had"


def _place(nodes: Nodes, k: int, takes: Sequence[Take], rate_hz: float) -> str:
    """Where a node is in the recordings."""
    begun = np.cumsum([0, *(len(take.poses) for take in takes)])
    frame = int(nodes.first[k]) % int(begun[-1])
    take = int(np.searchsorted(begun, frame, side="right")) - 1
    seconds = [(f - int(begun[take])) / rate_hz for f in (frame, frame + int(nodes.last[k] - nodes.first[k]))]
    return f"{takes[take].name}, {seconds[0]:.1f} to {seconds[1]:.1f} s"
