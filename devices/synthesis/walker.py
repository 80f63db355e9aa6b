"""A walk on a motion graph: frame by frame, each one pose on the floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from devices.synthesis import plan_kernel as beam
from devices.synthesis.blend_kernel import blended, hold_feet, placed, room_for
from stream.chunk import Array, Samples
from stream.errors import KinegraphError
from stream.humanoid import BONES
from stream.motion_graph import MotionGraph, edges_from

LEGS = np.array(
    [[BONES.index(f"{side}{bone}") for bone in ("UpperLeg", "LowerLeg", "Foot", "Toes")] for side in ("Left", "Right")]
)
NEARNESS = 3.0
"""By chance, a seam as far as the farthest is taken e^-3 times as often as a recording's own way on."""
EVENNESS = 1.0
"""By chance, a node is entered 2^-1 times as often for each time more that it was entered before."""
ARRIVED_M = 0.5
"""So near to a target, or to the end of a path, is there."""


@dataclass(frozen=True, slots=True)
class Aim:
    """What a walk is for: `times` nodes of a cluster (by number; -1: any), 0: to stay in it; or a polyline (p, 2) on the floor."""

    cluster: int = -1
    times: int = 1
    path: Samples | None = None


class GraphWalk:
    """New motion from a motion graph, one pose a call of `step`: the same for the same graph, aims and seed.

    Begins at the place (0, 0), facing z. `feet`: whether feet that stand are held; `smooth`: whether seams are blended (both for comparison
    only). A walk that has done all its aims goes on by chance, which prefers near seams and nodes that were entered less often, so that
    in the long run all that was recorded comes; `over` says that the aims are done.
    """

    def __init__(
        self, graph: MotionGraph, aims: Sequence[Aim] = (), areas: Samples | None = None, seed: int = 0, *,
        feet: bool = True, smooth: bool = True,
    ) -> None:  # fmt: skip
        self.graph, self.feet, self.smooth = graph, feet, smooth
        self.areas: Samples = np.zeros((0, 3)) if areas is None else np.asarray(areas, np.float64).reshape(-1, 3)
        self.random = np.random.default_rng(seed)
        self._begin, self._natural = edges_from(graph), np.ascontiguousarray(graph.natural)
        self._togo = seconds_to(graph)
        self._far = graph.distance / max(float(graph.distance.max(initial=0.0)), 1e-9)
        nodes = len(graph.first)
        self._none, self._all_zero, self._entered = np.zeros(nodes, np.bool_), np.zeros(nodes), np.zeros(nodes)
        self._rooms = np.zeros((2, beam.BEAM + 1, beam.COLUMNS))
        self._progress = np.zeros(5)
        joints = len(graph.tree.joints)
        self._turns, self._joints, self._work = room_for(joints)
        self._one, self._two, self.pose = (
            np.zeros(graph.tree.width),
            np.zeros(graph.tree.width),
            np.zeros(graph.tree.width),
        )
        self._stood, self._spot, self._moved, self._lowered = (
            np.zeros(2, np.bool_),
            np.zeros((2, 3)),
            np.zeros((2, 3)),
            np.zeros(1),
        )
        self.stands = np.zeros(2, np.bool_)
        self.trespassed = 0
        self.aims: list[Aim] = []
        self.node = self._first_node(aims[0].cluster if aims else -1)
        self.frame = int(graph.first[self.node])
        root = graph.poses[self.frame]
        w, x, y, z = root[3:7]
        heading = float(np.arctan2(2.0 * (w * y + x * z), 1.0 - 2.0 * (x * x + y * y)))
        cos, sin = np.cos(-heading), np.sin(-heading)
        self.place = np.array([-heading, -(root[0] * cos + root[2] * sin), -(root[2] * cos - root[0] * sin)])
        self.along, self._half, self._edge = 0.0, 0, -1
        self._searching = False
        self.go(aims)

    def _first_node(self, cluster: int) -> int:
        """Where a walk begins: the first node of the core of this cluster, else of the core."""
        g = self.graph
        mine = np.flatnonzero(g.core & ((g.cluster == cluster) | (cluster < 0)))
        return int(mine[0] if len(mine) else np.flatnonzero(g.core)[0])

    def go(self, aims: Sequence[Aim]) -> None:
        """These aims from now on, in turn."""
        self.aims, self.passed, self.along, self.over = list(aims), 0, 0.0, not aims
        self._count()
        self._aim()
        if not self._blending:
            self._search()

    @property
    def _blending(self) -> bool:
        return (
            self._edge >= 0
            and self.smooth
            and not self._natural[self._edge]
            and self.frame >= self.graph.leave[self._edge] - self._half
        )

    def _aim(self) -> None:
        """What the search knows of the first aim."""
        aim = self.aims[0] if self.aims else Aim()
        self.path: Samples = np.zeros((0, 2)) if aim.path is None else np.asarray(aim.path, np.float64)
        steps = np.linalg.norm(np.diff(self.path, axis=0), axis=1)
        self.length: Samples = np.concatenate([[0.0], np.cumsum(steps)]) if len(self.path) else np.zeros(0)
        self.goal: Array = (self.graph.cluster == aim.cluster) & self.graph.core if aim.cluster >= 0 else self._none

    def _count(self) -> None:
        """Note that a node has been entered: of the cluster that is wanted, perhaps often enough."""
        if self.aims and 0 <= self.aims[0].cluster == self.graph.cluster[self.node]:
            self.passed += 1
            if self.aims[0].times and self.passed >= self.aims[0].times:
                self._next_aim()

    def _next_aim(self) -> None:
        self.aims, self.passed, self.along = self.aims[1:], 0, 0.0
        self.over = self.over or not self.aims
        self._aim()

    def _search(self) -> None:
        """Begin to look for the edge that is taken next; where none is found, the one that was to be taken stays."""
        g = self.graph
        start = self._rooms[0, 0]
        start[:] = 0.0
        start[beam.NODE], start[beam.FRAME], start[beam.ALONG] = self.node, self.frame, self.along
        start[beam.TURN : beam.Z + 1] = self.place
        by_chance = not self.goal.any() and not len(self.path)
        self._noise = self._lots() if by_chance else 1e-3 * self.random.random(len(g.source))
        wanted = np.ascontiguousarray(self._togo[:, self.aims[0].cluster]) if self.goal.any() else self._all_zero
        self._sought = self.path, self.length, self.areas, wanted, self.goal
        self._progress[:] = 0.0, 1.0, np.inf, -1.0, -1.0
        self._from, self._from_along = self.frame, self.along
        if self._edge >= 0 or not self._searching:
            self._otherwise = self._edge
        ways = np.arange(self._begin[self.node], self._begin[self.node + 1])
        leave = g.leave[
            ways[g.core[g.target[ways]] & (self._natural[ways] | (g.leave[ways] - self.frame >= beam.HALF))]
        ]
        self._due = int(np.maximum(leave - g.blend, self.frame).min(initial=self.frame + beam.DEPTH))
        if self._otherwise >= 0:
            self._due = min(self._due, int(g.leave[self._otherwise]) - self._half)
        self._edge, self._searching = -1, True

    def _lots(self) -> Samples:
        """(m,) the lots, 0 to 1, of this node's ways on: chance takes the smallest. Near seams and seldom entered nodes win more often.

        A race of exponential waiting times, of which only the order counts.
        """
        g, ways = self.graph, slice(self._begin[self.node], self._begin[self.node + 1])
        often = self._entered[g.target[ways]]
        waits = (
            np.log(self.random.exponential(size=len(often)))
            + EVENNESS * np.log(2.0) * often
            + NEARNESS * self._far[ways]
        )
        lots = np.zeros(len(g.source))
        lots[ways.start + np.argsort(waits, kind="stable")] = np.arange(len(waits)) / max(1, len(waits))
        return lots

    def _look_ahead(self) -> None:
        """A part of the search, so that no frame takes much longer than others; what is left of it where the edge must be known now."""
        g, deep = self.graph, int(self._progress[beam.DEEP])
        levels = -(-(beam.DEPTH - deep) // max(1, self._due - self.frame + 1))
        beam.deepen(
            levels, self._progress, self._from_along, g.poses, g.first, g.last, g.core, self._begin, g.target, g.leave, g.enter,
            self._natural, g.turn, g.shift, g.blend, g.rate_hz, *self._sought, self._noise, *self._rooms,
        )  # fmt: skip
        if self._progress[beam.DEEP] < beam.DEPTH:
            return
        self._searching = False
        found = self._progress[beam.FOUND] if self._progress[beam.FOUND] >= 0 else self._progress[beam.CHOSEN]
        self._edge = int(found) if found >= 0 else self._otherwise
        if found >= 0:
            free = int(g.leave[self._edge]) - self._from
            self._half = 0 if self._natural[self._edge] else min(g.blend, free)

    def step(self) -> bool:
        """Make the next pose, in `pose`; whether a node was entered with it."""
        if self._searching:
            self._look_ahead()
        g, edge = self.graph, self._edge
        entered = False
        placed(g.poses[self.frame], self.place, self._one)
        stands = g.contacts[self.frame]
        seam = int(g.leave[edge]) if edge >= 0 else -1
        if edge >= 0 and not self._natural[edge] and self.smooth and self.frame >= seam - self._half:
            other = int(g.enter[edge]) + self.frame - seam
            share = (self.frame - seam + self._half + 1) / (2 * self._half + 2)
            share = share * share * (3.0 - 2.0 * share)
            placed(g.poses[other], self._beyond(edge), self._two)
            blended(self._one, self._two, share, self.pose)
            stands = g.contacts[other] if share > 0.5 else stands
        else:
            self.pose[:] = self._one
        self.stands[:] = stands
        if self.feet:
            hold_feet(
                self.pose, self.stands, g.tree.parents, g.tree.offsets, LEGS, self._stood, self._spot, self._moved, self._lowered,
                self._turns, self._joints, self._work,
            )  # fmt: skip
        self._follow()
        end = (
            int(g.last[self.node]) if edge < 0 or self._natural[edge] else seam + (self._half + 1 if self.smooth else 1)
        )
        self.frame += 1
        if self.frame >= end:
            if edge < 0:
                raise KinegraphError(f"the motion graph has no way on from node {self.node}; train it again")
            self._enter(edge)
            entered = True
        return entered

    def _beyond(self, edge: int) -> Samples:
        """How the frames beyond an edge are placed."""
        g, (turn, x, z) = self.graph, self.place
        cos, sin, (a, b) = np.cos(turn), np.sin(turn), g.shift[edge]
        return np.array([turn + g.turn[edge], x + a * cos + b * sin, z + b * cos - a * sin])

    def _enter(self, edge: int) -> None:
        g = self.graph
        if not self._natural[edge]:
            self.place = self._beyond(edge)
            self.frame = int(g.enter[edge]) + self.frame - int(g.leave[edge])
        self.node, self._edge = int(g.target[edge]), -1
        self._entered[self.node] += 1.0
        self._count()
        self._search()

    def _follow(self) -> None:
        """How far along the path the walk is; and whether it is where it must not be."""
        x, z = self.pose[0], self.pose[2]
        if len(self.path):
            self.along, _ = beam.nearest_ahead(self.path, self.length, self.along, 1.0, x, z)
            if self.length[-1] - self.along < ARRIVED_M and np.hypot(*(self.path[-1] - (x, z))) < ARRIVED_M:
                self._next_aim()
        self.trespassed += bool(
            ((self.areas[:, 0] - x) ** 2 + (self.areas[:, 1] - z) ** 2 < self.areas[:, 2] ** 2).any()
        )


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
