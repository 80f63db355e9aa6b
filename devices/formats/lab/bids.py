"""BIDS: a table of motion without a header, its columns in channels.tsv, its rate in a JSON file; facts of the study."""

from __future__ import annotations

import csv
import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.formats.import_result import Asked, RateMissing, Understood, unit_of
from kinegraph.devices.formats.lab.text_lines import NOTHING, TextLines, is_number
from kinegraph.stream.errors import RecordingError

AXES = ("x", "y", "z")
PERSONAL = ("participant_id", "name", "birth", "date_of_birth")
"""Columns of participants.tsv that are not taken as facts; the first is the subject."""


def is_motion(path: Path) -> bool:
    """By its name, which BIDS lays down: sub-01_task-walk_tracksys-mocap_motion.tsv."""
    return path.name.endswith(("_motion.tsv", "_motion.tsv.gz"))


def read_motion(path: Path, asked: Asked) -> Understood:
    """.markers, if every tracked point has x, y and z, else .motion; other kinds of columns beside them. Raises RecordingError."""
    made = Understood(path, "BIDS motion")
    stem = path.name.removesuffix(".gz").removesuffix(".tsv").removesuffix("_motion")
    channels = _rows(_beside(path, f"{stem}_channels.tsv"))
    sidecar = _json(_beside(path, f"{stem}_motion.json"))
    rate = (
        float(sidecar["SamplingFrequency"]) if is_number(str(sidecar.get("SamplingFrequency", ""))) else asked.rate_hz
    )
    if not rate or rate <= 0:
        raise RateMissing(f"{path}: {stem}_motion.json does not say SamplingFrequency; give --rate HZ")
    if not channels or "name" not in channels[0]:
        raise RecordingError(f"{path}: there is no {stem}_channels.tsv beside it that names its columns")
    text = _text(path)
    header = [cell.strip() for cell in text.lines[0].split("\t")] == [row["name"] for row in channels]
    if header:
        made.doubt("it has a header, which BIDS forbids: passed over")
    data = text.table(int(header), "\t", len(channels))
    _streams(made, channels, data, rate)
    add_study(made, path, stem)
    return made


def _text(path: Path) -> TextLines:
    if path.suffix != ".gz":
        return TextLines.read(path)
    with gzip.open(path) as file:
        data = file.read(1 << 28)
    if not data.strip():
        raise RecordingError(f"{path}: the file is empty")
    return TextLines(path, data.decode("utf-8", errors="replace").rstrip("\n").split("\n"))


def _streams(made: Understood, channels: list[dict[str, str]], data: np.ndarray, rate: float) -> None:
    kinds: dict[str, list[int]] = {}
    for k, row in enumerate(channels):
        kinds.setdefault(row.get("type", "MISC").upper(), []).append(k)
    for kind, columns in kinds.items():
        points = _points([channels[k] for k in columns]) if kind == "POS" else []
        values = np.ascontiguousarray(data[:, columns])
        units = tuple(unit_of(channels[k].get("units", "")) for k in columns)
        if points and len(set(units)) == 1:
            made.add("markers", values.reshape(len(values), -1, 3), rate, channels=points, units=units[:1])
        else:
            part = "motion" if len(kinds) == 1 else kind.lower()
            made.add(part, values, rate, channels=[channels[k]["name"] for k in columns], units=units)


def _points(rows: list[dict[str, str]]) -> list[str]:
    """The tracked points, if the columns are x, y and z of one after another; else nothing."""
    triples = [rows[i : i + 3] for i in range(0, len(rows), 3)]
    if any([row.get("component") for row in three] != list(AXES) for three in triples):
        return []
    points = [{row.get("tracked_point", "") for row in three} for three in triples]
    return [point.pop() for point in points] if all(len(point) == 1 for point in points) else []


def add_study(made: Understood, path: Path, stem: str) -> None:
    """What the study says of the file: the person (age, sex, ...), and the events beside it."""
    subject = next((part for part in path.name.split("_") if part.startswith("sub-")), "")
    if not subject:
        return
    made.facts["subject"] = subject.removeprefix("sub-")
    if task := next((part.removeprefix("task-") for part in path.name.split("_") if part.startswith("task-")), ""):
        made.facts["task"] = task
    for folder in list(path.resolve().parents)[:5]:
        people = folder / "participants.tsv"
        if people.is_file():
            mine = next((row for row in _rows(people) if row.get("participant_id") == subject), {})
            made.facts |= {
                k: v for k, v in mine.items() if k and k.lower() not in PERSONAL and v and v.lower() not in NOTHING
            }
            break
    events = next(
        (
            f
            for f in (path.parent / f"{_short(stem)}_events.tsv", path.parent.parent / f"{_short(stem)}_events.tsv")
            if f.is_file()
        ),
        None,
    )
    rows = [row for row in _rows(events) if is_number(row.get("onset", ""))] if events else []
    if rows:
        texts = [" ".join(filter(None, (row.get("trial_type"), row.get("value")))) for row in rows]
        made.add_events("events", [float(row["onset"]) for row in rows], texts)


def correct_units(made: Understood, path: Path) -> None:
    """Of signals from an EDF file: what channels.tsv says of their units, doubted where the file itself says another."""
    stem = path.stem.rpartition("_")[0]
    sidecar = path.parent / f"{stem}_channels.tsv"
    if not stem or not sidecar.is_file():
        return
    facts = {row.get("name", ""): unit_of(row.get("units", "")) for row in _rows(sidecar)}
    for one in made.series:
        for channel in one.spec.channels if not one.spec.is_event else ():
            unit = one.spec.unit_of(channel)
            if facts.get(channel) and unit and facts[channel] != unit:
                made.doubt(
                    f"{sidecar.name} gives {facts[channel]} where the file itself gives {unit}: the file is believed"
                )
                break
    add_study(made, path, stem)


def _short(stem: str) -> str:
    """Events belong to all recordings of a task: without the tracking system."""
    return "_".join(part for part in stem.split("_") if not part.startswith("tracksys-"))


def _beside(path: Path, name: str) -> Path | None:
    found = path.parent / name
    return found if found.is_file() else None


def _rows(path: Path | None) -> list[dict[str, str]]:
    if path is None or path.stat().st_size > 1 << 26:
        return []
    lines = TextLines.read(path).lines if path.stat().st_size else []
    return [
        {k: v for k, v in row.items() if isinstance(k, str) and isinstance(v, str)}
        for row in csv.DictReader(lines, delimiter="\t")
    ]


def _json(path: Path | None) -> dict[str, Any]:
    if path is None:
        return {}
    try:
        sidecar = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{path}: is not JSON ({error})") from None
    return sidecar if isinstance(sidecar, dict) else {}
