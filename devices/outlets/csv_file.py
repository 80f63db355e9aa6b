"""Any stream as a CSV file that spreadsheets and pandas read, whole up to the moment at which anything happens to the session."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from filelock import FileLock

from kinegraph.devices.outlets.append_file import AppendFile
from kinegraph.devices.outlets.output_lock import check_path, free_name, lock_output, unlock_output
from kinegraph.stream.chunk import NS, Array, Chunk, Specs, StreamSpec, Times, add_lost
from kinegraph.stream.data.csv_writer import Sheet, row_of
from kinegraph.stream.data.state import pack
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param

MAX_COLUMNS = 4096
UNKNOWN = -1


@dataclass(slots=True)
class CsvState:
    """How far the file has come. `missing`: samples that are missing before the next row, as `Chunk.lost` counts them."""

    path: str = ""
    offset: int = 0
    pending: str = ""
    start_ns: int = UNKNOWN
    rows: int = 0
    missing: int = 0


class CsvRuntime:
    """What belongs to a running outlet but not to its state: the spec, the open file, the lock on its name."""

    def __init__(self, spec: StreamSpec) -> None:
        self.spec = spec
        self.file: AppendFile | None = None
        self.lock: FileLock | None = None


@dataclass(frozen=True, slots=True)
class CsvFile(Outlet[CsvState, CsvRuntime]):
    """A stream or event as CSV: a header with units, then one row per sample, there as soon as its chunk has passed.

    Columns: `time (UTC)`, ISO 8601 to the nanosecond; `seconds (s)`, counted from the first row; `lost`, how many samples are missing just
    before the row (-1: unknown); then the channels or fields. Fields in ns (onset, end) are given in seconds like
    `seconds`, and left empty where they are not known (0 or less). Numbers are written so that reading them gives the same bits.

    A file is overwritten only on request; one that a session still writes to is refused. After a crash it is cut back to what the
    checkpoint knew and continued, so that no row is doubled or missing. While the disk is full rows wait in memory (8 MiB), and are
    dropped and counted beyond.
    """

    durable: ClassVar[bool] = True

    path: str = param(help="the file; folders are made")
    existing: Literal["number", "refuse", "replace"] = param(
        "number", help="if the file exists: take a new name (name-2.csv), refuse to run, or replace it"
    )

    def open(self, specs: Specs) -> Specs:
        wrong = check_path(Path(self.path))
        if wrong:
            raise ParameterError("path", self.path, wrong)
        spec = specs["in"]
        n = len(header(spec))
        if n > MAX_COLUMNS:
            raise InputError(
                "in", f"{spec.describe()}: {n} columns", f"a stream of at most {MAX_COLUMNS} numbers a sample"
            )
        self.set_state(CsvState(), CsvRuntime(spec))
        return {}

    @property
    def file(self) -> str:
        return str(Path(self.path).with_name(Path(self.state.path).name)) if self.state.path else self.path

    def begin(self) -> None:
        runtime = self.runtime
        runtime.lock = lock_output(Path(self.path).absolute())
        try:
            runtime.file = self._begin(self.state)
        except BaseException:
            unlock_output(runtime.lock)
            raise

    def process(self, port: str, chunk: Chunk) -> None:
        state, file = self.state, self.runtime.file
        if not len(chunk):
            return
        assert file is not None
        if state.start_ns == UNKNOWN:
            state.start_ns = int(chunk.time[0])
        missing = add_lost(state.missing, chunk.lost)
        dropped = file.write(rows(self.runtime.spec, chunk, state.start_ns, missing))
        state.missing = add_lost(missing, dropped) if dropped else 0
        state.rows += len(chunk) - dropped

    def close(self) -> None:
        runtime = self.runtime
        try:
            if runtime.file is not None:
                runtime.file.close()
        finally:
            runtime.file = None
            if runtime.lock is not None:
                unlock_output(runtime.lock)

    def snapshot(self) -> dict[str, Array]:
        if self.runtime.file is not None:
            self.state.offset, self.state.pending = (
                self.runtime.file.offset,
                self.runtime.file.pending.decode("latin-1"),
            )
        return pack(self.state)

    def _begin(self, state: CsvState) -> AppendFile:
        if state.path:
            file = AppendFile(Path(state.path), state.offset, state.pending.encode("latin-1"), fresh=False)
        else:
            path = Path(self.path).absolute()
            if self.existing == "number":
                path = free_name(path)
            elif self.existing == "replace":
                path.unlink(missing_ok=True)
            state.path = str(path)
            file = AppendFile(path)
        if not file.offset and not file.pending:
            file.write(row_of(header(self.runtime.spec)))
        return file


def header(spec: StreamSpec) -> list[str]:
    """Column names with units."""
    return [
        "time (UTC)",
        "seconds (s)",
        "lost",
        *(f"{name} ({unit})" if unit else name for name, unit in _columns(spec)),
    ]


def rows(spec: StreamSpec, chunk: Chunk, start_ns: int, lost: int) -> bytes:
    """A chunk's samples as lines; the first gives `lost`."""
    n = len(chunk)
    stamps = np.datetime_as_string(chunk.time.view("datetime64[ns]"), unit="ns")
    columns: list[list[Any]] = [
        [f"{stamp}Z" for stamp in stamps.tolist()],
        _seconds(chunk.time, start_ns),
        [lost, *[0] * (n - 1)],
    ]
    if spec.is_event:
        for field in spec.channels:
            columns += _values(chunk.data[field].reshape(n, -1), spec.unit_of(field), start_ns)
    else:
        columns += _values(chunk.data.reshape(n, -1), "", start_ns)
    text = io.StringIO()
    Sheet(text).writerows(zip(*columns, strict=True))
    return text.getvalue().encode()


