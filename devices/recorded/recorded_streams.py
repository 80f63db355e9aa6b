"""A recording's streams as a source: an imported file in a graph of one's own, alone or beside live devices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.stream.chunk import FOREVER, NEVER, NS, Array, Chunk, Specs, StreamSpec
from kinegraph.stream.errors import ParameterError, RecordingError, nearest
from kinegraph.stream.params import param
from kinegraph.stream.recording import Recording
from kinegraph.stream.source import Feed, Source, outputs_by_parameters


@dataclass(frozen=True, slots=True)
class RecordedStreams(Source):
    """What a recording holds of its inputs, chunk by chunk as it was written, under the names that it has there.

    The streams `lab.analog` and `lab.right_foot_strike` are the outputs `analog` and `right_foot_strike` of a node with `of: lab`; a
    stream that is called `lab` is its output `out`. Name the node `lab` as well: the graph then replays the recording itself, too.
    Stamps, and the times in events' fields, are moved so that the first sample comes when the graph starts, or with `speed: 0` so that
    the last one does. There is no delay; a chunk is given when its time has come.
    """

    path: str = param(help="the recording: what `kinegraph files import` or a session wrote")
    of: str = param("", help="what streams' names begin with, before a dot; left out: what they all begin with")
    streams: Mapping[str, str] | None = param(None, help="outputs by name, and the stream that each of them is")
    speed: float = param(
        1.0, least=0.0, help="how many times as fast as it was recorded; 0: as fast as the graph takes it"
    )

    @outputs_by_parameters()
    def outputs(self) -> tuple[str, ...]:
        return tuple(self.specs())

    def __post_init__(self) -> None:
        Source.__post_init__(self)
        self.specs()

    @property
    def live(self) -> bool:
        return False

    def specs(self) -> Specs:
        with self._opened() as recording:
            return {output: recording.streams[name].spec for output, name in self._chosen(recording).items()}

    def facts(self) -> Mapping[str, Any]:
        with self._opened() as recording:
            return dict(recording.header.get("session") or {})

    def present(self) -> bool | None:
        return Path(self.path).exists()

    def read(self, feed: Feed) -> None:
        with self._opened() as recording:
            outputs = {name: output for output, name in self._chosen(recording).items()}
            specs = {name: recording.streams[name].spec for name in outputs}
            ends = [
                (s.first, s.last) for name, s in recording.streams.items() if name in outputs and s.first is not None
            ]
            first, last = min((a for a, _ in ends), default=0), max((b for _, b in ends if b is not None), default=0)
            feed.identify("recording", file=Path(self.path).name)
            feed.ready()
            began = feed.now()
            offset = began - (first if self.speed else last)
            for _, name, chunk, _ in recording.inputs():
                if name not in outputs:
                    continue
                moved = _moved(specs[name], chunk, offset, last)
                if self.speed and feed.wait(
                    max(0.0, (_end(chunk, first) - first) / NS / self.speed - (feed.now() - began) / NS)
                ):
                    return
                if feed.stopped:
                    return
                feed.emit(moved, outputs[name])

    def _opened(self) -> Recording:
        """Raises ParameterError."""
        path = Path(self.path)
        if path.is_file() and path.suffix != ".mcap":
            raise ParameterError(
                "path", self.path, f"a recording; make one of it: kinegraph files import {path} -o {path.stem}.mcap"
            )
        try:
            return Recording.open(path)
        except RecordingError as error:
            raise ParameterError("path", self.path, f"a recording ({error})") from None

    def _chosen(self, recording: Recording) -> dict[str, str]:
        """The stream behind each output."""
        there = [
            name for name, stream in recording.streams.items() if stream.role == "input" and stream.kept != "outline"
        ]
        if self.streams is not None:
            for name in self.streams.values():
                if name not in there:
                    raise ParameterError("streams", name, f"a stream of {self.path}; {nearest(name, there)}")
            return dict(self.streams)
        beginnings = list(dict.fromkeys(name.partition(".")[0] for name in there))
        if not self.of and len(beginnings) != 1:
            raise ParameterError(
                "of", None, f"given: names in {self.path} begin with {', '.join(beginnings) or 'nothing'}"
            )
        of = self.of or beginnings[0]
        found = {name.partition(".")[2] or "out": name for name in there if name == of or name.startswith(f"{of}.")}
        if not found:
            raise ParameterError(
                "of", self.of, f"what names in {self.path} begin with: {', '.join(beginnings) or 'it has no streams'}"
            )
        return found


def _end(chunk: Chunk, otherwise: int) -> int:
    """When a chunk of the recording was there: its watermark, or its last sample where the stream ended with it."""
    if chunk.until not in (FOREVER, NEVER):
        return chunk.until
    return int(chunk.time[-1]) if len(chunk.time) else otherwise


def _moved(spec: StreamSpec, chunk: Chunk, offset: int, last: int) -> Chunk:
    """The chunk `offset` ns later, with the times in its fields; where the recording ends, it is complete up to its `last` sample."""
    until = (last if chunk.until in (FOREVER, NEVER) else chunk.until) + offset
    return Chunk(chunk.time + offset, _moved_fields(spec, chunk.data, offset), until, chunk.lost)


def _moved_fields(spec: StreamSpec, data: Array, offset: int) -> Array:
    times = [name for name in spec.dtype.names or () if spec.unit_of(name) == "ns" and name in ("onset", "end")]
    if not times:
        return data
    moved = data.copy()
    for name in times:
        moved[name] = np.where(data[name] > NEVER, data[name] + offset, data[name])
    return moved
