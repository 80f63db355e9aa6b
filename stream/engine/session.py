"""A live session: devices, the graph's turn, the session log, and a clean end whatever happens.

One thread at a time runs the graph: it has the turn. What a source brings while nothing waits and the turn is free is worked through at
once, on the source's own thread; that saves waking another, which costs more than most graphs' work. Everything else goes through the
queues to the thread that called `Session.run`: it waits on one ready queue, takes the next chunk of any source, enters it into the input
log and pushes it through the pipeline; several times a second it looks after the sources. Either way the order of entry is the log's order,
and the graph a function of that.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Protocol, Self

import structlog

from kinegraph.stream.chunk import NEVER
from kinegraph.stream.engine.flow.queues import DROPPED, ReadyQueue
from kinegraph.stream.engine.ingress import Ingress
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.engine.probing import probe
from kinegraph.stream.engine.resume import catch_up
from kinegraph.stream.engine.session_log import PriorSession, SessionLog
from kinegraph.stream.engine.shortfall import INCOMPLETE, shortfalls
from kinegraph.stream.engine.status import (
    MemoryWatch,
    Outcome,
    Rates,
    SessionView,
    Table,
    Views,
    recording_row,
    table_of,
)
from kinegraph.stream.engine.supervisor import GRACE_S, REST_S, SourceSupervisor
from kinegraph.stream.engine.warmup import Compilations, warm_up
from kinegraph.stream.engine.workers import Call, Watchdog, Workers
from kinegraph.stream.errors import KinegraphError, asked_to_end
from kinegraph.stream.graph import Graph, is_live
from kinegraph.stream.graph.session_check import refuse_unsuited
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.system.clock import SessionClock
from kinegraph.stream.system.memory_limit import ceiling, refused_beyond
from kinegraph.stream.system.stalls import calm

TICK_S = 0.2
"""How often the graph is looked after while something is about to happen; else every `REST_S`."""
METRICS_S = 1.0

log = structlog.get_logger(__name__)


class Session:
    """One live run of a graph. Whole from its constructor on, which opens no device, file or thread; `run` does, and closes them.

    folder       where the recording and the checkpoint go; None: nothing is recorded
    resume       go on with the session that was broken off in `folder`
    speaking     the outlets that take part; None: all
    duration_s   end after this long; 0: when stopped, or when every source has ended
    asked_by     which signal, or whoever else, asked it to end; "" where nothing did
    now(), turn  session time (ns): the clock's, or without live sources how far data have come;  whether all are ready: `turn.open`
    """

    def __init__(
        self,
        graph: Graph,
        folder: Path | None = None,
        *,
        resume: bool = False,
        duration_s: float = 0.0,
        view: SessionView | None = None,
        speaking: Collection[str] | None = None,
    ) -> None:
        refuse_unsuited(graph)
        self.graph, self.folder, self._view, self._duration_s = graph, folder, view, duration_s
        graph.recorded_in = str(folder or "")
        self._prior = PriorSession(folder, graph) if resume and folder else None
        self._probed = self._prior is not None
        self.clock = SessionClock(after=self._prior.last_time if self._prior else NEVER)
        self._ready: ReadyQueue = SimpleQueue()
        self._stopping = self._broken_off = self._down = self.warming = False
        self._error: Exception | None = None
        self._began, self._ran_s, self.asked_by = 0.0, 0.0, ""
        self.table: Table = {}
        waits = not is_live(graph)
        self.log = SessionLog(folder, graph, self.clock, self._prior, waits=waits)
        self._workers = Workers(self._ready, waits, self._fail, partial(self.log.report, DROPPED))
        self.pipeline = Pipeline(
            graph, speaking=graph.outlets if speaking is None else speaking, bridge=self._workers.bridge, stop=self.stop
        )
        self._supervisors = [
            SourceSupervisor(node, self._ready, self.clock, self.log.report, self._fail) for node in graph.sources
        ]
        self._ingress = Ingress(self._ready, self._supervisors, self.pipeline, self.log, self.clock, self._fail)
        self.now, self._watchdog = self._ingress.time.now, Watchdog(self.pipeline.slots.values())
        self.turn, self._memory, self._rates = self._ingress.turn, MemoryWatch(graph.memory_mb, self.pipeline), Rates()

    def stop(self, by: str = "") -> None:
        """End the session cleanly, and say `by` which signal that was asked; may be called from any thread and from a signal handler."""
        self.asked_by, self._stopping = self.asked_by or by, True
        self._ready.put(None)

    def tell(self, node: str, text: str) -> None:
        """Give a source what a person typed for it, before it starts or while it reads; raises KinegraphError if it cannot be."""
        self._ingress.tell(node, text)

    def mark(self, text: str, onset: int | None = None) -> None:
        """Annotate this moment, or the one at `onset` (ns)."""
        self.tell("annotations", f"{self.now() if onset is None else onset} {text}")

    def probe(self) -> None:
        """Look for the devices, once; `run` does so first. Raises DeviceError for required ones that are missing. A session that is resumed
        goes on without, as where a cable is pulled meanwhile."""
        if not self._probed:
            self._probed = True
            probe(self.graph)

    def run(self) -> Outcome:
        """Run until every source has ended, `stop` is called, or something fails; closes everything. Raises Interrupted while `warming`,
        DeviceError where a device is missing from the start."""
        self.probe()
        self._warm_up()
        self._open()
        compilations = Compilations()
        try:
            # after warming up: what compilers take for a moment is not the session's memory
            with calm(), refused_beyond(ceiling(self.graph.memory_mb)):
                self._begin()
                self._began = time.monotonic()
                try:
                    self._loop()
                finally:
                    self._ran_s = time.monotonic() - self._began
                self.log.asked_to_end(self.asked_by)
        except Exception as error:  # noqa: BLE001 - returned in the outcome, after everything is closed
            self._error = self._memory.of(error)
        finally:
            compilations.stop()
            try:
                self._finish()
            except BaseException:  # broken off by a second Ctrl-C: what is recorded is closed all the same
                self.log.close(well=False)
                raise
        return self._outcome(compilations.names)

    def compile(self) -> None:
        """Compile all that `run` compiles, for another time: nothing runs, no device is opened, the recording holds nothing."""
        self._warm_up(compiles_only=True)
        self._open()
        self._close()

    def _warm_up(self, *, compiles_only: bool = False) -> None:
        self.warming = True
        report = Views([self._view] if self._view else []).starting
        warm_up(self.pipeline, lambda: self._stopping, report, compiles_only=compiles_only)
        self.warming = False

    def in_hand(self) -> Call | None:
        """The call of a node that has been found under way for longest, or None; may be asked from any thread."""
        return self._watchdog.look()

    def break_off(self, error: KinegraphError, stuck: str) -> Outcome:
        """From another thread than the graph's, which does not come back out of the node `stuck`: close everything else without it."""
        self._fail(error)
        self._ran_s = self._ran_s or (time.monotonic() - self._began if self._began else 0.0)
        self._broken_off = True
        for supervisor in self._supervisors:
            supervisor.stop()
        self._close(stuck)
        return self._outcome([])

    def _outcome(self, compiled: list[str]) -> Outcome:
        files = files_of(self.pipeline)
        missing = shortfalls(self.pipeline.outlets, self._workers.queues, self._ingress.ports, self.log.status)
        code = exit_code(self._error, self._down, missing)
        return Outcome(self._error, code, self.table, self.folder, compiled, self._ran_s, files, missing)

    def _open(self) -> None:
        """Restore the state if a former session goes on, begin the recording, and compile; no device yet."""
        if self._prior and self._prior.checkpoint:
            self.pipeline.restore(self._prior.checkpoint.arrays)
        self.log.open()
        self._ingress.declare(self._prior)
        self.log.observe_edges(self.pipeline)
        self.pipeline.compile()
        self._workers.start()

    def _begin(self) -> None:
        if self._prior:
            catch_up(self._prior, self.pipeline, self._ingress.ports, self._workers, self.log, self.clock, self._pump)
        else:
            self.pipeline.begin(self.clock, (self.log.handed, self.log.saved))
            self._checkpoint()
        self._ingress.begin()
        # background sources (a person's entries, settings) first: what they say at the start comes before the data
        for supervisor in sorted(self._supervisors, key=lambda supervisor: not supervisor.source.background):
            supervisor.start(again=self._prior is not None)

    def _loop(self) -> None:
        began = time.monotonic()
        now, tick, metrics, checkpoint = began, began + TICK_S, began + METRICS_S, began + self.graph.checkpoint_s
        ends = began + self._duration_s if self._duration_s > 0 else math.inf
        while not self._stopping and self._error is None and not self._ingress.over:
            self._ingress.serve(tick - now)
            now = time.monotonic()
            if now < tick:
                continue
            with self._ingress.turn.lock:
                now = time.monotonic()
                # a debugger, a suspended machine or a long operator: sources must not seem silent for that
                if now - tick > TICK_S:
                    self._ingress.excuse_pause(now, now - tick)
                self.pipeline.fold()
                for supervisor in self._supervisors:
                    supervisor.watch()
                self._ingress.tick(now)
                tick = min(now + (REST_S if self._ingress.is_idle(now) else TICK_S), ends)
                if now >= metrics:
                    metrics = now + METRICS_S
                    self._measure()
                if now >= checkpoint:
                    checkpoint = now + self.graph.checkpoint_s
                    self._checkpoint()
            if now >= ends:
                return

    def _pump(self) -> None:
        """Take what workers send home."""
        self._ingress.drain_ready()
        if self._error:
            raise self._error

    def _measure(self, *, last: bool = False) -> None:
        for supervisor in self._supervisors:
            try:
                supervisor.look(over=last)
            except KinegraphError as error:
                self._error = self._error or error
        self.table = table_of(self.pipeline, self._ingress.ports, self._workers, self.log.status, self._rates)
        self.log.metrics(self.table)
        self._error = self._error or (None if last else self._memory.exceeded())
        if self._view:
            self._view.update(self.table)

    def _checkpoint(self) -> None:
        """Take the state between two chunks, with the workers at rest."""
        if self.log.wants_checkpoint:
            # a state taken while a worker holds a chunk would lack what that chunk does further on
            self._workers.settle(self._pump)
            self.log.checkpoint(self._ingress.watermarks, self._workers.indices, self.pipeline)

    def _fail(self, error: Exception) -> None:
        """From any thread: the run ends with this error."""
        self._error = self._error or error
        self._ingress.close()
        self._ready.put(None)

    def _finish(self) -> None:
        """Stop the sources, work through what had arrived, close every operator and file; each even if another fails."""
        self._down = any(r.down for r in self._supervisors)
        # under the lock: a source that is inside the graph now comes out first
        with self._ingress.turn.lock:
            self._ingress.close()
        for supervisor in self._supervisors:
            supervisor.stop()
        if self._error is None:
            try:
                drain(self._ingress, self._workers, self.pipeline, self._pump)
            except Exception as error:  # noqa: BLE001 - returned in the outcome; what is open must be closed first
                self._error = error
        if not self._broken_off:
            self._close()

    def _close(self, stuck: str = "") -> None:
        """Close what is open; where a node is `stuck`, the threads that wait for it are not waited for."""
        if self._error:
            self.log.report("session failed", error=str(self._error))
            for stage in self.pipeline.outlets:
                if stage.node.name != stuck:
                    stage.close()
        # before the log is closed: findings and losses of the last second belong into the recording
        self._measure(last=True)
        for supervisor in self._supervisors:
            if not supervisor.join() and not stuck:
                self.log.report("source does not stop", node=supervisor.node.name)
        for worker in self._workers.stop(GRACE_S) if stuck else self._workers.stop():
            self.log.report("worker does not stop", worker=worker)
        self.log.close(well=self._error is None)
        if (status := self.log.status) is not None:
            self.table["recording"] = recording_row(status)


