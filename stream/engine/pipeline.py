"""A graph made ready to run: operators wired to each other by plain calls, on the thread that feeds them.

A chunk that enters is pushed from operator to operator, depth first, without queues and without copies. Timing costs one reading of the
clock per call: every push is given the time at which its caller ended, and returns the time at which its own last reader did.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from time import perf_counter_ns
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import structlog

from stream.chunk import FOREVER, Array, Chunk, StreamSpec, add_lost, empty, utc
from stream.engine.clock import SessionClock
from stream.engine.merge import Merge
from stream.engine.metrics import FOLD_AT, Timing
from stream.errors import KinegraphError, RunError
from stream.graph import Edge, Graph, Node
from stream.operator import Emitted, Operator, Outlet

log = structlog.get_logger(__name__)

Push: TypeAlias = Callable[[Chunk, int], int]
"""Take a chunk and the time (ns, perf_counter) at which the caller ended; return the time at which the work ended."""
Tap: TypeAlias = Callable[[Chunk], None]


class Wire:
    """One output of a node while a graph runs: carries `lost` to the next samples, keeps arrays normal, calls taps and readers.

    single   the only reader, where that is an operator with one input on the same thread
    """

    __slots__ = ("edge", "gaps", "lost", "owed", "readers", "samples", "single", "spec", "taps")

    def __init__(self, edge: Edge, spec: StreamSpec) -> None:
        self.edge, self.spec = edge, spec
        self.taps: list[Tap] = []
        self.readers: list[Push] = []
        self.single: Single | None = None
        self.owed = 0
        self.gaps = 0
        self.lost = 0
        self.samples = 0

    def send(self, chunk: Chunk, start: int) -> int:
        """Carry a chunk to all who read it. Along a chain this is a loop: a deep one would otherwise cost twice as much per operator."""
        wire = self
        while True:
            if chunk.lost or wire.owed:
                chunk = wire._carry(chunk)
            wire.samples += len(chunk.time)
            if not chunk.data.flags.carray:
                chunk = _normal(chunk)
            for tap in wire.taps:
                tap(chunk)
            if wire.single is None:
                for push in wire.readers:
                    start = push(chunk, start)
                return start
            name, port, process, note, out, emit = wire.single
            try:
                emitted = process(port, chunk)
            except Exception as error:
                raise _failure(name, error, port, chunk) from error
            end = perf_counter_ns()
            note(end - start)
            if emitted.__class__ is not Chunk:
                return end if emitted is None else emit(emitted, end)
            wire, chunk, start = out, emitted, end

    def _carry(self, chunk: Chunk) -> Chunk:
        """Move a `lost` without samples to the next chunk that has some."""
        lost = add_lost(self.owed, chunk.lost)
        if not len(chunk.time):
            self.owed = lost
            return Chunk(chunk.time, chunk.data, chunk.until, 0)
        self.owed = 0
        self.gaps += 1
        self.lost = add_lost(self.lost, lost)
        return Chunk(chunk.time, chunk.data, chunk.until, lost)


def _normal(chunk: Chunk) -> Chunk:
    """The chunk with arrays that are contiguous, aligned and writable."""
    data = np.require(chunk.data, requirements=["C", "A", "W"])
    return Chunk(np.ascontiguousarray(chunk.time), data, chunk.until, chunk.lost)


class Single(NamedTuple):
    """An operator with one input that is a wire's only reader: what `Wire.send` needs to run it."""

    name: str
    port: str
    process: Callable[[str, Chunk], Emitted]
    note: Callable[[int], None]
    out: Wire
    emit: Callable[[Emitted, int], int]


