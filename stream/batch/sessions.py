"""Sessions wherever they are stored: recordings, and what each job of a batch gave, read by the same calls."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Self, TypeAlias, TypeVar

import numpy as np

from kinegraph.stream.batch.manifest import JOBS, JobEntry, Manifest
from kinegraph.stream.batch.parquet import LOST, TIME, arrow
from kinegraph.stream.chunk import Array, Chunk, StreamSpec, Times
from kinegraph.stream.data.columns import assemble, column_names, columns
from kinegraph.stream.data.series import Series
from kinegraph.stream.errors import KinegraphError, RecordingError, nearest
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.format.recorded_stream import RecordedStream

Wanted = TypeVar("Wanted")


class JobRecording:
    """What one job of `kinegraph batch` gave, with the calls of a `Recording`: streams, read, chunks, series.

    path     its entry in the results' folder
    name     the recording's name and the job's settings
    header   {"session": facts}
    streams  of its tables; as `first`, `begin_of_inputs` counts from the recording's first input
    """

    missing = None

    def __init__(self, path: Path) -> None:
        entry = Manifest(path.parent.parent).load(path.stem)
        if entry is None:
            raise RecordingError(f"{path}: is not an entry of a batch's results")
        if entry.failed:
            raise RecordingError(f"{entry.describe()}: failed in the batch: {entry.error}")
        self.path, self.entry = path, entry
        self.name = short_name(entry)
        self.header: dict[str, Any] = {"session": dict(entry.facts)}
        self.begin_of_inputs = entry.begin_ns
        self.streams = {name: self._described(name) for name in entry.tables}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Files are open only while they are read."""

    def stream(self, name: str) -> RecordedStream:
        """The stream of this name. Raises RecordingError with the nearest one there is."""
        if name not in self.streams:
            left = self.entry.left_out.get(name)
            raise RecordingError(
                f"{self.entry.describe()}: there is no table of {name!r}; {left or nearest(name, self.streams)}"
            )
        return self.streams[name]

    def series(self, name: str, start_s: float = 0.0, end_s: float | None = None) -> Series:
        """A table's samples, from `start_s` to before `end_s` after the recording's first input."""
        spec = self.stream(name).spec
        table = self._file(name).read(columns=[TIME, LOST, *(column for column, _ in column_names(spec))])
        time = table.column(TIME).cast(arrow().int64()).to_numpy()
        lost = table.column(LOST).to_numpy()
        kinds = [column.dtype.kind for column in columns(spec, np.zeros((0, *spec.shape), spec.dtype))]
        parts = [_values(column, kind) for column, kind in zip(table.columns[2:], kinds, strict=True)]
        whole = Series(name, spec, time, assemble(spec, parts), lost if lost.any() else None)
        since_s = (int(time[0]) - self.begin_of_inputs) / 1e9 if len(time) else 0.0
        if not start_s and end_s is None:
            return whole
        return whole.between(start_s - since_s, None if end_s is None else end_s - since_s)

    def read(self, name: str) -> tuple[Times, Array]:
        """The whole of a stream: stamps (n,) int64 ns, samples (n, *shape)."""
        found = self.series(name)
        return found.time, found.data

    def chunks(self, name: str) -> Iterator[Chunk]:
        """The samples, cut where some are missing."""
        found = self.series(name)
        if not len(found):
            return
        lost = np.zeros(len(found), np.int64) if found.lost is None else found.lost
        edges = [0, *(int(at) for at in np.flatnonzero(lost) if at), len(found)]
        for low, high in itertools.pairwise(edges):
            time = found.time[low:high]
            yield Chunk(time, found.data[low:high], int(time[-1]), int(lost[low]))

    def _file(self, name: str) -> Any:
        path = self.path.parent.parent / self.entry.tables[name]
        try:
            return arrow().parquet.ParquetFile(path)
        except (OSError, arrow().ArrowInvalid) as error:
            raise RecordingError(
                f"{path}: cannot be read ({error}); `kinegraph batch --overwrite` makes it again"
            ) from None

    def _described(self, name: str) -> RecordedStream:
        file = self._file(name)
        record = json.loads((file.schema_arrow.metadata or {}).get(b"kinegraph", b"{}"))
        if "spec" not in record:
            raise RecordingError(
                f"{self.path.parent.parent}: made by another version of kinegraph; run the batch again"
            )
        return RecordedStream(StreamSpec.from_json(record["spec"]), "edge", samples=file.metadata.num_rows)


