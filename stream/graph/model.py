"""A graph that has been read and checked: nodes in the order in which samples pass, every spec known, nothing open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

from kinegraph.stream.chunk import Specs, StreamSpec
from kinegraph.stream.errors import blaming
from kinegraph.stream.graph.backpressure import Policy
from kinegraph.stream.graph.page_options import PageOptions
from kinegraph.stream.graph.settings import GraphSetting
from kinegraph.stream.operator import Operator
from kinegraph.stream.params import param
from kinegraph.stream.source import Source

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Edge:
    """One output of a node, as a graph names it: "board.accel", or "board" for its first output."""

    node: str
    output: str

    def __str__(self) -> str:
        return self.node if self.output == "out" else f"{self.node}.{self.output}"


@dataclass(frozen=True, slots=True)
class NodeOptions:
    """Options of a node in YAML that are for the engine, not for the node.

    worker      run this node (and the nodes that only it feeds) in a thread of this name, behind a queue
    queue       how many chunks may wait before a source or a worker
    policy      what a full queue does: `block` its writer, `drop_oldest` chunk (counted, recorded), or `fail` the run; left
                open, an outlet drops where the graph cannot wait (its sources are live), everything else blocks
    required    the run starts only when this source is ready, and fails if it is not ready within `deadline_s`
    patience_s  after how long without a chunk the engine declares that nothing happened (advances `until`); 0: never
    silence_s   after how long without a chunk a source is closed and reopened; 0: never
    stale_s     after how long without a chunk an alarm is raised; 0: never
    claims      what a source that does not send as declared (rate, order, epoch, unit) leads to: `warn` raises an alarm, `refuse` ends the
                run, or closes a source that is not `required`
    """

    worker: str = ""
    queue: int = param(256, least=1)
    policy: Policy | None = None
    required: bool = True
    deadline_s: float = param(10.0, above=0.0)
    patience_s: float = param(1.0, least=0.0)
    silence_s: float = param(0.0, least=0.0)
    stale_s: float = param(2.0, least=0.0)
    claims: Literal["warn", "refuse"] = "warn"


@dataclass(frozen=True, slots=True)
class NodeDeclaration:
    """What an operator or outlet declared when it was opened for the check; empty for a source.

    delay_s, decision_s  as passed to `set_state`
    memory_bytes         what its state takes at the start
    """

    delay_s: float = 0.0
    decision_s: Mapping[str, float] = field(default_factory=dict)
    memory_bytes: int = 0


class OpenedOperator:
    """An operator that was opened when its graph was loaded, and waits for the run that takes it."""

    __slots__ = ("_inputs", "_kept", "_part")

    def __init__(self, part: Operator[Any], inputs: Specs, opened: Operator[Any], outputs: Specs) -> None:
        """`part` holds the parameters of `opened`; `outputs` as its `open` returned them."""
        self._part, self._inputs = part, inputs
        self._kept: tuple[Operator[Any], Specs] | None = (opened, outputs)

    def take(self, part: object, inputs: Specs) -> tuple[Operator[Any], Specs] | None:
        """The operator and its outputs, if it is still there, has this part's parameters and was opened on these inputs."""
        if part is not self._part or inputs != self._inputs:
            return None
        kept, self._kept = self._kept, None
        return kept


@dataclass(slots=True)
class Node:
    """One node: a part (source, operator or outlet), where its inputs come from, and what flows out.

    The part is what the node is and its parameters. It is never opened: `open` gives an operator with these parameters.
    """

    name: str
    part: Source | Operator[Any]
    use: str
    inputs: dict[str, Edge] = field(default_factory=dict)
    specs: Specs = field(default_factory=dict)
    """Output specs, by output name."""
    declared: NodeDeclaration = NodeDeclaration()
    options: NodeOptions = field(default_factory=NodeOptions)
    line: int = 0
    file: str = ""
    """The file of the part that has this node; empty for the graph's own."""
    given: dict[str, Any] = field(default_factory=dict)
    """The parameters as written in YAML."""
    opened: OpenedOperator | None = field(default=None, repr=False, compare=False)
    """Of an operator or outlet of a graph that was loaded."""

    def open(self, inputs: Specs) -> tuple[Operator[Any], Specs]:
        """An operator for a run, opened on these inputs, and its outputs as its `open` gave them.

        The first run gets the one that was opened when the graph was loaded, so that a node is opened once; a later run opens its own.
        """
        if self.opened and (kept := self.opened.take(self.part, inputs)):
            return kept
        assert isinstance(self.part, Operator)
        operator = self.part.unopened()
        return operator, operator.open(inputs)

    @property
    def is_source(self) -> bool:
        return isinstance(self.part, Source)

    @property
    def is_outlet(self) -> bool:
        return isinstance(self.part, Operator) and self.part.is_outlet


