"""Between operators: edges, which carry an output's chunks to all who read it, and input ports, which hand them to an operator.

`LiveEdge.carry` and `InputPort.__call__` do so for chunks of any kind, step by step. What comes most, chunks that follow one another
without a gap, takes a shorter way: the operators in a row behind an edge are written out as one function (`stream.engine.flow.segment`),
which the pipeline puts in the place of `LiveEdge.send`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import perf_counter_ns
from typing import Any, TypeAlias

import numpy as np

from kinegraph.stream.chunk import FOREVER, NEVER, STAMP, Array, Chunk, StreamSpec, add_lost, utc
from kinegraph.stream.engine.flow.metrics import Timing
from kinegraph.stream.engine.flow.promise import PromiseError, broken, ends
from kinegraph.stream.errors import KinegraphError, MemoryExceeded, RunError, asked_to_end, explain
from kinegraph.stream.graph import Edge
from kinegraph.stream.graph.components import is_ours
from kinegraph.stream.operator import Emitted, Operator

Push: TypeAlias = Callable[[Chunk, int], int]
"""Take a chunk and the time (ns, perf_counter) at which the caller ended; return the time at which the work ended."""
Observer: TypeAlias = Callable[[Chunk], None]

NOTHING = Chunk(np.empty(0, STAMP), np.empty(0), FOREVER)
"""What an operator is given where it is given nothing: it closes."""


class CallSlot:
    """What one worker calls now: the input port and the chunk, or, while it closes or its state is taken, the node alone.

    It also holds read-only views of the newest chunk that an operator from outside our packages was given.

    port    None: the worker is at rest, or `node` is busy without a chunk
    node    "" unless a node closes, or its state is taken
    """

    __slots__ = ("chunk", "data", "node", "port", "seen_data", "seen_time", "time")

    def __init__(self) -> None:
        self.port: InputPort | None = None
        self.chunk = NOTHING
        self.node = ""
        self.time: Array | None = None
        self.data: Array | None = None

    def rest(self) -> None:
        """The worker has nothing to do."""
        self.port = None
        self.node = ""

    def read_only(self, process: Callable[[str, Chunk], Emitted]) -> Callable[[str, Chunk], Emitted]:
        """`process` given views that it cannot write to; the arrays themselves where it gives them back."""

        def guarded(port: str, chunk: Chunk) -> Emitted:
            if chunk.time is not self.time or chunk.data is not self.data:
                self.show(chunk)
            shown = Chunk(self.seen_time, self.seen_data, chunk.until, chunk.lost)
            emitted = process(port, shown)
            if emitted is shown:
                return chunk
            if emitted.__class__ is Chunk:
                if emitted.time is self.seen_time:
                    emitted.time = chunk.time
                if emitted.data is self.seen_data:
                    emitted.data = chunk.data
            return emitted

        return guarded

    def show(self, chunk: Chunk) -> None:
        """Make views of a chunk's arrays, for reading only."""
        if chunk.time is not self.time:
            self.time, self.seen_time = chunk.time, chunk.time.view()
            self.seen_time.setflags(False)  # type: ignore[call-arg]  # by its name it costs twice as much
        if chunk.data is not self.data:
            self.data, self.seen_data = chunk.data, chunk.data.view()
            self.seen_data.setflags(False)  # type: ignore[call-arg]


class InputPort:
    """An operator's one input, or one of several behind a merge: calls the operator, and sends on what it gives back.

    out     the edge of the operator's first output, if it has any
    emit    sends whatever the operator gives back
    slot    of the worker that it runs on
    """

    __slots__ = ("contiguous", "emit", "is_ours", "node", "operator", "out", "port", "process", "slot", "timing")

    def __init__(
        self,
        node: str,
        port: str,
        operator: Operator[Any],
        timing: Timing,
        out: LiveEdge | None,
        emit: Callable[[Emitted, int], int],
        slot: CallSlot,
    ) -> None:
        self.node, self.port, self.operator, self.contiguous = node, port, operator, operator.contiguous
        self.is_ours = is_ours(operator)
        self.process = operator.process if self.is_ours else slot.read_only(operator.process)
        self.timing, self.out, self.emit, self.slot = timing, out, emit, slot

    def __call__(self, chunk: Chunk, start: int) -> int:
        emitted, end = self.call(chunk, start)
        return end if emitted is None else self.emit(emitted, end)

    def call(self, chunk: Chunk, start: int) -> tuple[Emitted, int]:
        """What the operator gives back, and when it did."""
        slot = self.slot
        slot.port, slot.chunk = self, chunk
        try:
            emitted = self.process(self.port, chunk)
        except BaseException as error:  # no operator ends the program by itself, with a recording open
            if asked_to_end(error):
                raise
            raise failure(self.node, error, self.port, chunk) from error
        end = perf_counter_ns()
        self.timing.durations.append(end - start)
        return emitted, end