class Stage:
    """An operator or outlet while a graph runs.

    feeds    the wires it reads
    muted    an outlet that hears nothing for now
    failed   why an outlet was switched off
    """

    __slots__ = ("failed", "feeds", "lane", "merge", "muted", "node", "operator", "timing", "wires")

    def __init__(self, graph: Graph, node: Node, lane: str) -> None:
        assert isinstance(node.part, Operator)
        self.node, self.lane = node, lane
        self.operator: Operator[Any] = node.part.fresh()
        specs = graph.input_specs(node)
        self.wires = {name: Wire(Edge(node.name, name), spec) for name, spec in self.operator.open(specs).items()}
        self.merge = Merge(specs, in_turn=self.operator.in_turn) if len(specs) > 1 else None
        self.timing = Timing()
        self.feeds: list[Wire] = []
        self.muted = False
        self.failed = ""

    def push(self, port: str) -> Push:
        """What brings a chunk to this operator's input `port`."""
        run = self._outlet_runner() if self.node.is_outlet else self._runner()
        if self.merge is None:
            return lambda chunk, start: run(port, chunk, start)
        merge = self.merge

        def push(chunk: Chunk, start: int) -> int:
            for name, piece in merge.push(port, chunk):
                start = run(name, piece, start)
            return start

        return push

    def single(self, port: str) -> Single | None:
        """How a wire may run this stage itself; None for an outlet, and where several inputs are merged."""
        if self.node.is_outlet or self.merge is not None:
            return None
        out = next(iter(self.wires.values()))
        return Single(self.node.name, port, self.operator.process, self.timing.durations.append, out, self.emit)

    def _runner(self) -> Callable[[str, Chunk, int], int]:
        process, note = self.operator.process, self.timing.durations.append
        send = next(iter(self.wires.values())).send
        name = self.node.name

        def run(port: str, chunk: Chunk, start: int) -> int:
            try:
                emitted = process(port, chunk)
            except Exception as error:
                raise _failure(name, error, port, chunk) from error
            end = perf_counter_ns()
            note(end - start)
            if emitted.__class__ is Chunk:
                return send(emitted, end)
            return end if emitted is None else self.emit(emitted, end)

        return run

    def _outlet_runner(self) -> Callable[[str, Chunk, int], int]:
        """An outlet's failure ends the outlet, not the graph."""

        def run(port: str, chunk: Chunk, start: int) -> int:
            if self.muted or self.failed:
                return start
            try:
                self.operator.process(port, chunk)
            except Exception as error:  # noqa: BLE001 - whatever it was: the graph goes on without this outlet
                self._switch_off(error)
            end = perf_counter_ns()
            self.timing.durations.append(end - start)
            return end

        return run

    def _switch_off(self, error: Exception) -> None:
        self.failed = f"{type(error).__name__}: {error}" if not isinstance(error, KinegraphError) else str(error)
        log.error(
            "outlet switched off",
            node=self.node.name,
            error=self.failed,
            exc_info=not isinstance(error, KinegraphError),
        )

    def emit(self, emitted: Emitted, start: int) -> int:
        """Send what an operator gave back to where it belongs."""
        if emitted is None:
            return start
        if isinstance(emitted, Chunk):
            emitted = [(next(iter(self.wires)), emitted)]
        for name, chunk in emitted:
            start = self.wires[name].send(chunk, start)
        return start

    def close(self) -> None:
        """Let the operator emit what is pending."""
        if self.node.is_outlet and (self.failed or self.muted):
            return
        try:
            emitted = self.operator.close()
        except Exception as error:
            if not self.node.is_outlet:
                raise _failure(self.node.name, error) from error
            self._switch_off(error)
        else:
            self.emit(emitted, perf_counter_ns())


def _failure(node: str, error: Exception, port: str = "", chunk: Chunk | None = None) -> RunError:
    """What an operator's exception means to the person at the screen: which node, at which sample's time."""
    where = ""
    if chunk is not None:
        stamp = int(chunk.time[0]) if len(chunk.time) else chunk.until
        where = f" at sample time {utc(stamp)} (input {port!r}, {len(chunk.time)} samples)"
    text = str(error) if isinstance(error, KinegraphError) else f"{type(error).__name__}: {error}"
    return RunError(f"node {node!r}: {text}{where}")


Bridge: TypeAlias = Callable[[Stage, str, Edge, Push], Push]
"""Puts a queue before the input port of a stage that runs on another lane than what feeds it."""