def policy_of(node: Node, *, live: bool) -> Policy:
    """What a full queue behind a source, or before another node, does: what the graph says, or else, before an outlet of a session that is
    `live`, it drops the oldest chunk; otherwise the writer waits."""
    return node.options.policy or ("drop_oldest" if node.is_outlet and live else "block")


@dataclass(slots=True)
class Graph:
    """A checked graph. `nodes` is in topological order."""

    name: str
    nodes: dict[str, Node]
    text: str
    path: str = ""
    latency_budget_ms: float | None = None
    checkpoint_s: float = 10.0
    memory_mb: float = 0.0
    record: tuple[Edge, ...] = ()
    """Edges that are recorded beside the input log; a source's images are only in it if they are named here."""
    recording: RecordingOptions = field(default_factory=lambda: RecordingOptions())
    page: PageOptions = field(default_factory=PageOptions)
    session: dict[str, Any] = field(default_factory=dict)
    """Free facts about the session that stand in its recording: subject code, speed, side, electrode sites."""
    settings: dict[str, GraphSetting] = field(default_factory=dict)
    """What a person may set, in the graph and in its parts ("left.cutoff_hz")."""

    replays: str = ""
    """The recording that replaces the sources; "" where they are live."""
    recorded_in: str = ""
    """The folder or file that this run is being recorded in; "" where it is not."""
    findings: list[str] = field(default_factory=list)
    """Claims of its sources that did not hold, in words, as they are found; in replay those of the recording."""
    imported: tuple[str, ...] = ()
    """The files that this recording was imported from; empty for a session."""

    def spec(self, edge: Edge) -> StreamSpec:
        return self.nodes[edge.node].specs[edge.output]

    def input_specs(self, node: Node) -> Specs:
        """The specs on a node's input ports, in port order."""
        return {port: self.spec(edge) for port, edge in node.inputs.items()}

    @property
    def sources(self) -> list[Node]:
        return [n for n in self.nodes.values() if n.is_source]

    @property
    def outlets(self) -> set[str]:
        """The names of the outlets."""
        return {n.name for n in self.nodes.values() if n.is_outlet}

    def parts(self, kind: type[T]) -> list[T]:
        """The sources, operators or outlets of one kind."""
        return [n.part for n in self.nodes.values() if isinstance(n.part, kind)]

    def readers(self, edge: Edge) -> list[tuple[Node, str]]:
        """The (node, port) pairs that read an edge, in topological order."""
        return [(n, port) for n in self.nodes.values() for port, e in n.inputs.items() if e == edge]


@dataclass(frozen=True, slots=True)
class RecordingOptions:
    """Where and how a session is recorded.

    folder      where recordings go
    rotate_mb   a new file is begun after this many megabytes; 0: never
    quota_mb    the oldest recordings are deleted once the folder exceeds this many megabytes; 0: no quota
    rolling     keep only what a resumed session needs: files older than the last checkpoint are deleted, and all of them when a session
                ends well (a device that runs for months; `rotate_mb` says how long a file becomes)
    gather_s    how long small chunks are collected into one message
    flush_s     at most this much is lost when the process is killed
    frames      how depth frames are kept, where `record` asks for them: `packed` (a quarter to a half of their size, or less), or as
                `image`s that Foxglove shows
    """

    folder: str = "recordings"
    rotate_mb: float = param(0.0, least=0.0)
    quota_mb: float = param(0.0, least=0.0)
    rolling: bool = False
    gather_s: float = param(0.1, least=0.0)
    flush_s: float = param(0.5, above=0.0)
    frames: Literal["packed", "image"] = "packed"


def is_live(graph: Graph) -> bool:
    """Whether a source other than typed input is live: its data are lost if they are not read, so an outlet may not block the graph."""
    for node in graph.sources:
        assert isinstance(node.part, Source)
        with blaming(node.name, "live"):
            if node.part.live and not node.part.background:
                return True
    return False
