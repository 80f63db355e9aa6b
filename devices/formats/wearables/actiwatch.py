"""Actiwatch: .AWD files; exports (.csv) of Actiware, in several languages, and of MotionWare; and MotionWatch's .mtn files."""

from __future__ import annotations

import re
from datetime import datetime, timedelta
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from kinegraph.devices.formats.import_result import Asked, Understood
from kinegraph.devices.formats.lab.text_lines import TextLines, delimiter_of, is_number
from kinegraph.devices.formats.wearables import UNTRIED
from kinegraph.stream.errors import RecordingError

MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
SPELT = {
    "mär": "mar", "mrz": "mar", "mai": "may", "okt": "oct", "dez": "dec", "fév": "feb", "fev": "feb", "avr": "apr", "aoû": "aug",
    "déc": "dec", "mei": "may",
}  # fmt: skip
DATES = {"date", "datum", "fecha", "data", "fecha de inicio"}
MOMENTS = {"date/time", "date time", "datetime", "date & time", "date and time", "timestamp"}
"""MotionWare may write both in one column."""
TIMES = {"time", "heure", "zeit", "uhrzeit", "hora", "ora", "tijd"}
ACTIVITIES = {"activity", "activité", "aktivität", "actividad", "attività", "activiteit", "atividade"}
ACTIVITIES |= {"activity count", "activity counts", "activity (counts)", "counts", "mw counts", "movement"}
MARKERS = {"marker", "marqueur", "markierung", "marcador", "marcatore"}
PASSED_OVER = {"line", "ligne", "zeile", "línea", "linha", "regel", "riga"}
CODE_S = 15
"""An .AWD file states its epochs in quarters of a minute."""


def is_awd(head: str) -> bool:
    lines = [line.strip() for line in head.splitlines()[:9]]
    if len(lines) < 8 or _date(lines[1]) is None:
        return False
    return bool(re.fullmatch(r"\d{1,2}:\d{2}(:\d{2})?", lines[2])) and lines[3].isdigit()


def read_awd(path: Path, asked: Asked) -> Understood:
    """.activity: counts for each epoch; .markers where the button was pressed. Neither name, age nor sex is kept. Raises RecordingError."""
    made, text = Understood(path, "Actiwatch AWD", doubts=[UNTRIED]), TextLines.read(path)
    if not is_awd("\n".join(text.lines[:9])):
        raise text.wrong(1, "the lines of an AWD file's header are name, date, time, epoch, age, serial number, sex")
    rate = asked.rate_hz or 1.0 / (CODE_S * max(1, int(text.lines[3])))
    counts, pressed = np.full(len(text.lines) - 7, np.nan), []
    for i, line in enumerate(text.lines[7:]):
        cells = line.replace(",", " ").split()
        counts[i] = text.number(7 + i, cells[0] if cells else "")
        if len(cells) > 1 and cells[1].upper() == "M":
            pressed.append(i / rate)
    made.facts["device"] = f"Actiwatch {text.lines[5].strip()}"
    made.add("activity", counts[:, None], rate, channels=["activity"])
    if pressed:
        made.add_events("markers", pressed)
    day, clock = _date(text.lines[1]), text.lines[2].split(":")
    assert day is not None
    made.local_time(
        day + timedelta(hours=int(clock[0]), minutes=int(clock[1]), seconds=int(clock[2]) if clock[2:] else 0)
    )
    return made


def _date(text: str) -> datetime | None:
    """17-Aug-2010, in several languages; None for anything else."""
    found = re.fullmatch(r"(\d{1,2})[-. /]+([^\W\d]{3})[^\W\d]*\.?[-. /]+(\d{4}|\d{2})", text.strip())
    if not found:
        return None
    month = SPELT.get(found[2].lower(), found[2].lower())
    year = int(found[3]) + (2000 if len(found[3]) == 2 else 0)
    try:
        return datetime(year, MONTHS.index(month) + 1, int(found[1]))
    except ValueError:
        return None


def is_actiware(head: str) -> bool:
    program = any(name in head for name in ("Actiwatch", "Actiware", "MotionWatch", "MotionWare"))
    return program and any(_header(line) for line in head.splitlines())


def _header(line: str) -> list[str]:
    """The names of columns, if this line holds those of epochs."""
    names = [cell.strip().strip('"').strip() for cell in line.split(delimiter_of(line, ",;\t"))]
    low = {name.lower() for name in names}
    return names if (low & MOMENTS or (low & DATES and low & TIMES)) and low & ACTIVITIES else []


