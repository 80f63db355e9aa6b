"""APDM's tables of format 7: three header rows (sensor, signal, axis), times in microseconds since 1970."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, Understood
from kinegraph.devices.formats.lab.text_lines import TextLines, filled

UNITS = {"accelerometer": "m/s2", "gyroscope": "rad/s", "magnetometer": "uT", "barometer": "", "orientation": ""}
MAX = 1e9
"""Numbers beyond this are what unused channels hold."""


def knows(head: str) -> bool:
    return head.startswith("Format=") and "Time," in head[:20_000]


def read_apdm(path: Path, asked: Asked) -> Understood:
    """.accelerometer, .gyroscope, .magnetometer, .barometer, .orientation (w, x, y, z): all sensors side by side. Raises RecordingError."""
    text, at = TextLines.read(path, asked.skip_rows), asked.skip_rows
    made = Understood(path, f"APDM table ({text.cells(at, ',')[0]})")
    if not text.cells(at, ",")[0].startswith("Format=7"):
        made.doubt("another format than 7 was never tried")
    sensors, signals, axes = text.cells(at, ","), text.cells(at + 1, ","), text.cells(at + 2, ",")
    width = len(axes)
    if not signals or signals[0] != "Time":
        raise text.wrong(at + 1, "the first column must be Time")
    kinds = filled(signals[:width], width)
    starts = [k for k, cell in enumerate(signals) if cell == kinds[1]] if width > 1 else []
    if not starts:
        raise text.wrong(at + 1, "there is no column beside the time")
    table = text.table(at + 3, ",", width)
    if not len(table):
        raise text.wrong(at + 2, "there are no samples below the header")
    clock = np.array([_microseconds(text, i) for i in range(at + 3, len(text.lines))], np.int64)
    if int(clock[0]) > 10**15:
        made.begin = int(clock[0]) * 1000
    seconds = (clock - clock[0]) / 1e6
    columns: dict[str, list[tuple[int, str]]] = {}
    for n, start in enumerate(starts):
        stop = starts[n + 1] if n + 1 < len(starts) else width
        labels = [cell for cell in sensors[start - (n == 0) * 0 : stop] if cell and not cell.startswith("Format=")]
        name = next((cell for cell in labels if not cell.isdigit()), labels[0] if labels else f"sensor{n + 1}")
        for k in range(start, stop):
            axis = "w" if axes[k] == "S" else axes[k].lower()
            columns.setdefault(kinds[k].lower(), []).append((k, f"{name}.{axis}" if axis else name))
    for kind, mine in columns.items():
        data = np.ascontiguousarray(table[:, [k for k, _ in mine]])
        if (wrong := np.abs(data) > MAX).any():
            made.doubt(
                f"{kind}: {int(wrong.sum())} numbers are beyond {MAX:g}and cannot be measurements; they become NaN"
            )
            data[wrong] = np.nan
        units = (UNITS.get(kind, ""),)
        made.add_timed(kind, seconds, data, at + 4, asked, channels=[name for _, name in mine], units=units)
    return made


def _microseconds(text: TextLines, at: int) -> int:
    cell = text.lines[at].partition(",")[0].strip()
    if not cell.isdigit() or len(cell) > 18:
        raise text.wrong(at, f"{cell!r} is not a time in microseconds")
    return int(cell)
