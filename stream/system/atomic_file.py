"""Files of people: private to who runs kinegraph (0600, in folders of 0700), and there when they are complete, or not at all.

A full disk, a killed process or a power cut leaves the file before as it was. Whoever else may read them is the owner's to say (chmod).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PRIVATE = 0o600
PRIVATE_FOLDER = 0o700
OTHERS = 0o077
"""What the umask of every command takes from files and folders that other libraries make."""


def be_private() -> None:
    """From now on, whatever this process and its children create is private, also where a library creates it."""
    os.umask(os.umask(OTHERS) | OTHERS)


def private_folder(path: Path) -> Path:
    """Make a folder, and those above it that are missing, for its owner alone. One that is there stays as it is. Raises OSError."""
    if not path.is_dir():
        if path.parent != path:
            private_folder(path.parent)
        path.mkdir(PRIVATE_FOLDER, exist_ok=True)
    return path


@contextmanager
def complete(path: Path, *, shared: bool = False) -> Iterator[Path]:
    """Within: the private file given, beside `path`, is written; then it takes its name, durably, or is removed if something fails.

    `shared`: other processes may do the same at the same time; what they write is the same, and need not survive a power cut.
    Raises OSError.
    """
    draft = path.with_name(f".{path.name}{f'.{os.getpid()}' if shared else ''}.draft")
    try:
        draft.unlink(missing_ok=True)
        os.close(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE))
        yield draft
        if not shared:
            _sync(draft)
        draft.replace(path)
        if not shared:
            _sync(path.parent)
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)


def write_complete(path: Path, content: str | bytes) -> None:
    """Write a file so. Raises OSError."""
    with complete(path) as draft:
        draft.write_bytes(content.encode() if isinstance(content, str) else content)


def _sync(path: Path) -> None:
    """Bring a file, or a folder's names, past every cache; where a system cannot do so with a folder, it is left."""
    if path.is_dir() and os.name != "posix":
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
