"""Qualisys Track Manager's TSV exports: keys, then markers (or analogue channels) with or without a header."""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, RateMissing, Understood
from kinegraph.devices.formats.lab.text_lines import TextLines, is_number
from kinegraph.stream.chunk import Samples

KEY = re.compile(r"^[A-Z][A-Z0-9_]+$")
OWN_TIME = ("frame", "time", "sample")


def knows(head: str) -> bool:
    first = next(iter(head.splitlines()), "").strip('"')
    return first.startswith(("NO_OF_FRAMES\t", "NO_OF_SAMPLES\t"))


def read_qualisys(path: Path, asked: Asked) -> Understood:
    """.markers (or .analog), and .events with their texts. Raises RecordingError."""
    text = TextLines.read(path, asked.skip_rows)
    made, at = Understood(path, "Qualisys Track Manager TSV"), asked.skip_rows
    facts: dict[str, list[str]] = {}
    events: list[tuple[float, str]] = []
    while at < len(text.lines):
        cells = text.cells(at, "\t")
        if not cells or not KEY.match(cells[0]):
            break
        if cells[0] == "EVENT" and len(cells) >= 4:
            events.append((text.number(at, cells[3]), cells[1]))
        else:
            facts.setdefault(cells[0], cells[1:])
        at += 1
    if at == len(text.lines):
        raise text.wrong(at - 1, "ends before its data begin; it was cut off")
    made.local_time(_moment(facts.get("TIME_STAMP", [""])[0]))
    _refuse(text, facts)
    markers = "MARKER_NAMES" in facts or "NO_OF_MARKERS" in facts
    rate = _number(facts, "FREQUENCY") or asked.rate_hz or 0.0
    if rate <= 0:
        raise RateMissing(f"{path}: FREQUENCY is missing; give --rate HZ")
    header = [] if _numeric(text.cells(at, "\t")) else text.cells(at, "\t")
    table = _table(text, at + bool(header), header)
    drop = sum(name.lower() in OWN_TIME for name in header[:2])
    data = table[:, drop:]
    announced = _number(facts, "NO_OF_FRAMES" if "NO_OF_FRAMES" in facts else "NO_OF_SAMPLES")
    if announced and announced != len(data):
        made.doubt(f"{announced:.0f} frames are announced, {len(data)} are there; was the file cut off?")
    if markers:
        _markers(made, text, at, facts, data, rate)
    else:
        names = [name for name in (facts.get("CHANNEL_NAMES") or header[drop:]) if name]
        units = (asked.unit,)
        made.add(
            "analog",
            np.ascontiguousarray(data),
            rate,
            channels=names if len(names) == data.shape[1] else (),
            units=units,
        )
    if events:
        made.add_events("events", [s for s, _ in events], [name for _, name in events])
    return made


def _refuse(text: TextLines, facts: dict[str, list[str]]) -> None:
    if "NO_OF_BODIES" in facts or "BODY_NAMES" in facts:
        raise text.wrong(0, "this is an export of rigid bodies (6D), which is not read; export 3D data, or C3D")


def _table(text: TextLines, at: int, header: list[str]) -> Samples:
    while header and not header[-1]:
        header.pop()
    first = text.lines[at].rstrip("\t").split("\t") if at < len(text.lines) else []
    return text.table(at, "\t", len(header) or len(first), comma=_comma(text, at))


def _comma(text: TextLines, at: int) -> bool:
    return at < len(text.lines) and "," in text.lines[at] and "." not in text.lines[at]


def _numeric(cells: list[str]) -> bool:
    return all(not cell or is_number(cell) or cell.lower() in ("nan", "null") for cell in cells)


def _markers(
    made: Understood, text: TextLines, at: int, facts: dict[str, list[str]], data: Samples, rate: float
) -> None:
    names = [name for name in facts.get("MARKER_NAMES", []) if name]
    if "Velocity" in facts.get("DATA_INCLUDED", []) or (facts.get("NO_OF_DATA_TYPES", ["1"])[0] not in ("1", "0")):
        made.doubt("velocities stand beside the positions: only the positions are read")
        data = data[:, : 3 * len(names)]
    if not names or data.shape[1] != 3 * len(names):
        raise text.wrong(at, f"{data.shape[1]} columns for {len(names)} markers; there must be three for each")
    points = np.ascontiguousarray(data.reshape(len(data), len(names), 3))
    gone = (points == 0).all(axis=2)
    if gone.any():
        made.doubt(f"{int(gone.sum())} positions are exactly 0, 0, 0: taken for markers that were not seen")
        points[gone] = np.nan
    made.add("markers", points, rate, channels=names, units=("mm",), start_ns=0)


def _number(facts: dict[str, list[str]], key: str) -> float:
    cell = (facts.get(key) or [""])[0]
    return float(cell.replace(",", ".")) if is_number(cell) else 0.0


def _moment(text: str) -> datetime | None:
    for form in ("%Y-%m-%d, %H:%M:%S.%f", "%Y-%m-%d, %H:%M:%S", "%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%d %H:%M:%S"):
        try:
            return datetime.strptime(text.strip(), form)
        except ValueError:
            continue
    return None
