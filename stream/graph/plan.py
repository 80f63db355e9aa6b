"""What a graph costs before it runs: how late each result is, where that comes from, and how much memory is held."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import GraphError, blaming
from kinegraph.stream.graph import Edge, Graph, Node, is_live, policy_of
from kinegraph.stream.graph.backpressure import max_bytes, queued_bytes
from kinegraph.stream.operator import Operator, input_of
from kinegraph.stream.source import Source
from kinegraph.stream.system.memory_limit import ceiling
from kinegraph.stream.text.time_text import delay

_CHUNK_S = 0.02
"""What a chunk is taken to cover where the source does not say."""
_CHUNK_BYTES = 300
"""What a chunk takes beside its samples (objects, array headers)."""


@dataclass(frozen=True, slots=True)
class Step:
    """One node on a path.

    delay_s       by how much it delays (s)
    memory_bytes  what it holds: its state, and the queue before or behind it
    wait_s        how long what comes this way waits here for the slowest input (s)
    """

    node: str
    delay_s: float
    memory_bytes: int
    wait_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Path:
    """The slowest path from a source to a node without readers.

    A result stands `delay_s` after what it describes: the chunk that the source fills, then the sum of what the operators on the way
    look ahead or smooth. An operator with several inputs waits for the slowest of them, so ways that meet are equally late.
    """

    steps: tuple[Step, ...]

    @property
    def source(self) -> str:
        return self.steps[0].node

    @property
    def sink(self) -> str:
        return self.steps[-1].node

    @property
    def delay_s(self) -> float:
        return sum(step.delay_s + step.wait_s for step in self.steps)

    @property
    def memory_bytes(self) -> int:
        return sum(step.memory_bytes for step in self.steps)

    def __str__(self) -> str:
        return " -> ".join(step.node for step in self.steps)

    def explain(self) -> str:
        """Where the delay comes from: "board 10 ms + envelope 24 ms = 34 ms"."""
        parts: list[str] = []
        for step in self.steps:
            parts += [f"{step.node} waits {delay(step.wait_s)}"] if step.wait_s > 1e-9 else []
            parts += [f"{step.node} {delay(step.delay_s)}"] if step.delay_s else []
        return f"{' + '.join(parts) or 'nothing'} = {delay(self.delay_s)}"


@dataclass(frozen=True, slots=True)
class Decision:
    """When the events of an output come.

    after_s  how long after what an event describes (its end, else its onset) it comes at the latest, in time of its node's input
    total_s  the same in time of the source: with the delay of the ways to the node
    """

    origin: Edge
    after_s: float
    total_s: float


@dataclass(frozen=True, slots=True)
class Plan:
    """Every path of a graph, when its events come, and what all its nodes hold together."""

    paths: tuple[Path, ...]
    memory_bytes: int
    decisions: tuple[Decision, ...] = ()

    @property
    def slowest(self) -> Path | None:
        return max(self.paths, key=lambda path: path.delay_s, default=None)


def plan(graph: Graph, *, enforce: bool = True) -> Plan:
    """Delay and memory of every path; raises GraphError if one exceeds the graph's `latency_budget_ms` (unless not to `enforce`)."""
    steps = {node.name: _step(graph, node) for node in graph.nodes.values()}
    paths = tuple(_paths(graph, steps))
    if enforce:
        refuse_late(graph, paths)
    refuse_large(graph, steps)
    return Plan(paths, sum(step.memory_bytes for step in steps.values()), tuple(_decisions(graph, steps)))


def refuse_large(graph: Graph, steps: dict[str, Step]) -> None:
    """Raise GraphError if the nodes would hold more memory than the session may take."""
    held, most = sum(step.memory_bytes for step in steps.values()), ceiling(graph.memory_mb)
    if 0 < most < held:
        worst = max(steps.values(), key=lambda step: step.memory_bytes)
        text = f"the nodes would hold {held / 1e6:.0f} MB, most of it {worst.node!r} with {worst.memory_bytes / 1e6:.0f} MB"
        why = "memory_mb" if graph.memory_mb else "three quarters of the machine's memory"
        raise GraphError(f"{text}; at most {most / 1e6:.0f} MB may be taken ({why})", path=graph.path or graph.name)


