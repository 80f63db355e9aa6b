"""Graphs at work for Python: on arrays, on a recording, on devices; and operators held to the laws."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from stream.arrays import series
from stream.chunk import Chunk, StreamSpec, add_lost
from stream.commands.ending import Ending
from stream.commands.run import simulated
from stream.conformance import hold, trials
from stream.engine.replay import Replay
from stream.engine.session import Session
from stream.engine.status import Outcome
from stream.errors import KinegraphError, nearest
from stream.face.builder import GraphBuilder
from stream.face.results import Results
from stream.graph import Edge, Graph
from stream.operator import Operator
from stream.recording import Recording
from stream.recording.place import refuse_taken_folder
from stream.recording.series import write_recording
from stream.series import Series
from stream.source import Source

CHUNK_S = 1.0
"""Arrays are cut into chunks of so much time; by the first law that changes no bit."""


def load(path: Path | str, overrides: Mapping[str, Any] | None = None) -> GraphBuilder:
    """A graph from a YAML file, or by a shipped graph's bare name ("treadmill_emg"); raises GraphError.

    `overrides` replace what the file says: {"envelope.cutoff_hz": 10}.
    """
    return GraphBuilder.load(path, overrides)


def run(
    graph: GraphBuilder | Path | str,
    folder: Path | str | None = None,
    *,
    duration_s: float = 0.0,
    simulate: bool = False,
) -> Outcome:
    """Run a graph on its devices, live; returns when every source has ended, after `duration_s`, or at Ctrl-C.

    folder     where the session is recorded, a new one; None: not at all
    simulate   simulated devices in the place of real ones

    Raises where an operator fails or a device is missing; the outcome's `exit_code` is 5 where an outlet or the recording lost something.
    """
    checked = _builder(graph).check()
    if folder is not None:
        refuse_taken_folder(Path(folder))
    with simulated(checked) if simulate else nullcontext(), ExitStack() as stack:
        session = Session(checked, Path(folder) if folder is not None else None, duration_s=duration_s)
        if threading.current_thread() is threading.main_thread():
            stack.enter_context(Ending(session, lambda outcome: None))
        outcome = session.run()
    if outcome.error is not None:
        raise outcome.error
    return outcome


def replay(
    graph: GraphBuilder | Path | str,
    recording: Recording | Path | str,
    *,
    keep: Iterable[str] = (),
    outlets: Iterable[str] = (),
) -> Results:
    """Run a graph on a recording, whose streams take the places of the sources of the same names.

    `Results.differing` names the edges that came out otherwise than they were recorded.
    """
    return on_recording(_builder(graph), recording, keep, outlets)


def _builder(graph: GraphBuilder | Path | str) -> GraphBuilder:
    return graph if isinstance(graph, GraphBuilder) else GraphBuilder.load(graph)


def on_recording(
    graph: GraphBuilder, recording: Recording | Path | str, keep: Iterable[str], outlets: Iterable[str]
) -> Results:
    """What a graph makes of a recording."""
    if not isinstance(recording, Recording):
        with Recording.open(Path(recording)) as opened:
            return on_recording(graph, opened, keep, outlets)
    checked = graph.fed_from({name: stream.spec for name, stream in recording.streams.items()})
    checked.session = recording.header.get("session") or checked.session
    speaking = {*outlets}
    for name in speaking - checked.outlets:
        raise KinegraphError(f"there is no outlet {name!r}; {nearest(name, checked.outlets)}")
    at_work = Replay(checked, recording, speaking=speaking)
    kept: dict[str, list[Chunk]] = {name: [] for name in _kept(at_work.graph, [*keep])}
    for name, chunks in kept.items():
        at_work.observe(name, chunks.append)
    replayed = at_work.run()
    results = Results({name: _joined(name, at_work.graph, chunks) for name, chunks in kept.items()})
    results.differing = tuple(replayed.differing)
    return results


def _kept(graph: Graph, asked: list[str]) -> list[str]:
    """The edges that come back."""
    there = {str(Edge(n.name, out)): n for n in graph.nodes.values() for out in n.specs}
    for name in asked:
        if name not in there:
            raise KinegraphError(f"keep: there is no output {name!r}; {nearest(name, there)}")
    computed = [name for name, node in there.items() if not node.is_source]
    return asked or list(map(str, graph.record)) or computed


def _joined(name: str, graph: Graph, chunks: list[Chunk]) -> Series:
    node, _, output = name.partition(".")
    specs = graph.nodes[node].specs
    spec = specs[output or next(iter(specs))]
    time = np.concatenate([np.empty(0, np.int64), *(chunk.time for chunk in chunks)])
    data = np.concatenate([np.empty((0, *spec.shape), spec.dtype), *(chunk.data for chunk in chunks)])
    lost = np.zeros(len(time), np.int64)
    at = owed = 0
    for chunk in chunks:
        owed = add_lost(owed, chunk.lost)
        if len(chunk):
            lost[at], owed = owed, 0
            at += len(chunk)
    return Series(name, spec, time, data, lost if lost.any() else None)


def on_arrays(
    graph: GraphBuilder,
    data: Any,
    keep: Iterable[str],
    outlets: Iterable[str],
    *,
    rate_hz: float | None = None,
    time: Any = None,
) -> Results:
    """What a graph makes of arrays in the place of its sources."""
    wanted = _fed(graph)
    if not isinstance(data, Mapping):
        if len(wanted) != 1:
            names = ", ".join(f"{name!r}: ..." for name in wanted)
            raise KinegraphError(f"the graph reads {len(wanted)} streams; give a mapping of arrays: {{{names}}}")
        data = {next(iter(wanted)): data}
    elif time is not None or rate_hz is not None:
        raise KinegraphError(
            "rate_hz and time are of a single array; a mapping takes kinegraph.Series, which have their own"
        )
    given = [_series(name, value, wanted, rate_hz, time) for name, value in data.items()]
    with TemporaryDirectory(prefix="kinegraph-") as folder:
        path = Path(folder) / "arrays.mcap"
        write_recording(path, given, {"graph": "", "session": {}}, chunk_s=CHUNK_S)
        return on_recording(graph, path, keep, outlets)


def _fed(graph: GraphBuilder) -> dict[str, StreamSpec]:
    """The outputs of sources that arrays may take the place of: all that a device, not a person, gives."""
    found: dict[str, StreamSpec] = {}
    for name, part in graph.nodes.items():
        if isinstance(part, Source) and not part.background:
            found |= {str(Edge(name, output)): graph.specs[str(Edge(name, output))] for output in part.outputs}
    return found


def _series(name: str, value: Any, wanted: Mapping[str, StreamSpec], rate_hz: float | None, time: Any) -> Series:
    if name not in wanted:
        raise KinegraphError(f"there is no source {name!r}; {nearest(name, wanted)}")
    if isinstance(value, Series):
        made = series(value.data, name=name, time=value.time, spec=value.spec)
        return Series(name, value.spec, made.time, made.data, value.lost if value.lost is not None else made.lost)
    return series(value, name=name, rate_hz=rate_hz, time=time, spec=wanted[name])


def try_(operator: type[Operator[Any]], *, examples: int = 50, seed: int = 1) -> None:
    """Hold an operator's class to the laws on its `cases`; raises `Broken`: which law is broken, where, and what to do."""
    for make in trials(operator):
        hold(make(), examples, seed)
