"""What a session leaves on disk: the input log, recorded edges, what happened, metrics, checkpoints; and what a prior session left."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import Any

import structlog

from kinegraph.stream.chunk import FOREVER, NEVER, Chunk, StreamSpec, utc
from kinegraph.stream.compiler.fingerprint import fingerprint_of_class
from kinegraph.stream.domain.finding import REPORT, Finding
from kinegraph.stream.engine.flow.merge import Merge
from kinegraph.stream.engine.flow.queues import DROPPED
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.errors import KinegraphError, RecordingError
from kinegraph.stream.graph import Graph
from kinegraph.stream.recording import Recorder, RecorderStatus, Recording, versions
from kinegraph.stream.recording.format.checkpoint import Checkpoint, CheckpointWriter, fingerprint
from kinegraph.stream.recording.format.image import is_picture
from kinegraph.stream.recording.format.paths import is_running, parts_of
from kinegraph.stream.system.clock import SessionClock

QUIET = {"device", "source ended", "session resumed", "source reopened", "asked to end"}
"""Reports that are news, not warnings."""
LOSSES = {"late samples dropped", "source queue dropped", DROPPED}
"""Reports that may come with every chunk."""
SETTLE_S = 0.2
"""Beyond this, a slow disk holds up the start no longer."""
TOLD_EVERY_S = 10.0
"""On the screen, a stream's or queue's losses are reported at once, and then this often; the recording keeps each."""

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class Loss:
    """What a stream or queue has lost since the last report on the screen.

    next    when it may be reported again (monotonic s)
    facts   of the first of these losses
    """

    next: float = 0.0
    times: int = 0
    samples: int = 0
    facts: dict[str, Any] = field(default_factory=dict)

    def add(self, facts: dict[str, Any]) -> None:
        self.facts = self.facts if self.times else facts
        self.times += 1
        self.samples += facts["samples"]

    def summary(self, now: float) -> dict[str, Any]:
        """The facts to be reported now, with all samples lost; from here on it is counted from zero."""
        facts = self.facts | {"samples": self.samples} | ({"times": self.times} if self.times > 1 else {})
        self.next, self.times, self.samples = now + TOLD_EVERY_S, 0, 0
        return facts


class PriorSession:
    """A session that was broken off: its recording and its last checkpoint, if it came to one."""

    def __init__(self, folder: Path, graph: Graph) -> None:
        """Raises RecordingError where it cannot be resumed with this graph."""
        if is_running(folder):
            raise RecordingError(
                f"{folder}: another kinegraph is still recording there; stop it before resuming its session"
            )
        self.recording = Recording.open(folder)
        try:
            self.checkpoint = Checkpoint.load(folder)
            self._check(folder, graph)
        except KinegraphError:
            self.recording.close()
            raise

    def _check(self, folder: Path, graph: Graph) -> None:
        if self.recording.finished and self.checkpoint is None:
            raise RecordingError(
                f"{folder} holds a session that ended normally; start a new one instead of resuming it"
            )
        graph_then = self.checkpoint.graph if self.checkpoint else fingerprint(str(self.recording.header.get("graph")))
        if graph_then != fingerprint(graph.text):
            raise RecordingError(
                f"{folder} was recorded with another graph, or with other values of --set; resume with the same, or start a new session"
            )

        now, then = code_of(graph), self.recording.header.get("code")
        if then != now:
            changed = [name for name in now if not isinstance(then, dict) or then.get(name) != now[name]]
            uses = [f"{node.name!r} ({node.use})" for name in changed if (node := graph.nodes.get(name))]
            what = f"of node {uses[0]}" if len(uses) == 1 else f"of {len(uses)} nodes" if uses else "of kinegraph"
            raise RecordingError(
                f"{folder} was recorded with another version of the code {what}, to which its state may mean something else, and cannot be"
                " resumed; what it recorded can be replayed: start a new session"
            )

    @property
    def last_time(self) -> int:
        """The last stamp that it gave."""
        lasts = [s.last for s in self.recording.streams.values() if s.last is not None and s.last < FOREVER // 2]
        return max(lasts, default=NEVER)

    def recorded(self, edge: str) -> int:
        """How many samples of an edge are recorded."""
        return self.recording.last_samples(edge) if edge in self.recording.streams else 0

    def recorded_through(self, edge: str) -> int:
        """Index in the input log of the last input with a recorded answer on an edge; -1: no input."""
        return self.recording.streams[edge].last_sequence if edge in self.recording.streams else -1


def code_of(graph: Graph) -> dict[str, str]:
    """By node, a hash of the code that gives its state a meaning; under "" that of the engine's own state."""
    return {"": fingerprint_of_class(Merge)} | {
        name: fingerprint_of_class(type(node.part)) for name, node in graph.nodes.items()
    }