StoredSession: TypeAlias = Recording | JobRecording


def is_results(path: Path) -> bool:
    """Whether `kinegraph batch` has written into this folder."""
    return (path / JOBS).is_dir()


def sessions_at(paths: Iterable[Path]) -> list[Path]:
    """The paths; a batch's results become one for each of its jobs that did not fail. Raises KinegraphError where all did."""
    found: list[Path] = []
    for path in paths:
        if not is_results(path):
            found.append(path)
            continue
        jobs = [_entry_of(path, entry) for entry in _jobs(path)]
        if not jobs:
            raise KinegraphError(f"{path}: no job of this batch has given results")
        found += jobs
    return found


def open_session(path: Path) -> StoredSession:
    """A recording, or a job of a batch by what `sessions_at` gave. Raises RecordingError."""
    if path.parent.name == JOBS and path.suffix == ".json":
        return JobRecording(path)
    if is_results(path):
        jobs = sessions_at([path])
        if len(jobs) > 1:
            raise RecordingError(f"{path}: holds the results of {len(jobs)} jobs, of which one cannot be chosen here")
        return JobRecording(jobs[0])
    return Recording.open(path)


def name_of(session: StoredSession) -> str:
    """What a session is called in reports: the recording's name, and the settings of its job."""
    return session.name if isinstance(session, JobRecording) else session.path.stem


def recording_name(session: StoredSession) -> str:
    """What the recording itself is called, whatever it was replayed with."""
    return Path(session.entry.name).stem if isinstance(session, JobRecording) else session.path.stem


def short_name(entry: JobEntry) -> str:
    """ "S01", or "S01 smooth.cutoff_hz=6" of a job with settings."""
    return " ".join([Path(entry.name).stem, *settings_of(entry)])


def settings_of(entry: JobEntry) -> list[str]:
    return [f"{name}={value}" for name, value in entry.settings.items()]


def named_in(table: Path, result: Path) -> str:
    """Name of the recording in a table of results."""
    return str(result.relative_to(table.parent) if result.is_relative_to(table.parent) else result)


def matched(results: Path, wanted: dict[str, Wanted]) -> list[tuple[Path, JobEntry, Wanted]]:
    """Every job of a batch with what is `wanted` of its recording, by the recording's name in the results, or that name's last part.

    Raises KinegraphError where a name is of no recording, or of several.
    """
    entries = _jobs(results)
    names = {entry.name for entry in entries}
    found: dict[str, Wanted] = {}
    for name, value in wanted.items():
        hits = [n for n in names if n == name] or [n for n in names if Path(n).stem == Path(name).stem]
        if len(hits) != 1:
            why = f"{', '.join(sorted(hits))} could be meant" if hits else nearest(name, names)
            raise KinegraphError(f"{results}: {name!r} is not a recording of these results; {why}")
        found[hits[0]] = value
    return [(_entry_of(results, entry), entry, found[entry.name]) for entry in entries if entry.name in found]


def _jobs(folder: Path) -> list[JobEntry]:
    """The jobs that did not fail, in the order of recordings and settings."""
    return sorted(
        (entry for entry in Manifest(folder) if not entry.failed),
        key=lambda entry: (entry.name, [(name, str(value)) for name, value in entry.settings.items()]),
    )


def _entry_of(folder: Path, entry: JobEntry) -> Path:
    return folder / JOBS / f"{entry.key}.json"


def _values(column: Any, kind: str) -> Array:
    """A column's values as numpy holds them; texts are bytes again where the stream holds bytes."""
    values: Array = column.to_numpy()
    return np.array([text.encode() for text in values], "S") if kind == "S" and len(values) else values
