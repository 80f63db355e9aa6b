"""Delsys: tables of EMGworks (a time column before every channel) and of Trigno Discover (no times, a rate in every name)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, RateMissing, Understood, unit_of, voltage_by_size
from kinegraph.devices.formats.lab.text_lines import TextLines, delimiter_of, filled, is_number
from kinegraph.devices.formats.timing import grid_of
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.errors import RecordingError

BASE_HZ = 2000 / 27
"""Rates of Trigno sensors are multiples of this: 148.148, 518.52, 1259.26, 1925.93, 2222.22 Hz."""
NEAR_HZ = 0.5
"""Names give whole numbers of Hz."""
TIME = re.compile(r'^"?\s*(X|Time)\s*[\[(]\s*(s|sec|seconds)\s*[\])]\s*"?$', re.IGNORECASE)
UNIT = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]$")
SIGNAL = re.compile(r"\b(EMG|EKG|ECG|ACC|GYRO|MAG|FSR|ORIENTATION|GONIOMETER|ANALOG|HR)\b", re.IGNORECASE)
UNITS = {"acc": "g", "gyro": "deg/s"}
"""Of signals without a unit."""
DATES = ("%m/%d/%Y %I:%M:%S %p", "%m/%d/%Y %H:%M:%S", "%Y-%m-%d %H:%M:%S", "%d.%m.%Y %H:%M:%S", "%d/%m/%Y %H:%M:%S")


@dataclass(frozen=True, slots=True)
class TimedChannel:
    """A column: its name, unit and rate as far as the file gives them, and its samples from `start_s` on."""

    name: str
    unit: str
    rate_hz: float
    start_s: float
    data: Samples

    @property
    def signal(self) -> str:
        found = SIGNAL.findall(self.name.rpartition(":")[2]) or SIGNAL.findall(self.name)
        return found[0].lower() if found else "analog"


def is_emgworks(head: str) -> bool:
    """A first line with a time in every second cell."""
    line = next(iter(head.splitlines()), "")
    cells = [cell.strip() for cell in line.split(delimiter_of(line))]
    return len(cells) >= 2 and len(cells) % 2 == 0 and all(TIME.match(cell) for cell in cells[::2]) and "X" in cells[0]


def is_discover(head: str) -> bool:
    lines = head.splitlines()[:8]
    return (
        bool(lines)
        and lines[0].startswith(("Application:", "Application,"))
        and any("Collection Length" in x for x in lines)
    )


def read_emgworks(path: Path, asked: Asked) -> Understood:
    """Streams by signal and rate: .emg, .acc, ..., each channel's samples where its own times end. Raises RecordingError."""
    made = Understood(path, "Delsys EMGworks table (a time column for each channel)")
    text = TextLines.read(path, asked.skip_rows)
    at = asked.skip_rows
    delimiter = delimiter_of(text.lines[at])
    header = text.cells(at, delimiter)
    if len(header) % 2 or not all(TIME.match(cell) for cell in header[::2]):
        raise text.wrong(at, "a time column must stand before every channel, as in X[s],name,X[s],name")
    table = text.table(at + 1, delimiter, len(header), comma=delimiter == ";", ragged=True)
    channels = []
    for k, name in enumerate(header[1::2]):
        seconds, data = table[:, 2 * k], table[:, 2 * k + 1]
        there = np.isfinite(seconds)
        count = int(np.flatnonzero(there)[-1]) + 1 if there.any() else 0
        if not there[:count].all():
            raise text.wrong(at + 1 + int(np.flatnonzero(~there)[0]), f"{name!r} has no time here, but has one later")
        if count < 2:
            made.doubt(f"{name}: has {count} samples: left out")
            continue
        channels.append(_timed(text, at + 1, name, seconds[:count], data[:count]))
    _streams(made, channels, asked)
    return made


def _timed(text: TextLines, line: int, name: str, seconds: Samples, data: Samples) -> TimedChannel:
    steps = np.diff(seconds)
    if (steps <= 0).any():
        raise text.wrong(
            line + int(np.flatnonzero(steps <= 0)[0]) + 1, f"the times of {name!r} run backwards or stand still"
        )
    rate = _snapped((len(seconds) - 1) / float(seconds[-1] - seconds[0]), 2e-4)
    off = np.abs(seconds - seconds[0] - np.arange(len(seconds)) / rate).max() * rate
    if off > 1.5:
        raise text.wrong(
            line, f"the times of {name!r} are not those of a regular signal ({off:.0f} samples are missing)"
        )
    matched = UNIT.match(name)
    plain, unit = (matched[1], matched[2]) if matched else (name, "")
    return TimedChannel(plain, unit, rate, float(seconds[0]), data)


def _snapped(rate: float, share: float) -> float:
    near = max(1, round(rate / BASE_HZ)) * BASE_HZ
    whole = round(rate)
    if abs(near - rate) <= share * rate:
        return near
    return float(whole) if abs(whole - rate) <= share * rate else rate


