"""A whole file: its bytes, and its SHA-256, which says whether it is the one that was published."""

from __future__ import annotations

import hashlib
from pathlib import Path

from kinegraph.stream.errors import KinegraphError


def sha256_of(path: Path) -> str:
    """In hexadecimal digits. Raises KinegraphError where the file cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise KinegraphError(f"{path} cannot be read: {error.strerror}") from None


def bytes_of(path: Path) -> bytes:
    """All that is in it. Raises KinegraphError where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise KinegraphError(f"{path} cannot be read: {error.strerror}") from None