class SessionPage(SessionView, Protocol):
    """A view that also takes samples, and through which people steer."""

    def attach(self, session: Session) -> None:
        """Observe what is to be shown; called before the session runs."""

    def rest(self, outcome: Outcome) -> None:
        """The session has ended, and the page is left open: show how it ended, and what it leaves behind."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...


def drain(ingress: Ingress, workers: Workers, pipeline: Pipeline, drain_ready: Callable[[], None]) -> None:
    """Everything that had arrived is worked through, then every operator emits what is pending."""
    ingress.serve_all()
    workers.settle(drain_ready)
    ingress.end()
    workers.settle(drain_ready)
    if files_of(pipeline):
        log.info("finishing: outlets write what is left")
    pipeline.close(lambda: workers.settle(drain_ready))


def exit_code(error: Exception | None, down: bool, missing: Mapping[str, str]) -> int:
    """How a session ended, as a number: see `Outcome`."""
    if error:
        return getattr(error, "exit_code", 4)
    return 3 if down else INCOMPLETE if missing else 0


def files_of(pipeline: Pipeline) -> dict[str, str]:
    """What outlets leave behind, by node."""
    found = {}
    for stage in pipeline.outlets:
        assert isinstance(stage.operator, Outlet)
        try:
            found[stage.node.name] = stage.operator.file
        except BaseException as error:
            if asked_to_end(error):
                raise
            stage.switch_off(error)
    return {name: file for name, file in found.items() if file}
