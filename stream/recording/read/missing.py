"""What a recording lacks that was not closed in order: how much is known to have been written after its last whole record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.format.checkpoint import Checkpoint
from kinegraph.stream.recording.read.recorded_file import RecordedFile


@dataclass(frozen=True, slots=True)
class Missing:
    """What is known to be missing of a recording; what was written after that, if anything, is unknown.

    bytes      at the end of a file that belong to no whole record
    seconds    from the last input that can be read to the latest that is known to have been written: by the times in a record that
               breaks off, and by the session's checkpoint; 0.0 where neither shows more
    samples    that lay between an earlier file that breaks off and the next one, all streams together
    before     that lay before the first file of a session's folder, all streams together
    """

    bytes: int = 0
    seconds: float = 0.0
    samples: int = 0
    before: int = 0

    @property
    def words(self) -> str:
        """What is missing, to follow "missing is"."""
        known = [f"at least {self.seconds:.1f} s" if self.seconds else ""]
        known.append(f"{self.before} samples before its first file" if self.before else "")
        known.append(f"{self.samples} samples between its files" if self.samples else "")
        least = ", ".join(filter(None, known)) or "what was recorded after the last whole record, if anything"
        return least + (f" ({self.bytes} bytes at its end are not a complete record)" if self.bytes else "")

    def to_json(self) -> dict[str, Any]:
        return {"bytes": self.bytes, "seconds": round(self.seconds, 3), "samples": self.samples, "before": self.before}


def missing_after(part: RecordedFile, *, last: bool) -> Missing | None:
    """What is missing at the end of a file; None where all its data are there. Beside the `last` file, a checkpoint tells more."""
    if part.whole:
        return None
    inputs = [stream for stream in part.streams.values() if stream.role == "input"]
    end = max((stream.last_arrival for stream in inputs), default=0)
    sequence = max((stream.last_sequence for stream in inputs), default=-1)
    known = [end, part.file.torn_until, _checkpointed(part.file.path, sequence) if last else 0]
    return Missing(part.torn, (max(known) - end) / NS if end else 0.0)


def missing_of(parts: Sequence[RecordedFile], *, open_end: bool = False, from_start: bool = False) -> Missing | None:
    """What is missing of a recording of these files; None where nothing is.

    A file that breaks off costs nothing if the next one continues with the next sample of every stream, as after a resumed session or
    a file that could not grow. `open_end`: a further file had been begun, and holds nothing. `from_start`: the first file is that of the
    session's start, unless it was deleted or moved.
    """
    found = missing_after(parts[-1], last=True) or (Missing() if open_end else None)
    ends: dict[str, int] = {}
    samples = late = 0
    for before, part in zip([None, *parts[:-1]], parts, strict=True):
        for name, stream in part.streams.items():
            if not stream.chunks:
                continue
            if before is not None and not before.whole:
                samples += max(stream.begin - ends.get(name, stream.begin), 0)
            if from_start and name not in ends:
                late += stream.begin
            ends[name] = stream.end
    if not (found or samples or late):
        return None
    return Missing(found.bytes if found else 0, found.seconds if found else 0.0, samples, late)


def _checkpointed(path: Path, sequence: int) -> int:
    """When the session's checkpoint was taken, if it knows of an input after `sequence`, which was on the disk before; otherwise 0."""
    try:
        kept = Checkpoint.load(path.parent) if path.name.startswith("session.") else None
    except RecordingError:
        return 0
    return kept.time if kept and kept.sequence > sequence else 0
