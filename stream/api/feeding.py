"""A graph fed from Python: what it makes of arrays or of a recording in the place of its sources."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

from kinegraph.stream.api.notebook_bar import notebook_bar
from kinegraph.stream.api.results import Results
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.data.arrays import series
from kinegraph.stream.data.series import Series
from kinegraph.stream.engine.replay import Replay
from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.graph import Edge, Graph
from kinegraph.stream.operator import Operator
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import write_recording
from kinegraph.stream.source import Source
from kinegraph.stream.text.short_names import whole_name

CHUNK_S = 1.0
"""Arrays are cut into chunks of this length; by the first law that changes no bit."""


class Feedable(Protocol):
    """A graph that is still to be checked against what it is fed with."""

    @property
    def nodes(self) -> Mapping[str, Source | Operator[Any]]:
        """Its parts by name."""

    @property
    def specs(self) -> Mapping[str, StreamSpec]:
        """What flows, by edge."""

    def fed_from(self, recorded: Mapping[str, StreamSpec]) -> Graph:
        """The engine's graph, with these streams in the places of the sources of the same names."""


def on_recording(
    graph: Feedable, recording: Recording | Path | str, keep: Iterable[str], outlets: Iterable[str]
) -> Results:
    """What a graph makes of a recording."""
    if not isinstance(recording, Recording):
        with Recording.open(Path(recording)) as opened:
            return on_recording(graph, opened, keep, outlets)
    checked = graph.fed_from({name: stream.spec for name, stream in recording.streams.items()})
    checked.session = recording.header.get("session") or checked.session
    speaking = {whole_name(name, checked.outlets) for name in outlets}
    for name in speaking - checked.outlets:
        raise KinegraphError(f"there is no outlet {name!r}; {nearest(name, checked.outlets)}")
    at_work = Replay(checked, recording, speaking=speaking)
    kept: dict[str, list[Chunk]] = {name: [] for name in _kept(at_work.graph, [*keep])}
    for name, chunks in kept.items():
        at_work.observe(name, chunks.append)
    with notebook_bar("replay", recording.duration_ns / NS) as progress:
        replayed = at_work.run(progress)
    results = Results({name: _joined(name, at_work.graph, chunks) for name, chunks in kept.items()})
    results.differing = tuple(replayed.differing)
    return results


def _kept(graph: Graph, asked: list[str]) -> list[str]:
    """The edges that come back."""
    there = {str(Edge(n.name, out)): n for n in graph.nodes.values() for out in n.specs}
    asked = [whole_name(name, there) for name in asked]
    for name in asked:
        if name not in there:
            raise KinegraphError(f"keep: there is no output {name!r}; {nearest(name, there)}")
    computed = [name for name, node in there.items() if not node.is_source]
    return asked or list(map(str, graph.record)) or computed


def _joined(name: str, graph: Graph, chunks: list[Chunk]) -> Series:
    there = {str(Edge(n.name, out)): spec for n in graph.nodes.values() for out, spec in n.specs.items()}
    return Series.of_chunks(name, there[name], chunks)


def on_arrays(
    graph: Feedable,
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


def _fed(graph: Feedable) -> dict[str, StreamSpec]:
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
