"""A link: an operator's one input, fed on the thread of what it reads."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from stream.chunk import FOREVER, STAMP, Array, Chunk, utc
from stream.engine.metrics import Timing
from stream.errors import KinegraphError, RunError, explain
from stream.graph import parts
from stream.operator import Emitted, Operator

if TYPE_CHECKING:
    from stream.engine.wire import Wire

Push: TypeAlias = Callable[[Chunk, int], int]
"""Take a chunk and the time (ns, perf_counter) at which the caller ended; return the time at which the work ended."""


NOTHING = Chunk(np.empty(0, STAMP), np.empty(0), FOREVER)
"""What is in hand where an operator is given nothing: it closes."""


class Hand:
    """What a thread has in hand: its present or last call, and read-only views of what an operator from outside was given."""

    __slots__ = ("chunk", "data", "link", "seen_data", "seen_time", "time")

    def __init__(self) -> None:
        self.link: Link | None = None
        self.chunk = NOTHING
        self.time: Array | None = None
        self.data: Array | None = None

    def read_only(self, process: Callable[[str, Chunk], Emitted]) -> Callable[[str, Chunk], Emitted]:
        """The operator's `process` given views that it cannot write to; the arrays themselves where it gives them back."""

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


class Link:
    """Brings chunks to an operator's input, and sends on what it gives back.

    hand    of the thread that it runs on
    out     the wire of the operator's first output, if it has any
    emit    sends whatever the operator gives back
    """

    __slots__ = ("contiguous", "emit", "hand", "is_ours", "name", "operator", "out", "port", "process", "timing")

    def __init__(
        self,
        name: str,
        port: str,
        operator: Operator[Any],
        timing: Timing,
        out: Wire | None,
        emit: Callable[[Emitted, int], int],
        hand: Hand,
    ) -> None:
        self.name, self.port, self.operator, self.contiguous = name, port, operator, operator.contiguous
        self.is_ours = parts.is_ours(operator)
        self.process = operator.process if self.is_ours else hand.read_only(operator.process)
        self.timing, self.out, self.emit, self.hand = timing, out, emit, hand

    def __call__(self, chunk: Chunk, start: int) -> int:
        hand = self.hand
        hand.link, hand.chunk = self, chunk
        try:
            emitted = self.process(self.port, chunk)
        except (Exception, SystemExit) as error:  # no operator ends the program by itself, with a recording open
            raise failure(self.name, error, self.port, chunk) from error
        end = perf_counter_ns()
        self.timing.durations.append(end - start)
        return end if emitted is None else self.emit(emitted, end)


def failure(node: str, error: Exception | SystemExit, port: str = "", chunk: Chunk | None = None) -> RunError:
    """What an operator's exception means to the person at the screen: which node, at which sample's time."""
    where = "" if chunk is None else given(port, chunk)
    text = str(error) if isinstance(error, KinegraphError) else explain(error)
    if isinstance(error, ValueError) and "read-only" in str(error):
        text += "; an input must not be written to, for others read it: work on a copy"
    return RunError(f"node {node!r}: {text}{where}")


def given(port: str, chunk: Chunk) -> str:
    """What an operator was given when it failed, for the end of a sentence."""
    stamp = int(chunk.time[0]) if len(chunk.time) else chunk.until
    return f" at sample time {utc(stamp)} (input {port!r}, {len(chunk.time)} samples)"


def nonsense(node: str, emitted: object, outputs: Iterable[str], error: Exception) -> RunError:
    """What it means that an operator gave back something that cannot be sent on."""
    named = ", ".join(map(repr, outputs)) or "none"
    return RunError(
        f"node {node!r}: gave back a {type(emitted).__name__} that cannot be sent on ({explain(error)}); an operator gives back a Chunk,"
        f" pairs of an output and a Chunk, or nothing; its outputs: {named}"
    )
