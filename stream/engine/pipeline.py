"""A graph made ready to run: operators wired to each other by plain calls, on the thread that feeds them.

A chunk that enters is pushed from operator to operator, depth first, without queues and without copies. Timing costs one reading of the
clock per call: every push is given the time at which its caller ended, and returns the time at which its own last reader did. How
wires, links and chains of them do that is in `stream.engine.wire` and `stream.engine.chain`.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from time import perf_counter_ns
from typing import Any, TypeAlias

import numpy as np
import structlog

from stream.chunk import FOREVER, NEVER, Array, Chunk, empty
from stream.engine.channel import Channel
from stream.engine.clock import SessionClock
from stream.engine.link import NOTHING, Hand, Link, Push, failure, nonsense
from stream.engine.merge import Merge
from stream.engine.metrics import FOLD_AT, Timing
from stream.engine.wire import Wire
from stream.errors import KinegraphError
from stream.graph import Edge, Graph, Node
from stream.graph.parts import is_ours
from stream.operator import Emitted, Operator, Outlet
from stream.rows import Rows, rows_for

log = structlog.get_logger(__name__)


class Stage:
    """An operator or outlet while a graph runs.

    feeds    the wires it reads
    limits   what says how far each input has come: the wire, or the queue behind it
    hand     what its thread has in hand
    muted    an outlet that hears nothing for now
    failed   why an outlet was switched off
    """

    __slots__ = ("failed", "feeds", "hand", "lane", "limits", "merge", "muted", "node", "operator", "timing", "wires")

    def __init__(self, graph: Graph, node: Node, lane: str, hand: Hand) -> None:
        assert isinstance(node.part, Operator)
        self.node, self.lane, self.hand = node, lane, hand
        self.operator: Operator[Any] = node.part.fresh()
        specs = graph.input_specs(node)
        opened = self.operator.open(specs)
        self.wires = {name: Wire(Edge(node.name, name), spec, hand, self.reached) for name, spec in opened.items()}
        for wire in self.wires.values():
            wire.strict = not is_ours(self.operator)
        merged = len(specs) > 1 and getattr(self.operator, "in_order", True)
        self.merge = Merge(specs, in_turn=self.operator.in_turn) if merged else None
        self.timing = Timing()
        self.feeds: list[Wire] = []
        self.limits: list[Wire | Channel] = []
        self.muted = False
        self.failed = ""

    def reached(self) -> int:
        """How far the inputs are: no output is ahead of that."""
        link, chunk = self.hand.link, self.hand.chunk
        if chunk is NOTHING or link is None or link.operator is not self.operator:
            return FOREVER  # it closes
        newest = chunk.time.item(-1) if len(chunk.time) else NEVER
        return max(newest, chunk.until, *(feed.told for feed in self.limits))

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

    def _input(self, port: str) -> Push:
        if self.node.is_outlet:
            return self._outlet_input(port)
        out = next(iter(self.wires.values()), None)
        return Link(self.node.name, port, self.operator, self.timing, out, self.emit, self.hand)

    def _outlet_input(self, port: str) -> Push:
        """An outlet's failure ends the outlet, not the graph."""
        process = self.operator.process if is_ours(self.operator) else self.hand.read_only(self.operator.process)

        def run(chunk: Chunk, start: int) -> int:
            if self.muted or self.failed:
                return start
            try:
                process(port, chunk)
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
        try:
            for name, chunk in emitted:
                start = self.wires[name].send(chunk, start)
        except KinegraphError:
            raise
        except Exception as error:
            for name, chunk in emitted if isinstance(emitted, list | tuple) else ():
                if name in self.wires and isinstance(chunk, Chunk):
                    self.wires[name].check(chunk)
            raise nonsense(self.node.name, emitted, self.wires, error) from error
        return start

    def close(self) -> None:
        """Let the operator emit what is pending."""
        if self.node.is_outlet and (self.failed or self.muted):
            return
        self.hand.chunk = NOTHING
        try:
            emitted = self.operator.close()
        except Exception as error:
            if not self.node.is_outlet:
                raise failure(self.node.name, error) from error
            self._switch_off(error)
        else:
            self.emit(emitted, perf_counter_ns())


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
        self.hands: dict[str, Hand] = {}
        self.stages = {
            name: Stage(graph, node, lane, self.hands.setdefault(lane, Hand()))
            for name, node in graph.nodes.items()
            if not node.is_source and (not node.is_outlet or name in speaking)
            for lane in (lane_of(graph, node),)
        }
        self.wires = {str(w.edge): w for w in self._wires()}
        for wire in self.wires.values():
            readers = [(self.stages[n.name], port) for n, port in graph.readers(wire.edge) if n.name in self.stages]
            made: dict[bool, Rows] = {}
            for stage, port in readers:
                push = self._bridged(wire, stage, port, stage.push(port), bridge)
                rows = rows_for(stage.operator, wire.spec, made)
                wire.readers.append(_converting(rows, push) if rows else push)
                stage.feeds.append(wire)
                wire.strict = wire.strict or stage.node.is_outlet

    def _wires(self) -> Iterable[Wire]:
        yield from self.entries.values()
        for stage in self.stages.values():
            yield from stage.wires.values()

    def _bridged(self, wire: Wire, stage: Stage, port: str, push: Push, bridge: Bridge | None) -> Push:
        """The push, behind a queue where the stage runs on another lane than what feeds it."""
        origin = self.stages.get(wire.edge.node)
        if bridge is None or stage.lane == (origin.lane if origin else ""):
            stage.limits.append(wire)
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
        """Let the outlets touch the world; `clock` is a live session's. What taps a wire has been added before."""
        self.fasten()
        for stage in self.outlets:
            assert isinstance(stage.operator, Outlet)
            stage.operator.meet(self.graph)
            if clock:
                stage.operator.keep_time(clock)
            stage.operator.begin()

    @property
    def outlets(self) -> list[Stage]:
        return [s for s in self.stages.values() if s.node.is_outlet]

    def fasten(self) -> None:
        """Write the chains of operators, and compile their rows. What taps a wire has been added before."""
        self.loosen()
        for wire in self.wires.values():
            if not any(wire in w.chain.wires for w in self.wires.values() if w.chain):
                wire.fasten()

    def loosen(self) -> None:
        """Taps, readers or the operators' memory were changed: chains of operators are written anew."""
        for wire in self.wires.values():
            wire.loosen()

    def fold(self, least: int = FOLD_AT) -> None:
        """Keep the lists of durations short: work up those that hold at least so many."""
        for wire in self.wires.values():
            if wire.chain:
                wire.chain.fold(least)
        for stage in self.stages.values():
            if len(stage.timing.durations) >= least:
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
            wire.told = NEVER
        self.loosen()


def _converting(rows: Rows, push: Push) -> Push:
    """Brings chunks to a reader that asks for rows, where the edge carries something else."""
    return lambda chunk, start: push(rows(chunk), start)


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
