"""A motion graph that grows while motion is segmented: its nodes, and where one may go over into another (thesis, chapter 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import structlog

from kinegraph.operators.inputs.directions import turned_to
from kinegraph.operators.maps.motion_graph.growth import ROOM, WAITING, WINDOWS, Growth, longest_gap_ns
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.data.require import regular, samples_in
from kinegraph.stream.domain.axes import BODY
from kinegraph.stream.domain.joint_names import find_point
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.operator import Case, Emitted, Input, Operator, grid
from kinegraph.stream.params import param

log = structlog.get_logger(__name__)
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
NODE = np.dtype([
    ("node", "<i8"), ("onset", "<i8"), ("end", "<i8"), ("cluster", "<i8"), ("nodes", "<i4"), ("core", "<i4"), ("core_s", "<f8"),
    ("ways", "<f8"),
])  # fmt: skip
EDGE = np.dtype([
    ("source", "<i8"), ("target", "<i8"), ("leave", "<i8"), ("enter", "<i8"), ("turn", "<f8"), ("x", "<f8"), ("z", "<f8"),
    ("distance", "<f8"),
])  # fmt: skip
NEEDED = {"onset", "end", "cluster"}


@dataclass(slots=True)
class GrowingState:
    """
    growth       see there
    scale        to m
    order (j,)   columns of the input, the origin first; sides (2,): places of `left` and `right` in what that gives
    blend        frames on either side of a seam; gap_ns: a longer time between frames ends a take; period_ns
    newest       stamp of the newest frame, NEVER before the first
    ended        end of the newest stretch; begun: where one that was too short began; NEVER without one
    reported     up to when nothing more comes
    """

    growth: Growth
    scale: float
    order: Times
    sides: Times
    blend: int
    gap_ns: int
    period_ns: int
    newest: int = NEVER
    ended: int = NEVER
    begun: int = NEVER
    reported: int = NEVER


class _Turning(Operator[GrowingState]):
    """What does not change while samples come: which coordinates of the input are x, y and z, and their signs."""

    __slots__ = ("turn",)
    turn: tuple[tuple[int, int, int], tuple[float, float, float]]


@dataclass(frozen=True, slots=True)
class GrowingGraph(_Turning):
    """Joints and the primitives that their segmentation finds in; nodes and edges of a motion graph out, as they are found.

    in         (joints, 3) in m, cm or mm, y up, or in other axes that it declares
    primitive  events with onset, end and cluster (operators.segmentation.Segment); stretches between them are nodes, too, of cluster -1.
               A stretch shorter than `shortest_s` belongs to the next one
    node       when the edges of a stretch are known: its number, onset, end, cluster; of the graph so far: how many nodes, how many of them
               in the strongly connected core, how long these last, and how many ways lead on from one of them on average
    edge       source, target (numbers of nodes); leave and enter, the stamps of the frames in the middle of the blend; turn (rad), x and z
               (m): the placement of the second on the floor; distance (m), 0 where the recording goes on by itself

    Of each node's first and last quarter nine windows at most are compared with those of all others, by the neighbour index: one window
    with every frame, so that a node has its edges 20 frames after it was decided. What is near is measured by the closed form of Kovar
    et al.; an edge is what lies within `within_cm`. Only the newest `max_nodes` stretches, and joints of the newest `memory_s`, are
    compared. No mirror images, and late entries are not ruled out: `kinegraph motion train graph` makes of the recording
    what can be walked.

    Source: thesis, chapter 10; Kovar, Gleicher and Pighin 2002.

    >>> given, made = tried(GrowingGraph)
    >>> len(given["primitive"]), len(made["node"]), len(made["edge"])
    (20, 20, 328)
    """

    inputs = {"primitive": Input(), "in": Input(trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("node", "edge")

    left: str = param("hip_l", help="poses are turned to the front by the line from `right` to this joint")
    right: str = param("hip_r", help="see `left`")
    origin: str = param("", help="the joint that the floor is seen from; left out: the mean of these two")
    within_cm: float = param(12.0, above=0.0, most=100.0, help="so far may joints lie apart, rms, for an edge")
    blend_s: float = param(0.37, least=0.1, most=1.0, help="how long a blend takes")
    shortest_s: float = param(0.4, above=0.0, help="a shorter stretch is no node")
    max_nodes: int = param(200, least=2, most=1000, help="how many of the newest stretches are compared")
    memory_s: float = param(300.0, above=1.0, most=3600.0, help="joints are kept so long")

    def open(self, specs: Specs) -> Specs:
        spec, events = specs["in"], specs["primitive"]
        if len(spec.shape) != 2 or spec.shape[1] != 3 or not spec.channels or set(spec.units) - set(METRES):
            raise InputError("in", spec.describe(), "named joints (n, 3) in m, cm or mm")
        if not set(events.dtype.names or ()) >= NEEDED:
            raise InputError("primitive", events.describe(), f"events with the fields {', '.join(sorted(NEEDED))}")
        called = {}
        for key in ("left", "right", "origin"):
            name = getattr(self, key)
            called[key] = find_point(name, spec.channels) if name else None
            if (name or key != "origin") and called[key] is None:
                raise ParameterError(key, name, f"a joint of the input; {nearest(name, spec.channels)}")
        origin, *both = (spec.channels.index(called[key]) if called[key] else -1 for key in ("origin", "left", "right"))
        rate_hz = regular(spec)
        joints = len(spec.channels) + (not self.origin)
        front = [origin] if self.origin else []
        order = np.array(front + [k for k in range(len(spec.channels)) if k not in front], np.int64)
        sides = [order.tolist().index(place) + (not self.origin) for place in both]
        blend = max(2, round((self.blend_s * rate_hz - 1) / 2))
        growth = Growth.empty(joints, samples_in("memory_s", self.memory_s, rate_hz), self.max_nodes, blend)
        object.__setattr__(self, "turn", turned_to(BODY, spec))
        scale, gap_ns = METRES[spec.units[0]], longest_gap_ns(rate_hz)
        taken_s = (2 * WINDOWS + 2) / rate_hz
        self.set_state(
            GrowingState(growth, scale, order, np.array(sides), blend, gap_ns, spec.period_ns),
            decision_s={"node": taken_s, "edge": taken_s},
        )
        return {
            "node": StreamSpec((), NODE, units=("", "ns", "ns", "", "", "", "s", "")),
            "edge": StreamSpec((), EDGE, units=("", "", "ns", "ns", "rad", "m", "m", "m")),
        }

    def process(self, port: str, chunk: Chunk) -> Emitted:
        found = GraphEvents([], [])
        if port == "primitive":
            for event in chunk.data:
                self._take(int(event["onset"]), int(event["end"]), int(event["cluster"]))
        else:
            s, (columns, signs) = self.state, self.turn
            data = np.asarray(chunk.data, np.float64)[..., columns] * signs
            for stamp, joints in zip(chunk.time.tolist(), data, strict=True):
                points = s.scale * joints[s.order]
                if not self.origin:
                    points = np.concatenate([points[s.sides - 1].mean(axis=0)[None], points])
                s.growth.add(points, stamp, gap=s.newest != NEVER and stamp - s.newest > s.gap_ns)
                s.newest = stamp
                for _ in range(1 + s.growth.queued // 4):
                    self._work(stamp, found)
        if chunk.until == FOREVER:
            self._finish(found)
        self.state.reported = max(self.state.reported, chunk.until)
        return found.chunks(chunk.until, -1 if chunk.lost else 0)

    def _finish(self, found: GraphEvents) -> None:
        """Process what waits at the end of input, stamped with the first moment not promised yet."""
        s = self.state
        stamp = max(s.newest, s.reported + 1)
        if s.begun != NEVER and s.ended > s.begun:
            self._wait(s.begun, s.ended, -1)
            s.begun = NEVER
        while s.newest != NEVER and (s.growth.queued or s.growth.at >= 0):
            self._work(stamp, found)

    def _take(self, onset: int, end: int, cluster: int) -> None:
        """A stretch of the segmentation, and what lies between it and the one before."""
        s = self.state
        if s.ended != NEVER:
            onset = max(onset, s.ended + 1)
            if onset - s.ended > 1.5 * s.period_ns:
                self._stretch(s.ended + 1, onset - 1, -1)
        self._stretch(onset, end, cluster)

    def _stretch(self, onset: int, end: int, cluster: int) -> None:
        """One stretch: a short one waits for the next and belongs to it."""
        s = self.state
        if end <= onset:
            return
        begun = onset if s.begun == NEVER else s.begun
        s.ended = end
        if end - begun < self.shortest_s * NS:
            s.begun = begun
            return
        s.begun = NEVER
        self._wait(begun, end, cluster)

    def _wait(self, onset: int, end: int, cluster: int) -> None:
        growth = self.state.growth
        if growth.queued == WAITING:
            log.warning("more stretches at once than a growing graph can take up; one is left out", onset_ns=onset)
            return
        growth.waiting[growth.queued] = onset, end, cluster
        growth.queued += 1

    def _work(self, stamp: int, found: GraphEvents) -> None:
        """One frame's part of the work: a node taken up, a window looked around, or its edges measured and emitted."""
        s, g = self.state, self.state.growth
        if g.at < 0:
            g.begin(s.blend, *s.sides.tolist())
            return
        if g.step < 2 * WINDOWS:
            g.look(ROOM * self.within_cm / 100 * np.sqrt(3.0 * g.ring.shape[1]), s.blend)
            return
        number = g.nodes - 1
        for source, target, leave, enter, placed in g.edges(self.within_cm / 100, s.blend):
            at = [number - (g.at - place) % len(g.first) for place in (source, target)]
            stamps = [int(g.stamps[frame % len(g.ring)]) for frame in (leave, enter)]
            found.edges.append((stamp, (*at, *stamps, *placed.tolist())))
        core = g.core()
        ways = float(g.leads[core][:, core].sum() / core.sum()) if core.any() else 0.0
        lasts = float((g.end - g.onset)[core].sum() / NS)
        here = int(g.onset[g.at]), int(g.end[g.at]), int(g.cluster[g.at])
        found.nodes.append((stamp, (number, *here, min(g.nodes, len(g.first)), int(core.sum()), lasts, ways)))
        g.at = -1

    @classmethod
    def cases(cls) -> Sequence[Case]:
        time = grid(30.0, 700)
        phase = 2 * np.pi * np.arange(700) / 30
        data = np.zeros((700, 4, 3))
        data[:, :, 1] = 1.0
        data[:, 0, 2], data[:, 1, 2] = -0.2, 0.2
        data[:, 2, 0], data[:, 3, 0] = 0.3 * np.sin(phase), -0.3 * np.sin(phase)
        data += 0.005 * np.random.default_rng(56).normal(size=data.shape)
        spec = StreamSpec((4, 3), rate_hz=30.0, channels=("hip_l", "hip_r", "foot_l", "foot_r"), units=("m",))
        ends = time[100:700:30]
        rows = np.zeros(len(ends), [("onset", "<i8"), ("end", "<i8"), ("cluster", "<i8")])
        rows["onset"], rows["end"], rows["cluster"] = ends - 2 * NS, ends - NS - 1, np.arange(len(ends)) % 2 - 1
        events = StreamSpec((), rows.dtype, units=("ns", "ns", ""))
        inputs = {"primitive": (events, ends, rows), "in": (spec, time, data)}
        return [
            Case(cls(max_nodes=12, memory_s=15.0), inputs, least=60),
            Case(cls(origin="foot_l", within_cm=30.0, max_nodes=5), inputs, least=40),
        ]


@dataclass(frozen=True, slots=True)
class GraphEvents:
    """Rows with their stamps."""

    nodes: list[tuple[int, tuple[float, ...]]]
    edges: list[tuple[int, tuple[float, ...]]]

    def chunks(self, until: int, lost: int) -> list[tuple[str, Chunk]]:
        return [
            (
                name,
                Chunk(np.array([t for t, _ in rows], np.int64), np.array([row for _, row in rows], kind), until, lost),
            )
            for name, rows, kind in (("node", self.nodes, NODE), ("edge", self.edges, EDGE))
        ]
