"""Lines of numbers, as an Arduino prints them: text to rows, whatever else stands between; no port, no clock.

What a line may look like: as many numbers as there are columns, with the delimiter between and perhaps one behind the last; or each number
behind its column's name and a colon, in any order ("emg:512,b:3", as Arduino's plotter has it). Blank lines and lines that begin
with '#' are passed over. The first line is thrown away, for it may have begun before the port was opened, unless it is the header.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from kinegraph.stream.chunk import Samples

LONGEST = 4096
"""What has no line end within this many bytes is no line."""
_NUMBER = rb"[+-]?(?:\d+\.?\d*(?:[eE][+-]?\d{1,3})?|\.\d+(?:[eE][+-]?\d{1,3})?|nan|inf)"
_END = re.compile(rb"[\r\n]+")
_LABELLED = re.compile(rb"\s*([^:=]+?)\s*[:=]\s*(" + _NUMBER + rb")\s*", re.IGNORECASE)


@dataclass(slots=True)
class Lines:
    """What a feed brought.

    rows       (n, columns) float64, columns in the order that was asked for
    rejected   lines with another number of columns, with something that is no number, or without an end
    example    the first of these
    """

    rows: Samples
    rejected: int = 0
    example: bytes = b""


@dataclass(slots=True)
class LineDecoder:
    """Feed it bytes as they come, cut anywhere; it never waits and never raises.

    columns      names of the columns, in the order in which the device prints them; with `header`, the wanted ones, in any order
    delimiter    between two numbers; " " stands for any number of blanks
    header       whether the device prints the names of its columns; until then no line is believed
    """

    columns: tuple[str, ...]
    delimiter: str = ","
    header: bool = False
    names: tuple[str, ...] = field(default=(), init=False)
    """The columns as the header has named them."""
    _buffer: bytes = field(default=b"", init=False)
    _first: bool = field(default=True, init=False)
    _overlong: bool = field(default=False, init=False)
    _pattern: re.Pattern[bytes] | None = field(default=None, init=False)
    _places: list[int] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        if not self.header:
            self._expect(self.columns)

    def feed(self, data: bytes) -> Lines:
        lines = _END.split(self._buffer + data)
        self._buffer = lines.pop()
        found = Lines(np.empty(0))
        rows: list[list[float]] = []
        for line in lines:
            self._take(line, rows, found)
        if len(self._buffer) > LONGEST:
            self._reject(self._buffer, found)
            self._buffer, self._overlong, self._first = b"", True, False
        found.rows = np.array(rows, np.float64).reshape(-1, len(self.columns))
        return found

    def _take(self, line: bytes, rows: list[list[float]], found: Lines) -> None:
        line = line.strip()
        first, self._first = self._first, False
        overlong, self._overlong = self._overlong, False
        if self._is_header(line) or first or overlong or not line or line.startswith(b"#"):
            return
        if self._pattern is not None and self._pattern.fullmatch(line):
            fields = line.split(None if self.delimiter == " " else self.delimiter.encode())
            rows.append([float(fields[place]) for place in self._places])
        elif (row := self._labelled(line)) is not None:
            rows.append(row)
        elif self._pattern is not None:
            self._reject(line, found)

    def _labelled(self, line: bytes) -> list[float] | None:
        """The numbers of a line that names each; columns that were not asked for are passed over."""
        if b":" not in line and b"=" not in line:
            return None
        parts = line.split() if self.delimiter == " " else line.split(self.delimiter.encode())
        matches = [_LABELLED.fullmatch(part) for part in parts if part.strip()]
        if not matches or not all(matches):
            return None
        named = {m[1].decode("utf-8", "replace"): float(m[2]) for m in matches if m}
        if len(named) < len(matches) or not set(self.columns) <= set(named):
            return None
        return [named[name] for name in self.columns]

    def _is_header(self, line: bytes) -> bool:
        """Whether a line names columns; then these are expected from now on."""
        text = line.decode("utf-8", "replace")
        names = tuple(part.strip() for part in (text.split() if self.delimiter == " " else text.split(self.delimiter)))
        if self.header:
            if set(self.columns) <= set(names) and len(set(names)) == len(names):
                self._expect(names)
                return True
            return False
        return names == self.columns

    def _expect(self, names: tuple[str, ...]) -> None:
        between = rb"[ \t]+" if self.delimiter == " " else rb"[ \t]*" + re.escape(self.delimiter.encode()) + rb"[ \t]*"
        self.names = names
        last = b"" if self.delimiter == " " else b"(?:%s)?" % between
        self._pattern = re.compile(between.join([_NUMBER] * len(names)) + last, re.IGNORECASE)
        self._places = [names.index(name) for name in self.columns]

    def _reject(self, line: bytes, found: Lines) -> None:
        found.rejected += 1
        found.example = found.example or line
