"""Named arrays from CSV and NPZ files, and the streams that somebody asks to be made of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.formats.findings import Claims, Findings
from kinegraph.devices.formats.timing import (
    MAX_HZ,
    MAX_NS,
    UNITS,
    check_order,
    grid_of,
    lost_by_counter,
    plain_unit,
    regular,
    to_ns,
    unit_in,
)
from kinegraph.stream.chunk import NS, Array, StreamSpec, Times
from kinegraph.stream.data.tables import FileColumn
from kinegraph.stream.errors import RecordingError, nearest
from kinegraph.stream.recording.series import Series


class ColumnTable:
    """All arrays of all files, by name, or by `file:name` where two files have the same name."""

    def __init__(self) -> None:
        self.columns: dict[str, FileColumn] = {}
        self._twice: set[str] = set()

    def put(self, file: Path, columns: dict[str, FileColumn]) -> None:
        """Take the columns of a file; raises RecordingError where another file has the same name."""
        if other := next((c.file for c in self.columns.values() if c.file.stem == file.stem), None):
            raise RecordingError(f"{file}: {other} has the same name; rename one: column names must differ")
        for name, column in columns.items():
            if name in self.columns:
                self._twice.add(name)
            self.columns[name] = self.columns[f"{file.stem}:{name}"] = column

    def find(self, name: str, option: str, near: Path | None = None) -> FileColumn:
        """An array by its name; where several files have it, that of the file `near`."""
        if name in self._twice and near is not None and (own := self.columns.get(f"{near.stem}:{name}")):
            return own
        if name in self._twice:
            choices = ", ".join(sorted(k for k in self.columns if k.endswith(f":{name}")))
            raise RecordingError(f"{option}: {name!r} is in several files; name one of {choices}")
        if name not in self.columns:
            raise RecordingError(f"{option}: there is no column or array {name!r}; {nearest(name, self.columns)}")
        return self.columns[name]

    def part(self, name: str, option: str, near: Path | None = None) -> FileColumn:
        """A whole array, or with `name:2` its column number 2."""
        array, colon, number = name.rpartition(":")
        if not colon or name in self.columns or not number.isdigit():
            return self.find(name, option, near)
        whole = self.find(array, option, near)
        if whole.data.ndim < 2 or int(number) >= whole.data.shape[1]:
            raise RecordingError(f"{option}: {array!r} of shape {whole.data.shape} has no column {number}")
        return FileColumn(whole.data[:, int(number)], whole.file, whole.row, whole.unit)


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """Options for the streams to be made; each mapping is by stream name, "" for every stream.

    streams    the columns or arrays of each signal; several one-dimensional ones become its channels
    events     the column or array of each event stream's times
    """

    streams: dict[str, list[str]] = field(default_factory=dict)
    events: dict[str, str] = field(default_factory=dict)
    rate: dict[str, str] = field(default_factory=dict)
    time: dict[str, str] = field(default_factory=dict)
    time_unit: dict[str, str] = field(default_factory=dict)
    counter: dict[str, str] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    unit: dict[str, str] = field(default_factory=dict)
    scale: dict[str, str] = field(default_factory=dict)
    meta: dict[str, dict[str, Any]] = field(default_factory=dict)
    repeated: bool = False
    begin: int | None = None
    """When time 0 of the files was (ns UTC); None: not given."""
    text_width: int | None = None
    """Characters that a marker of an XDF file may have; None: as many as it has."""
    dejitter: bool = True
    clock_sync: bool = True
    """Of XDF files: whether the jitter of regular streams' times is removed, and clock offsets are applied."""
    claims: Claims = "warn"
    """What is done where a file claims one thing and holds another: warn of it, refuse the file, or use what was measured."""
    skip_rows: int | None = None
    """Lines of text files before the header that are passed over; None: not given."""
    untried: bool = False
    """Whether formats are read of which no real file was at hand."""
    preview: bool = False
    """Whether files are only looked at: an unknown rate is then no error."""
    findings: Findings = field(default_factory=Findings)

    @property
    def start_ns(self) -> int:
        """What is added to the files' times."""
        return self.begin or 0

    def of(self, what: dict[str, str], stream: str) -> str:
        return what.get(stream, what.get("", ""))


def make(shelf: ColumnTable, options: ImportOptions) -> list[Series]:
    """The streams that were asked for. Raises RecordingError that names the option or the file's row."""
    for option in ("rate", "time", "time_unit", "counter", "names", "unit", "scale", "meta"):
        for stream in getattr(options, option):
            if stream and stream not in options.streams and stream not in options.events:
                known = [*options.streams, *options.events]
                raise RecordingError(
                    f"--{option.replace('_', '-')} {stream}=...: no such stream is made; {nearest(stream, known)}"
                )
    signals = [_signal(shelf, options, name, parts) for name, parts in options.streams.items()]
    return [*signals, *(_events(shelf, options, name, array) for name, array in options.events.items())]


