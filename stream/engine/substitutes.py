"""What a recording lacks, because its images were not kept, and what replaces it: edges that were recorded live.

A source's images are stored only where the graph says so (DESIGN). Replay of a session without them cannot compute the nodes that read
them; but where such a node's output was recorded, it is taken from there, and everything after it is computed as ever.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from kinegraph.stream.chunk import Specs
from kinegraph.stream.engine.flow.edge import LiveEdge
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.graph import Edge, Graph, Node
from kinegraph.stream.recording.format.recorded_stream import RecordedStream
from kinegraph.stream.source import Source


@dataclass(frozen=True, slots=True)
class FromRecording(Source):
    """Takes the place of a node that cannot be computed; it is never read."""


@dataclass(slots=True)
class Substitutes:
    """What is missing in a recording, for one graph.

    missing   source outputs that have readers, but no recorded images
    taken     edges that are taken from the recording instead of being computed
    idle      nodes that are not computed: per node, the outputs of theirs that exist (taken from the recording)
    """

    missing: list[str] = field(default_factory=list)
    taken: list[str] = field(default_factory=list)
    idle: dict[str, Specs] = field(default_factory=dict)

    @classmethod
    def of(cls, graph: Graph, streams: Mapping[str, RecordedStream]) -> Substitutes:
        """For a graph and the streams that were recorded of it."""
        sources = [str(edge) for edge in _outputs(graph.sources)]
        # another graph computed them, on the machine whose recording this is: here they are sources
        found = cls(taken=[name for name in sources if name in streams and streams[name].role == "edge"])
        gone = {str(edge) for edge in _outputs(graph.sources) if _is_outline(streams, edge)}
        for node in graph.nodes.values():
            lacks = [str(edge) for edge in node.inputs.values() if str(edge) in gone]
            if not lacks:
                continue
            found.missing += [name for name in lacks if name in streams and name not in found.missing]
            there = {output: str(Edge(node.name, output)) for output in node.specs}
            found.idle[node.name] = {o: streams[name].spec for o, name in there.items() if name in streams}
            found.taken += [name for name in there.values() if name in streams]
            gone |= {name for name in there.values() if name not in streams}
        return found

    def reduced(self, graph: Graph) -> Graph:
        """The graph as it can be computed: idle nodes are sources of what is taken from the recording, or left out."""
        if not self.missing:
            return graph
        nodes: dict[str, Node] = {}
        for name, node in graph.nodes.items():
            if name not in self.idle:
                kept = {o: s for o, s in node.specs.items() if str(Edge(name, o)) not in self.missing}
                nodes[name] = replace(node, specs=kept)
            elif self.idle[name]:
                nodes[name] = replace(node, part=FromRecording(), inputs={}, specs=self.idle[name])
        record = tuple(e for e in graph.record if e.node in nodes and e.output in nodes[e.node].specs)
        return replace(graph, nodes=nodes, record=record)

    @property
    def silent(self) -> list[str]:
        """Nodes that give nothing at all, for no output of theirs was recorded."""
        return [name for name, specs in self.idle.items() if not specs]

    @contextmanager
    def at_work(self, pipeline: Pipeline) -> Iterator[dict[str, LiveEdge]]:
        """Within: the edges that take chunks from the recording, by edge. The output of their own nodes is ignored meanwhile."""
        twins: dict[str, LiveEdge] = {}
        for name in self.taken:
            edge = pipeline.edges[name]
            twins[name] = twin = LiveEdge(edge.origin, edge.spec)
            _move(edge, twin)
            edge.observers, edge.readers = [], []
        _read_instead(pipeline, {edge.origin: twins[name] for name, edge in pipeline.edges.items() if name in twins})
        pipeline.invalidate()
        try:
            yield twins
        finally:
            for name, twin in twins.items():
                _move(twin, pipeline.edges[name])
            _read_instead(pipeline, {edge.origin: edge for edge in pipeline.edges.values()})
            pipeline.invalidate()


def _read_instead(pipeline: Pipeline, edges: Mapping[Edge, LiveEdge]) -> None:
    """Let every stage know these of its inputs by another edge."""
    for stage in pipeline.stages.values():
        stage.feeds = [edges.get(edge.origin, edge) for edge in stage.feeds]
        stage.limits = [edges.get(at.origin, at) if isinstance(at, LiveEdge) else at for at in stage.limits]


def _move(of: LiveEdge, to: LiveEdge) -> None:
    for slot in ("observers", "readers", "pending_gap", "gaps", "lost", "samples", "promised"):
        setattr(to, slot, getattr(of, slot))


def _outputs(nodes: list[Node]) -> list[Edge]:
    return [Edge(node.name, output) for node in nodes for output in node.specs]


def _is_outline(streams: Mapping[str, Any], edge: Edge) -> bool:
    stream = streams.get(str(edge))
    return stream is not None and stream.kept == "outline"