def read_actiware(path: Path, asked: Asked) -> Understood:
    """.epochs: activity, light and what else is a number, for each epoch; .markers where the button was pressed. Raises RecordingError."""
    text = TextLines.read(path)
    british = any("MotionWa" in line for line in text.lines[:40])
    made = Understood(path, "MotionWare export" if british else "Actiware export", doubts=[UNTRIED])
    at = next((k for k, line in enumerate(text.lines) if _header(line)), -1)
    if at < 0:
        raise text.wrong(0, "there is no line that names a date, a time and an activity")
    delimiter = delimiter_of(text.lines[at], ",;\t")
    names = _header(text.lines[at])
    low = [name.lower() for name in names]
    day, clock = (next(k for k, name in enumerate(low) if name in known | MOMENTS) for known in (DATES, TIMES))
    rows = [text.cells(k, delimiter) for k in range(at + 1, len(text.lines)) if text.lines[k].strip(' "\t,;')]
    rows = [row for row in rows if len(row) > max(day, clock) and re.match(r"\d+\D\d+\D\d+", row[day])]
    if not rows:
        raise text.wrong(at, "there are no epochs below this line")
    comma = delimiter != ","
    dates = [[int(n) for n in re.findall(r"\d+", row[day])[:3]] for row in rows]
    order, doubt = _order(dates, english="date" in low and not british)
    if doubt:
        made.doubt(doubt)
    clocks = [row[clock].partition(" ")[2] if clock == day else row[clock] for row in rows]
    seconds = np.array([_seconds(text, at, date, time, order) for date, time in zip(dates, clocks, strict=True)])
    passed = {day, clock, *(k for k, name in enumerate(low) if name in PASSED_OVER or not name)}
    numeric = [
        k for k in range(len(names))
        if k not in passed and low[k] not in MARKERS and any(k < len(row) and is_number(row[k], comma=comma) for row in rows)
    ]  # fmt: skip
    data = np.full((len(rows), len(numeric)), np.nan)
    for i, row in enumerate(rows):
        for j, k in enumerate(numeric):
            if k < len(row) and is_number(row[k], comma=comma):
                data[i, j] = float(row[k].replace(",", ".") if comma else row[k])
    made.add_timed("epochs", seconds - seconds[0], data, at + 2, asked, channels=[names[k] for k in numeric])
    marks = [k for k, name in enumerate(low) if name in MARKERS]
    pressed = [
        float(s - seconds[0]) for s, row in zip(seconds, rows, strict=True)
        if marks and marks[0] < len(row) and is_number(row[marks[0]]) and float(row[marks[0]].replace(",", ".")) > 0
    ]  # fmt: skip
    if pressed:
        made.add_events("markers", pressed)
    made.local_time(datetime(1970, 1, 1) + timedelta(seconds=float(seconds[0])))
    return made


def _order(dates: list[list[int]], *, english: bool) -> tuple[tuple[int, int, int], str]:
    """Where year, month and day are in dates of three numbers; and what is doubtful about it."""
    if dates[0][0] > 31:
        return (0, 1, 2), ""
    if any(date[0] > 12 for date in dates):
        return (2, 1, 0), ""
    if any(date[1] > 12 for date in dates):
        return (2, 0, 1), ""
    written = "month/day" if english else "day/month"
    return (2, 0, 1) if english else (
        2,
        1,
        0,
    ), f"its dates may be day/month or month/day: taken for {written} (--start)"


def _seconds(text: TextLines, at: int, date: list[int], clock: str, order: tuple[int, int, int]) -> float:
    """Seconds since 1970 by the watch's clock."""
    parts = [int(n) for n in re.findall(r"\d+", clock)]
    try:
        year, month, day = (date[k] for k in order)
        moment = datetime(
            year + (2000 if year < 100 else 0), month, day, parts[0], parts[1], parts[2] if parts[2:] else 0
        )
    except (ValueError, IndexError):
        raise text.wrong(at, f"an epoch below it has the date {date} and the time {clock!r}, which cannot be") from None
    low = clock.lower()
    hours = 12 if "pm" in low and parts[0] < 12 else -12 if "am" in low and parts[0] == 12 else 0
    return (moment - datetime(1970, 1, 1)).total_seconds() + 3600.0 * hours


def is_motionwatch(head: str) -> bool:
    return "<log2" in head and "<channel" in head


def read_motionwatch(path: Path, asked: Asked) -> Understood:
    """A stream for each channel of an .mtn file: .motion, .light, ... The name of the person is not kept. Raises RecordingError."""
    made = Understood(path, "MotionWatch", doubts=[UNTRIED])
    raw = path.read_bytes()
    if b"<!DOCTYPE" in raw or b"<!ENTITY" in raw:
        raise RecordingError(f"{path}: holds a document type, which a MotionWatch never writes")
    try:
        root = ElementTree.fromstring(raw)
    except ElementTree.ParseError as error:
        raise RecordingError(f"{path}: cannot be read as XML ({error})") from None
    facts = {one.findtext("name", "").lstrip("=+"): one.findtext("content", "") for one in root.iter("property")}
    for channel in root.iter("channel"):
        name, epoch = channel.findtext("name", "").strip(), channel.findtext("epoch", "").strip()
        numbers = re.split(r"[,\s]+", (channel.findtext("data") or "").strip(" ,\n\r\t"))
        if not name or not is_number(epoch) or float(epoch) <= 0 or not all(is_number(n, comma=False) for n in numbers):
            continue
        made.add(
            name.lower().replace(" ", "_"), np.array([[float(n)] for n in numbers]), 1.0 / float(epoch), channels=[name]
        )
    if not made.series:
        raise RecordingError(f"{path}: there is no channel with an epoch and numbers in it")
    if device := facts.get("Device"):
        made.facts["device"] = f"{device} {facts.get('SerialNo', '')}".strip()
    try:
        made.local_time(datetime.fromisoformat(facts.get("StartTime", "").strip()))
    except ValueError:
        made.doubt(f"when it began is not understood: {facts.get('StartTime', '')!r} (--start)")
    return made
