"""A graph made ready to run: operators connected by plain calls, on the thread that feeds them.

A chunk that enters is pushed from operator to operator, depth first, without queues and without copies. Timing costs one reading of the
clock per call: every push is given the time at which its caller ended, and returns the time at which its own last reader did. How
edges, input ports and segments do that is in `stream.engine.flow.edge` and `stream.engine.flow.segment`.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from time import perf_counter_ns
from typing import TypeAlias

import numpy as np
import structlog

from kinegraph.stream.chunk import FOREVER, NEVER, Array, Chunk, empty
from kinegraph.stream.data.rows import Rows, rows_for
from kinegraph.stream.engine.flow.edge import NOTHING, CallSlot, InputPort, LiveEdge, Push, failure, nonsense
from kinegraph.stream.engine.flow.merge import Merge
from kinegraph.stream.engine.flow.metrics import FOLD_AT, Timing
from kinegraph.stream.engine.flow.queues import BoundedQueue
from kinegraph.stream.engine.flow.segment import CompiledSegment
from kinegraph.stream.errors import KinegraphError, asked_to_end, blaming, explain
from kinegraph.stream.graph import Edge, Graph, Node
from kinegraph.stream.graph.components import is_ours
from kinegraph.stream.operator import Emitted, Operator, input_of
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.system.clock import SessionClock

log = structlog.get_logger(__name__)


class Stage:
    """An operator or outlet while a graph runs.

    feeds    the edges it reads
    limits   what says how far each input has come: the edge, or the queue behind it
    slot     of its worker: what it calls now
    muted    an outlet that hears nothing for now
    failed   why an outlet was switched off
    """

    __slots__ = ("edges", "failed", "feeds", "limits", "merge", "muted", "node", "operator", "slot", "timing", "worker")

    def __init__(self, graph: Graph, node: Node, worker: str, slot: CallSlot) -> None:
        assert isinstance(node.part, Operator)
        self.node, self.worker, self.slot = node, worker, slot
        specs = graph.input_specs(node)
        with blaming(node.name, "open"):
            self.operator, opened = node.open(specs)
        self.edges = {name: LiveEdge(Edge(node.name, name), spec, slot, self.reached) for name, spec in opened.items()}
        for edge in self.edges.values():
            # our operators are held to it by the laws in tests, so that sessions need not pay for the look
            edge.strict = not is_ours(self.operator)
        merged = len(specs) > 1 and getattr(self.operator, "in_order", True)
        self.merge = Merge(specs, self.operator.inputs) if merged else None
        self.timing = Timing()
        self.feeds: list[LiveEdge] = []
        self.limits: list[LiveEdge | BoundedQueue] = []
        self.muted = False
        self.failed = ""

    def reached(self) -> int:
        """How far the inputs are: no output is ahead of that."""
        port, chunk = self.slot.port, self.slot.chunk
        # while it closes, an operator may give what it held back, which no input's time limits
        if chunk is NOTHING or port is None or port.operator is not self.operator:
            return FOREVER  # it closes
        newest = chunk.time.item(-1) if len(chunk.time) else NEVER
        return max(newest, chunk.until, *(feed.promised for feed in self.limits))

    def push(self, port: str) -> Push:
        """What brings a chunk to this operator's input `port`."""
        if self.merge is None:
            return self._input(port)
        merge = self.merge
        inputs = {name: self._input(name) for name in self.node.inputs}

        def push(chunk: Chunk, start: int) -> int:
            for name, piece in merge.push(port, chunk):
                start = inputs[name](piece, start)
            return start

        return push

    def _input(self, port: str) -> InputPort:
        if self.node.is_outlet:
            return OutletPort(self, port)
        out = next(iter(self.edges.values()), None)
        return InputPort(self.node.name, port, self.operator, self.timing, out, self.emit, self.slot)

    def switch_off(self, error: BaseException) -> None:
        self.failed = str(error) if isinstance(error, KinegraphError) else explain(error)
        log.debug("outlet failed", node=self.node.name, exc_info=error)
        log.error("outlet switched off", node=self.node.name, error=self.failed)

    def emit(self, emitted: Emitted, start: int) -> int:
        """Send what an operator gave back to where it belongs."""
        if emitted is None:
            return start
        if isinstance(emitted, Chunk):
            emitted = [(next(iter(self.edges)), emitted)]
        try:
            for name, chunk in emitted:
                start = self.edges[name].send(chunk, start)
        # a wrong shape is found sooner by the chunk's own check than by whatever it broke downstream
        except KinegraphError:
            raise
        except Exception as error:
            for name, chunk in emitted if isinstance(emitted, list | tuple) else ():
                if name in self.edges and isinstance(chunk, Chunk):
                    self.edges[name].check(chunk)
            raise nonsense(self.node.name, emitted, self.edges, error) from error
        return start

    def close(self) -> None:
        """Let the operator emit what is pending."""
        if self.node.is_outlet and (self.failed or self.muted):
            return
        self.slot.node, self.slot.port, self.slot.chunk = self.node.name, None, NOTHING
        try:
            emitted = self.operator.close()
        except BaseException as error:
            if asked_to_end(error):
                raise
            if not self.node.is_outlet:
                raise failure(self.node.name, error) from error
            self.switch_off(error)
        else:
            self.emit(emitted, perf_counter_ns())
        finally:
            self.slot.rest()


