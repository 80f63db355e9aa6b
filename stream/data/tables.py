"""CSV tables and NPZ archives, read as named arrays; what is wrong in them is named by file and line."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.data.bounded import arrays, reading
from kinegraph.stream.errors import KinegraphError, RecordingError

DELIMITERS = ",;\t|"
REMARKS = ("#", "%", "//")


class FileColumn:
    """An array of a file. `row` is what messages call its first row, e.g. 2 where line 1 of a CSV is the header.

    wrong     of a column that does not hold numbers only: the message for whoever asks for its data
    is_text   whether no cell of it holds a number
    is_local  whether it holds times by a clock of an unknown time zone
    """

    __slots__ = ("_data", "file", "is_local", "is_text", "row", "unit", "wrong")

    def __init__(
        self,
        data: Array,
        file: Path,
        row: int = 0,
        unit: str = "",
        *,
        wrong: str = "",
        is_text: bool = False,
        is_local: bool = False,
    ) -> None:
        self._data, self.file, self.row, self.unit = data, file, row, unit
        self.wrong, self.is_text, self.is_local = wrong, is_text, is_local

    @property
    def data(self) -> Array:
        """The numbers. Raises RecordingError where the file holds something else in their place."""
        if self.wrong:
            raise RecordingError(self.wrong)
        return self._data

    @property
    def where(self) -> str:
        return f"{self.file}: {'line' if self.row else 'row'}"


def read_npz(path: Path) -> dict[str, FileColumn]:
    """The arrays of an NPZ file. Raises RecordingError; nothing that would run code (pickles) is loaded."""
    with reading(path, "an NPZ file"):
        return {name: FileColumn(array, path) for name, array in arrays(path).items()}


def read_csv(path: Path, skip_rows: int | None = None) -> dict[str, FileColumn]:
    """The columns of a CSV file with a header line: names, with units in brackets ("emg [uV]").

    The delimiter (comma, semicolon, tab or bar) is named by a first line "sep=;", or found in the header; with another one than a comma,
    numbers may have decimal commas. Empty cells are NaN; lines before the header that begin with #, % or // are skipped, and the first
    `skip_rows` whatever they hold; after these the header may be missing (then the columns are column1, column2, ...). A line of units may
    follow the header; all lines may end with a separator; of names that occur twice the later ones are numbered.
    A column of dates and times holds ns since 1970 (those without a zone by UTC, `is_local`); one of times of day ns since midnight.
    A column that holds text instead raises where its `data` are asked for, and has `is_text`.
    Raises RecordingError with file and line.
    """
    text = read_text(path, "CSV")
    if "\0" in text:
        raise RecordingError(f"{path}: holds zero bytes; it is not text, or was damaged")
    lines = text.split("\n")
    skip = skip_rows or 0
    named = re.fullmatch(r'"?sep=(.)"?', lines[0].rstrip("\r"))
    if named:
        lines[0] = "#"
    at = next((i for i, line in enumerate(lines) if i >= skip and line.strip() and not line.startswith(REMARKS)), None)
    if at is None:
        raise RecordingError(f"{path}: the file is empty")
    if _by_spaces(lines, at):
        lines = ["\t".join(line.split()) for line in lines]
    while not lines[-1].strip():
        lines.pop()
    delimiter = named[1] if named else max(DELIMITERS, key=lines[at].count)
    if all(line.rstrip().endswith(delimiter) for line in lines[at:]):
        lines = [line.rstrip()[:-1] if i >= at else line for i, line in enumerate(lines)]
    header = [name.strip() for name in next(csv.reader([lines[at]], delimiter=delimiter))]
    headless = skip_rows is not None and all(not name or _is_number(name) for name in header)
    if headless:
        header = [f"column{i + 1}" for i in range(len(header))]
        at -= 1
    if any(_is_number(name) for name in header):
        raise RecordingError(
            f"{path}: line {at + 1}: the first line must name the columns, but holds the number {next(filter(_is_number, header))};"
            " say how many lines to skip with --skip-rows N (0: there is no header)"
        )
    names = [_split(name) for name in header]
    if nameless := [str(i + 1) for i, (name, _) in enumerate(names) if not name]:
        raise RecordingError(
            f"{path}: line {at + 1}: every column needs a name of its own; number {', '.join(nameless)} has no name"
        )
    names = _numbered(names)
    if units := _units(lines, at + 1, delimiter, len(names)):
        names = [(name, unit or given_unit) for (name, unit), given_unit in zip(names, units, strict=True)]
        at += 1
    data = _fast(lines[at + 1 :], delimiter, len(names))
    if data is None:
        return _careful(path, lines, at + 1, delimiter, header, names)
    return {
        name: FileColumn(np.ascontiguousarray(data[:, i]), path, at + 2, unit) for i, (name, unit) in enumerate(names)
    }


def _numbered(names: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Names and units, in which a name that occurs again has its number: x, x_2."""
    made: list[tuple[str, str]] = []
    taken = {name for name, _ in names}
    seen: Counter[str] = Counter()
    for name, unit in names:
        seen[name] += 1
        again = name
        while seen[name] > 1 and again in taken:
            again = f"{name}_{seen[name]}" if again == name else f"{again}_"
        taken.add(again)
        made.append((again, unit))
    return made