def _columns(spec: StreamSpec) -> Iterator[tuple[str, str]]:
    """Name and unit of every number of a sample, flattened in C order."""
    if spec.is_event:
        for field in spec.channels:
            shape = spec.dtype[field].shape
            unit = spec.unit_of(field)
            for index in np.ndindex(shape):
                yield field + _index(index), "s" if unit == "ns" else unit
        return
    for index in np.ndindex(spec.shape):
        if spec.channels:
            channel = spec.channels[index[spec.channel_axis]]
            rest = tuple(i for axis, i in enumerate(index) if axis != spec.channel_axis)
            yield channel + _index(rest), spec.unit_of(channel)
        else:
            yield "value" + _index(index), spec.units[0]


def _index(index: tuple[int, ...]) -> str:
    return f"[{','.join(map(str, index))}]" if index else ""


def _values(table: Array, unit: str, start_ns: int) -> list[list[Any]]:
    """The columns of a table (n, k), in a form that the csv module writes exactly."""
    return [_column(table[:, k], unit, start_ns) for k in range(table.shape[1])]


def _column(column: Array, unit: str, start_ns: int) -> list[Any]:
    if unit == "ns":
        return [_seconds_of(value, start_ns) if value > 0 else "" for value in column.tolist()]
    if column.dtype.kind == "S":
        return [value.decode("utf-8", "replace") for value in column.tolist()]
    if column.dtype.kind == "f" and column.dtype.itemsize != 8:
        return list(column.astype(str).tolist())
    if column.dtype.kind == "b":
        return list(column.astype(int).tolist())
    return list(column.tolist())


def _seconds(stamps: Times, start_ns: int) -> list[str]:
    return [_seconds_of(stamp, start_ns) for stamp in stamps.tolist()]


def _seconds_of(stamp: int, start_ns: int) -> str:
    past = stamp - start_ns
    whole, rest = divmod(abs(past), NS)
    return f"{'-' if past < 0 else ''}{whole}.{rest:09d}"