class SessionLog:
    """Everything that is written while a session runs. Without a folder it writes nothing, and everything else is as ever.

    sequence   the number of the input log's last chunk
    arrival    when it came (ns of session time)
    recorder   what records; None without a folder
    """

    def __init__(
        self,
        folder: Path | None,
        graph: Graph,
        clock: SessionClock,
        prior: PriorSession | None,
        *,
        waits: bool = False,
    ) -> None:
        """Nothing is written before `open`. `waits`: no source is live, so that the graph can wait for the disk."""
        self.folder, self._graph, self._clock, self._prior = folder, graph, clock, prior
        checkpoint = prior.checkpoint if prior else None
        self.sequence = checkpoint.sequence if checkpoint else -1
        self.arrival = 0
        self.recorder: Recorder | None = None
        self._checkpoints: CheckpointWriter | None = None
        self._begun, self._waits = prior is not None, waits
        self._losses: dict[tuple[str, str], Loss] = {}
        self._losing = Lock()

    def open(self) -> None:
        """Begin the recording; raises RecordingError where that cannot be."""
        if self.folder is not None:
            resume = self._prior is not None
            self.recorder = Recorder(
                self.folder, self._header(), self._graph.recording, resume=resume, waits=self._waits
            )
            self._checkpoints = CheckpointWriter(self.folder, self.recorder.flush)

    def _header(self) -> dict[str, Any]:
        return {
            "graph": self._graph.text,
            "graph_path": self._graph.path,
            "name": self._graph.name,
            "session": self._graph.session,
            "clock": self._clock.to_json(),
            "started": utc(self._clock.utc_ns),
            "resumed": self._prior is not None,
            "versions": versions(),
            "code": code_of(self._graph),
        }

    def add_input(self, stream: str, spec: StreamSpec, first: int) -> int:
        """Declare a stream of the input log; returns its number. Images are kept only if the graph names them under `record`."""
        if self.recorder is None:
            return -1
        outline = is_picture(spec) and stream not in map(str, self._graph.record)
        if outline:
            log.info("images are not recorded; name the stream under `record` to keep them", stream=stream)
        return self.recorder.add_stream(stream, spec, "input", first, outline=outline)

    def observe_edges(self, pipeline: Pipeline) -> None:
        """Record the edges that the graph asks for; what the input log holds anyway is not doubled."""
        if self.recorder is None:
            return
        for name in map(str, self._graph.record):
            if name not in pipeline.entries:
                edge = pipeline.edges[name]
                done = self._prior.recorded(name) if self._prior else 0
                number = self.recorder.add_stream(name, edge.spec, "edge", max(done, edge.samples))
                through = self._prior.recorded_through(name) if self._prior else -1
                edge.observers.append(self._observer(number, max(0, done - edge.samples), through))

    def _observer(self, number: int, skip: int, through: int) -> Callable[[Chunk], None]:
        """Record an edge, but not again the `skip` samples, nor the watermarks up to input `through`, that are recorded already."""
        recorder = self.recorder
        assert recorder

        def observe(chunk: Chunk) -> None:
            nonlocal skip
            if skip:
                n = min(skip, len(chunk.time))
                skip -= n
                if skip or n == len(chunk.time):
                    return
                chunk = chunk.part(n, len(chunk.time))
            if not len(chunk.time) and self.sequence <= through:
                return
            recorder.write(number, chunk, self.arrival, self.sequence)

        return observe

    def enter(self, number: int, chunk: Chunk, arrival: int, joined: bool = False) -> None:
        """A chunk enters the graph: its place in the input log. One that was `joined` lies in memory that no source writes to."""
        self.sequence += 1
        self.arrival = arrival
        if self.recorder:
            self.recorder.write(number, chunk, arrival, self.sequence, owned=joined)

    def idle_hint(self) -> None:
        """The session has nothing to do just now: a good moment for the recorder's thread."""
        if self.recorder and self.recorder.patient:
            self.recorder.idle_hint()

    def report(self, kind: str, **facts: Any) -> None:
        """Write an event into the recording and the log."""
        if self.recorder:
            self.recorder.log(kind, self._clock.now(), **facts)
        if kind == REPORT:
            self._graph.findings.append(Finding.from_facts(facts).text)
        if kind in LOSSES:
            with self._losing:  # what a source's queue drops is reported on its own thread
                self._losses.setdefault((kind, facts.get("stream") or facts["queue"]), Loss()).add(facts)
            self._report_losses(monotonic())
        else:
            tell = log.error if "failed" in kind else log.info if kind in QUIET else log.warning
            tell(kind, **facts)

    def asked_to_end(self, by: str) -> None:
        """Record the signal that ended the session, if any: it explains a short recording. A time limit sends a signal, too."""
        if by:
            with suppress(OSError, ValueError):  # there may be no terminal any more
                self.report("asked to end", by=by)

    def _report_losses(self, now: float) -> None:
        with self._losing:
            due = [
                (kind, loss.summary(now)) for (kind, _), loss in self._losses.items() if loss.times and now >= loss.next
            ]
        for kind, facts in due:
            log.warning(kind, **facts)

    def metrics(self, table: dict[str, Any]) -> None:
        self._report_losses(monotonic())
        if self.recorder:
            self.recorder.metrics(self._clock.now(), table)

    @property
    def wants_checkpoint(self) -> bool:
        return self._checkpoints is not None and not self._checkpoints.busy

    def checkpoint(self, promised: dict[str, int], indices: dict[str, int], pipeline: Pipeline) -> None:
        """Keep the state as it is now; it is copied here and written in the background. The first one is waited for, for a moment at
        most: no file is opened beside the first samples then."""
        assert self._checkpoints
        now, graph = self._clock.now(), fingerprint(self._graph.text)
        kept = Checkpoint(self.sequence, now, graph, promised, indices, pipeline.snapshot())
        part = self.recorder.part if self.recorder and self._graph.recording.rolling else 0
        self._checkpoints.write(kept, lambda: self._forget(part))
        if not self._begun:
            self._begun = True
            self._checkpoints.wait(SETTLE_S)

    def _forget(self, part: int) -> None:
        """Delete the files before a part: a checkpoint on the disk knows what they hold. Raises OSError."""
        if part and self.folder is not None:
            for path in parts_of(self.folder, before=part):
                path.unlink()

    def handed(self) -> int:
        """The newest arrival (ns) that the recording was handed; FOREVER where nothing is recorded."""
        return self.recorder.handed if self.recorder else FOREVER

    def saved(self) -> int:
        """Up to which arrival (ns) the recording is on the disk; FOREVER where nothing is recorded."""
        return self.recorder.saved if self.recorder else FOREVER

    @property
    def status(self) -> RecorderStatus | None:
        return self.recorder.status if self.recorder else None

    def close(self, *, well: bool) -> None:
        """End the recording. After a session that ended `well` there is nothing to resume."""
        self._report_losses(FOREVER)
        if self._checkpoints:
            self._checkpoints.wait()
        if self.recorder:
            self.recorder.close()
        if self._checkpoints and well:
            self._checkpoints.discard()
            if self._graph.recording.rolling and self.folder is not None:
                for path in parts_of(self.folder):
                    path.unlink(missing_ok=True)
