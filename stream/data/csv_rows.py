"""The rows of a small CSV table that is read as text, with the lines that they stand in."""

from __future__ import annotations

import csv
from pathlib import Path

from kinegraph.stream.data.tables import read_text


def csv_rows(path: Path, kind: str) -> list[tuple[int, list[str]]]:
    """Line number and cells of each row; empty lines, and those that begin with #, are left out. Raises RecordingError."""
    lines = enumerate(read_text(path, kind).splitlines(), 1)
    return [(number, next(csv.reader([line]))) for number, line in lines if line.strip() and not line.startswith("#")]
