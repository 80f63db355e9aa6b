"""kinegraph: graphs from YAML. "fed" goes through the pipeline as replay does; "session" is a whole live session with a source in its own
thread, "unrecorded" the same without a recording. Metrics are always on; the recorder writes the input log and, in the overhead's graphs,
the last edge."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from time import perf_counter_ns

import structlog

from bench.parts import TRIAL, feed_all, leave
from bench.work import CUTOFF_HZ, EVERY, ORDER, RATE_HZ, WINDOW, Feed, Sink, Step
from bench.worker import SESSION, UNRECORDED, serve
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recorder
from kinegraph.stream.system.stalls import calm

CHAIN = f"""
  rectify: {{use: operators.filters.rectify.Rectify, from: device}}
  lowpass: {{use: operators.filters.iir.Lowpass, from: rectify, cutoff_hz: {CUTOFF_HZ}, order: {ORDER}}}
  thin: {{use: operators.filters.decimate.Decimate, from: lowpass, every: {EVERY}}}
  mean: {{use: operators.filters.moving.MovingMean, from: thin, window_s: {WINDOW * EVERY / RATE_HZ}}}
  count: {{use: bench.parts.Count, from: mean}}
"""


def graph_of(steps: Sequence[Step | None], *, live: bool) -> str:
    """The YAML of a graph: the chain, or as many identities as there are steps."""
    text = f"nodes:\n  device: {{use: bench.parts.Device, live_pace: {str(live).lower()}}}"
    if any(steps):
        return text + CHAIN
    names = ["device", *(f"same{i}" for i in range(len(steps)))]
    for before, name in pairwise(names):
        text += f"\n  {name}: {{use: bench.parts.Identity, from: {before}}}"
    return text + f"\n  count: {{use: bench.parts.Count, from: {names[-1]}}}\nrecord: [{names[-1]}]\n"


class Kinegraph:
    def versions(self) -> dict[str, str]:
        return {"kinegraph": version("kinegraph")}

    def drive(self, style: str, steps: Sequence[Step | None], feed: Feed, sink: Sink) -> tuple[int, int]:
        TRIAL.feed, TRIAL.sink, TRIAL.take = feed, sink, leave
        graph = load_text(graph_of(steps, live=feed.paced or style in (SESSION, UNRECORDED)))
        if style in (SESSION, UNRECORDED):
            self._session(graph, recorded=style == SESSION)
        else:
            self._fed(graph, feed, sink, recorded=not any(steps))
        return EVERY, 0

    def _session(self, graph: object, *, recorded: bool) -> None:
        folder = Path(tempfile.mkdtemp(prefix="kinegraph-bench-"))
        try:
            outcome = Session(graph, folder / "session" if recorded else None).run()  # type: ignore[arg-type]
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        if outcome.error:
            raise outcome.error

    def _fed(self, graph: object, feed: Feed, sink: Sink, *, recorded: bool) -> None:
        """With the recorder, the work is over when it has written everything: it shares the interpreter, so all of it must count."""
        pipeline = Pipeline(graph)  # type: ignore[arg-type]
        folder = Path(tempfile.mkdtemp(prefix="kinegraph-bench-"))
        recorder = Recorder(folder / "session", {"graph": ""}, RecordingOptions(), wait=True) if recorded else None
        try:
            if recorder:
                for role, wire in (("input", pipeline.edges["device"]), ("edge", pipeline.edges[last_edge(pipeline)])):
                    number = recorder.add_stream(str(wire.origin), wire.spec, role)  # type: ignore[arg-type]
                    wire.observers.append(lambda chunk, n=number: recorder.write(n, chunk, chunk.until, 0))  # type: ignore[misc]
            with calm():
                pipeline.begin()
                feed_all(pipeline, feed)
        finally:
            if recorder:
                recorder.close()
                sink.calls.append((perf_counter_ns(), 0))
            shutil.rmtree(folder, ignore_errors=True)


def last_edge(pipeline: Pipeline) -> str:
    return [name for name in pipeline.edges if name.startswith("same")][-1]


if __name__ == "__main__":
    structlog.configure(logger_factory=structlog.ReturnLoggerFactory())
    serve(Kinegraph())
