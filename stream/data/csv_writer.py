"""CSV for spreadsheets: the one writer of all tables. A text that would run as a formula there is written with an apostrophe before it."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from typing import Any, Protocol

FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")
"""What a formula, or a command, begins with in some spreadsheet; the last four are their full-width forms."""


class _Text(Protocol):
    def write(self, text: str, /) -> object: ...


class Sheet:
    """Rows of cells, written to `file`. Numbers stay as they are, also those that are given as texts."""

    def __init__(self, file: _Text, lineterminator: str = "\n") -> None:
        self._writer = csv.writer(file, lineterminator=lineterminator)

    def writerow(self, cells: Iterable[Any]) -> None:
        self._writer.writerow(map(cell, cells))

    def writerows(self, rows: Iterable[Iterable[Any]]) -> None:
        self._writer.writerows(map(cell, row) for row in rows)


def row_of(cells: Iterable[Any]) -> bytes:
    """A row, as it stands in a file."""
    text = io.StringIO()
    Sheet(text).writerow(cells)
    return text.getvalue().encode()


def cell(value: Any) -> Any:
    """A cell: a text that would be a formula has an apostrophe before it; carriage returns, which csv does not quote, are line feeds."""
    if not isinstance(value, str):
        return value
    if "\r" in value:
        value = value.replace("\r\n", "\n").replace("\r", "\n")
    return f"'{value}" if value.startswith(FORMULA) and not _is_number(value) else value


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text == text.strip()


def sheet_text(rows: Iterable[Iterable[Any]]) -> str:
    """A whole table as text."""
    file = io.StringIO()
    Sheet(file).writerows(rows)
    return file.getvalue()
