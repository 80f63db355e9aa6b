"""The state of a running session as one table: what flows where, how long it takes, what waits, what was lost."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from kinegraph.stream.chunk import FOREVER, NEVER, NS
from kinegraph.stream.engine.flow.metrics import rounded
from kinegraph.stream.engine.shortfall import reader_of
from kinegraph.stream.errors import MemoryExceeded, blaming
from kinegraph.stream.system.malloc_tuning import give_back
from kinegraph.stream.system.memory_limit import ceiling, taken

if TYPE_CHECKING:
    from kinegraph.stream.engine.flow.queues import BoundedQueue
    from kinegraph.stream.engine.ingress import IngressPort
    from kinegraph.stream.engine.pipeline import Pipeline, Stage
    from kinegraph.stream.engine.workers import Workers
    from kinegraph.stream.recording import RecorderStatus

Table: TypeAlias = dict[str, dict[str, Any]]
"""Per stream of a source ("board.emg"), per node, and for "recording": named numbers with units in their names."""


RATE_NS = 10 * NS
"""How much sample time a rate covers."""


class Rates:
    """How many samples a second there are, over the last ten seconds of each stream's own time: in whatever bursts they come."""

    __slots__ = ("_seen",)

    def __init__(self) -> None:
        self._seen: dict[str, deque[tuple[int, int]]] = {}

    def of(self, name: str, samples: int, until: int) -> float:
        """The rate of a stream that is complete up to `until` (ns), after `samples` samples; 0.0 as long as too little is known."""
        seen = self._seen.setdefault(name, deque())
        if until not in (NEVER, FOREVER) and (not seen or until > seen[-1][0]):
            seen.append((until, samples))
        while len(seen) > 2 and seen[-1][0] - seen[1][0] >= RATE_NS:
            seen.popleft()
        if len(seen) < 2:
            return 0.0
        (begin, before), (end, now) = seen[0], seen[-1]
        return round((now - before) * NS / (end - begin), 2)


def table_of(
    pipeline: Pipeline,
    ports: Iterable[IngressPort],
    workers: Workers,
    recording: RecorderStatus | None,
    rates: Rates,
) -> Table:
    """The table now. Reading it starts a new interval of the timings."""
    now = time.monotonic()
    pipeline.fold(least=1)
    table: Table = {}
    for port in ports:
        table[port.stream] = row = _source_row(port, now)
        rate = rates.of(port.stream, row["samples"], port.edge.promised)
        row["rate_hz"] = 0.0 if row["state"] == "stale" else rate
    for name, stage in pipeline.stages.items():
        table[name] = _stage_row(stage, workers.queues, rates)
    if recording:
        table["recording"] = recording_row(recording)
    return table


def table_of_replay(pipeline: Pipeline, rates: Rates) -> Table:
    """The same of a replay, into which recorded streams are fed."""
    pipeline.fold(least=1)
    table: Table = {}
    for name, edge in pipeline.entries.items():
        rate = rates.of(name, edge.samples, edge.promised)
        table[name] = {"kind": "source", "samples": edge.samples, "gaps": edge.gaps, "lost": edge.lost, "rate_hz": rate}
    for name, stage in pipeline.stages.items():
        table[name] = _stage_row(stage, {}, rates)
    return table


def recording_row(recording: RecorderStatus) -> dict[str, Any]:
    """How the recorder does; once it has been closed, `behind_s` is what it could not write at the end."""
    return {
        "kind": "recording",
        "bytes": recording.bytes,
        "behind_s": round(recording.behind_s, 2),
        "dropped_chunks": sum(recording.dropped.values()),
        "error": recording.error,
    }


def _source_row(port: IngressPort, now: float) -> dict[str, Any]:
    supervisor, edge = port.supervisor, port.edge
    queue = supervisor.queues[port.output]
    first = queue is next(iter(supervisor.queues.values()))
    return {
        "kind": "source",
        "state": "stale" if port.stale else supervisor.state,
        "samples": edge.samples,
        "age_s": round(now - port.last, 3),
        "queue": queue.depth,
        "queue_limit": queue.limit,
        "dropped": queue.dropped,
        "late": port.late,
        "gaps": edge.gaps,
        "lost": edge.lost,
        "openings": supervisor.openings,
        "problems": dict(supervisor.problems) if first else {},
        "clock": dict(supervisor.clock_facts) if first else {},
        "findings": "; ".join(finding.text for finding in supervisor.findings) if first else "",
        "error": supervisor.error if supervisor.state == "failed" or not supervisor.ready else "",
    }


