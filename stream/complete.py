"""Files that appear when they are complete, or not at all: a full disk or a killed process leaves the one before as it was."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def complete(path: Path) -> Iterator[Path]:
    """Within: the file given is written, beside `path`; then it takes its name, and if something fails it is removed. Raises OSError."""
    draft = path.with_name(f".{path.name}.draft")
    try:
        yield draft
        draft.replace(path)
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)


def write_complete(path: Path, text: str) -> None:
    """Write a text file so. Raises OSError."""
    with complete(path) as draft:
        draft.write_text(text, encoding="utf-8")