def refuse_late(graph: Graph, paths: tuple[Path, ...]) -> None:
    """Raise GraphError if a path's delay exceeds the graph's latency budget."""
    budget = graph.latency_budget_ms
    late = [path for path in paths if budget is not None and path.delay_s * 1e3 > budget * (1 + 1e-9)]
    if late:
        texts = [f"{path} takes {path.explain()}" for path in late]
        text = f"latency_budget_ms is {budget:g}, but " + "; ".join(texts)
        raise GraphError(text, path=graph.path or graph.name)


def _paths(graph: Graph, steps: dict[str, Step]) -> Iterator[Path]:
    """One path per source and last node: the way that delays most by itself."""
    best: dict[str, dict[str, tuple[Step, ...]]] = {}
    late: dict[str, float] = {}
    for node in graph.nodes.values():
        own = steps[node.name]
        best[node.name] = {node.name: (own,)} if node.is_source else {}
        waited = max((late[edge.node] for edge in node.inputs.values()), default=0.0)
        late[node.name] = waited + own.delay_s
        for edge in node.inputs.values():
            here = replace(own, wait_s=waited - late[edge.node])
            for source, way in best[edge.node].items():
                if source not in best[node.name] or _own(way) > _own(best[node.name][source][:-1]):
                    best[node.name][source] = (*way, here)
    read = {edge.node for node in graph.nodes.values() for edge in node.inputs.values()}
    for node in graph.nodes.values():
        if node.name not in read and not node.is_source:
            yield from (Path(way) for way in best[node.name].values())


def _decisions(graph: Graph, steps: dict[str, Step]) -> Iterator[Decision]:
    """The decision delay of every output that declares one."""
    late: dict[str, float] = {}
    found: dict[Edge, Decision] = {}
    for node in graph.nodes.values():
        waited = max((late[edge.node] for edge in node.inputs.values()), default=0.0)
        late[node.name] = waited + steps[node.name].delay_s
        declared = node.part.inputs if isinstance(node.part, Operator) else {}
        waits_for = [edge for port, edge in node.inputs.items() if not input_of(declared, port).revises]
        came = [found[edge] for edge in waits_for if edge in found]
        after_s = max((before.after_s for before in came), default=0.0)
        total_s = max([waited, *(before.total_s for before in came)])
        for output, own_s in node.declared.decision_s.items():
            origin = Edge(node.name, output)
            found[origin] = Decision(origin, after_s + own_s, total_s + own_s)
            yield found[origin]


def _own(way: tuple[Step, ...]) -> float:
    """What the nodes on a way delay by themselves."""
    return sum(step.delay_s for step in way)


def _step(graph: Graph, node: Node) -> Step:
    part = node.part
    if isinstance(part, Source):
        with blaming(node.name, "chunk_s"):
            chunk_s = part.chunk_s
        with blaming(node.name, "live"):
            bound = max_bytes(policy_of(node, live=part.live), live=part.live)
        chunks = [_chunk_bytes(spec, chunk_s) for spec in node.specs.values()]
        return Step(node.name, chunk_s, sum(queued_bytes(node.options.queue, size, bound) for size in chunks))
    held = node.declared.memory_bytes
    if node.options.worker or node.is_outlet:
        waiting = [_chunk_bytes(spec, 0.0) for spec in graph.input_specs(node).values()]
        live = is_live(graph)
        bound = max_bytes(policy_of(node, live=live), live=live)
        held += sum(queued_bytes(node.options.queue, size, bound) for size in waiting)
    return Step(node.name, node.declared.delay_s, held)


def _chunk_bytes(spec: StreamSpec, chunk_s: float) -> int:
    """About what one chunk takes: its samples and their stamps; an irregular stream is taken to bring one sample at a time."""
    samples = max(1, round((chunk_s or _CHUNK_S) * spec.rate_hz)) if spec.rate_hz else 1
    return _CHUNK_BYTES + samples * (spec.sample_bytes + 8)
