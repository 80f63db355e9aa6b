"""A stream as a CSV table: a time column, then one column per channel with its unit in the header."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np

from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec
from kinegraph.stream.data.columns import column_names, columns
from kinegraph.stream.data.csv_writer import Sheet

Clock = Literal["seconds", "iso", "ns"]
_TOLD_IN: dict[Clock, str] = {"seconds": "s", "iso": "", "ns": "ns"}


def write_csv(
    path: Path, spec: StreamSpec, chunks: Iterable[Chunk], *, clock: Clock, origin: int, progress: Callable[[int], None]
) -> int:
    """Write one stream; returns its rows. `clock`: seconds since `origin` (ns), ISO 8601 in UTC, or ns since 1970.

    Every digit is kept: stamps to the nanosecond, numbers as the shortest text that reads back as the same number. A column `lost`
    says how many samples are missing just before a row (-1: an unknown number). Times in events (their unit is ns: onset, end) follow
    the same clock; one that is not known is empty.
    """
    names = column_names(spec)
    times = [unit == "ns" and spec.is_event and clock != "ns" for _, unit in names]
    heads = [
        _head(name, _TOLD_IN[clock] if is_time else unit) for (name, unit), is_time in zip(names, times, strict=True)
    ]
    first = {"seconds": "time [s]", "iso": "time", "ns": "time [ns]"}[clock]
    rows = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = Sheet(file, lineterminator="\r\n")
        writer.writerow([first, *heads, "lost"])
        for chunk in chunks:
            n = len(chunk.time)
            if n:
                lost = [chunk.lost, *[0] * (n - 1)]
                cells = [
                    _times(column, clock, origin) if is_time else _texts(column)
                    for column, is_time in zip(columns(spec, chunk.data), times, strict=True)
                ]
                writer.writerows(zip(_stamps(chunk.time, clock, origin), *cells, lost, strict=True))
                rows += n
                progress(n)
    return rows


def _head(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _times(column: Array, clock: Clock, origin: int) -> list[str]:
    known = column.astype(np.int64) > 0
    return [
        str(text) if there else "" for text, there in zip(_stamps(column, clock, origin), known.tolist(), strict=True)
    ]


def _stamps(time: Array, clock: Clock, origin: int) -> list[str] | list[int]:
    if clock == "ns":
        return [int(t) for t in time]
    if clock == "iso":
        return [f"{datetime.fromtimestamp(t // NS, UTC):%Y-%m-%dT%H:%M:%S}.{t % NS:09d}Z" for t in time.tolist()]
    return [seconds(t - origin) for t in time.tolist()]


def seconds(ns: int) -> str:
    """Exact seconds: 1.500000000, -0.000000001."""
    return f"{'-' if ns < 0 else ''}{abs(ns) // NS}.{abs(ns) % NS:09d}"


def _texts(column: Array) -> list[object]:
    """Shortest texts that read back as the same numbers; a float32's is shorter than that of the same float64."""
    if column.dtype.kind == "f" and column.dtype != np.float64:
        return list(column.astype(str))
    values: list[object] = column.tolist()
    return [v.decode(errors="replace") for v in values if isinstance(v, bytes)] if column.dtype.kind == "S" else values
