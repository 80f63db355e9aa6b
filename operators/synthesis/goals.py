"""The aims of a walk: as they are given, and as the search on the graph takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from kinegraph.operators.synthesis.layout import Sought
from kinegraph.operators.synthesis.matching_kernel import nearest_ahead
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.motion_graph import MotionGraph

ARRIVED_M = 0.5
"""So near to a target, or to the end of a path, is there."""
AROUND_M = 0.35
"""A path is bent around forbidden areas, so far from them."""


@dataclass(frozen=True, slots=True)
class Aim:
    """What a walk is for: `times` nodes of a cluster (by number; -1: any), 0: to stay in it; or a polyline (p, 2) on the floor, followed
    in nodes of the cluster where these lead on."""

    cluster: int = -1
    times: int = 1
    path: Samples | None = None


def sought(graph: MotionGraph, seconds: Samples, aim: Aim) -> Sought:
    """An aim as the search on the graph knows it; `seconds` as `seconds_to` returns them. Paths are followed by motion matching."""
    mine = graph.core & (graph.cluster == aim.cluster)
    if aim.path is not None or aim.cluster < 0:
        return Sought(np.zeros(len(mine), np.bool_), np.zeros(len(mine)))
    return Sought(mine, np.ascontiguousarray(seconds[:, aim.cluster]) if mine.any() else np.zeros(len(mine)))


def around(path: Samples, areas: Samples) -> Samples:
    """A polyline (p, 2) that passes areas (x, z, radius) by half an octagon, `AROUND_M` from them, where its lines cross them."""
    made = [path[0]]
    for a, b in pairwise(path):
        along = b - a
        size = float(np.linalg.norm(along))
        unit = along / size if size else along
        for x, z, radius in sorted(areas.tolist(), key=lambda area: float((np.array(area[:2]) - a) @ unit)):
            centre, room = np.array([x, z]), radius + AROUND_M
            at = float((centre - a) @ unit)
            away = a + at * unit - centre
            if not 0.0 < at < size or np.linalg.norm(away) >= room:
                continue
            side = away / np.linalg.norm(away) if np.linalg.norm(away) > 1e-6 else np.array([unit[1], -unit[0]])
            made += [
                centre + room / np.cos(np.pi / 8) * turn
                for turn in ((side - unit) / 2**0.5, side, (side + unit) / 2**0.5)
            ]
        made.append(b)
    return np.array(made)


def seconds_to(graph: MotionGraph) -> Samples:
    """(k, clusters) seconds from the start of each node to that of the first node of each cluster; inf: it is not reached."""
    k, inner = len(graph.first), graph.core[graph.source] & graph.core[graph.target]
    source, target = np.unique(np.stack([graph.source[inner], graph.target[inner]]), axis=1)
    back = csr_array(((graph.last - graph.first)[source] / graph.rate_hz, (target, source)), shape=(k, k))
    made = np.full((k, max(1, len(graph.names))), np.inf)
    for c in range(len(graph.names)):
        goals = np.flatnonzero((graph.cluster == c) & graph.core)
        if len(goals):
            made[:, c] = dijkstra(back, indices=goals, min_only=True)
    return made


class Progress:
    """Aims that a walk does in turn, and how far it has come.

    aims    those that are left, the first under way
    over    whether all have been done
    sought  the first, as the search on the graph knows it
    path (p, 2), length (p,)   its path on the floor, and how far along it each point is; may be empty
    along   how far along its path the walk is, m
    """

    def __init__(self, graph: MotionGraph, areas: Samples) -> None:
        self._graph, self._seconds, self._areas = graph, seconds_to(graph), areas
        self.aims: list[Aim] = []
        self.over, self._passed, self.along = True, 0, 0.0
        self.sought = sought(graph, self._seconds, Aim())
        self.path, self.length = np.zeros((0, 2)), np.zeros(0)

    def begin(self, aims: Sequence[Aim]) -> None:
        """These from now on."""
        self.aims, self.over = list(aims), not aims
        self._take_up()

    @property
    def left_m(self) -> float:
        """How much is left of the path."""
        return float(self.length[-1] - self.along) if len(self.path) else np.inf

    def ends_at(self, node: int) -> bool:
        """Whether entering `node` is the last that the first aim asks for: nodes of a cluster, a number of them."""
        return self._counts(node) and 0 < self.aims[0].times <= self._passed + 1

    def next_sought(self) -> Sought:
        """What is sought once the first aim is done."""
        return sought(self._graph, self._seconds, self.aims[1] if len(self.aims) > 1 else Aim())

    def enter(self, node: int) -> None:
        """Note that a node has been entered: of the cluster that is wanted, perhaps often enough."""
        if self.ends_at(node):
            self._next_aim()
        else:
            self._passed += self._counts(node)

    def follow(self, x: float, z: float) -> bool:
        """Note that the walk is at this place; whether that is the end of the path."""
        if not len(self.path):
            return False
        self.along, _ = nearest_ahead(self.path, self.length, self.along, 1.0, x, z)
        arrived = self.left_m < ARRIVED_M and bool(np.hypot(*(self.path[-1] - (x, z))) < ARRIVED_M)
        if arrived:
            self._next_aim()
        return arrived

    def _counts(self, node: int) -> bool:
        return bool(self.aims) and self.aims[0].path is None and 0 <= self.aims[0].cluster == self._graph.cluster[node]

    def _next_aim(self) -> None:
        self.aims = self.aims[1:]
        self.over = self.over or not self.aims
        self._take_up()

    def _take_up(self) -> None:
        self._passed, self.along = 0, 0.0
        aim = self.aims[0] if self.aims else Aim()
        self.sought = sought(self._graph, self._seconds, aim)
        self.path = np.zeros((0, 2)) if aim.path is None else around(np.array(aim.path, np.float64), self._areas)
        self.length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.path, axis=0), axis=1))])
