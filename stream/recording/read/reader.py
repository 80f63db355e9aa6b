"""Reading a recording: one file, the rotated parts of a session, or what a killed process left."""

from __future__ import annotations

import json
from collections.abc import Container, Iterator
from html import escape
from itertools import takewhile
from pathlib import Path
from typing import Any, Self

import numpy as np

from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, Times
from kinegraph.stream.data.series import Series
from kinegraph.stream.errors import NothingRecorded, RecordingError, nearest
from kinegraph.stream.recording.format.layout import LOG, METRICS, Entry, decode_log
from kinegraph.stream.recording.format.overview import Overview
from kinegraph.stream.recording.format.paths import parts_of
from kinegraph.stream.recording.format.recorded_stream import RecordedStream
from kinegraph.stream.recording.read.input_log import Input, MessageReader, inputs
from kinegraph.stream.recording.read.missing import missing_of
from kinegraph.stream.recording.read.recorded_file import RecordedFile
from kinegraph.stream.recording.read.records import DAMAGE
from kinegraph.stream.recording.read.seeking import messages_from
from kinegraph.stream.text.html import table_html
from kinegraph.stream.text.short_names import whole_name


class Recording:
    """A recorded session. Samples come in fresh memory that may be written; nothing is held beyond what is being read.

    header     of the first part: the graph, versions, the session's facts (as handed to the recorder)
    finished   whether it was closed in order, if need be by the session that resumed it; one left by a killed process is read all the same
    parts      its files, but for those that were begun and hold nothing
    missing    what is known to be missing where it was not, and its data are not all there; None otherwise
    streams    what was recorded, by name
    """

    def __init__(self, path: Path, parts: list[RecordedFile], *, open_end: bool = False) -> None:
        """`open_end`: a further file had been begun, into which nothing was written."""
        self.path = path
        self.parts = parts
        self.header = parts[0].header
        self.missing = missing_of(parts, open_end=open_end, from_start=path.is_dir())
        self.finished = parts[-1].finished and self.missing is None
        self.streams: dict[str, RecordedStream] = {}
        for part in parts:
            for name, stream in part.streams.items():
                whole = self.streams.setdefault(name, RecordedStream(stream.spec, stream.role, stream.kept))
                if whole.spec != stream.spec:
                    raise RecordingError(
                        f"{part.file.path}: stream {name!r} changes from {whole.spec.describe()} to {stream.spec.describe()}; "
                        "open the parts one by one"
                    )
                if path.is_dir() and not whole.chunks:
                    whole.dropped, whole.gaps = stream.begin, int(stream.begin > 0)
                whole.follow(stream)

    @classmethod
    def open(cls, path: Path | str) -> Recording:
        """Open a file, a session's folder, or what a killed process left. Raises RecordingError, which says what to do."""
        path = Path(path)
        if not path.exists():
            raise RecordingError(f"{path}: there is no such recording")
        paths = parts_of(path)
        if not paths:
            raise RecordingError(f"{path}: the folder holds no recording (session.0000.mcap is missing)")
        parts: list[RecordedFile] = []
        begun: NothingRecorded | None = None
        try:
            for part in paths:
                try:
                    parts.append(RecordedFile(part))
                    begun = None
                except NothingRecorded as error:  # killed as the file began: what is before and after it is there
                    begun = error
            if not parts and begun:
                raise begun
            return cls(path, parts, open_end=begun is not None)
        except BaseException:
            # on Windows an open file could not be deleted or completed by who reads the error
            for opened in parts:
                opened.file.close()
            raise

    def close(self) -> None:
        for part in self.parts:
            part.file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def stream(self, name: str) -> RecordedStream:
        """The stream of this name, without those of parts where it is plain. Raises RecordingError with the nearest one there is."""
        name = whole_name(name, self.streams)
        if name not in self.streams:
            raise RecordingError(f"{self.path}: no stream {name!r} was recorded; {nearest(name, self.streams)}")
        return self.streams[name]

    def inputs(self, after: int = -1, also: Container[str] = ()) -> Iterator[Input]:
        """The input log: (sequence, stream, chunk, arrival) in the order of `sequence`, from the one after `after` on.

        Chunks of recorded edges named in `also` come after the input that led to them. Samples that were not kept are `lost`.
        """
        return inputs(self.parts, after, also)

    def entries(self, name: str) -> Iterator[Entry]:
        """The chunks of one stream with their arrival and sequence, in order. Raises RecordingError where its samples were not kept."""
        name = whole_name(name, self.streams)
        if self.stream(name).kept == "outline":
            raise RecordingError(
                f"{self.path}: the frames of {name!r} were not recorded; a graph that is to keep them names it under `record`"
            )
        reader = MessageReader()
        for part in self.parts:
            for _, _, body, frames in part.messages({name} & part.streams.keys()):
                yield from reader.read(part, name, body, frames)

    def chunks(self, name: str) -> Iterator[Chunk]:
        """The chunks of one stream, in order."""
        return (entry.chunk for entry in self.entries(name))

    def chunks_from(self, name: str, time: int) -> Iterator[Chunk]:
        """The chunks of one stream from the one on that holds `time` (ns), or from a little before."""
        for part in self.parts:
            stream = part.streams.get(name)
            if stream is None or stream.kept == "outline" or stream.last is None or stream.last < time:
                continue
            for _, _, body, frames in messages_from(part, time, name):
                yield from (entry.chunk for entry in MessageReader().read(part, name, body, frames))

    def overviews(self, name: str) -> list[Overview] | None:
        """What the recorder saw of a signal from afar, of each part that holds it; None if a part has no overview."""
        found = [part.overview(name) for part in self.parts if (s := part.streams.get(name)) and s.samples]
        return [seen for seen in found if seen] if found and all(found) else None

    def read(self, name: str) -> tuple[Times, Array]:
        """The whole of a stream: stamps (n,) int64 ns, samples (n, *shape)."""
        spec = self.stream(name).spec
        chunks = list(self.chunks(name))
        times = [np.empty(0, np.int64), *(c.time for c in chunks)]
        data = [np.empty((0, *spec.shape), spec.dtype), *(c.data for c in chunks)]
        return np.concatenate(times), np.concatenate(data)

    def series(self, name: str, start_s: float = 0.0, end_s: float | None = None) -> Series:
        """A stream from `start_s` to before `end_s`, in seconds after the recording's first input; only that much of the file is read."""
        name = whole_name(name, self.streams)
        stream = self.stream(name)
        if stream.kept == "outline":
            return Series.of_chunks(name, stream.spec, self.chunks(name))  # which says why there is nothing
        begin = self.begin_of_inputs + round(start_s * NS)
        end = FOREVER if end_s is None else self.begin_of_inputs + round(end_s * NS)
        chunks = takewhile(lambda chunk: not len(chunk) or chunk.time[0] < end, self.chunks_from(name, begin))
        whole = Series.of_chunks(name, stream.spec, chunks)
        low, high = np.searchsorted(whole.time, [begin, end])
        lost = None if whole.lost is None else whole.lost[low:high]
        return Series(name, stream.spec, whole.time[low:high], whole.data[low:high], lost)

    def _repr_html_(self) -> str:
        """What it holds, in a notebook."""
        rows = [
            (
                name,
                s.role,
                s.spec.describe(),
                s.samples,
                f"{(s.last - s.first) / NS:.1f}" if s.first and s.last else "",
                s.gaps,
            )
            for name, s in self.streams.items()
        ]
        table = table_html(("stream", "role", "of", "samples", "seconds", "gaps"), rows)
        state = "closed in order" if self.finished else "not closed cleanly"
        return f"<p>{escape(str(self.path))}: {self.duration_ns / NS:.1f} s, {state}</p>{table}"

    @property
    def log(self) -> list[dict[str, Any]]:
        """The session's log: {"kind": ..., "time": ns, fact: value, ...} in the order in which it was written."""
        return list(self.log_lines())

    def log_lines(self) -> Iterator[dict[str, Any]]:
        """The same, line by line. Raises RecordingError where one is damaged."""
        for part in self.parts:
            for _, _, body, _ in part.messages({LOG}):
                try:
                    yield decode_log(body)
                except DAMAGE as error:
                    raise RecordingError(f"{part.file.path}: a line of its log is damaged ({error})") from None

    def metrics(self) -> Iterator[dict[str, Any]]:
        """The nodes' metrics over time: {"time": ns, "table": {...}}."""
        for part in self.parts:
            for _, _, body, _ in part.messages({METRICS}):
                yield json.loads(bytes(body))

    def last_samples(self, name: str) -> int:
        """The cumulative index after a stream's last recorded sample: where a resumed session goes on. 0 for an unknown stream."""
        return self.streams[name].end if name in self.streams else 0

    @property
    def inputs_recorded(self) -> dict[str, RecordedStream]:
        """The streams of the input log."""
        return {name: s for name, s in self.streams.items() if s.role == "input"}

    @property
    def last_sequence(self) -> int:
        """The last place in the input log; -1 if nothing was recorded."""
        return max((s.last_sequence for s in self.inputs_recorded.values()), default=-1)

    @property
    def begin_of_inputs(self) -> int:
        """The stamp of the first input sample (ns); 0 without samples."""
        return min((s.first for s in self.inputs_recorded.values() if s.first is not None), default=0)

    @property
    def end_of_inputs(self) -> int:
        """The arrival of the last input chunk (ns); 0 if nothing was recorded."""
        return max((s.last_arrival for s in self.inputs_recorded.values()), default=0)

    @property
    def duration_ns(self) -> int:
        """From the first to the last stamp of any stream."""
        first = [s.first for s in self.streams.values() if s.first is not None]
        last = [s.last for s in self.streams.values() if s.last is not None]
        return max(last) - min(first) if first else 0


def missing_at(path: Path) -> str:
    """What is missing of the recording at `path`, in words; "" where nothing is."""
    try:
        with Recording.open(path) as recording:
            return f"missing: {recording.missing.words}" if recording.missing else ""
    except RecordingError:
        return "the recording was deleted or moved"
