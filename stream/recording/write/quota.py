"""The quota: the oldest closed recordings of a folder give way to new ones; the running one never does."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from kinegraph.stream.recording.format.layout import PROFILE
from kinegraph.stream.recording.format.paths import SUFFIX, is_running, lock_path, parts_of


def keep_quota(path: Path, quota_mb: float) -> list[Path]:
    """Delete the oldest recordings beside the one at `path` until the folder holds at most `quota_mb`; returns what was deleted.

    Only files that kinegraph recorded are touched: a session's reports and tables stay. 0 means no quota.
    """
    if quota_mb <= 0:
        return []
    sizes = {place: _size(place) for place in recordings_in(path.parent)}
    total = sum(sizes.values())
    deleted = []
    for place in sorted((p for p in sizes if p != path), key=_age):
        if total <= quota_mb * 1e6:
            break
        if not is_running(place) and _delete(place):
            total -= sizes[place]
            deleted.append(place)
    return deleted


def recordings_in(folder: Path) -> list[Path]:
    """Every recording in a folder: session folders, and named files without their further parts."""
    found = []
    for entry in folder.iterdir() if folder.is_dir() else ():
        parts = parts_of(entry) if entry.is_dir() or (entry.suffix == SUFFIX and not _is_further(entry)) else []
        if parts and all(_is_ours(part) for part in parts):
            found.append(entry)
    return found


def _is_further(path: Path) -> bool:
    stem, _, number = path.stem.rpartition(".")
    return number.isdigit() and path.with_name(stem + SUFFIX).is_file()


def _is_ours(part: Path) -> bool:
    """Whether a file is empty (begun and killed) or an MCAP file with our profile."""
    with suppress(OSError), part.open("rb") as file:
        head = file.read(64)
        return not head or head[21 : 21 + len(PROFILE)] == PROFILE.encode()
    return False


def _size(place: Path) -> int:
    return sum(part.stat().st_size for part in parts_of(place))


def _age(place: Path) -> float:
    return max((part.stat().st_mtime for part in parts_of(place)), default=0.0)


def _delete(place: Path) -> bool:
    try:
        for part in parts_of(place):
            part.unlink()
        lock_path(place).unlink(missing_ok=True)
        for checkpoint in place.glob("checkpoint.npz*"):
            checkpoint.unlink()
        if place.is_dir() and not any(place.iterdir()):
            place.rmdir()
    except OSError:
        return False
    return True