def read_rows(path: Path) -> Array | None:
    """The numbers (n, columns) of a table that has no header; None for one that begins with something else than numbers.

    The delimiter may also be spaces. Raises RecordingError with file and line.
    """
    lines = read_text(path, "CSV").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise RecordingError(f"{path}: the file is empty")
    cut = next((d for d in DELIMITERS if d in lines[0]), None)
    width = len(lines[0].split(cut))
    if not all(_is_number(cell) for cell in lines[0].split(cut)):
        return None
    made = np.empty((len(lines) if len(lines) * width <= sum(map(len, lines)) else 1, width))
    for number, line in enumerate(lines, 1):
        cells = line.split(cut)
        if len(cells) != width:
            raise RecordingError(f"{path}: line {number}: {len(cells)} numbers, but the first line has {width}")
        for i, cell in enumerate(cells):
            try:
                made[number - 1, i] = float(cell if cut == "," else cell.replace(",", "."))
            except ValueError:
                raise RecordingError(f"{path}: line {number}: {cell!r} is not a number") from None
    return made


def read_records(path: Path, wrong: type[KinegraphError] = KinegraphError) -> list[tuple[int, dict[str, str]]]:
    """The rows of a CSV file with a header line: line number, and cells by column name. Raises `wrong`."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            return list(enumerate(csv.DictReader(file), 2))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise wrong(f"{path}: cannot be read: {error}") from None


def read_text(path: Path, kind: str) -> str:
    """The whole of a text file in UTF-8; raises RecordingError where it cannot be one of this kind."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise RecordingError(
            f"{path}: not a text file in UTF-8, so no {kind}; if a spreadsheet wrote it, save it again as UTF-8"
        ) from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror or error})") from None


def _split(name: str) -> tuple[str, str]:
    """A column's name and unit: "emg [uV]" or "emg (uV)"."""
    match = re.fullmatch(r"(.*?)\s*[\[(]([^\])]*)[\])]", name)
    return (match[1].strip(), match[2].strip()) if match else (name, "")


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _by_spaces(lines: list[str], at: int) -> bool:
    """Whether a table has blanks between its cells: no other delimiter, and as many words in its first line as numbers in a later one."""
    words = lines[at].split()
    if len(words) < 2 or any(delimiter in lines[at] for delimiter in DELIMITERS):
        return False
    rows = [line.split() for line in lines[at : at + 3] if line.strip()]
    return any(len(row) == len(words) and all(map(_is_number, row)) for row in rows)


def _units(lines: list[str], at: int, delimiter: str, columns: int) -> list[str]:
    """The units in a line of short words, one for each column, or blank; [] for any other line."""
    cells = next(csv.reader([lines[at]], delimiter=delimiter), []) if at < len(lines) else []
    texts = [cell.strip().strip("[]()") for cell in cells]
    words = [cell for cell in texts if cell and cell != "-"]
    known = all(re.fullmatch(r"[A-Za-z\u00b5\u03bc%\u00b0][A-Za-z0-9/*.^\u00b2]{0,7}|-", word) for word in words)
    fits = len(texts) == columns and words and known and not any(map(_is_number, words))
    return ["" if cell == "-" else cell for cell in texts] if fits else []