class LiveEdge:
    """One output of a node while a graph runs: checks what it promises, carries `lost` to the next samples, keeps arrays normal, calls
    observers and readers.

    origin   which output of which node it is
    send     brings a chunk to all who read the edge: `carry`, until the pipeline compiles the segment behind it
    promised its watermark: the `until` of the newest chunk
    slot     of the worker that its node runs on; None: what comes was checked where it entered (a source's, a recording's)
    strict   whether the ends of stamps are checked, too, whoever observes the edge
    reached  how far its node's inputs are
    pending_gap samples lost before the next one
    """

    __slots__ = (
        *("gaps", "lost", "observers", "origin", "pending_gap", "reached"),
        *("readers", "samples", "send", "slot", "spec", "strict", "promised"),
    )

    def __init__(
        self, origin: Edge, spec: StreamSpec, slot: CallSlot | None = None, reached: Callable[[], int] = lambda: FOREVER
    ) -> None:
        self.origin, self.spec, self.slot, self.reached = origin, spec, slot, reached
        self.observers: list[Observer] = []
        self.readers: list[Push] = []
        self.pending_gap = self.gaps = self.lost = self.samples = 0
        self.promised = NEVER
        self.strict = False
        self.send: Push = self.carry

    @property
    def looks_at_ends(self) -> bool:
        """Whether the ends of stamps are checked: at the recorder, at outlets and behind operators from outside."""
        return self.slot is not None and (self.strict or bool(self.observers))

    def check(self, chunk: Chunk) -> None:
        """Raise PromiseError where the node gave what its spec, its watermark or its inputs rule out."""
        if self.slot is not None:
            what = broken(self.spec, chunk, self.promised)
            if not what and self.looks_at_ends:
                what = ends(chunk, self.promised, self.reached())
            if what:
                raise PromiseError(self.origin.node, self.origin.output, what, chunk)
        # an int, for a numpy integer here would make every later comparison slower
        self.promised = max(self.promised, int(chunk.until))

    def carry(self, chunk: Chunk, start: int) -> int:
        """Bring a chunk of any kind to all who read the edge; along operators in a row without recursion, however many."""
        edge = self
        while True:
            chunk = edge.enter(chunk)
            port = edge.next
            if port is None:
                break
            emitted, start = port.call(chunk, start)
            if not isinstance(emitted, Chunk) or port.out is None:
                return port.emit(emitted, start)
            edge, chunk = port.out, emitted
        for push in edge.readers:
            start = push(chunk, start)
        return start

    @property
    def next(self) -> InputPort | None:
        """The only reader, where it is an operator of one input that has an output."""
        reader = self.readers[0] if len(self.readers) == 1 else None
        return reader if isinstance(reader, InputPort) and reader.out else None

    def enter(self, chunk: Chunk) -> Chunk:
        """Check, count and observe a chunk, and give it as readers take it."""
        self.check(chunk)
        if chunk.lost or self.pending_gap:
            chunk = self._with_lost(chunk)
        self.samples += len(chunk.time)
        # kernels are compiled for one layout; another would compile them again in the middle of a session
        if not (chunk.data.flags.carray and chunk.time.flags.carray):
            chunk = _normal(chunk)
        for observe in self.observers:
            observe(chunk)
        return chunk

    def _with_lost(self, chunk: Chunk) -> Chunk:
        """Move a `lost` without samples to the next chunk that has some."""
        lost = add_lost(self.pending_gap, chunk.lost)
        # a gap belongs to the sample after it: a chunk of none cannot carry it
        if not len(chunk.time):
            self.pending_gap = lost
            return Chunk(chunk.time, chunk.data, chunk.until, 0)
        self.pending_gap = 0
        self.gaps += 1
        self.lost = add_lost(self.lost, lost)
        return Chunk(chunk.time, chunk.data, chunk.until, lost)


def _normal(chunk: Chunk) -> Chunk:
    """The chunk with arrays that are contiguous, aligned and writable."""
    time, data = (np.require(array, requirements=["C", "A", "W"]) for array in (chunk.time, chunk.data))
    return Chunk(time, data, chunk.until, chunk.lost)


def failure(node: str, error: BaseException, port: str = "", chunk: Chunk | None = None) -> RunError:
    """What an operator's exception means to the person at the screen: which node, at which sample's time."""
    where = "" if chunk is None else given(port, chunk)
    text = str(error) if isinstance(error, KinegraphError) else explain(error)
    if isinstance(error, ValueError) and "read-only" in text:
        text += "; an input must not be written to, for others read it: work on a copy"
    if isinstance(error, MemoryError):
        return MemoryExceeded(f"node {node!r} asked for more memory than memory_mb leaves: {text}{where}")
    return RunError(f"node {node!r}: {text}{where}")


def given(port: str, chunk: Chunk) -> str:
    """What an operator was given when it failed, for the end of a sentence."""
    stamp = int(chunk.time[0]) if len(chunk.time) else chunk.until
    return f" at sample time {utc(stamp)} (input {port!r}, {len(chunk.time)} samples)"


def nonsense(node: str, emitted: object, outputs: Iterable[str], error: Exception) -> RunError:
    """What it means that an operator gave back something that cannot be sent on."""
    named = ", ".join(map(repr, outputs)) or "no output"
    return RunError(
        f"node {node!r}: gave back a {type(emitted).__name__} that cannot be sent on ({explain(error)}); an operator gives back a Chunk,"
        f" pairs of an output and a Chunk, or nothing; its outputs: {named}"
    )
