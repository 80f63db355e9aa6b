"""A live session: devices, the graph's one thread, the recording, checkpoints, and a clean end whatever happens.

The thread that calls `Session.run` is the graph's thread. It waits on one doorbell, takes the next chunk of any source, writes it into
the input log, and pushes it through the pipeline; several times a second it looks after the sources.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from time import perf_counter_ns
from typing import Any, Protocol

import numpy as np
import structlog

from stream.channel import Channel, Doorbell
from stream.checkpoint import Checkpoint, Keeper, fingerprint
from stream.chunk import FOREVER, NEVER, NS, Chunk, add_lost, empty, utc
from stream.clock import SessionClock
from stream.drops import KIND as DROPPED
from stream.drops import recorded_drops
from stream.errors import DeviceError, KinegraphError, RunError
from stream.graph import Graph
from stream.lanes import Lanes
from stream.manual import Value
from stream.pipeline import Pipeline, Wire
from stream.recording import Recorder, Recording, versions
from stream.stalls import calm
from stream.status import Table, table_of
from stream.supervisor import Runner
from stream.warmup import Compilations, warm_up

TICK_S = 0.05
METRICS_S = 1.0

log = structlog.get_logger(__name__)


class View(Protocol):
    """Something that shows a running session."""

    def update(self, table: Table) -> None: ...


@dataclass(slots=True)
class Intake:
    """One output of a source, as the graph's thread sees it.

    promised   the stream is complete up to this time; what comes later and is older is dropped
    last       when its last chunk came (monotonic s)
    """

    stream: str
    runner: Runner
    output: str
    wire: Wire
    record: int = -1
    promised: int = NEVER
    last: float = 0.0
    late: int = 0
    silent: bool = False
    stale: bool = False


@dataclass(slots=True)
class Outcome:
    """How a session ended. `exit_code`: 0 well, 3 a device was missing, 4 the graph stopped by an error, 5 something at an end was lost."""

    error: Exception | None
    exit_code: int
    table: Table
    folder: Path | None
    compiled: list[str]


class Session:
    """One live run of a graph.

    folder    where the recording and the checkpoint go; None: nothing is recorded
    resume    go on with the session that was broken off in `folder`
    view      shown the metrics once a second
    """

    def __init__(
        self, graph: Graph, folder: Path | None = None, *, resume: bool = False, view: View | None = None
    ) -> None:
        self.graph, self.folder, self._view = graph, folder, view
        self._resume = resume
        self._bell: Doorbell = SimpleQueue()
        self._put_aside: list[Channel] = []
        self._stopping = False
        self._error: Exception | None = None
        self._started = False
        self._held: list[tuple[Intake, Chunk, int]] = []
        self.sequence = -1
        self.table: Table = {}
        self._recorder: Recorder | None = None
        self._keeper: Keeper | None = None
        waits = not any(n.part.live for n in graph.sources if not n.part.background)  # type: ignore[union-attr]
        self._lanes = Lanes(self._bell, waits, self._lane_failed, self._lane_dropped)

    # the start -------------------------------------------------------------------------------------------------------

    def run(self) -> Outcome:
        """Run until every source has ended, `stop` is called, or something fails; closes everything in every case."""
        warm_up(self.graph)
        speaking = {n.name for n in self.graph.nodes.values() if n.is_outlet}
        self.pipeline = Pipeline(self.graph, speaking=speaking, bridge=self._lanes.bridge)
        recording, checkpoint = self._former()
        self.clock = SessionClock(after=_last_time(recording))
        self._open_recording(recording, checkpoint)
        self._runners = [Runner(node, self._bell, self.clock, self.report) for node in self.graph.sources]
        self._intakes = [self._intake(r, output) for r in self._runners for output in r.channels]
        compilations = Compilations()
        try:
            with calm():
                if recording:
                    self._catch_up(recording, checkpoint)
                else:
                    self.pipeline.begin()
                for runner in self._runners:
                    runner.start(again=recording is not None)
                self._loop()
        except Exception as error:  # noqa: BLE001 - told to the caller in the outcome, after everything is closed
            self._error = error
        finally:
            compilations.stop()
            self._finish()
        return Outcome(self._error, self._exit_code(), self.table, self.folder, compilations.names)

    def stop(self) -> None:
        """End the session cleanly; may be called from any thread and from a signal handler."""
        self._stopping = True
        self._bell.put(None)

    def tell(self, node: str, text: str) -> None:
        """Give a source what a person typed for it; raises KinegraphError if it cannot be."""
        for runner in self._runners:
            if runner.node.name == node:
                if isinstance(runner.source, Value):
                    runner.source.accepts(text)
                runner.mailbox.put(text)
                return
        raise KinegraphError(f"there is no source {node!r} to tell {text!r}")

    def mark(self, text: str, onset: int | None = None) -> None:
        """Annotate this moment."""
        self.tell("annotations", f"{self.clock.now() if onset is None else onset} {text}")

    def _intake(self, runner: Runner, output: str) -> Intake:
        channel = runner.channels[output]
        intake = Intake(channel.name, runner, output, self.pipeline.entries[channel.name], last=time.monotonic())
        channel.owner = intake
        channel.on_drop = lambda first, n: self.report("source queue dropped", stream=channel.name, samples=n)
        if self._recorder:
            spec = runner.node.specs[output]
            intake.record = self._recorder.add_stream(channel.name, spec, "input", intake.wire.samples)
        intake.promised = self._promised.get(channel.name, NEVER)
        return intake

    # recording, and going on after a crash ---------------------------------------------------------------------------

    def _former(self) -> tuple[Recording | None, Checkpoint | None]:
        """What a broken-off session left, if this one resumes it."""
        self._promised: dict[str, int] = {}
        if not self._resume or self.folder is None:
            return None, None
        recording, checkpoint = Recording.open(self.folder), Checkpoint.load(self.folder)
        if recording.finished and checkpoint is None:
            raise RunError(
                f"{self.folder} holds a session that was ended properly; start a new one instead of resuming it"
            )
        expected = checkpoint.graph if checkpoint else fingerprint(recording.header["graph"])
        if expected != fingerprint(self.graph.text):
            raise RunError(
                f"{self.folder} was recorded with another graph; resume with that one, or start a new session"
            )
        if checkpoint:
            self.pipeline.restore(checkpoint.arrays)
            self._promised = dict(checkpoint.promised)
            self.sequence = checkpoint.sequence
        return recording, checkpoint

    def _open_recording(self, former: Recording | None, checkpoint: Checkpoint | None) -> None:
        if self.folder is None:
            return
        header = {
            "graph": self.graph.text,
            "graph_path": self.graph.path,
            "name": self.graph.name,
            "session": self.graph.session,
            "clock": self.clock.to_json(),
            "started": utc(self.clock.utc_ns),
            "resumed": former is not None,
            "versions": versions(),
        }
        self._recorder = Recorder(self.folder, header, self.graph.recording, resume=former is not None)
        self._keeper = Keeper(self.folder, self._recorder.flush)
        for edge in self.graph.record:
            wire = self.pipeline.wires[str(edge)]
            if wire in self.pipeline.entries.values():
                continue  # the input log holds it anyway
            done = former.last_samples(str(edge)) if former and str(edge) in former.streams else 0
            stream = self._recorder.add_stream(str(edge), wire.spec, "edge", max(done, wire.samples))
            wire.taps.append(self._edge_tap(stream, max(0, done - wire.samples)))

    def _edge_tap(self, stream: int, skip: int) -> Callable[[Chunk], None]:
        """Record an edge, but not again the `skip` samples that are recorded already."""
        recorder = self._recorder
        assert recorder

        def tap(chunk: Chunk) -> None:
            nonlocal skip
            if skip:
                n = min(skip, len(chunk.time))
                skip -= n
                if skip or n == len(chunk.time):
                    return
                chunk = chunk.part(n, len(chunk.time))
            recorder.write(stream, chunk, 0, self.sequence)

        return tap

    def _catch_up(self, recording: Recording, checkpoint: Checkpoint | None) -> None:
        """Work through what was logged after the checkpoint; durable outlets write again what they had written since."""
        for stage in self.pipeline.outlets:
            stage.muted = not stage.operator.durable  # type: ignore[attr-defined]
        self.pipeline.begin()
        self._lanes.repeat(recorded_drops(recording.log), checkpoint.indices if checkpoint else {})
        log.info("going on with a broken-off session", folder=str(self.folder), after=self.sequence)
        intakes = {intake.stream: intake for intake in self._intakes}
        for sequence, stream, chunk, _arrival in recording.inputs(after=self.sequence):
            self.sequence = sequence
            if stream in intakes:
                intakes[stream].promised = max(intakes[stream].promised, chunk.until)
                self.pipeline.feed(stream, chunk)
            self._lanes.settle(self._pump)
        for intake in self._intakes:
            if intake.promised == FOREVER:
                intake.promised = self.clock.utc_ns  # it had ended then; now it begins again
        for stage in self.pipeline.outlets:
            stage.muted = False
        self._lanes.repeat({}, {})
        self.report("session resumed", sequence=self.sequence)

    def _checkpoint(self) -> None:
        """Take the state between two chunks, with the lanes at rest; it is written in the background."""
        if self._keeper is None or self._keeper.busy:
            return
        self._lanes.settle(self._pump)
        self._keeper.keep(
            Checkpoint(
                self.sequence,
                self.clock.now(),
                fingerprint(self.graph.text),
                {i.stream: i.promised for i in self._intakes},
                {name: channel.index for name, channel in self._lanes.channels.items()},
                self.pipeline.snapshot(),
            )
        )

    # the loop --------------------------------------------------------------------------------------------------------

    def _loop(self) -> None:
        began = time.monotonic()
        tick = began + TICK_S
        metrics, checkpoint = began + METRICS_S, began + self.graph.checkpoint_s
        while not self._stopping and self._error is None and not self._ended():
            self._serve(max(0.0, tick - time.monotonic()))
            now = time.monotonic()
            if now < tick:
                continue
            tick = now + TICK_S
            self._look_after(now, began)
            self.pipeline.fold()
            if now >= metrics:
                metrics = now + METRICS_S
                self._measure()
            if now >= checkpoint and self._started:
                checkpoint = now + self.graph.checkpoint_s
                self._checkpoint()

    def _serve(self, timeout_s: float) -> None:
        """Take the next chunk, whoever it comes from; waits at most `timeout_s` for one."""
        if self._put_aside:
            token: Any = self._put_aside.pop(0)
        else:
            try:
                token = self._bell.get(timeout=timeout_s)
            except Empty:
                return
        if token is None or (item := token.take()) is None:
            return
        if isinstance(token.owner, Intake):
            self._accept(token.owner, *item)
        else:
            token.owner(item[0], perf_counter_ns())

    def _pump(self) -> None:
        """Take what lanes send home; chunks of sources are put aside until the lanes are at rest."""
        while True:
            try:
                token = self._bell.get_nowait()
            except Empty:
                break
            if not isinstance(token, Channel):
                continue
            if isinstance(token.owner, Intake):
                self._put_aside.append(token)
            elif (item := token.take()) is not None:
                token.owner(item[0], perf_counter_ns())
        if self._error:
            raise self._error

    def _accept(self, intake: Intake, chunk: Chunk, arrival: int) -> None:
        """A source's chunk enters the graph: lateness is decided, the log written, and all it leads to is done."""
        intake.last = time.monotonic()
        intake.silent = intake.stale = False
        if not self._started and not self._start_with(intake, chunk, arrival):
            return
        if len(chunk.time) and chunk.time[0] <= intake.promised:
            chunk = self._without_late(intake, chunk)
        if chunk.until <= intake.promised:
            if not len(chunk.time) and not chunk.lost:
                return
            chunk.until = intake.promised
        intake.promised = chunk.until
        self.sequence += 1
        if self._recorder:
            self._recorder.write(intake.record, chunk, arrival, self.sequence)
        intake.wire.send(chunk, perf_counter_ns())

    def _without_late(self, intake: Intake, chunk: Chunk) -> Chunk:
        """Samples older than what their source had promised are dropped here, counted and logged."""
        keep = chunk.time > intake.promised
        n = int((~keep).sum())
        intake.late += n
        self.report("late samples dropped", stream=intake.stream, samples=n, at=utc(int(chunk.time[0])))
        return Chunk(
            np.ascontiguousarray(chunk.time[keep]),
            np.ascontiguousarray(chunk.data[keep]),
            chunk.until,
            add_lost(chunk.lost, n),
        )

    def _ended(self) -> bool:
        lasting = [i for i in self._intakes if not i.runner.source.background]
        return bool(lasting) and all(i.promised == FOREVER for i in lasting)

    # the common start ------------------------------------------------------------------------------------------------

    def _start_with(self, intake: Intake, chunk: Chunk, arrival: int) -> bool:
        """Before the common start: live samples are left out, a file's wait. Returns whether this chunk may pass now."""
        if not self._all_ready():
            if not intake.runner.source.live:
                self._held.append((intake, chunk, arrival))
            return False
        self._started = True
        held, self._held = self._held, []
        for item in held:
            self._accept(*item)
        return True

    def _all_ready(self) -> bool:
        return all(r.ready for r in self._runners if r.node.options.required and not r.source.background)

    # looking after the sources ---------------------------------------------------------------------------------------

    def _look_after(self, now: float, began: float) -> None:
        if not self._started:
            self._check_deadlines(now - began)
            if self._all_ready() and (self._held or all(r.source.background for r in self._runners)):
                self._started = True
                held, self._held = self._held, []
                for item in held:
                    self._accept(*item)
        for runner in self._runners:
            runner.watch()
        if self._started:
            for intake in self._intakes:
                self._check_silence(intake, now)

    def _check_deadlines(self, waited_s: float) -> None:
        for runner in self._runners:
            options = runner.node.options
            if options.required and not runner.source.background and not runner.ready and waited_s > options.deadline_s:
                why = f": {runner.error}" if runner.error else ""
                raise DeviceError(
                    f"source {runner.node.name!r} gave nothing within {options.deadline_s:g} s{why};"
                    " connect it, or set `required: false` or a longer `deadline_s`"
                )

    def _check_silence(self, intake: Intake, now: float) -> None:
        """After the stated patience, say that nothing happened, so that nobody waits; after `stale_s`, raise the alarm."""
        options, age = intake.runner.node.options, now - intake.last
        if intake.promised == FOREVER:
            return
        if 0 < options.stale_s < age and not intake.stale:
            intake.stale = True
            self.report("stream is stale", stream=intake.stream, age_s=round(age, 2))
        if 0 < options.patience_s < age:
            until = self.clock.now() - int(options.patience_s * NS)
            if until > intake.promised:
                self._advance(intake, until)

    def _advance(self, intake: Intake, until: int) -> None:
        if not intake.silent:
            intake.silent = True
            self.report("silent source advanced", stream=intake.stream, to=utc(until))
        intake.promised = until
        self.sequence += 1
        chunk = empty(intake.wire.spec, until)
        if self._recorder:
            self._recorder.write(intake.record, chunk, self.clock.now(), self.sequence)
        intake.wire.send(chunk, perf_counter_ns())

    # what is told ----------------------------------------------------------------------------------------------------

    def report(self, kind: str, **facts: Any) -> None:
        """Something worth knowing happened: to the log, and into the recording."""
        (log.error if "failed" in kind else log.warning if kind not in QUIET else log.info)(kind, **facts)
        if self._recorder:
            self._recorder.log(kind, self.clock.now(), **facts)

    def _lane_failed(self, error: Exception) -> None:
        self._error = self._error or error
        self._bell.put(None)

    def _lane_dropped(self, queue: str, first: int, samples: int) -> None:
        self.report(DROPPED, queue=queue, first=first, samples=samples)

    def _measure(self) -> None:
        self.table = table_of(self.pipeline, self._intakes, self._lanes, self._recorder, self.table)
        if self._recorder:
            self._recorder.metrics(self.clock.now(), self.table)
        if self._view:
            self._view.update(self.table)

    # the end ---------------------------------------------------------------------------------------------------------

    def _finish(self) -> None:
        """Stop the sources, work through what had arrived, close every operator and file; each even if another fails."""
        self._down = [r.node.name for r in self._runners if r.state == "failed" or (r.error and r.state == "starting")]
        for runner in self._runners:
            runner.stop()
        steps = [self._drain, self._measure] if self._error is None else [self._close_outlets, self._measure]
        for step in steps:
            try:
                step()
            except Exception as error:
                log.debug("while closing", exc_info=True)
                self._error = self._error or error
                if step == self._drain:
                    self._close_outlets()
        for runner in self._runners:
            if not runner.join():
                self.report("source does not stop", node=runner.node.name)
        for lane in self._lanes.stop():
            self.report("lane does not stop", lane=lane)
        if self._keeper:
            self._keeper.wait()
        if self._error:
            self.report("session failed", error=str(self._error))
        if self._recorder:
            self._recorder.close()
        if self._keeper and self._error is None:
            self._keeper.discard()

    def _drain(self) -> None:
        """Everything that had arrived is worked through, then every operator emits what is pending."""
        while not self._bell.empty() or self._put_aside:
            self._serve(0.0)
        self._lanes.settle(self._pump)
        for intake in self._intakes:
            if intake.promised != FOREVER:
                intake.wire.send(empty(intake.wire.spec, FOREVER), perf_counter_ns())
        self._lanes.settle(self._pump)
        self.pipeline.close(lambda: self._lanes.settle(self._pump))

    def _close_outlets(self) -> None:
        for stage in self.pipeline.outlets:
            stage.close()

    def _exit_code(self) -> int:
        if self._error:
            return getattr(self._error, "exit_code", 4)
        if self._down:
            return 3
        incomplete = self._recorder is not None and bool(self._recorder.status.dropped)
        return 5 if incomplete or any(s.failed for s in self.pipeline.outlets) else 0


QUIET = {"source ended", "session resumed", "source reopened"}
"""Reports that are news, not warnings."""


def _last_time(recording: Recording | None) -> int:
    """The last stamp that a former session gave."""
    if recording is None:
        return NEVER
    return max(
        [s.last for s in recording.streams.values() if s.last is not None and s.last < FOREVER // 2], default=NEVER
    )
