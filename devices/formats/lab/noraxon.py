"""Noraxon myoRESEARCH tables: two lines of facts, a header, and rows with activities and markers as text between the numbers."""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import VOLTAGES, Asked, Understood, unit_of
from kinegraph.devices.formats.lab.text_lines import TextLines, delimiter_of, is_number

UNIT = re.compile(r"^(.*?)(?:\s*[\[(]([^\])]*)[\])]|,\s*(uV|\u00b5V|mV|V|deg|N|g|mG|%))$")
TEXTS = ("activity", "marker", "markers", "activities")


def knows(head: str) -> bool:
    """The first line names a record's facts, or the program."""
    first = next(iter(head.splitlines()), "").replace('"', "").lower()
    return first.startswith("type") and "begin_time" in first and "frequency" in first


def read_noraxon(path: Path, asked: Asked) -> Understood:
    """.emg, the channels in volts; .sensors, all others; .activity and .marker, the texts in the rows where they begin."""
    text = TextLines.read(path, asked.skip_rows)
    at = asked.skip_rows
    delimiter = delimiter_of(text.lines[at])
    facts = dict(zip((key.lower() for key in text.cells(at, delimiter)), text.cells(at + 1, delimiter), strict=False))
    made = Understood(path, f"Noraxon table ({facts.get('created with version') or 'myoRESEARCH'})")
    _told(made, facts)
    head = next(
        (
            i
            for i in range(at + 2, len(text.lines))
            if text.cells(i, delimiter)[:1] in (["time"], ["Time"], ["time (s)"])
        ),
        None,
    )
    if head is None:
        raise text.wrong(at + 2, "there is no header with 'time' in its first cell below the record's facts")
    names = text.cells(head, delimiter)
    rows = [text.cells(i, delimiter) for i in range(head + 1, len(text.lines))]
    comma = any("," in row[0] for row in rows[:1]) if delimiter != "," else False
    for i, row in enumerate(rows):
        if len(row) < len(names):
            raise text.wrong(
                head + 1 + i, f"{len(row)} cells, where there are {len(names)} columns; was the file cut off here?"
            )
    texts = [k for k, name in enumerate(names) if k and (name.lower() in TEXTS or _is_text(rows, k))]
    numbers = [k for k in range(1, len(names)) if k not in texts]
    table = np.array(
        [[text.number(head + 1 + i, row[k], comma=comma) for k in (0, *numbers)] for i, row in enumerate(rows)]
    )
    table = table.reshape(len(rows), 1 + len(numbers))
    if (count := facts.get("count", "")) and is_number(count) and int(float(count.replace(",", "."))) != len(rows):
        made.doubt(f"{count} samples are announced, {len(rows)} are there; was the file cut off?")
    start = table[0, 0] if len(rows) else 0.0
    rate = text.number(at + 1, facts.get("frequency", "")) if is_number(facts.get("frequency", "")) else asked.rate_hz
    seconds = table[:, 0]
    if rate and len(rows) and abs(seconds[-1] - start - (len(rows) - 1) / rate) <= 1.0 / rate + 1e-5:
        seconds = start + np.arange(len(rows)) / rate  # five digits of a second are too few: the rate says it
    _signals(made, names, numbers, seconds, table, head + 2, rate, asked)
    for k in texts:
        begun = [(float(seconds[i]), row[k]) for i, row in enumerate(rows) if row[k]]
        part = re.sub(r"\W+", "_", names[k]).lower()
        made.add_events(part, [t for t, _ in begun], [word for _, word in begun])
    return made


def _is_text(rows: list[list[str]], k: int) -> bool:
    return any(row[k] and not is_number(row[k]) and row[k].lower() != "nan" for row in rows[:2000])


def _told(made: Understood, facts: dict[str, str]) -> None:
    """The start, and what is known of the person but who it is."""
    try:
        made.local_time(datetime.fromisoformat(facts.get("measurement_date", "")))
    except ValueError:
        made.doubt("the time of the measurement is unknown")
    if sex := facts.get("sex"):
        made.facts["sex"] = sex
    if program := facts.get("created with version"):
        made.facts["software"] = program
    if record := facts.get("record_name"):
        made.facts["record"] = record


def _signals(
    made: Understood,
    names: list[str],
    numbers: list[int],
    seconds: np.ndarray,
    table: np.ndarray,
    line: int,
    rate: float | None,
    asked: Asked,
) -> None:
    kinds: dict[str, list[tuple[int, str, str]]] = {}
    for column, k in enumerate(numbers, 1):
        match = UNIT.match(names[k])
        name, unit = (match[1].strip(), unit_of(match[2] or match[3] or "")) if match else (names[k], asked.unit)
        kinds.setdefault("emg" if unit in VOLTAGES else "sensors", []).append((column, name, unit))
    for part, columns in kinds.items():
        data = np.ascontiguousarray(table[:, [c for c, _, _ in columns]])
        facts = {"channels": [name for _, name, _ in columns], "units": tuple(unit for _, _, unit in columns)}
        made.add_timed(part, seconds, data, line, asked, rate_hz=rate, **facts)
