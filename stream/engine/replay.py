"""Replay: a recording replaces the sources of the same names; the graph gives what it gave live, bit for bit."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter_ns
from typing import Any

from numpy.lib.recfunctions import repack_fields

from kinegraph.stream.chunk import FOREVER, NS, Chunk, empty
from kinegraph.stream.domain.finding import recorded_findings
from kinegraph.stream.engine.ahead import CompilationReport
from kinegraph.stream.engine.flow.edge import Observer, Push
from kinegraph.stream.engine.flow.promise import Inside
from kinegraph.stream.engine.flow.queues import recorded_drops
from kinegraph.stream.engine.pace import Pace
from kinegraph.stream.engine.pipeline import Pipeline, Stage
from kinegraph.stream.engine.status import Rates, SessionView, Table, table_of_replay
from kinegraph.stream.engine.substitutes import Substitutes
from kinegraph.stream.engine.warmup import Compilations, warm_up
from kinegraph.stream.graph import Edge, Graph
from kinegraph.stream.graph.session_check import refuse_unsuited
from kinegraph.stream.recording import Recorder, Recording, versions
from kinegraph.stream.recording.format.image import is_picture
from kinegraph.stream.recording.format.packed import Packer
from kinegraph.stream.recording.read.joined import joinable, joined

FOLD_EVERY = 1000
"""Chunks between two foldings of the durations."""
TOLD_S = 1.0
"""How often whoever shows a replay is given its metrics."""


class Digest:
    """A hash of a stream's samples, stamps and gap positions that does not depend on how they were cut into chunks."""

    def __init__(self, limit: int | None = None, fields: tuple[str, ...] = ()) -> None:
        """`limit`: only this many samples count. `fields`: of events only these, where they have them and more."""
        self._data, self._time, self._gaps = hashlib.blake2b(), hashlib.blake2b(), hashlib.blake2b()
        self.samples = 0
        self._limit, self._fields = limit, fields

    def add(self, chunk: Chunk) -> None:
        n = len(chunk.time)
        if self._limit is not None and self.samples + n > self._limit:
            n = self._limit - self.samples
        if not n:
            return
        if chunk.lost:
            self._gaps.update(f"{self.samples}:{chunk.lost};".encode())
        data = chunk.data[:n]
        if self._fields and set(self._fields) < set(
            data.dtype.names or ()
        ):  # recorded before events had all their fields
            data = repack_fields(data[list(self._fields)])
        self._data.update(data.tobytes())
        self._time.update(chunk.time[:n].tobytes())
        self.samples += n

    def hexdigest(self) -> str:
        return hashlib.blake2b(
            self._data.digest() + self._time.digest() + self._gaps.digest(), digest_size=16
        ).hexdigest()


@dataclass(slots=True)
class Replayed:
    """What a replay came to.

    digests    per recorded edge that the graph computes: (recorded, replayed) digest; of a stream that was cut off, as by a power cut, of
               as many samples as the recording holds
    seconds    of session time that were replayed
    took_s     how long that took
    broken     per edge of a node that did not keep what its spec promises: what came first; only of a replay that looks for it
    """

    digests: dict[str, tuple[str, str]] = field(default_factory=dict)
    samples: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    took_s: float = 0.0
    compiled: list[str] = field(default_factory=list)
    stopped: bool = False
    broken: dict[str, str] = field(default_factory=dict)

    @property
    def differing(self) -> list[str]:
        """Edges with replayed samples that differ from those recorded."""
        return [name for name, (recorded, replayed) in self.digests.items() if recorded != replayed]


