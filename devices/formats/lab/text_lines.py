"""The lines of a text file from a laboratory's program, and the numbers in them; errors name file and line."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples
from kinegraph.stream.errors import RecordingError

NOTHING = {"", "nan", "-nan", "+nan", "n/a", "na", "null", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#ind"}
"""Contents of cells that hold no number, in lower case."""


def decoded(data: bytes) -> str:
    """Text in UTF-8, in UTF-16 with its mark, or else in the Western encoding that older programs write."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


@dataclass(frozen=True, slots=True)
class TextLines:
    """A text file's lines, without their ends; messages count lines from 1, `lines` from 0."""

    path: Path
    lines: list[str]

    @classmethod
    def read(cls, path: Path, skip: int = 0) -> TextLines:
        """The file; the first `skip` lines are left blank. Raises RecordingError."""
        try:
            text = decoded(path.read_bytes())
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read ({error.strerror or error})") from None
        if "\0" in text:
            raise RecordingError(f"{path}: holds zero bytes; it is not text, or was damaged")
        lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        while lines and not lines[-1].strip():
            lines.pop()
        if not lines:
            raise RecordingError(f"{path}: the file is empty")
        return cls(path, [""] * min(skip, len(lines)) + lines[skip:])

    def wrong(self, at: int, what: str) -> RecordingError:
        """An error at a line, counted from 0."""
        return RecordingError(f"{self.path}: line {at + 1}: {what}")

    def cells(self, at: int, delimiter: str) -> list[str]:
        """The cells of a line, stripped, without quotes. Raises RecordingError where the line is not there."""
        if at >= len(self.lines):
            raise RecordingError(f"{self.path}: ends at line {len(self.lines)}, before its data begin; it was cut off")
        try:
            return [cell.strip() for cell in next(csv.reader([self.lines[at]], delimiter=delimiter), [])]
        except csv.Error as error:
            raise self.wrong(at, str(error)) from None

    def table(
        self,
        start: int,
        delimiter: str,
        width: int,
        *,
        stop: int | None = None,
        comma: bool = False,
        ragged: bool = False,
    ) -> Samples:
        """The numbers (n, width) of the lines from `start` to before `stop`; blanks and NaN, in whatever letters, are NaN.

        Cells behind the last column must be blank. `comma`: numbers have decimal commas. `ragged`: a line may have fewer cells (the
        columns behind them have ended). Raises RecordingError.
        """
        lines = self.lines[start:stop]
        if sum(map(len, lines)) * 4 < len(lines) * width and not ragged:
            raise self.wrong(start, f"{width} columns are announced, but the lines hold fewer cells")
        out = np.full((len(lines), width), np.nan)
        for i, line in enumerate(lines):
            cells = line.split(delimiter)
            if len(cells) != width:
                cells = self._trimmed(start + i, cells, width, ragged=ragged)
            try:
                out[i, : len(cells)] = (
                    [float(c) for c in cells] if not comma else [float(c.replace(",", ".")) for c in cells]
                )
            except ValueError:
                out[i, : len(cells)] = [self.number(start + i, cell, comma=comma) for cell in cells]
        return out

    def columns(self, start: int, delimiter: str, width: int, wanted: Sequence[int], *, comma: bool = False) -> Samples:
        """The numbers (n, width) of the lines from `start` on, of the wanted columns only; all others are NaN, whatever they hold.

        Cells behind the last column must be blank. Raises RecordingError.
        """
        lines = self.lines[start:]
        out = np.full((len(lines), width), np.nan)
        for i, line in enumerate(lines):
            cells = line.split(delimiter)
            if len(cells) != width:
                cells = self._trimmed(start + i, cells, width, ragged=False)
            for k in wanted:
                out[i, k] = self.number(start + i, cells[k], comma=comma)
        return out

    def integers(self, start: int, delimiter: str, column: int) -> NDArray[np.int64]:
        """The whole numbers of a column of the lines from `start` on, exactly. Raises RecordingError."""
        made = np.empty(len(self.lines) - start, np.int64)
        for i, line in enumerate(self.lines[start:]):
            cell = line.split(delimiter)[column].strip() if line.count(delimiter) >= column else ""
            if not cell.lstrip("-").isdigit() or len(cell) > 18:
                raise self.wrong(start + i, f"{cell!r} is not a whole number")
            made[i] = int(cell)
        return made

    def _trimmed(self, at: int, cells: list[str], width: int, *, ragged: bool) -> list[str]:
        if any(cell.strip() for cell in cells[width:]) or (len(cells) < width and not ragged):
            raise self.wrong(at, f"{len(cells)} cells, where there are {width} columns; was the file cut off here?")
        return cells[:width]

    def number(self, at: int, cell: str, *, comma: bool = False) -> float:
        """The number in a cell of a line, NaN for a blank one. Raises RecordingError."""
        text = cell.strip().strip('"').strip()
        if text.lower() in NOTHING:
            return np.nan
        try:
            if "_" in text:
                raise ValueError
            return float(text.replace(",", ".") if comma else text)
        except ValueError:
            hint = "; save the file with decimal points" if not comma and is_number(text) else ""
            raise self.wrong(at, f"{text!r} is no number{hint}") from None


def is_number(cell: str, *, comma: bool = True) -> bool:
    """Whether a cell holds a finite number."""
    try:
        return (
            bool(np.isfinite(float(cell.strip().strip('"').replace(",", ".") if comma else cell))) and "_" not in cell
        )
    except ValueError:
        return False


def delimiter_of(line: str, among: str = "\t;,") -> str:
    """Which of these stands most often in a line."""
    return max(among, key=line.count)


def separator_of(line: str) -> str:
    """The separator that a first line like "sep=;" names for spreadsheets; or "".

    >>> separator_of('"sep=;"')
    ';'
    """
    found = re.fullmatch(r'"?sep=(.)"?', line.strip(" \r\n"))
    return found[1] if found else ""


def filled(cells: Sequence[str], width: int) -> list[str]:
    """Names that stand at their group's first column, at every column of the group."""
    made: list[str] = []
    for i in range(width):
        cell = cells[i].strip() if i < len(cells) else ""
        made.append(cell or (made[-1] if made else ""))
    return made
