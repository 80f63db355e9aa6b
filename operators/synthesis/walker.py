"""A walk on a motion graph: frame by frame, each one pose on the floor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinegraph.operators.synthesis.blend_kernel import blended, hold_feet, placed, room_for
from kinegraph.operators.synthesis.goals import Aim, Progress
from kinegraph.operators.synthesis.matching import HALF_LIFE_S, Ahead, Matching, Played
from kinegraph.operators.synthesis.matching_kernel import add_offset, heading_of
from kinegraph.operators.synthesis.path_search import Start, WaySearch
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.motion_graph import MotionGraph
from kinegraph.stream.errors import KinegraphError

LEGS = np.array(
    [[BONES.index(f"{side}{bone}") for bone in ("UpperLeg", "LowerLeg", "Foot", "Toes")] for side in ("Left", "Right")]
)


class GraphWalk:
    """New motion from a motion graph, one pose a call of `step`: the same for the same graph, aims and seed.

    Begins at the place (0, 0), facing z. `feet`: whether feet that stand are held; `smooth`: whether seams are blended (both for comparison
    only). A walk that has done all its aims goes on by chance, which prefers near seams and nodes that were entered less often, so that
    in the long run all that was recorded comes. Paths are followed by motion matching: not from node to node, but from any frame to any
    other one that leads along them. `progress` says how far it has come with its aims.
    """

    def __init__(
        self, graph: MotionGraph, aims: Sequence[Aim] = (), areas: Samples | None = None, seed: int = 0, *,
        feet: bool = True, smooth: bool = True,
    ) -> None:  # fmt: skip
        self.graph, self.feet, self.smooth = graph, feet, smooth
        self.areas: Samples = np.zeros((0, 3)) if areas is None else np.asarray(areas, np.float64).reshape(-1, 3)
        self._search = WaySearch(graph, self.areas, np.random.default_rng(seed))
        self.progress = Progress(graph, self.areas)
        self._matchings = dict[int, Matching]()
        self._matching: Matching | None = None
        self._entered = np.zeros(len(graph.first))
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
        self.node = self._first_node(aims[0].cluster if aims else -1)
        self.frame = int(graph.first[self.node])
        root = graph.poses[self.frame]
        heading = heading_of(root)
        cos, sin = np.cos(-heading), np.sin(-heading)
        self.place = np.array([-heading, -(root[0] * cos + root[2] * sin), -(root[2] * cos - root[0] * sin)])
        self._half, self._edge, self._otherwise, self._beyond_it = 0, -1, -1, False
        self._played = Played.empty(joints)
        placed(root, self.place, self._one)
        self._played.shown[:] = self._one
        self.go(aims)

    def _first_node(self, cluster: int) -> int:
        """Where a walk begins: the first node of the core of this cluster, else of the core."""
        g = self.graph
        mine = np.flatnonzero(g.core & ((g.cluster == cluster) | (cluster < 0)))
        return int(mine[0] if len(mine) else np.flatnonzero(g.core)[0])

    def go(self, aims: Sequence[Aim]) -> None:
        """These aims from now on, in turn."""
        self.progress.begin(aims)
        self.progress.enter(self.node)
        if len(self.progress.path) or self._matching:
            self._change_ways()
        else:
            self._seek()

    def _seek(self) -> None:
        """Look for the way on from here."""
        if self._blending:
            self._seek_beyond()
            return
        if self._edge >= 0:
            self._otherwise = self._edge
        self._edge, self._beyond_it = -1, False
        self._search.begin_at(Start(self.node, self.frame, self.place), self.progress.sought, self._entered)
        if self._otherwise >= 0:
            self._search.due = min(self._search.due, int(self.graph.leave[self._otherwise]) - self._half)

    @property
    def _blending(self) -> bool:
        return (
            self._edge >= 0
            and self.smooth
            and not self._search.ways.natural[self._edge]
            and self.frame >= self.graph.leave[self._edge] - self._half
        )

    def _end(self, edge: int) -> int:
        """The frame of this node with which the node that `edge` leads to is entered."""
        if edge < 0 or self._search.ways.natural[edge]:
            return int(self.graph.last[self.node])
        return int(self.graph.leave[edge]) + (self._half + 1 if self.smooth else 1)

    def _seek_beyond(self) -> None:
        """Begin to look for what comes after the edge that has been decided on, as if its node had been entered."""
        g, edge, end, s = self.graph, self._edge, self._end(self._edge), self._search
        node = int(g.target[edge])
        wanted = self.progress.next_sought() if self.progress.ends_at(node) else self.progress.sought
        if s.ways.natural[edge]:
            start = Start(node, end, self.place)
        else:
            start = Start(node, int(g.enter[edge]) + end - int(g.leave[edge]), self._placed_beyond(edge))
        entered = self._entered.copy()
        entered[node] += 1.0
        s.begin_at(start, wanted, entered)
        self._beyond_it = True

    def _look_ahead(self) -> None:
        """A part of the search, so that it is done when the edge must be known."""
        s = self._search
        s.go_on(s.due - (s.start.frame - self._end(self._edge) if self._beyond_it else 0) - self.frame)
        if not s.running and not self._beyond_it:
            self._decide()

    def _decide(self) -> None:
        """Take what the search has found; where it found nothing, the edge that was to be taken before stays."""
        self._edge = self._otherwise
        if self._search.edge >= 0:
            self._edge, self._half = self._search.edge, self._search.half(self._search.edge)
        if self._edge >= 0:
            self._seek_beyond()

    def step(self) -> bool:
        """Make the next pose, in `pose`; whether a node was entered with it."""
        entered = self._match() if self._matching else self._walk()
        self._played.show(self.pose)
        return entered

    def _change_ways(self) -> None:
        """Take up a path by motion matching, from the pose that was shown last; or walk on the graph again, after one."""
        if len(self.progress.path):
            gait = self.progress.aims[0].cluster
            if gait not in self._matchings:
                self._matchings[gait] = Matching(self.graph, gait)
            before = self._matching
            self._matching = self._matchings[gait]
            if not before:
                self._played.enter(
                    self._matching.motion, self.frame - (self.graph.take[self.frame - 1] == self.graph.take[self.frame])
                )
            self._played.since = round(self.graph.rate_hz)
        elif self._matching:
            frame = self._matching.rejoined(self._played.frame)
            if frame != self._played.frame:
                self._played.enter(self._matching.motion, frame)
            self.node, self.frame, self.place[:] = int(self._matching.node[frame]), frame + 1, self._played.place
            self._entered[self.node] += 1.0
            self._edge, self._otherwise, self._beyond_it, self._matching = -1, -1, False, None
            self.progress.enter(self.node)
            self._seek()

    def _match(self) -> bool:
        """The next pose along a path; whether it is of another node."""
        m, p = self._matching, self.progress
        assert m is not None
        self._played.step(m.motion, m.rate_hz, Ahead(p.path, p.length, p.along, m.speed_m_s), m.nearest, self._one)
        frame = self._played.frame
        self.pose[:], self.stands[:] = self._one, self.graph.contacts[frame]
        self._hold()
        node = int(m.node[frame])
        entered = node >= 0 and node != self.node
        self.node = node if entered else self.node
        if self._follow():
            self._change_ways()
        return entered

    def _walk(self) -> bool:
        """The next pose on the graph."""
        if self._search.running:
            self._look_ahead()
        g, edge = self.graph, self._edge
        entered = False
        placed(g.poses[self.frame], self.place, self._one)
        stands = g.contacts[self.frame]
        seam = int(g.leave[edge]) if edge >= 0 else -1
        if self._blending:
            other = int(g.enter[edge]) + self.frame - seam
            share = (self.frame - seam + self._half + 1) / (2 * self._half + 2)
            share = share * share * (3.0 - 2.0 * share)
            placed(g.poses[other], self._placed_beyond(edge), self._two)
            blended(self._one, self._two, share, self.pose)
            stands = g.contacts[other] if share > 0.5 else stands
        else:
            self.pose[:] = self._one
        self.stands[:] = stands
        add_offset(self.pose, self._played.off, self._played.change, HALF_LIFE_S * g.rate_hz, self._played.room)
        self._hold()
        self._follow()
        self.frame += 1
        if self.frame >= self._end(edge):
            if edge < 0:
                raise KinegraphError(f"the motion graph has no way on from node {self.node}; train it again")
            self._enter(edge)
            entered = True
        return entered

    def _hold(self) -> None:
        """Keep feet that stand where they are."""
        tree = self.graph.tree
        if self.feet:
            hold_feet(
                self.pose, self.stands, tree.parents, tree.offsets, LEGS, self._stood, self._spot, self._moved, self._lowered,
                self._turns, self._joints, self._work,
            )  # fmt: skip

    def _placed_beyond(self, edge: int) -> Samples:
        """How the frames beyond an edge are placed."""
        g, (turn, x, z) = self.graph, self.place
        cos, sin, (a, b) = np.cos(turn), np.sin(turn), g.shift[edge]
        return np.array([turn + g.turn[edge], x + a * cos + b * sin, z + b * cos - a * sin])

    def _enter(self, edge: int) -> None:
        g = self.graph
        if not self._search.ways.natural[edge]:
            self.place = self._placed_beyond(edge)
            self.frame = int(g.enter[edge]) + self.frame - int(g.leave[edge])
        self.node, self._edge, self._otherwise, self._beyond_it = int(g.target[edge]), -1, -1, False
        self._entered[self.node] += 1.0
        self.progress.enter(self.node)
        if len(self.progress.path):
            self._change_ways()
        elif not self._search.running:
            self._decide()

    def _follow(self) -> bool:
        """How far along the path the walk is, and whether it is where it must not be; whether it is at the path's end."""
        x, z = self.pose[0], self.pose[2]
        self.trespassed += bool(
            ((self.areas[:, 0] - x) ** 2 + (self.areas[:, 1] - z) ** 2 < self.areas[:, 2] ** 2).any()
        )
        return self.progress.follow(x, z)