class Pipeline:
    """A graph's operators, opened and wired, ready to be fed.

    entries   per source output ("board", "board.accel"): the wire into the graph
    stages    per node, in topological order
    """

    def __init__(self, graph: Graph, *, speaking: Container[str] = (), bridge: Bridge | None = None) -> None:
        """`speaking` names the outlets that take part; `bridge` puts nodes on their lanes (else all run on the caller's thread)."""
        self.graph = graph
        self.entries = {
            str(Edge(n.name, o)): Wire(Edge(n.name, o), s) for n in graph.sources for o, s in n.specs.items()
        }
        self.stages = {
            name: Stage(graph, node, lane_of(graph, node))
            for name, node in graph.nodes.items()
            if not node.is_source and (not node.is_outlet or name in speaking)
        }
        self.wires = {str(w.edge): w for w in self._wires()}
        for wire in self.wires.values():
            readers = [(self.stages[n.name], port) for n, port in graph.readers(wire.edge) if n.name in self.stages]
            for stage, port in readers:
                push = stage.push(port)
                bridged = self._bridged(wire, stage, port, push, bridge)
                wire.readers.append(bridged)
                stage.feeds.append(wire)
                if len(readers) == 1 and bridged is push:
                    wire.single = stage.single(port)

    def _wires(self) -> Iterable[Wire]:
        yield from self.entries.values()
        for stage in self.stages.values():
            yield from stage.wires.values()

    def _bridged(self, wire: Wire, stage: Stage, port: str, push: Push, bridge: Bridge | None) -> Push:
        """The push, behind a queue where the stage runs on another lane than what feeds it."""
        origin = self.stages.get(wire.edge.node)
        if bridge is None or stage.lane == (origin.lane if origin else ""):
            return push
        return bridge(stage, port, wire.edge, push)

    def feed(self, stream: str, chunk: Chunk) -> None:
        """Bring a source's chunk into the graph and work through all it leads to."""
        self.entries[stream].send(chunk, perf_counter_ns())

    def end(self, stream: str) -> None:
        """The stream has ended: nothing will come any more."""
        self.feed(stream, empty(self.entries[stream].spec, FOREVER))

    def close(self, settle: Callable[[], None] = lambda: None) -> None:
        """Let every operator emit what is pending, upstream first; `settle` waits for the lanes after each."""
        for stage in self.stages.values():
            stage.close()
            settle()

    def begin(self, clock: SessionClock | None = None) -> None:
        """Let the outlets touch the world; `clock` is a live session's."""
        for stage in self.outlets:
            assert isinstance(stage.operator, Outlet)
            stage.operator.meet(self.graph)
            if clock:
                stage.operator.keep_time(clock)
            stage.operator.begin()

    @property
    def outlets(self) -> list[Stage]:
        return [s for s in self.stages.values() if s.node.is_outlet]

    def fold(self) -> None:
        """Keep the lists of durations short."""
        for stage in self.stages.values():
            if len(stage.timing.durations) >= FOLD_AT:
                stage.timing.fold()

    def snapshot(self) -> dict[str, Array]:
        """The whole graph's state as plain arrays; call it between chunks, with the lanes at rest."""
        arrays: dict[str, Array] = {}
        for name, stage in self.stages.items():
            arrays |= {f"{name}/state/{k}": a for k, a in stage.operator.snapshot().items()}
            if stage.merge:
                arrays |= {f"{name}/merge/{k}": a for k, a in stage.merge.snapshot().items()}
        for name, wire in self.wires.items():
            arrays[f"{name}/wire"] = np.array([wire.owed, wire.samples, wire.gaps, wire.lost])
        return arrays

    def restore(self, arrays: dict[str, Array]) -> None:
        """Go on from a snapshot of the same graph."""
        for name, stage in self.stages.items():
            stage.operator.restore(_under(arrays, f"{name}/state/"))
            if stage.merge:
                stage.merge.restore(_under(arrays, f"{name}/merge/"))
        for name, wire in self.wires.items():
            wire.owed, wire.samples, wire.gaps, wire.lost = (int(v) for v in arrays[f"{name}/wire"])


def lane_of(graph: Graph, node: Node) -> str:
    """The thread a node runs on: the one it names; an outlet's is `outlets`; else its inputs' common lane, or the graph's own ("")."""
    if node.options.lane or node.is_source:
        return node.options.lane
    if node.is_outlet:
        return "outlets"
    lanes = {lane_of(graph, graph.nodes[edge.node]) for edge in node.inputs.values()}
    return lanes.pop() if len(lanes) == 1 else ""


def _under(arrays: dict[str, Array], prefix: str) -> dict[str, Array]:
    return {k.removeprefix(prefix): a for k, a in arrays.items() if k.startswith(prefix)}