def _stage_row(stage: Stage, waiting: Mapping[str, BoundedQueue], rates: Rates) -> dict[str, Any]:
    queues = [c for name, c in waiting.items() if reader_of(name) == stage.node.name]
    samples = sum(edge.samples for edge in stage.feeds)
    return {
        "kind": "outlet" if stage.node.is_outlet else "operator",
        "worker": stage.worker,
        "samples": samples,
        "rate_hz": rates.of(stage.node.name, samples, max((edge.promised for edge in stage.feeds), default=NEVER)),
        **rounded(stage.timing.read()),
        "queue": sum(c.depth for c in queues),
        "dropped": sum(c.dropped for c in queues),
        "gaps": sum(w.gaps for w in stage.edges.values()),
        "error": stage.failed,
    }


class SessionView(Protocol):
    """Something that shows a running session."""

    def update(self, table: Table) -> None:
        """Take the newest metrics, once a second; must not wait."""

    def starting(self, text: str, over: bool) -> None:
        """Take how far the compilation of kernels is, in words, and whether it is over; must not wait."""


class Views(list[SessionView]):
    """Several views as one."""

    def update(self, table: Table) -> None:
        for view in self:
            view.update(table)

    def starting(self, text: str, over: bool) -> None:
        for view in self:
            view.starting(text, over)


@dataclass(slots=True)
class Outcome:
    """How a session ended.

    exit_code   0 well, 3 a device was missing, 4 the graph stopped by an error, 5 less was delivered than offered: `missing`
    table       the last metrics
    seconds     from the common opening of the devices to their end
    files       what outlets have left, by node
    compiled    kernels that were compiled while running; it should be 0
    missing     what was offered and not delivered, in words, by outlet and source, and for "recording"
    """

    error: Exception | None
    exit_code: int
    table: Table
    folder: Path | None
    compiled: list[str]
    seconds: float = 0.0
    files: dict[str, str] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)


SPARE_BYTES, GIVEN_BACK_S = 256 << 10, 60.0
"""Once memory has grown by more, what is free of it is given back, at most once in this time."""


class MemoryWatch:
    """Checks a session's memory against its limit, and finds the node with the fastest growing state. Returns free memory to the system."""

    def __init__(self, memory_mb: float, pipeline: Pipeline) -> None:
        self._most, self._stages = ceiling(memory_mb), pipeline.stages
        self._first = self._held_by_each()
        self._held, self._due = 0, 0.0
        """What the session held after free memory had been given back last, and when that may be done again."""

    def exceeded(self) -> MemoryExceeded | None:
        """The error that ends the session; None while all is well. Call it between two chunks."""
        held, now = taken(), time.monotonic()
        if 0 < self._most < held or (now >= self._due and held - self._held > SPARE_BYTES):
            give_back()
            held = self._held = taken()
            self._due = now + GIVEN_BACK_S
        return self._error(held) if 0 < self._most < held else None

    def of(self, error: Exception) -> Exception:
        """The error that ended the session; a lack of memory names the node with the largest growth."""
        return self._error(taken()) if isinstance(error, MemoryError) else error

    def _held_by_each(self) -> dict[str, int]:
        held = {}
        for name, stage in self._stages.items():
            with blaming(name, "memory_bytes"):
                held[name] = stage.operator.memory_bytes
        return held

    def _error(self, held: int) -> MemoryExceeded:
        rise = {name: held - self._first[name] for name, held in self._held_by_each().items()}
        worst = max(rise, key=lambda name: rise[name], default="")
        grown = worst and rise[worst] > 1e6
        who = (
            f"node {worst!r} has grown by {rise[worst] / 1e6:.0f} MB" if grown else "no node's state has grown by much"
        )
        return MemoryExceeded(
            f"the session takes {held / 1e6:.0f} MB of memory; at most {self._most / 1e6:.0f} MB may be (memory_mb): {who}"
        )