class OutletPort(InputPort):
    """An outlet's input: its failure ends the outlet, not the graph."""

    __slots__ = ("stage",)

    def __init__(self, stage: Stage, port: str) -> None:
        super().__init__(stage.node.name, port, stage.operator, stage.timing, None, stage.emit, stage.slot)
        self.stage = stage

    def __call__(self, chunk: Chunk, start: int) -> int:
        stage = self.stage
        if stage.muted or stage.failed:
            return start
        self.slot.port, self.slot.chunk = self, chunk
        try:
            self.process(self.port, chunk)
        except BaseException as error:  # whatever it was: the graph goes on without this outlet
            if asked_to_end(error):
                raise
            stage.switch_off(error)
        end = perf_counter_ns()
        self.timing.durations.append(end - start)
        return end


Bridge: TypeAlias = Callable[[Stage, str, Edge, Push], Push]
"""Puts a queue before the input port of a stage that runs on another worker than what feeds it."""


class Pipeline:
    """A graph's operators, opened and wired, ready to be fed.

    entries   per source output ("board", "board.accel"): the edge into the graph
    stages    per node, in topological order
    slots     per worker ("": the graph's own thread): what it calls now
    segments  operators in a row, each as one function, while nothing has changed since `compile`
    """

    def __init__(
        self,
        graph: Graph,
        *,
        speaking: Container[str] = (),
        bridge: Bridge | None = None,
        stop: Callable[[], None] | None = None,
    ) -> None:
        """`speaking` names the outlets that take part; `bridge` puts nodes on their workers (else all run on the caller's thread); `stop`
        ends the session."""
        self.graph, self._stop = graph, stop
        self.entries = {
            str(Edge(n.name, o)): LiveEdge(Edge(n.name, o), s) for n in graph.sources for o, s in n.specs.items()
        }
        workers = workers_of(graph)
        self.slots = {worker: CallSlot() for worker in ("", *workers.values())}
        self.segments: list[CompiledSegment] = []
        self.stages = {
            name: Stage(graph, node, workers[name], self.slots[workers[name]])
            for name, node in graph.nodes.items()
            if not node.is_source and (not node.is_outlet or name in speaking)
        }
        self.edges = {str(edge.origin): edge for edge in self._all_edges()}
        for edge in self.edges.values():
            readers = [(self.stages[n.name], port) for n, port in graph.readers(edge.origin) if n.name in self.stages]
            # readers of one edge that want the same form share one conversion
            made: dict[bool, Rows] = {}
            for stage, port in readers:
                push = self._bridged(edge, stage, port, stage.push(port), bridge)
                rows = rows_for(input_of(stage.operator.inputs, port), edge.spec, made)
                edge.readers.append(_converting(rows, push) if rows else push)
                stage.feeds.append(edge)
                edge.strict = edge.strict or stage.node.is_outlet

    def _all_edges(self) -> Iterable[LiveEdge]:
        yield from self.entries.values()
        for stage in self.stages.values():
            yield from stage.edges.values()

    def _bridged(self, edge: LiveEdge, stage: Stage, port: str, push: Push, bridge: Bridge | None) -> Push:
        """The push, behind a queue where the stage runs on another worker than what feeds it."""
        origin = self.stages.get(edge.origin.node)
        if bridge is None or stage.worker == (origin.worker if origin else ""):
            stage.limits.append(edge)
            return push
        return bridge(stage, port, edge.origin, push)

    def feed(self, stream: str, chunk: Chunk) -> None:
        """Bring a source's chunk into the graph and work through all it leads to."""
        self.entries[stream].send(chunk, perf_counter_ns())

    def end(self, stream: str) -> None:
        """The stream has ended: nothing will come any more."""
        self.feed(stream, empty(self.entries[stream].spec, FOREVER))

    def close(self, settle: Callable[[], None] = lambda: None) -> None:
        """Let every operator emit what is pending, upstream first; `settle` waits for the workers after each."""
        for stage in sorted(self.stages.values(), key=lambda stage: getattr(stage.operator, "closes_last", False)):
            stage.close()
            settle()

    def begin(
        self, clock: SessionClock | None = None, disk: tuple[Callable[[], int], Callable[[], int]] | None = None
    ) -> None:
        """Let the outlets touch the world; `clock` is a live session's, and `disk` what its recording was handed and has saved (see
        `Outlet.follow_disk`). Observers have been added before."""
        self.compile()
        for stage in self.outlets:
            assert isinstance(stage.operator, Outlet)
            with blaming(stage.node.name, "begin"):
                stage.operator.meet(self.graph)
                if clock:
                    stage.operator.keep_time(clock)
                if disk:
                    stage.operator.follow_disk(*disk)
                if clock and self._stop:
                    stage.operator.let_stop(self._stop)
                stage.operator.begin()

    @property
    def outlets(self) -> list[Stage]:
        return [s for s in self.stages.values() if s.node.is_outlet]

    def compile(self) -> None:
        """Write operators in a row as one function each, and compile their rows. Observers have been added before."""
        self.invalidate()
        inside: set[int] = set()
        # topological order: the first edge of a row is met before those inside it
        for edge in self.edges.values():
            if id(edge) not in inside:
                segment = CompiledSegment(edge)
                edge.send = segment.send
                self.segments.append(segment)
                inside |= {id(later) for later in segment.edges}

    def invalidate(self) -> None:
        """Observers, readers or the operators' memory were changed: until the next `compile`, chunks are carried step by step."""
        self.fold(least=1)
        self.segments.clear()
        for edge in self.edges.values():
            edge.send = edge.carry

    def fold(self, least: int = FOLD_AT) -> None:
        """Keep the lists of durations short: fold those that hold at least `least`."""
        for segment in self.segments:
            segment.fold(least)
        for stage in self.stages.values():
            if len(stage.timing.durations) >= least:
                stage.timing.fold()

    def snapshot(self) -> dict[str, Array]:
        """The whole graph's state as plain arrays; call it between chunks, with the workers at rest."""
        arrays: dict[str, Array] = {}
        for name, stage in self.stages.items():
            stage.slot.node = name
            with blaming(name, "snapshot"):
                arrays |= {f"{name}/state/{k}": a for k, a in stage.operator.snapshot().items()}
            if stage.merge:
                arrays |= {f"{name}/merge/{k}": a for k, a in stage.merge.snapshot().items()}
            stage.slot.node = ""
        for name, edge in self.edges.items():
            # without `promised`: watermarks come anew with the first chunk after a restore
            arrays[f"{name}/edge"] = np.array([edge.pending_gap, edge.samples, edge.gaps, edge.lost])
        return arrays

    def restore(self, arrays: dict[str, Array]) -> None:
        """Go on from a snapshot of the same graph."""
        for name, stage in self.stages.items():
            with blaming(name, "restore"):
                stage.operator.restore(_under(arrays, f"{name}/state/"))
            if stage.merge:
                stage.merge.restore(_under(arrays, f"{name}/merge/"))
        for name, edge in self.edges.items():
            edge.pending_gap, edge.samples, edge.gaps, edge.lost = (int(v) for v in arrays[f"{name}/edge"])
            edge.promised = NEVER
        self.invalidate()


def _converting(rows: Rows, push: Push) -> Push:
    """Brings chunks to a reader that asks for rows, where the edge carries something else."""
    return lambda chunk, start: push(rows(chunk), start)


def workers_of(graph: Graph) -> dict[str, str]:
    """The thread of each node: the one it names; an outlet's is `outlets`; else its inputs' common worker, or the graph's own ("")."""
    workers: dict[str, str] = {}
    for name, node in graph.nodes.items():
        inputs = {workers[edge.node] for edge in node.inputs.values()}
        common = inputs.pop() if len(inputs) == 1 else ""
        workers[name] = node.options.worker or ("outlets" if node.is_outlet else common)
    return workers


def _under(arrays: dict[str, Array], prefix: str) -> dict[str, Array]:
    return {k.removeprefix(prefix): a for k, a in arrays.items() if k.startswith(prefix)}
