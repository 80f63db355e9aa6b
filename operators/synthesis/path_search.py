"""The search for a walk's way on: begun when the node before is entered, a bounded part of it done with every frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.synthesis import plan_kernel as beam
from kinegraph.operators.synthesis.layout import SEARCH, WALK, Sought, Ways
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.domain.motion_graph import MotionGraph

MAX = 1200
"""A frame looks at this many frames and edges at most, but for the ways on from the first node: some 0.3 ms."""
NEARNESS = 3.0
"""By chance, a seam as far as the farthest is taken e^-3 times as often as a recording's own way on."""
EVENNESS = 1.0
"""By chance, a node is entered 2^-1 times as often for each time more that it was entered before."""


@dataclass(slots=True)
class Start:
    """Where a search begins: at a frame of a node, placed (turn, x, z)."""

    node: int
    frame: int
    place: Samples


class WaySearch:
    """One search at a time on a graph. `edge`: what it has found; -1: nothing (yet). `due`: the frame at which it must be known."""

    def __init__(self, graph: MotionGraph, areas: Samples, random: np.random.Generator) -> None:
        self.graph, self.areas, self.random = graph, areas, random
        self.ways = Ways.of(graph)
        self._far = graph.distance / max(float(graph.distance.max(initial=0.0)), 1e-9)
        self._share = beam.BEAM * max(1.0, len(graph.source) / len(graph.first))
        self._rooms = np.zeros((2, beam.BEAM + 1), WALK)
        self._search = np.zeros(1, SEARCH)
        self.start = Start(0, 0, np.zeros(3))
        self.running, self.edge, self.due = False, -1, 0

    def begin_at(self, start: Start, sought: Sought, entered: Samples) -> None:
        """Begin to look for the edge that is taken after `start`. entered (k,): how often each node was, for walks by chance."""
        self.start, self._sought = start, sought
        _set_out(self._rooms[0, :1], start)
        ways = slice(*self.ways.begin[start.node : start.node + 2].tolist())
        by_chance = not sought.goal.any()
        self._lots = self._chances(ways, entered) if by_chance else 1e-3 * self.random.random(ways.stop - ways.start)
        self._search[0] = 0, 1, np.inf, -1, -1, 0, 0, ways.start
        self.running, self.edge = True, -1
        self.due = self._first_due(ways)

    def _first_due(self, ways: slice) -> int:
        """The frame at which the edge must be known, as that is when the blend of one begins."""
        g, frame = self.graph, self.start.frame
        leave, natural = g.leave[ways], self.ways.natural[ways]
        usable = g.core[g.target[ways]] & (natural | (leave - frame >= beam.HALF))
        return int(np.maximum(leave[usable] - g.blend, frame).min(initial=frame + beam.DEPTH))

    def _chances(self, ways: slice, entered: Samples) -> Samples:
        """The lots, 0 to 1, of a node's ways on: chance takes the smallest. Near seams and seldom entered nodes win more often.

        A race of exponential waiting times, of which only the order counts.
        """
        often = entered[self.graph.target[ways]]
        waits = np.log(self.random.exponential(size=len(often)))
        waits += EVENNESS * np.log(2.0) * often + NEARNESS * self._far[ways]
        lots = np.empty(len(waits))
        lots[np.argsort(waits, kind="stable")] = np.arange(len(waits)) / max(1, len(waits))
        return lots

    def go_on(self, frames: int) -> int:
        """A part of the search, so that it is done in `frames` frames; with 0 left it ends with what has been found until then.

        Returns how much was done: frames and edges looked at.
        """
        search = self._search[0]
        share = 1 + (beam.DEPTH - search["deep"]) * self._share / max(1, frames)
        looked = beam.deepen(
            int(min(MAX, share)) if frames > 0 else MAX, self._search, self.ways, self._sought,
            self.areas, self._lots, *self._rooms,
        )  # fmt: skip
        if frames > 0 and search["deep"] < beam.DEPTH:
            return looked
        self.running = False
        self.edge = int(search["found"] if search["found"] >= 0 else search["chosen"])
        return looked

    def half(self, edge: int) -> int:
        """How many frames the blend of an edge has on either side of its middle."""
        return 0 if self.ways.natural[edge] else min(self.graph.blend, int(self.graph.leave[edge]) - self.start.frame)


def _set_out(walk: Array, start: Start) -> None:
    """Let a walk (1,) begin there."""
    walk[:] = np.zeros(1, WALK)
    walk["node"], walk["frame"] = start.node, start.frame
    walk["turn"], walk["x"], walk["z"] = start.place
