"""Vicon Nexus tables: sections of trajectories, devices, model outputs and events, one below the other."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, Understood, unit_of, without_prefix
from kinegraph.devices.formats.lab.text_lines import TextLines, delimiter_of, filled, is_number
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.errors import RecordingError

SECTIONS = ("Trajectories", "Devices", "Model Outputs", "Joints", "Segments", "Events")
DELIMITERS = ",;\t"
PARTS = {
    "Trajectories": "markers",
    "Devices": "analog",
    "Model Outputs": "model",
    "Joints": "joints",
    "Segments": "segments",
}


def _section(line: str) -> str:
    name = line.strip().strip(DELIMITERS).strip().strip('"')
    return name if name in SECTIONS else ""


def knows(head: str) -> bool:
    """A section's name alone in the first line, and its rate alone in the next."""
    lines = head.lstrip("\ufeff").splitlines()
    return len(lines) > 2 and bool(_section(lines[0])) and is_number(lines[1].strip().strip(DELIMITERS))


def read_vicon(path: Path, asked: Asked) -> Understood:
    """.markers (Trajectories), .analog (Devices), .model, .joints, .segments, and a stream of each kind of event.

    Time counts from frame 1, as events do. Raises RecordingError.
    """
    text = TextLines.read(path, asked.skip_rows)
    made = Understood(path, "Vicon Nexus table")
    at, frame_rate = asked.skip_rows, 0.0
    while at < len(text.lines):
        section = _section(text.lines[at])
        if not section:
            if text.lines[at].strip().strip(DELIMITERS).strip():
                raise text.wrong(at, f"a section must begin here: one of {', '.join(SECTIONS)}")
            at += 1
            continue
        stop = next((i for i in range(at + 2, len(text.lines)) if _ends(text.lines[i])), len(text.lines))
        result = text.number(at + 1, text.lines[at + 1].strip().strip(DELIMITERS), comma=True) if at + 1 < stop else 0.0
        if section == "Events":
            _events(made, text, at, stop)
        else:
            frame_rate = _samples(made, text, section, result, at, stop, frame_rate)
        at = stop
    if not made.series:
        raise RecordingError(f"{path}: there are no samples in it")
    made.kind += f" ({', '.join(one.name.rpartition('.')[2] for one in made.series)})"
    return made


def _ends(line: str) -> bool:
    return not line.strip().strip(DELIMITERS).strip() or bool(_section(line))


def _samples(
    made: Understood, text: TextLines, section: str, rate: float, at: int, stop: int, frame_rate: float
) -> float:
    """One section's streams; returns the rate of frames."""
    if not np.isfinite(rate) or rate <= 0:
        raise text.wrong(at + 1, f"the rate of {section} must stand here, in Hz")
    if at + 5 > stop:
        raise text.wrong(at, f"{section} ends before its data begin; the file was cut off")
    delimiter = delimiter_of(text.lines[at + 3], DELIMITERS)
    names, units = text.cells(at + 3, delimiter), text.cells(at + 4, delimiter)
    while names and not names[-1]:
        names.pop()
    if [name.lower() for name in names[:2]] != ["frame", "sub frame"]:
        raise text.wrong(at + 3, "the columns must begin with Frame and Sub Frame")
    groups = filled(text.cells(at + 2, delimiter), len(names))
    table = text.table(at + 5, delimiter, len(names), stop=stop, comma=delimiter != ",")
    if not len(table):
        made.doubt(f"{section}: has no rows")
        return frame_rate
    frames, subs = table[:, 0], table[:, 1]
    if not np.isfinite(table[:, :2]).all():
        raise text.wrong(at + 5 + int(np.flatnonzero(~np.isfinite(table[:, :2]).all(1))[0]), "a row without its frame")
    per = int(subs.max()) + 1
    index = (frames - 1) * per + subs
    steps = np.diff(index)
    if (steps < 1).any():
        raise text.wrong(at + 6 + int(np.flatnonzero(steps < 1)[0]), "frames run backwards, or appear twice")
    if frames[0] != 1:
        made.doubt(f"its first frame is number {frames[0]:.0f}: time counts from frame 1, as that of events does")
    facts = {"start_ns": round(index[0] / rate * NS), "lost": np.concatenate([[0], steps.astype(np.int64) - 1])}
    units += [""] * (len(names) - len(units))
    _columns(
        made,
        section,
        groups[2:],
        names[2:],
        [unit_of(unit) for unit in units[2 : len(names)]],
        table[:, 2:],
        rate,
        facts,
    )
    return rate / per


def _columns(
    made: Understood,
    section: str,
    groups: list[str],
    names: list[str],
    units: list[str],
    data: Samples,
    rate: float,
    facts: dict[str, object],
) -> None:
    part = PARTS[section]
    while any(one.name == made.name(part) for one in made.series):
        part += "_2"
    if section == "Trajectories":
        count = len(names) // 3
        if len(names) != 3 * count or [name.upper() for name in names] != ["X", "Y", "Z"] * count:
            raise RecordingError(
                f"{made.path}: Trajectories must have X, Y and Z of every marker; it has {', '.join(names[:6])} ..."
            )
        points = np.ascontiguousarray(data.reshape(len(data), count, 3))
        made.add(
            part, points, rate, channels=without_prefix(groups[::3]), units=(units[0] if units else "mm",), **facts
        )
        return
    full = [f"{group}.{name}" if group else name for group, name in zip(groups, names, strict=True)]
    if section == "Devices":
        full = _device_names(groups, names)
    made.add(part, np.ascontiguousarray(data), rate, channels=full, units=tuple(units), **facts)


def _device_names(groups: list[str], names: list[str]) -> list[str]:
    """A channel's own name where it says what it is and stands there once; else with its device's."""
    own = [name if re.search(r"[A-Za-z]", name) and names.count(name) == 1 else "" for name in names]
    return [mine or f"{group}.{name}" for mine, group, name in zip(own, groups, names, strict=True)]


def _events(made: Understood, text: TextLines, at: int, stop: int) -> None:
    delimiter = delimiter_of(text.lines[min(at + 2, stop - 1)], DELIMITERS)
    head = [cell.lower() for cell in text.cells(at + 2, delimiter)]
    if "context" not in head or "name" not in head or not any(cell.startswith("time") for cell in head):
        raise text.wrong(at + 2, "the columns of Events must be Subject, Context, Name, Time (s), Description")
    context, name, time = (
        head.index("context"),
        head.index("name"),
        next(i for i, c in enumerate(head) if c.startswith("time")),
    )
    kinds: dict[tuple[str, str], list[float]] = {}
    for i in range(at + 3, stop):
        row = text.cells(i, delimiter)
        if len(row) <= max(context, name, time):
            raise text.wrong(i, f"{len(row)} cells, where there are {len(head)} columns")
        kinds.setdefault((row[context], row[name]), []).append(text.number(i, row[time], comma=delimiter != ","))
    for (side, label), seconds in kinds.items():
        part = re.sub(r"\W+", "_", f"{side} {label}".strip()).lower()
        known = side.lower() if side.lower() in ("left", "right") else ""
        made.add_events(part, [s for s in seconds if np.isfinite(s)], None, label=label, side=known)