def read_discover(path: Path, asked: Asked) -> Understood:
    """The same streams; times come from each channel's rate. Raises RecordingError."""
    text = TextLines.read(path, asked.skip_rows)
    at, notes = asked.skip_rows, {}
    while at < len(text.lines) and (match := re.match(r"^([^,;\t]+?):[,;\t]\s*(.*?)[,;\t\s]*$", text.lines[at])):
        notes[match[1].strip()] = match[2].strip()
        at += 1
    made = Understood(path, f"Delsys {notes.get('Application', 'Trigno Discover')} table")
    made.facts["software"] = notes.get("Application", "Trigno Discover")
    made.local_time(_moment(notes.get("Date/Time", "")))
    head = []
    while at < len(text.lines) and not _numbers(text.lines[at]):
        head.append(at)
        at += 1
    if len(head) < 2 or at == len(text.lines):
        raise text.wrong(at - 1, "no rows of sensors and channels before the numbers; is this a full export?")
    delimiter = delimiter_of(text.lines[head[-1]], ",;\t")
    rows = [text.cells(i, delimiter) for i in head]
    rates_at = next((i for i, row in enumerate(rows) if _is_rates(row)), None)
    named = [i for i in range(len(rows)) if i != rates_at]
    names = rows[named[-1]]
    while names and not names[-1]:
        names.pop()
    width = len(names)
    sensors = filled(rows[0], width)
    rates = [_number(cell) for cell in rows[rates_at]] if rates_at is not None else []
    table = text.table(at, delimiter, width, comma=delimiter == ";", ragged=True)
    channels = [_untimed(sensors, names, rates, k, table[:, k], asked, path, made) for k in range(width)]
    _streams(made, [channel for channel in channels if len(channel.data)], asked)
    return made


def _untimed(
    sensors: Sequence[str],
    names: Sequence[str],
    rates: Sequence[float],
    k: int,
    data: Samples,
    asked: Asked,
    path: Path,
    made: Understood,
) -> TimedChannel:
    matched = UNIT.match(names[k])
    plain, inside = (matched[1], matched[2]) if matched else (names[k], "")
    in_name = re.fullmatch(r"([\d.]+)\s*Hz", inside, re.IGNORECASE)
    rate = rates[k] if k < len(rates) else float(in_name[1]) if in_name else asked.rate_hz or 0.0
    if not rate or not np.isfinite(rate):
        raise RateMissing(f"{path}: the rate of {names[k]!r} is not in the file; give --rate HZ")
    snapped = max(1, round(rate / BASE_HZ)) * BASE_HZ
    if in_name and abs(snapped - rate) < NEAR_HZ and snapped != rate:
        made.doubt(
            f"rates stand there as whole numbers of Hz; those of the sensors are taken, {snapped:.4f} for {rate:g}"
        )
    rate = snapped if abs(snapped - rate) < (NEAR_HZ if in_name else 1e-3) else rate
    short = re.sub(r"\s*\([^)]*\)$", "", sensors[k])
    several = {name for name in sensors if re.sub(r"\s*\([^)]*\)$", "", name) == short}
    sensor = sensors[k] if len(several) > 1 else short
    there = np.flatnonzero(np.isfinite(data))
    count = int(there[-1]) + 1 if len(there) else 0
    return TimedChannel(f"{sensor}: {plain}" if sensor else plain, "" if in_name else inside, rate, 0.0, data[:count])


def _streams(made: Understood, channels: Sequence[TimedChannel], asked: Asked) -> None:
    """Channels of one signal, rate, unit, start and length side by side."""
    if not channels:
        raise RecordingError(f"{made.path}: there are no samples in it")
    clocks: dict[tuple[str, float, float], list[TimedChannel]] = {}
    for channel in channels:
        clocks.setdefault((channel.signal, round(channel.rate_hz, 2), round(channel.start_s, 4)), []).append(channel)
    for (signal, rate, start), mine in clocks.items():
        alike = [key for key in clocks if key[0] == signal]
        rates = {key[1] for key in alike}
        part = signal if len(alike) == 1 else f"{signal}_{rate:.0f}hz"
        part = part if len(rates) == len(alike) else f"{part}_{alike.index((signal, rate, start)) + 1}"
        longest = max(len(one.data) for one in mine)
        data = np.full((longest, len(mine)), np.nan)
        for k, one in enumerate(mine):
            data[: len(one.data), k] = one.data
        if len({len(one.data) for one in mine}) > 1:
            made.doubt(
                f"{part}: its channels end after {min(len(one.data) for one in mine)} to {longest} samples; NaN follows"
            )
        units = [unit_of(one.unit) or asked.unit or _unit(made, signal, data) for one in mine]
        units = ["g" if unit == "G" else unit for unit in units]
        spec = {"channels": [one.name for one in mine], "units": tuple(units), "meta": {"signal": signal}}
        made.add(part, data, mine[0].rate_hz, start_ns=int(grid_of(NS, np.array([0]), round(start * NS))[0]), **spec)


def _unit(made: Understood, signal: str, data: Samples) -> str:
    unit = voltage_by_size(data) if signal in ("emg", "ekg", "ecg") else UNITS.get(signal, "")
    if unit:
        made.doubt(f"the file gives no unit of {signal}: judged by its size to be {unit} (--unit sets another)")
    return unit


def _numbers(line: str) -> bool:
    cells = [cell for cell in re.split(r"[,;\t]", line) if cell.strip()]
    return bool(cells) and all(is_number(cell) for cell in cells)


def _is_rates(cells: Sequence[str]) -> bool:
    rows = [cell for cell in cells if cell]
    return bool(rows) and all(re.fullmatch(r"[\d.,]+\s*Hz", cell, re.IGNORECASE) for cell in rows)


def _number(cell: str) -> float:
    return float(re.sub(r"[^\d.]", "", cell.replace(",", ".")) or "nan")


def _moment(text: str) -> datetime | None:
    for form in DATES:
        try:
            return datetime.strptime(text, form)
        except ValueError:
            continue
    return None