def _signal(shelf: ColumnTable, options: ImportOptions, name: str, parts: Sequence[str]) -> Series:
    if not parts:
        raise RecordingError(
            f"stream {name!r}: there is no column for it beside the time; name some with --stream {name}=COLUMNS"
        )
    columns = [shelf.part(part, f"--stream {name}") for part in parts]
    first = columns[0]
    data = _joined(name, parts, columns)
    channels = _channels(shelf, options, name, data, parts)
    near = first.file if all(column.file == first.file for column in columns) else None
    kept, time, rate, lost = _timing(shelf, options, name, near, len(data))
    data = data if len(kept) == len(data) else data[kept]
    if scale := options.of(options.scale, name):
        data = data * _number(scale, f"--scale {name}")
    spec = StreamSpec(
        shape=data.shape[1:],
        dtype=data.dtype,
        rate_hz=rate,
        channels=channels,
        units=_units(name, options.of(options.unit, name), [column.unit for column in columns], len(channels)),
        meta=options.meta.get(name, {}),
    )
    return Series(name, spec, time + options.start_ns, np.ascontiguousarray(data), lost)


def _units(name: str, unit_text: str, found: list[str], channels: int) -> tuple[str, ...]:
    """One unit for all channels or one for each; a micro sign, of either kind, is spelt as graphs and references do: uV."""
    given, found = [plain_unit(unit.strip()) for unit in unit_text.split(",")], [plain_unit(unit) for unit in found]
    if len(given) > 1 and (len(given) != channels or not all(given)):
        named = f"{channels} named channels" if channels else "channels without names; --names says what they are"
        raise RecordingError(f"--unit {name}={unit_text}: {len(given)} units for {named}")
    if len(given) > 1:
        return tuple(given) if len(set(given)) > 1 else (given[0],)
    if given[0] or len(set(found)) == 1:
        return (given[0] or found[0],)
    return tuple(found) if len(found) == channels else ("",)


def _joined(name: str, parts: Sequence[str], columns: list[FileColumn]) -> Array:
    """One array of shape (n, ...), from one array or from several of one dimension."""
    data = [column.data for column in columns]
    if any(d.dtype.kind not in "fiub" for d in data):
        raise RecordingError(f"--stream {name}: {', '.join(parts)} holds no numbers")
    if any(0 in d.shape[1:] for d in data):
        raise RecordingError(f"--stream {name}: {', '.join(parts)} of shape {data[0].shape} has no channels")
    if len(data) == 1 and data[0].ndim > 1:
        return data[0]
    if any(d.ndim != 1 for d in data) or len({len(d) for d in data}) != 1:
        shapes = ", ".join(f"{part} {d.shape}" for part, d in zip(parts, data, strict=True))
        raise RecordingError(f"--stream {name}: only columns of one length can be put side by side; given {shapes}")
    return np.stack(data, axis=1)


def _channels(
    shelf: ColumnTable, options: ImportOptions, name: str, data: Array, parts: Sequence[str]
) -> tuple[str, ...]:
    given = options.of(options.names, name)
    count = data.shape[1] if data.ndim > 1 else 1
    if not given:
        return tuple(part.rpartition(":")[2] for part in parts) if len(parts) == count else ()
    if given in shelf.columns:
        channels = tuple(str(n) for n in np.atleast_1d(shelf.columns[given].data))
        if len(channels) != count and name not in options.names:
            return ()
    else:
        channels = tuple(n.strip() for n in given.split(","))
    if len(channels) != count or len(set(channels)) != count:
        raise RecordingError(
            f"--names {name}: {len(channels)} names ({', '.join(channels)}) for {count} channels; they must be as many, and differ"
        )
    return channels


def _timing(
    shelf: ColumnTable, options: ImportOptions, name: str, near: Path | None, n: int
) -> tuple[Array, Times, float | None, Array | None]:
    """The rows that count, their stamps, rate, and lost samples, of a signal of `n` rows with all columns from the file `near`."""
    rate = _rate(shelf, options, name)
    counter = options.of(options.counter, name)
    kept, lost = np.arange(n), None
    if counter:
        found = shelf.part(counter, f"--counter {name}", near)
        _same_length(found.data, n, f"--counter {name}")
        kept, lost, doubt = lost_by_counter(found.data, found.where, repeated=options.repeated)
        if doubt:
            options.findings.doubts.append(f"{found.file.name}: {doubt}")
    named = options.of(options.time, name)
    if named:
        return kept, *_timed(shelf, options, name, named, near, n, rate, kept, lost)
    if rate is None:
        raise RecordingError(
            f"stream {name!r}: when its samples were taken is not known; give --rate {name}=HZ or --time {name}=COLUMN"
        )
    if counter:
        assert lost is not None
        origin = int(np.asarray(found.data).ravel()[0]) if n else 0
        index = origin + np.arange(len(kept)) + np.cumsum(lost)
        return kept, grid_of(rate, index, 0), rate, lost
    return kept, grid_of(rate, kept, 0), rate, None


