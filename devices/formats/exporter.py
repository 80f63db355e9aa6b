"""A recording's streams out into other programs' formats: what an exporter is, and which there are.

An exporter is an entry point of the group `kinegraph.exporters`, so that any package can add a format to `kinegraph files export`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from kinegraph.devices.formats.installed import installed
from kinegraph.stream.errors import RecordingError

if TYPE_CHECKING:
    from kinegraph.devices.formats.table.csv_writer import Clock
    from kinegraph.stream.chunk import StreamSpec
    from kinegraph.stream.recording import Recording

GROUP = "kinegraph.exporters"


@dataclass(frozen=True, slots=True)
class Export:
    """What is wanted.

    recording  is open
    names      the streams, each of which the format takes
    place      the file, or the folder, that is to be made
    clock      how tables write times: seconds since the recording's first sample, ISO 8601 in UTC, or ns since 1970
    overwrite  whether what already exists is replaced
    progress   receives how many more samples have been written
    resample   whether signals without regular stamps are interpolated where a format needs a regular rate
    """

    recording: Recording
    names: list[str]
    place: Path
    clock: Clock
    overwrite: bool
    progress: Callable[[int], None]
    resample: bool = False

    @property
    def origin(self) -> int:
        """The first sample's time (ns)."""
        return min((s.first for s in self.recording.streams.values() if s.first is not None), default=0)

    def refuse_existing(self, path: Path) -> None:
        """Raise RecordingError where a file would be lost."""
        if path.is_dir():
            raise RecordingError(f"{path}: is a folder; choose another --out")
        if path.exists() and not self.overwrite:
            raise RecordingError(f"{path}: already exists; choose another --out, or replace it with --overwrite")


FILE_NAME = 200
"""Letters of a file's name, beside its ending; file systems take 255 bytes."""


def titled(names: Sequence[str], width: int, forbidden: str) -> list[str]:
    """Titles of at most `width` letters, one per name, that differ in more than capital letters; `forbidden` letters become _."""
    made: list[str] = []
    for name in names:
        plain = re.sub(forbidden, "_", name)[: width - 3] or "stream"
        title, count = plain, 1
        while title.lower() in {other.lower() for other in made}:
            count += 1
            title = f"{plain}_{count}"
        made.append(title)
    return made


Written: TypeAlias = "tuple[str, Path, int]"
"""A stream, the file that has it, and how many samples that are."""


@dataclass(frozen=True, slots=True)
class Exporter:
    """A format.

    what    in words, for the help: "one table per stream"
    suffix  of what is made; for a folder, how its name ends: "_csv"
    write   makes it; raises RecordingError or OSError
    takes   why it cannot have a stream of this spec, "" where it can; left out: it takes what fits into a table
    """

    what: str
    suffix: str
    write: Callable[[Export], list[Written]]
    takes: Callable[[StreamSpec], str] | None = None


@cache
def exporters() -> dict[str, Exporter]:
    """All that are installed, by name; raises KinegraphError for one that cannot be loaded."""
    return installed(GROUP, "exporter")


def chosen(name: str, out: Path | None) -> Exporter:
    """The exporter of this name; without a name, by the suffix of `out`, else CSV. Raises RecordingError."""
    known = exporters()
    if name:
        if name not in known:
            raise RecordingError(f"--format {name}: is not one of {', '.join(known)}")
        return known[name]
    suffix = out.suffix.lower() if out else ""
    return next((one for one in known.values() if suffix and one.suffix == suffix), known["csv"])