def _fast(body: list[str], delimiter: str, columns: int) -> Array | None:
    """numpy's own reader, where the table is what it should be; else None."""
    if not body:
        return np.empty((0, columns))
    if not all(map(str.strip, body)):
        return None
    try:
        data: Array = np.loadtxt(body, delimiter=delimiter, ndmin=2, comments=None, quotechar='"')
    except ValueError:
        return None
    return data if data.shape[1] == columns else None


def _careful(
    path: Path, lines: list[str], start: int, delimiter: str, header: list[str], names: list[tuple[str, str]]
) -> dict[str, FileColumn]:
    """Cell by cell: decimal commas, empty cells, times of day, and the line of whatever is no number."""
    rows: list[list[str]] = []
    for number, line in enumerate(lines[start:], start + 1):
        cells = next(csv.reader([line], delimiter=delimiter), [])
        if len(cells) != len(header):
            raise RecordingError(
                f"{path}: line {number}: {len(cells)} cells, but the header names {len(header)} columns"
            )
        rows.append(cells)
    columns = zip(*rows, strict=True) if rows else ((),) * len(names)
    made = {}
    for (name, unit), label, column in zip(names, header, columns, strict=True):
        made[name] = _column(column, FileColumn(np.empty(0), path, start + 1, unit), label, delimiter)
    return made


def _column(cells: Sequence[str], made: FileColumn, label: str, delimiter: str) -> FileColumn:
    """One column of cells: numbers, or times, or text of which the first line is named."""
    values = np.full(len(cells), np.nan)
    wrong: list[int] = []
    for i, cell in enumerate(cells):
        try:
            values[i] = _value(cell, delimiter)
        except ValueError:
            wrong.append(i)
    if not wrong:
        return FileColumn(values, made.file, made.row, made.unit)
    if len(wrong) == len(cells) and (times := moments(cells)) is not None:
        return FileColumn(times[0], made.file, made.row, "ns", is_local=times[1])
    line = made.row + wrong[0]
    text = f"{made.file}: line {line}: {cells[wrong[0]]!r} in column {label!r} is not a number"
    filled = sum(1 for cell in cells if cell.strip())
    return FileColumn(values, made.file, made.row, made.unit, wrong=text, is_text=len(wrong) == filled)


def moments(cells: Sequence[str]) -> tuple[Array, bool] | None:
    """Dates and times (ISO 8601), or times of day, as whole ns, and whether they are without a zone; None for anything else.

    Times of day count from the midnight before the first of them, also across another midnight.
    """
    dated = [
        re.fullmatch(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?(Z|[+-]\d\d:?\d\d)?", c.strip())
        for c in cells
    ]
    if all(dated):
        made = np.empty(len(cells), np.int64)
        for i, found in enumerate(dated):
            assert found is not None
            moment = datetime.fromisoformat(f"{found[1]}T{found[2]}{found[4] or '+00:00'}")
            made[i] = round(moment.timestamp()) * NS + int((found[3] or "0").ljust(9, "0"))
        return made, not all(found and found[4] for found in dated)
    clock = [re.fullmatch(r"(\d{1,2}):(\d\d):(\d\d)(?:[.,](\d{1,9}))?", c.strip()) for c in cells]
    if not all(clock):
        return None
    made = np.array(
        [
            (int(c[1]) * 3600 + int(c[2]) * 60 + int(c[3])) * NS + int((c[4] or "0").ljust(9, "0")) if c else 0
            for c in clock
        ],
        np.int64,
    )
    day = 24 * 3600 * NS
    made[1:] += day * np.cumsum(np.diff(made) < -day // 2)
    return made, True


def _value(cell: str, delimiter: str) -> float:
    if not cell.strip():
        return np.nan
    return float(cell if delimiter == "," else cell.replace(",", "."))