def _timed(
    shelf: ColumnTable,
    options: ImportOptions,
    name: str,
    named: str,
    near: Path | None,
    n: int,
    rate: float | None,
    kept: Array,
    lost: Array | None,
) -> tuple[Times, float | None, Array | None]:
    column = shelf.part(named, f"--time {name}", near)
    _same_length(column.data, n, f"--time {name}")
    if column.is_local and options.begin is None:
        options.findings.doubts.append(
            f"{column.file.name}: {named!r} holds times by a clock of an unknown time zone: taken for UTC (--start)"
        )
    time = _times(options, name, named, column, rate)[kept]
    if column.unit == "ns" and column.is_local and options.begin is not None:
        time = time - time[:1]
    check_order(time, column.where, column.row, repeated=options.repeated)
    found = regular(time, rate)
    if found is None:
        if rate is not None:
            raise RecordingError(
                f"--rate {name}: the times in {named!r} are not those of samples at {rate:g} Hz; leave one of the two out"
            )
        return time, None, lost
    rate, stamps, missing = found
    return stamps, rate, lost if lost is not None else missing if missing.any() else None


def _times(options: ImportOptions, name: str, named: str, column: FileColumn, rate: float | None) -> Times:
    """A column of times in ns; with the unit "samples" it counts samples at the stream's rate."""
    result = options.of(options.time_unit, name)
    unit = result or unit_in(named, column.unit)
    if unit == "samples":
        if rate is None:
            raise RecordingError(f"--time-unit {name}=samples: give the rate of these samples, --rate {name}=HZ")
        if (
            column.data.dtype.kind not in "iuf"
            or not (np.abs(column.data.astype(np.float64)) <= rate * (MAX_NS / NS)).all()
        ):
            raise RecordingError(f"--time-unit {name}=samples: {named!r} does not hold numbers of samples")
        return grid_of(rate, column.data, 0)
    if not result and unit not in UNITS:
        raise RecordingError(
            f"{column.file}: {named!r} is in {unit!r}, which is not a unit of time; say what it is with --time-unit {name}=UNIT"
        )
    if unit not in UNITS:
        raise RecordingError(
            f"--time-unit {name}: {unit!r} is not a unit of time; valid are samples, {', '.join(UNITS)}"
        )
    try:
        return to_ns(column.data, unit)
    except ValueError as error:
        row = int(str(error).split()[1])
        raise RecordingError(f"{column.where} {column.row + row}: {named!r} holds no time") from None


def _rate(shelf: ColumnTable, options: ImportOptions, name: str) -> float | None:
    given = options.of(options.rate, name)
    if not given:
        return None
    if given in shelf.columns and shelf.columns[given].data.size == 1:
        given = str(shelf.columns[given].data.ravel()[0])
    rate = _number(given, f"--rate {name}")
    if not 1e-6 <= rate <= MAX_HZ:
        raise RecordingError(f"--rate {name}: {given} must be a positive number of Hz, from 1e-6 to 1e9")
    return rate


def _number(text: str, option: str) -> float:
    try:
        number = float(text)
    except ValueError:
        raise RecordingError(f"{option}: {text!r} is not a number") from None
    if not isfinite(number):
        raise RecordingError(f"{option}: {text} must be a finite number")
    return number


def _same_length(data: Array, n: int, option: str) -> None:
    if data.shape != (n,):
        raise RecordingError(f"{option}: an array of shape {data.shape} for {n} samples; it must be of shape ({n},)")


def _events(shelf: ColumnTable, options: ImportOptions, name: str, array: str) -> Series:
    """Events at given times: one field, `onset`, in ns; they are stamped with it."""
    column = shelf.part(array, f"--events {name}")
    if column.data.ndim != 1:
        raise RecordingError(
            f"--events {name}: {array!r} has the shape {column.data.shape}; name one column of it, as {array}:0"
        )
    time = _times(options, name, array, column, _rate(shelf, options, name))
    check_order(time, column.where, column.row, repeated=options.repeated)
    time = time + options.start_ns
    dtype = np.dtype([("onset", "<i8")])
    data = np.empty(len(time), dtype)
    data["onset"] = time
    return Series(name, StreamSpec((), dtype, units=("ns",), meta=options.meta.get(name, {})), time, data)


def positive(text: str, option: str) -> float:
    """The number that an option names. Raises RecordingError for one that is not positive."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not isfinite(number) or number <= 0.0:
        raise RecordingError(f"{option}: {text} must be a positive number")
    return number
