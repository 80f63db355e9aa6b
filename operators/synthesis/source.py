"""Synthesised motion as a source: poses that no recording holds, walked on a motion graph."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import ClassVar

import numpy as np

from kinegraph.operators.synthesis.blend_kernel import blended
from kinegraph.operators.synthesis.goals import Aim
from kinegraph.operators.synthesis.walker import GraphWalk
from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.motion_graph import MotionGraph
from kinegraph.stream.errors import ParameterError, nearest
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

NODE = np.dtype(
    [("onset", "<i8"), ("node", "<i4"), ("cluster", "<U32"), ("mirrored", "?"), ("x_m", "<f8"), ("z_m", "<f8")]
)
NOWHERE_S = 60.0
NEARER_M = 1.0
"""A target or a path's end that has not come this much nearer after this long is not reached: seams alone move somebody by half of it."""


EXAMPLE = Path(__file__).with_name("example.npz")
"""Of `devices.people.performer.Performer`, hides: false, 40 s; `kinegraph motion train graph --no-mirror`."""


@dataclass(frozen=True, slots=True)
class Synthesis(Source):
    """Walks on a motion graph (`kinegraph motion train graph`) and gives out its poses, at the graph's rate; begins at (0, 0), facing z.

    pose   root position and quaternions of the humanoid skeleton, for an avatar, a BVH file, the page
    node   an event whenever another stretch of the recordings begins: its number, its cluster, whether mirrored, and where (m)

    What is done, in turn: `order`, the clusters named, a number of nodes of each; `path`, along a line on the floor; `target`, to a place.
    A path and a target are gone to in the cluster `gait`, where that leads there. When all is done the stream ends, unless `then` is
    wander. Without these it wanders by chance, the same for the same seed. A word typed while it runs takes the place of all that: a
    cluster's name (stay in it), `x z` (go there), a name and `x z` (go there in it), `wander`, `stop`.

    Where two stretches meet they are blended over 5 to 15 frames, rotations along great circles; a foot that stands stays where it is.
    Thesis, chapter 10; Kovar, Gleicher and Pighin 2002. Departures: docs/method/motion-graphs.md. What it gives is recorded, and
    replayed, as of any source.
    """

    outputs: ClassVar[tuple[str, ...]] = ("pose", "node")

    model: Path = param(
        EXAMPLE, help="what `kinegraph motion train graph` has made; left out: 40 s of the simulated performer"
    )
    order: tuple[tuple[str, int], ...] = param((), least=1, help="[cluster, nodes of it], one after the other")
    path: tuple[tuple[float, float], ...] = param((), help="points x, z (m) on the floor, to be walked along")
    target: tuple[float, float] | None = param(None, help="a place x, z (m) to go to")
    gait: str = param("", help="the cluster in which a path and a target are gone to; empty: any")
    forbidden: tuple[tuple[float, float, float], ...] = param((), help="x, z, radius (m): where the root must not be")
    then: str = param("stop", help="when all is done: stop or wander")
    seed: int = param(0, least=0, help="another seed, other chances")
    duration_s: float = param(0.0, least=0.0, help="how long at most; 0: until stopped")
    realtime: bool = param(True, help="false: as fast as the graph takes it")

    @property
    def live(self) -> bool:
        return self.realtime

    def specs(self) -> Specs:
        graph = self._graph()
        pose = graph.tree.spec(graph.rate_hz, meta={"synthesised": True})
        return {
            "pose": pose,
            "node": StreamSpec((), NODE, units=("ns", "", "", "", "m", "m"), meta={"synthesised": True}),
        }

    def _graph(self) -> MotionGraph:
        graph = MotionGraph.read(self.model)
        if graph.tree.joints != BONES:
            raise ParameterError("model", str(self.model), "a motion graph of human poses")
        self._check(graph)
        return graph

    def _check(self, graph: MotionGraph) -> None:
        """Raise ParameterError for what cannot be done on this graph."""
        for k, (name, _) in enumerate(self.order):
            self._cluster(graph, name, f"order[{k}]")
        if self.gait:
            self._cluster(graph, self.gait, "gait")
        if self.then not in ("stop", "wander"):
            raise ParameterError("then", self.then, "stop or wander")
        if len(self.path) == 1:
            raise ParameterError("path", [list(p) for p in self.path], "two points or more")
        for k, (x, z, radius) in enumerate(self.forbidden):
            if radius <= 0.0:
                raise ParameterError(f"forbidden[{k}]", [x, z, radius], "x, z and a radius above 0")
            for name, place in (("target", self.target), ("path", self.path[-1] if self.path else None)):
                if place and np.hypot(place[0] - x, place[1] - z) < radius:
                    raise ParameterError(
                        name, list(place), f"a way to a place outside of forbidden[{k}], where nothing may go"
                    )
            if np.hypot(x, z) < radius:
                raise ParameterError(
                    f"forbidden[{k}]", [x, z, radius], "an area without the place (0, 0), where every walk begins"
                )

    def _cluster(self, graph: MotionGraph, name: str, parameter: str) -> int:
        if name not in graph.names:
            raise ParameterError(parameter, name, f"a cluster of {self.model}; {nearest(name, graph.names)}")
        number = graph.names.index(name)
        if not (graph.core & (graph.cluster == number)).any():
            inner = ", ".join(n for k, n in enumerate(graph.names) if (graph.core & (graph.cluster == k)).any())
            accepts = f"a cluster that there is a way back from: {inner or 'none'}; a larger --within-cm may make one"
            raise ParameterError(parameter, name, accepts)
        return number

    def prepare(self) -> None:
        graph, areas = self._graph(), np.array([[50.0, 50.0, 1.0]])
        for aims in ([], [Aim(path=np.array([[0.0, 0.0], [1.0, 1.0]]))]):
            walker = GraphWalk(graph, aims, areas)
            for _ in range(round(graph.rate_hz)):
                walker.step()
        blended(walker.pose.copy(), walker.pose.copy(), 0.5, walker.pose)

    def aims(self, graph: MotionGraph) -> list[Aim]:
        """What is to be done, in turn."""
        made = [Aim(self._cluster(graph, name, "order"), times) for name, times in self.order]
        gait = self._cluster(graph, self.gait, "gait") if self.gait else -1
        if self.path:
            made.append(Aim(gait, path=np.array(self.path)))
        if self.target:
            made.append(Aim(gait, path=np.array([self.path[-1] if self.path else (0.0, 0.0), self.target])))
        return made

    def read(self, feed: Feed) -> None:
        graph = self._graph()
        aims = self.aims(graph)
        walker = GraphWalk(graph, aims, np.array(self.forbidden).reshape(-1, 3), self.seed)
        begun, last = feed.now(), round(self.duration_s * graph.rate_hz)
        nearest_m, since, trespasses, aim_count = np.inf, 0, 0, len(aims)
        self._emit(feed, walker, begun)
        for frame in range(last) if last else count():
            stamp = begun + round(frame * NS / graph.rate_hz)
            word = self._pause(feed, stamp)
            if feed.stopped or word == "stop":
                return
            if word is not None and self._obey(feed, walker, word):
                aims, nearest_m, since = walker.progress.aims, np.inf, frame
            entered = walker.step()
            feed.emit(Chunk(np.array([stamp]), walker.pose[None].copy(), stamp), "pose")
            if entered:
                self._emit(feed, walker, stamp + 1)
            elif frame % round(graph.rate_hz) == 0:
                feed.emit(Chunk(np.empty(0, np.int64), np.empty(0, NODE), stamp), "node")  # no other stretch up to now
            if walker.trespassed > trespasses:
                trespasses = walker.trespassed
                feed.problem("frames in a forbidden area")
            if aims and walker.progress.over and self.then == "stop":
                return
            if len(walker.progress.aims) != aim_count:  # another path, with an end of its own
                nearest_m, aim_count = np.inf, len(walker.progress.aims)
            left = _left(walker)
            if left < nearest_m - NEARER_M:
                nearest_m, since = left, frame
            if len(walker.progress.path) and frame - since > NOWHERE_S * graph.rate_hz:
                feed.tell("not reached", left_m=round(left, 2), seconds=NOWHERE_S)
                return

    def _pause(self, feed: Feed, stamp: int) -> str | None:
        """Wait until a pose is due; a word that was typed meanwhile."""
        if not self.realtime:
            return None
        word = feed.listen(0.0)
        feed.wait(max(0, stamp - feed.now()) / NS)
        return word

    def _obey(self, feed: Feed, walker: GraphWalk, word: str) -> bool:
        """Do what a person has typed; whether it could be."""
        graph = walker.graph
        try:
            if word == "wander":
                walker.go([])
            elif len(parts := word.split()) in (2, 3):
                place = (float(parts[-2]), float(parts[-1]))
                if not np.isfinite(place).all():
                    raise ParameterError("word", word, "two finite numbers")
                gait = self._cluster(graph, parts[0], "word") if len(parts) == 3 else -1
                walker.go([Aim(gait, path=np.array([(walker.pose[0], walker.pose[2]), place]))])
            else:
                walker.go([Aim(self._cluster(graph, word, "word"), 0)])
        except (ValueError, ParameterError) as error:
            feed.tell("not understood", word=word[:64], error=str(error)[:200])
            return False
        return True

    def _emit(self, feed: Feed, walker: GraphWalk, stamp: int) -> None:
        graph, node = walker.graph, walker.node
        event = (stamp, node, graph.name_of(node), graph.mirrored[node], walker.pose[0], walker.pose[2])
        feed.emit(Chunk(np.array([stamp]), np.array([event], NODE), stamp), "node")


def _left(walker: GraphWalk) -> float:
    """How far it is to the end of the path (m): to where it has been followed up to, and from there along it."""
    progress = walker.progress
    if not len(progress.path):
        return np.inf
    x, z = (float(np.interp(progress.along, progress.length, progress.path[:, k])) for k in (0, 1))
    return progress.left_m + float(np.hypot(x - walker.pose[0], z - walker.pose[2]))
