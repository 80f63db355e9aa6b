"""An output file belongs to one running session: a second one is refused, a crashed one holds nothing."""

from __future__ import annotations

import os
from pathlib import Path

from filelock import FileLock, Timeout

from kinegraph.stream.errors import DeviceError
from kinegraph.stream.system.atomic_file import private_folder


def lock_output(path: Path) -> FileLock:
    """Hold `.<name>.lock` beside an output until `unlock_output`; the system releases it when the process dies.

    Makes the folder. Raises DeviceError if another session writes to `path`, or its folder cannot be written.
    """
    try:
        private_folder(path.parent)
        held = FileLock(path.with_name(f".{path.name}.lock"))
        held.acquire(blocking=False)
    except Timeout:
        raise DeviceError(
            f"{path} is being written by another session; stop that one, or choose another path"
        ) from None
    except OSError as error:
        raise DeviceError(f"cannot write to {path.parent}: {error.strerror or error}; choose another path") from None
    return held


def unlock_output(held: FileLock) -> None:
    """Release an output. The lock's file is removed first, while it is held, so that no other session's file is removed."""
    Path(held.lock_file).unlink(missing_ok=True)
    held.release()


def check_path(path: Path) -> str:
    """What `path` must be but is not, as far as can be seen without writing; "" if nothing is wrong."""
    if path.is_dir():
        return "a file, not a folder"
    folder = next((p for p in path.absolute().parents if p.exists()), Path("/"))
    if not folder.is_dir():
        return f"in a folder; {folder} is a file"
    if not os.access(folder, os.W_OK | os.X_OK):
        return f"in a folder that may be written; {folder} may not"
    return ""


def free_name(path: Path) -> Path:
    """`path`, or the first of path-2, path-3, ... that does not exist yet."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_stem(f"{path.stem}-{number}")
    return free
