"""Where a recording lies: the names of its parts, and the lock that keeps a second instance away."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

from filelock import FileLock, Timeout

from kinegraph.stream.errors import RecordingError
from kinegraph.stream.system.atomic_file import private_folder

SUFFIX = ".mcap"


def part_path(path: Path, number: int) -> Path:
    """Part `number` of a recording at `path`: session.0000.mcap ... in a folder; name.mcap, name.0001.mcap ... beside a named file."""
    if path.suffix != SUFFIX:
        return path / f"session.{number:04d}{SUFFIX}"
    return path if number == 0 else path.with_name(f"{path.stem}.{number:04d}{SUFFIX}")


def parts_of(path: Path, before: int | None = None) -> list[Path]:
    """The parts of the recording at `path` (a folder, or a named file) that exist, in order; in a folder, those before a number."""
    if path.is_dir():
        found = [p for p in path.iterdir() if re.fullmatch(r"session\.\d{4,}\.mcap", p.name)]
        return sorted((p for p in found if before is None or _number(p) < before), key=_number)
    more = re.compile(re.escape(path.stem) + r"\.\d{4,}\.mcap")
    if not path.parent.is_dir():
        return []
    found = sorted((p for p in path.parent.iterdir() if more.fullmatch(p.name)), key=_number)
    return [path, *found] if path.is_file() else []


def _number(path: Path) -> int:
    return int(path.stem.rpartition(".")[2])


def lock_path(path: Path) -> Path:
    return path.with_name(f".{path.name}.lock") if path.suffix == SUFFIX else path / ".lock"


def lock(path: Path) -> FileLock:
    """Take the recording at `path` for this process, until `release` or the process's end. Raises RecordingError if another holds it."""
    held = FileLock(lock_path(path))
    try:
        held.acquire(blocking=False)
    except Timeout:
        if not lock_path(path).exists():  # what filelock says as well where no file can be made
            raise RecordingError(f"{path}: cannot write there; choose a folder that can be written") from None
        raise RecordingError(
            f"{path}: another kinegraph is recording there; choose another folder, or stop it first"
        ) from None
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot write there ({error.strerror or error}); choose a folder that can be written"
        ) from None
    return held


def unlock_recording(path: Path, held: FileLock) -> None:
    """Release the place, and leave no lock file behind (filelock minds a file that vanished; Windows keeps it)."""
    with suppress(OSError):
        lock_path(path).unlink(missing_ok=True)
    held.release()


def refuse_taken_folder(path: Path) -> None:
    """Raise RecordingError for a folder in which somebody records, or in which a recording lies already."""
    if path.is_dir():
        unlock_recording(path, lock(path))
        refuse_taken(path)


def refuse_taken(path: Path) -> None:
    """Raise RecordingError where a recording lies already."""
    if parts_of(path):
        raise RecordingError(
            f"{path}: already holds a recording; name another place with -o (`run --resume` continues an interrupted session)"
        )


def lock_recording(path: Path, *, taken: bool = False) -> tuple[FileLock, int]:
    """Lock the place, and prove that it can be written. Returns the lock and the number of the part to begin with.

    `taken` says that a recording may lie there already.
    """
    folder = path.parent if path.suffix == SUFFIX else path
    try:
        if folder.exists() and not folder.is_dir():
            raise RecordingError(f"{folder}: is a file; choose a folder, or another name")
        if path.suffix == SUFFIX and path.is_dir():
            raise RecordingError(f"{path}: is a folder; choose another name")
        private_folder(folder)
    except OSError as error:
        raise RecordingError(
            f"{folder}: cannot be created ({error.strerror or error}); choose a folder that can be written"
        ) from None
    held = lock(path)
    try:
        parts = parts_of(path)
        if not taken:
            refuse_taken(path)
        number = 0 if not parts else 1 if parts[-1] == path else _number(parts[-1]) + 1
        _probe(part_path(path, number))
    except RecordingError:
        unlock_recording(path, held)
        raise
    except OSError as error:
        unlock_recording(path, held)
        raise RecordingError(
            f"{path}: cannot write there ({error.strerror or error}); free some space or choose another folder"
        ) from None
    return held, number


def draft_of(path: Path) -> Path:
    """Where the recording that will be the file at `path` is written until it is complete."""
    return path.with_name(f".{path.stem}.draft{SUFFIX}")


def publish(draft: Path, path: Path) -> None:
    """Give a complete draft its name, in the place of a recording that lies there. Raises OSError."""
    parts = parts_of(draft)
    for old in parts_of(path)[len(parts) :]:  # first, so that at no moment parts of the two stand side by side
        old.unlink()
    for number, part in enumerate(parts):
        part.replace(part_path(path, number))


def discard(path: Path) -> None:
    """Remove a draft, as far as there is one."""
    for part in parts_of(path):
        with suppress(OSError):
            part.unlink()


def _probe(path: Path) -> None:
    """Write a little beside `path` and remove it again: raises OSError where the disk is full or may not be written."""
    trial = path.with_name(f".{path.name}.trial")
    try:
        with trial.open("wb") as file:
            file.write(bytes(4096))
            file.flush()
    finally:
        trial.unlink(missing_ok=True)


def is_running(path: Path) -> bool:
    """Whether some process is recording at `path` now."""
    if not lock_path(path).exists():
        return False
    try:
        with FileLock(lock_path(path)).acquire(blocking=False):
            return False
    except Timeout:
        return True
    except OSError:
        return False
