"""Refuses folders and files that are run or trusted if other users can write them: anything could be planted there."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from kinegraph.stream.errors import KinegraphError


def refuse_shared(path: Path, what: str, why: str = "what it holds is run") -> None:
    """Raise KinegraphError where others than its owner (us, or root) may write `path`. Systems without such owners are passed over."""
    if not hasattr(os, "getuid"):
        return
    found = path.stat()
    mode = stat.S_IMODE(found.st_mode)
    if found.st_uid not in (os.getuid(), 0):
        raise KinegraphError(f"{path}: {what} must be your own or root's, but is owned by another user; {why}")
    if mode & stat.S_IWOTH or (mode & stat.S_IWGRP and found.st_gid not in (os.getgid(), 0)):
        raise KinegraphError(
            f"{path}: {what} may be written by others, and {why}; look what it holds, then: chmod go-w {path}"
        )


def is_foreign(path: Path) -> bool:
    """Whether a file belongs to another user (and not to root)."""
    return hasattr(os, "getuid") and path.exists() and path.stat().st_uid not in (os.getuid(), 0)
