"""A simulated night through the graph of the depth operators, in this process and as fast as it goes; and what came out of every edge."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import numpy as np

from stream.chunk import NS, Array, Chunk
from stream.engine.pipeline import Pipeline
from stream.graph import Graph
from stream.graph.load import load_text

START = 1_772_395_200 * NS
"""2026-03-01T20:00:00Z."""
OPERATORS = """
  simplify: {use: operators.depth_simplify.Simplify, from: camera.depth, components: COMPONENTS, learn_s: 60}
  bed: {use: operators.depth_bed.BedRegion, from: simplify.blocks, sleepers: SLEEPERS}
  presence: {use: operators.depth_presence.Presence, from: {regions: bed, blocks: simplify.blocks}}
  motion: {use: operators.depth_motion.Motion, from: {scene: simplify.scene, regions: bed, frames: simplify}}
  activity: {use: operators.depth_activity.Activity, from: {bed: presence, motion: motion}}
  breathing: {use: operators.depth_breathing.Breathing, from: {regions: bed, bed: presence, blocks: simplify.blocks}}
"""


def graph(source: str, *, components: int = 2, sleepers: str = "[sleeper]", more: str = "") -> Graph:
    """The graph; `source` are the parameters of devices.bedside.Bedside as in a YAML mapping."""
    operators = OPERATORS.replace("COMPONENTS", str(components)).replace("SLEEPERS", sleepers)
    return load_text(f"nodes:\n  camera: {{use: devices.bedside.Bedside, {source}}}\n{operators}{more}")


class Run:
    """A feed that hands what a source reads straight to a pipeline, and keeps what comes out."""

    def __init__(self, graph: Graph, kept: Iterable[str], start: int = START) -> None:
        """`kept`: edges by name ("motion", "motion.map")."""
        self.graph, self.pipeline, self._start = graph, Pipeline(graph), start
        self._kept: dict[str, list[tuple[Array, Array]]] = defaultdict(list)
        for name in kept:
            node, _, output = name.partition(".")
            wires = self.pipeline.stages[node].wires if node in self.pipeline.stages else self.pipeline.entries
            wire = wires[output or next(iter(wires))] if node in self.pipeline.stages else wires[name]
            wire.taps.append(lambda chunk, name=name: self._kept[name].append((chunk.time, chunk.data)))

    def run(self) -> Run:
        self.graph.nodes["camera"].part.fresh().read(self)  # type: ignore[union-attr]
        for entry in self.pipeline.entries:
            self.pipeline.end(entry)
        self.pipeline.close()
        return self

    def __getitem__(self, name: str) -> Array:
        """All samples of an edge."""
        return np.concatenate([data for _, data in self._kept[name]])

    def time(self, name: str) -> Array:
        return np.concatenate([time for time, _ in self._kept[name]])

    # what a source needs of a feed
    stopped = False

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        self.pipeline.feed(f"camera.{output}", chunk)

    def now(self) -> int:
        return self._start

    def wait(self, seconds: float) -> bool:
        return False

    def ready(self) -> None: ...

    def hear(self, timeout_s: float) -> str | None:
        return None

    def problem(self, kind: str, count: int = 1) -> None: ...


def kappa(a: Any, b: Any) -> float:
    """Cohen's kappa of two labellings."""
    a, b = np.asarray(a), np.asarray(b)
    labels = np.union1d(a, b)
    shares = np.array([[np.mean(x == label) for label in labels] for x in (a, b)])
    by_chance = float((shares[0] * shares[1]).sum())
    agreed = float(np.mean(a == b))
    return 1.0 if by_chance == 1 else (agreed - by_chance) / (1 - by_chance)
