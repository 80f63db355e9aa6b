"""What has been done: a file for every job in the results' folder, written once its tables are complete."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder, write_complete

JOBS = ".jobs"
FORMAT = 1


@dataclass(frozen=True, slots=True)
class JobEntry:
    """What came of a job.

    status     "done"; "incomplete": the recording broke off, and the tables hold what there is; "failed": there are no tables
    error      why it failed, or what is missing
    digest     what the results depend on (see `digests`)
    recording  its hash, and its files' sizes and times
    tables     {output: file below the folder}
    rows       {output: rows}
    left_out   {output: why it is in no table}
    begin_ns   stamp of the recording's first input
    graph, version, worker   the graph's hash, kinegraph's version, and which worker did it
    """

    key: str
    name: str
    settings: Mapping[str, Any]
    status: str
    digest: str
    error: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)
    recording: Mapping[str, Any] = field(default_factory=dict)
    tables: Mapping[str, str] = field(default_factory=dict)
    rows: Mapping[str, int] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)
    begin_ns: int = 0
    seconds: float = 0.0
    took_s: float = 0.0
    graph: str = ""
    version: str = ""
    worker: str = ""

    def describe(self) -> str:
        """ "walks/s01 with smooth.cutoff_hz=6"."""
        settings = ", ".join(f"{name}={value}" for name, value in self.settings.items())
        return f"{self.name} with {settings}" if settings else self.name

    @property
    def failed(self) -> bool:
        return self.status == "failed"


class Manifest:
    """The entries of a results' folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def _path(self, key: str) -> Path:
        return self.folder / JOBS / f"{key}.json"

    def load(self, key: str) -> JobEntry | None:
        """What came of a job; None where it was never finished, or its entry cannot be read."""
        try:
            return _entry(json.loads(self._path(key).read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            return None

    def save(self, entry: JobEntry) -> None:
        """Raises OSError."""
        private_folder(self.folder / JOBS)
        write_complete(self._path(entry.key), json.dumps({"format": FORMAT, **asdict(entry)}, default=str))

    def forget(self, key: str) -> None:
        """A job is to be done again: its entry goes first, then its tables."""
        entry = self.load(key)
        self._path(key).unlink(missing_ok=True)
        for name in entry.tables.values() if entry else ():
            path = self.folder / name
            if path.resolve().is_relative_to(self.folder.resolve()):
                path.unlink(missing_ok=True)

    def __iter__(self) -> Iterator[JobEntry]:
        for path in sorted((self.folder / JOBS).glob("*.json")):
            if (entry := self.load(path.stem)) is not None:
                yield entry


def _entry(facts: dict[str, Any]) -> JobEntry:
    if facts.pop("format", None) != FORMAT:
        raise KinegraphError("these results are of another version of kinegraph; give another folder with -o")
    return JobEntry(**facts)
