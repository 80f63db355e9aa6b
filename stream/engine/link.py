"""A link: an operator's one input, fed on the thread of what it reads."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any, TypeAlias

from stream.chunk import Chunk, utc
from stream.engine.metrics import Timing
from stream.errors import KinegraphError, RunError, explain
from stream.operator import Emitted, Operator

if TYPE_CHECKING:
    from stream.engine.wire import Wire

Push: TypeAlias = Callable[[Chunk, int], int]
"""Take a chunk and the time (ns, perf_counter) at which the caller ended; return the time at which the work ended."""


class Link:
    """Brings chunks to an operator's input, and sends on what it gives back.

    out     the wire of the operator's first output, if it has any
    emit    sends whatever the operator gives back
    """

    __slots__ = ("contiguous", "emit", "name", "operator", "out", "port", "process", "timing")

    def __init__(
        self,
        name: str,
        port: str,
        operator: Operator[Any],
        timing: Timing,
        out: Wire | None,
        emit: Callable[[Emitted, int], int],
    ) -> None:
        self.name, self.port, self.operator, self.process, self.contiguous = (
            name,
            port,
            operator,
            operator.process,
            operator.contiguous,
        )
        self.timing, self.out, self.emit = timing, out, emit

    def __call__(self, chunk: Chunk, start: int) -> int:
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