class Replay:
    """A graph fed from a recording, on the caller's thread.

    speaking   names of the outlets that take part; the others stay silent
    speed      how many times real time; None: as fast as it goes; or a `Pace`, which others may change meanwhile
    output     record the graph's edges again, into this file or folder
    strict     look at every chunk whether it keeps its node's promises
    view       shows the replay's metrics; None: no view
    """

    def __init__(
        self,
        graph: Graph,
        recording: Recording,
        *,
        speaking: Container[str] = (),
        speed: float | Pace | None = None,
        output: Path | None = None,
        strict: bool = False,
    ) -> None:
        refuse_unsuited(graph)
        self.substitutes = Substitutes.of(graph, recording.streams)
        self.graph, self.recording = self.substitutes.reduced(graph), recording
        self.pace: Pace | None = speed if isinstance(speed, Pace) else Pace(speed) if speed else None
        self.graph.replays = recording.path.name
        self.graph.recorded_in = str(output or "")
        self.graph.imported = tuple((recording.header.get("imported") or {}).get("files", ()))
        self.graph.findings = [finding.text for finding in recorded_findings(recording)]
        self._drops = recorded_drops(recording.log)
        self.pipeline = Pipeline(self.graph, speaking=speaking, bridge=self._bridge)
        self.sequence, self._arrival = -1, 0
        self._output = output
        # chunks carry no meaning, but pace, a new recording and drops are counted by them
        self._joins = speed is None and output is None and not self._drops
        self._stopping = False
        self.view: SessionView | None = None
        self.starting: CompilationReport = lambda text, over: None
        self._table: Table = {}
        self._rates = Rates()
        self._due = 0.0
        edges = {name: edge for name, edge in self.pipeline.edges.items() if name not in self.pipeline.entries}
        self._inside = {name: Inside() for name in edges} if strict else {}
        for name, inside in self._inside.items():
            edges[name].observers.append(inside.look)

    def _bridge(self, stage: Stage, port: str, edge: Edge, push: Push) -> Push:
        """Workers run on this thread, in order; what their queues dropped live is left out again."""
        drops = self._drops.get(f"{edge} -> {stage.node.name}.{port}")
        return push if drops is None else lambda chunk, start: push(drops.repeat(chunk), start)

    @property
    def length_s(self) -> float:
        """From the first input's arrival to the last one's."""
        first = next(iter(self.recording.inputs(also=self.substitutes.taken)), None)
        return (self.recording.end_of_inputs - first[3]) / NS if first else 0.0

    def stop(self) -> None:
        """End after the chunk in slot, cleanly."""
        self._stopping = True
        if self.pace:
            self.pace.stop()

    def observe(self, edge: str, observer: Observer) -> None:
        """Pass every chunk of a computed edge to `observer`; call it before `run`."""
        self.pipeline.edges[edge].observers.append(observer)

    def run(self, progress: Callable[[float], None] = lambda done_s: None) -> Replayed:
        """Feed the whole recording; `progress` receives the seconds of session time done so far."""
        warm_up(self.pipeline, report=self.starting)
        if any(stream.kept == "packed" for stream in self.recording.streams.values()):
            Packer()
        recorder = self._open_output()
        result = Replayed()
        computed = self._listen()
        recorded = {name: Digest() for name in computed}
        self.pipeline.begin()
        compilations = Compilations()
        began = time.monotonic()
        try:
            self._feed_all(recorder, progress, result, recorded)
            self._close()
        finally:
            compilations.stop()
            if recorder:
                recorder.close()
        if recorder:
            recorder.check()
        result.took_s = time.monotonic() - began
        result.compiled = compilations.names
        result.samples = {name: edge.samples for name, edge in self.pipeline.edges.items()}
        result.broken = {name: inside.broken for name, inside in self._inside.items() if inside.broken}
        result.digests = {name: (recorded[name].hexdigest(), digest.hexdigest()) for name, digest in computed.items()}
        return result

    def _chunks(self, recorded: dict[str, Digest]) -> Iterable[tuple[int, str, Chunk, int]]:
        """What is fed, and beside it the recorded edges; in long chunks where nothing needs them as they came."""
        streams = self.recording.streams
        inputs = {name for name, s in self.recording.inputs_recorded.items() if s.kept != "outline"}
        names = {*inputs, *self.substitutes.taken, *recorded}
        if self._joins and all(joinable(streams[name].spec) for name in names):
            return joined(self.recording, names)
        for name, digest in recorded.items():
            for chunk in self.recording.chunks(name):
                digest.add(chunk)
        return self.recording.inputs(also=self.substitutes.taken)

    def _feed_all(
        self,
        recorder: Recorder | None,
        progress: Callable[[float], None],
        result: Replayed,
        recorded: dict[str, Digest],
    ) -> None:
        entries = {name: edge.send for name, edge in self.pipeline.entries.items()}
        numbers = self._numbers if recorder else {}
        first: int | None = None
        for count, (sequence, stream, chunk, arrival) in enumerate(self._chunks(recorded)):
            if self._stopping:
                result.stopped = True
                break
            send = entries.get(stream)
            if send is None:
                if stream in recorded:
                    recorded[stream].add(chunk)
                continue
            self.sequence, self._arrival = sequence, arrival
            first = arrival if first is None else first
            if self.pace and not self.pace.keep((arrival - first) / NS):
                result.stopped = True
                break
            if recorder:
                recorder.write(numbers[stream], chunk, arrival, sequence)
            send(chunk, perf_counter_ns())
            if self.view and time.monotonic() >= self._due:
                self._report(self.view)
            if not count % FOLD_EVERY:
                self.pipeline.fold()
                result.seconds = (arrival - first) / NS
                progress(result.seconds)
        else:
            result.seconds = self.recording.duration_ns / NS
            progress(result.seconds)

    def _report(self, view: SessionView) -> None:
        # by the clock of the person who looks, not of the data, which may go by in a hundredth of the time
        self._due, self._table = time.monotonic() + TOLD_S, table_of_replay(self.pipeline, self._rates)
        view.update(self._table)

    def _close(self) -> None:
        """As a live session ends: every source's stream is over, then every operator emits what is pending."""
        for edge in self.pipeline.entries.values():
            edge.send(empty(edge.spec, FOREVER), perf_counter_ns())
        self.pipeline.close()

    def _listen(self) -> dict[str, Digest]:
        """Digests of the edges that the recording also holds."""
        digests: dict[str, Digest] = {}
        for name, stream in self.recording.streams.items():
            computed = name in self.pipeline.edges and name not in self.substitutes.taken
            if stream.role == "edge" and computed:
                # cut off: operators emit more at the replay's end than was ever recorded
                limit = stream.samples if stream.until < FOREVER else None
                digests[name] = Digest(limit, stream.spec.dtype.names or ())
                self.pipeline.edges[name].observers.append(digests[name].add)
        return digests

    def _outlined(self, entry: str) -> bool:
        """Whether a source's images are left out when its chunks are recorded again."""
        return is_picture(self.pipeline.entries[entry].spec) and entry not in map(str, self.graph.record)

    def _open_output(self) -> Recorder | None:
        if self._output is None:
            return None
        header: dict[str, Any] = {
            **self.recording.header,
            "graph": self.graph.text,
            "graph_path": self.graph.path,
            "name": self.graph.name,
            "replayed": True,
            "versions": versions(),
        }
        recorder = Recorder(self._output, header, self.graph.recording, wait=True)
        taken = self.substitutes.taken
        self._numbers = {
            name: recorder.add_stream(
                name, edge.spec, "edge" if name in taken else "input", outline=self._outlined(name)
            )
            for name, edge in self.pipeline.entries.items()
        }
        for name in self.substitutes.missing:
            recorder.add_stream(name, self.recording.streams[name].spec, "input", outline=True)
        for entry in self.recording.log:  # its drops belong to this replay as well
            recorder.log(entry["kind"], entry["time"], **{k: v for k, v in entry.items() if k not in ("kind", "time")})
        for name in map(str, self.graph.record):
            if name not in self.pipeline.entries:
                edge = self.pipeline.edges[name]
                edge.observers.append(self._observer(recorder, recorder.add_stream(name, edge.spec, "edge")))
        return recorder

    def _observer(self, recorder: Recorder, number: int) -> Observer:
        return lambda chunk: recorder.write(number, chunk, self._arrival, self.sequence)
