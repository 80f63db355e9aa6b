"""OpenSim's tables: markers (.trc), and storage files of coordinates, forces or orientations (.mot, .sto)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, Understood, unit_of
from kinegraph.devices.formats.lab.text_lines import TextLines, delimiter_of, is_number
from kinegraph.stream.chunk import Array
from kinegraph.stream.errors import RecordingError

TRANSLATION = re.compile(r"(_t[xyz]|_trans[XYZ])$")


def is_trc(head: str) -> bool:
    return head.startswith("PathFileType")


def is_storage(head: str) -> bool:
    return any(line.strip().strip(",;\t ").lower() == "endheader" for line in head.splitlines())


def read_trc(path: Path, asked: Asked) -> Understood:
    """.markers (n, markers, 3) in the file's unit, NaN where one was not seen. Times come from the Time column. Raises RecordingError."""
    text, at = TextLines.read(path, asked.skip_rows), asked.skip_rows
    made = Understood(path, "OpenSim marker table (.trc)")
    if len(text.lines) < at + 6:
        raise text.wrong(len(text.lines) - 1, "ends before its data begin; it was cut off")
    facts = dict(zip(text.cells(at + 1, "\t"), text.cells(at + 2, "\t"), strict=False))
    head = text.cells(at + 3, "\t")
    if [cell.lower() for cell in head[:2]] != ["frame#", "time"]:
        raise text.wrong(at + 3, "the columns must begin with Frame# and Time")
    names = [cell for cell in head[2:] if cell]
    count = int(float(facts["NumMarkers"].replace(",", "."))) if is_number(facts.get("NumMarkers", "")) else len(names)
    lines = [i for i in range(at + 5, len(text.lines)) if text.lines[i].strip()]
    if count != len(names):
        columns = max((len(text.lines[i].rstrip().split("\t")) for i in lines), default=0)
        held = max(len(names), -(-(columns - 2) // 3))
        made.doubt(
            f"{count} markers are announced, {len(names)} are named, {held} are there; those without a name are numbered"
        )
        names += [f"marker{k + 1}" for k in range(len(names), held)]
    width, comma = 2 + 3 * len(names), any("," in text.lines[i] for i in lines)
    data = np.concatenate(
        [text.table(i, "\t", width, stop=i + 1, comma=comma) for i in lines] or [np.empty((0, width))]
    )
    frames = facts.get("NumFrames", "")
    if is_number(frames, comma=False) and int(float(frames)) != len(data):
        made.doubt(f"{frames} frames are announced, {len(data)} are there")
    points = np.ascontiguousarray(data[:, 2:].reshape(len(data), len(names), 3))
    rate = float(facts["DataRate"].replace(",", ".")) if is_number(facts.get("DataRate", "")) else None
    spec = {"channels": names, "units": (unit_of(facts.get("Units", "") or asked.unit),)}
    made.add_timed("markers", data[:, 1], points, (lines or [0])[0] + 1, asked, rate_hz=rate, **spec)
    return made


def read_storage(path: Path, asked: Asked) -> Understood:
    """The columns beside the time: .coordinates of a motion, .orientations (n, bodies, 4; w, x, y, z), else .values."""
    text, at = TextLines.read(path, asked.skip_rows), asked.skip_rows
    made, facts, title = Understood(path, "OpenSim storage"), {}, ""
    while text.lines[at].strip().strip(",;\t ").lower() != "endheader":
        line = text.lines[at].strip().strip(",;\t ")
        key, equals, value = line.partition("=")
        if not equals and (match := re.match(r"^(datarows|datacolumns|nRows|nColumns|name)\s+(.*)$", line)):
            key, value = match[1], match[2]
        elif not equals:
            title = title or line
        facts[key.strip().lower()] = value.strip()
        at += 1
        if at == len(text.lines):
            raise text.wrong(at - 1, "there is no line 'endheader'")
    at += 1
    while at < len(text.lines) and not text.lines[at].strip():
        at += 1
    if at == len(text.lines):
        raise text.wrong(at - 1, "ends before the labels of its columns; it was cut off")
    delimiter = delimiter_of(text.lines[at], "\t,") if re.search(r"[\t,]", text.lines[at]) else ""
    labels = _cells(text, at, delimiter)
    if not labels or labels[0].lower() != "time":
        raise text.wrong(at, "the first column must be 'time'")
    lines = [i for i in range(at + 1, len(text.lines)) if text.lines[i].strip()]
    rows = [_cells(text, i, delimiter, len(labels)) for i in lines]
    for key in ("nrows", "datarows"):
        if is_number(facts.get(key, "")) and int(float(facts[key])) != len(rows):
            made.doubt(f"{facts[key]} rows are announced, {len(rows)} are there")
    return _columns(made, text, lines, rows, labels, facts, title, asked)


def _cells(text: TextLines, at: int, delimiter: str, width: int = 0) -> list[str]:
    """The cells of a line; in a line of rows there must be `width`, and what is behind them blank."""
    line = text.lines[at]
    cells = [cell.strip() for cell in line.split(delimiter)] if delimiter else line.split()
    while len(cells) > max(width, 1) and not cells[-1]:
        cells.pop()
    if width and len(cells) != width:
        raise text.wrong(at, f"{len(cells)} cells, where there are {width} columns; was the file cut off here?")
    return cells


def _columns(
    made: Understood,
    text: TextLines,
    lines: list[int],
    rows: list[list[str]],
    labels: list[str],
    facts: dict[str, str],
    title: str,
    asked: Asked,
) -> Understood:
    size = len(rows[0][1].split(",")) if rows and len(labels) > 1 else 1
    seconds = np.array([text.number(i, row[0]) for i, row in zip(lines, rows, strict=True)])
    if size > 1:
        data: Array = np.full((len(rows), len(labels) - 1, size), np.nan)
        for k, (i, row) in enumerate(zip(lines, rows, strict=True)):
            for c, cell in enumerate(row[1:]):
                parts = cell.split(",")
                if len(parts) not in (size, 1) or (len(parts) == 1 and cell.strip().lower() not in ("", "nan")):
                    raise text.wrong(i, f"{len(parts)} numbers in column {labels[c + 1]!r}, where there are {size}")
                data[k, c] = [text.number(i, part) for part in parts] if len(parts) == size else np.nan
    else:
        data = np.array([[text.number(i, cell) for cell in row[1:]] for i, row in zip(lines, rows, strict=True)])
        data = data.reshape(len(rows), len(labels) - 1)
    if not data.shape[1]:
        raise RecordingError(f"{made.path}: there is no column beside the time")
    quaternions = facts.get("datatype", "").lower() == "quaternion" or size == 4
    part = "orientations" if quaternions else "coordinates" if title.lower() == "coordinates" else "values"
    units = _units(made, labels[1:], facts, part == "coordinates", asked)
    rate = float(facts["datarate"]) if is_number(facts.get("datarate", "")) else None
    spec = {"channels": labels[1:], "units": units}
    made.add_timed(part, seconds, data, (lines or [0])[0] + 1, asked, rate_hz=rate, **spec)
    return made


def _units(
    made: Understood, labels: list[str], facts: dict[str, str], coordinates: bool, asked: Asked
) -> tuple[str, ...]:
    """OpenSim's own: translations of a motion are in m, its angles in degrees or radians as the header says."""
    if asked.unit or not coordinates:
        return (asked.unit,)
    angle = "deg" if facts.get("indegrees", "yes").lower() == "yes" else "rad"
    units = tuple("m" if TRANSLATION.search(label) else angle for label in labels)
    if "m" in units:
        made.doubt("only the names say which columns are in metres (_tx, _ty, _tz)")
    return units
