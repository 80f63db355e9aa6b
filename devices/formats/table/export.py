"""Any stream as a sheet of an Excel workbook, as a structure of a MATLAB file, or as a Parquet file."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np

from kinegraph.devices.formats.exporter import FILE_NAME, Export, Exporter, Written, titled
from kinegraph.devices.formats.whole_streams import gather
from kinegraph.stream.chunk import NS, utc
from kinegraph.stream.data.columns import column_names, columns
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.system.atomic_file import complete, private_folder
from kinegraph.stream.system.extras import optional

SHEET_ROWS, SHEET_COLUMNS = 1_048_576, 16_384
MATLAB_NAME = 63
MATLAB_BYTES = (1 << 31) - 1
"""A variable of a version 5 file holds no more."""
FORBIDDEN = r"[\[\]:*?/\\]"


def _xlsx(wanted: Export) -> list[Written]:
    openpyxl = optional("openpyxl", "an Excel file", "pip install 'kinegraph[excel]'", RecordingError)
    wanted.refuse_existing(wanted.place)
    private_folder(wanted.place.parent)
    book = openpyxl.Workbook(write_only=True)
    streams = gather(wanted)
    for one, title in zip(streams, titled(wanted.names, 31, FORBIDDEN), strict=True):
        heads = [f"{name} [{unit}]" if unit else name for name, unit in column_names(one.spec)]
        if len(one.time) >= SHEET_ROWS or len(heads) >= SHEET_COLUMNS:
            raise RecordingError(
                f"stream {one.name!r}: {len(one.time)} rows of {len(heads)} columns do not fit into a sheet; export CSV"
            )
        sheet = book.create_sheet(title)
        sheet.append(["time [s]", *heads])
        seconds = (one.time - wanted.origin) / NS
        for row in zip(seconds.tolist(), *(_cells(column) for column in columns(one.spec, one.data)), strict=True):
            sheet.append(row)
    about = book.create_sheet("about")
    for key, value in (("recording", wanted.recording.path.name), ("time 0", utc(wanted.origin)), *_facts(wanted)):
        about.append([key, str(value)])
    with complete(wanted.place) as draft:
        book.save(draft)
    return [(one.name, wanted.place, len(one.time)) for one in streams]


def _facts(wanted: Export) -> list[tuple[str, Any]]:
    return list((wanted.recording.header.get("session") or {}).items())


def _cells(column: Any) -> list[Any]:
    """Values that a sheet can hold: nothing for NaN and infinity; a text that begins as a formula stays a text."""
    if column.dtype.kind == "f":
        return [value if np.isfinite(value) else None for value in column.tolist()]
    if column.dtype.kind in "US":
        return [f"'{text}" if str(text)[:1] in "=+-@" else str(text) for text in column.tolist()]
    return list(column.tolist())


def _matlab(wanted: Export) -> list[Written]:
    import scipy.io

    wanted.refuse_existing(wanted.place)
    private_folder(wanted.place.parent)
    streams, variables = gather(wanted), {}
    for one, name in zip(streams, titled(wanted.names, MATLAB_NAME, r"[^A-Za-z0-9_]"), strict=True):
        if one.data.nbytes > MATLAB_BYTES:
            raise RecordingError(
                f"stream {one.name!r}: its {one.data.nbytes} bytes do not fit into a MATLAB file; export parts of it"
            )
        about = {"stream": one.name, "rate_hz": one.spec.rate_hz or np.nan, "time_s": (one.time - wanted.origin) / NS}
        units = np.array([unit for _, unit in column_names(one.spec)], object)
        if one.spec.is_event:
            fields = {name: _plain(one.data[name]) for name in one.spec.dtype.names or ()}
            variables[_letter(name)] = {**about, **fields}
        else:
            channels = np.array(one.labels, object)
            variables[_letter(name)] = {**about, "data": one.data, "channels": channels, "units": units}
    variables["about"] = {
        "time_zero_utc": utc(wanted.origin),
        **{re.sub(r"\W", "_", str(k)): str(v) for k, v in _facts(wanted)},
    }
    with complete(wanted.place) as draft:
        scipy.io.savemat(
            str(draft), variables, appendmat=False, do_compression=True, long_field_names=True, oned_as="column"
        )
    return [(one.name, wanted.place, len(one.time)) for one in streams]


def _letter(name: str) -> str:
    return name if name[0].isalpha() else f"s_{name}"


def _plain(column: Any) -> Any:
    return column.astype(object) if column.dtype.kind in "US" else column


def _parquet(wanted: Export) -> list[Written]:
    pyarrow = optional("pyarrow", "a Parquet file", "pip install 'kinegraph[parquet]'", RecordingError)
    optional("pyarrow.parquet", "a Parquet file", "pip install 'kinegraph[parquet]'", RecordingError)
    if wanted.place.exists() and not wanted.place.is_dir():
        raise RecordingError(f"--out {wanted.place}: is a file; name a folder for the tables")
    private_folder(wanted.place)
    streams, written = gather(wanted), []
    for one, name in zip(streams, titled(wanted.names, FILE_NAME, r"[^A-Za-z0-9._-]"), strict=True):
        path = wanted.place / f"{name}.parquet"
        wanted.refuse_existing(path)
        held: dict[str, Any] = {"time": pyarrow.array(one.time, pyarrow.timestamp("ns", tz="UTC"))}
        for (column, _), values in zip(column_names(one.spec), columns(one.spec, one.data), strict=True):
            held[column if column != "time" else "time_"] = pyarrow.array(
                values.tolist() if values.dtype.kind in "US" else np.ascontiguousarray(values)
            )
        about = {
            "stream": one.name,
            "rate_hz": one.spec.rate_hz,
            "units": dict(column_names(one.spec)),
            "session": dict(_facts(wanted)),
        }
        table = pyarrow.table(held).replace_schema_metadata({"kinegraph": json.dumps(about, default=str)})
        with complete(path) as draft:
            pyarrow.parquet.write_table(table, draft)
        written.append((one.name, path, len(one.time)))
    return written


XLSX = Exporter("an Excel workbook, a sheet per stream", ".xlsx", _xlsx)
MATLAB = Exporter("a MATLAB file (version 5), a structure per stream", ".mat", _matlab)
PARQUET = Exporter("a folder with one Parquet file per stream", "_parquet", _parquet)
