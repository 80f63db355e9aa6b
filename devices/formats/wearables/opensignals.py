"""OpenSignals (BITalino, biosignalsplux): text files with a header in JSON and a column for each channel."""

from __future__ import annotations

import json
import re
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.formats.import_result import Asked, RateMissing, Understood
from kinegraph.devices.formats.lab.text_lines import TextLines
from kinegraph.devices.formats.timing import lost_by_counter
from kinegraph.devices.formats.wearables import UNTRIED

COUNTER = "nSeq"
DIGITAL = re.compile(r"^(DI|[IO]\d+)$")


def knows(head: str) -> bool:
    return head.startswith("# OpenSignals Text File Format")


def read_opensignals(path: Path, asked: Asked) -> Understood:
    """.signals: raw counts, or what OpenSignals converted; with several devices .signals1, .signals2, ... Raises RecordingError."""
    made, text = Understood(path, "OpenSignals text", doubts=[UNTRIED]), TextLines.read(path)
    end = next((k for k, line in enumerate(text.lines) if line.strip().lstrip("# ").startswith("EndOfHeader")), -1)
    written = next((line for line in text.lines[: max(0, end)] if line.lstrip("# ").startswith("{")), "")
    try:
        devices: dict[str, dict[str, Any]] = json.loads(written.lstrip("# "))
        columns = [[str(name) for name in one["column"]] for one in devices.values()]
    except (ValueError, KeyError, TypeError, AttributeError):
        raise text.wrong(1, "the header is no JSON that names the columns of each device") from None
    width = sum(map(len, columns))
    if not devices or end + 1 >= len(text.lines) or not width:
        raise text.wrong(max(0, end), "there are no samples below the header")
    signals = [k for k, name in enumerate(name for names in columns for name in names) if not DIGITAL.match(name)]
    table = text.columns(end + 1, "\t", width, signals)
    first = 0
    for number, (one, names) in enumerate(zip(devices.values(), columns, strict=True), 1):
        own = table[:, first : first + len(names)]
        first += len(names)
        _add(made, "signals" if len(devices) == 1 else f"signals{number}", one, names, own, asked, end + 2)
    device = next(iter(devices.values()))
    made.facts["device"] = str(device.get("device", "OpenSignals"))
    made.local_time(_moment(str(device.get("date", "")), str(device.get("time", ""))))
    return made


def _add(
    made: Understood, part: str, device: dict[str, Any], names: list[str], table: Any, asked: Asked, line: int
) -> None:
    rate = float(device.get("sampling rate") or asked.rate_hz or 0.0)
    if not rate:
        raise RateMissing(f"{made.path}: its header states no sampling rate; give --rate HZ")
    wanted = [k for k, name in enumerate(names) if name != COUNTER and not DIGITAL.match(name)]
    if not wanted:
        return
    sensors = [str(sensor) for sensor in device.get("sensor", [])]
    if len(sensors) == len(wanted):
        meta: dict[str, Any] = {"sensors": sensors}
    else:
        meta = {}
    lost = None
    if COUNTER in names and len(table) > 1 and (np.diff(table[:, names.index(COUNTER)]) != 0).any():
        where = f"{made.path}: line {line} on: counter"
        kept, lost, doubt = lost_by_counter(table[:, names.index(COUNTER)], where, repeated=asked.repeated)
        table = table[kept]
        if doubt:
            made.doubt(doubt)
    if not device.get("convertedValues"):
        made.doubt(f"{part}: raw counts of the converter; the maker's transfer functions give units (--scale, --unit)")
    channels = [names[k] for k in wanted]
    made.add(part, np.ascontiguousarray(table[:, wanted]), rate, channels=channels, lost=lost, meta=meta)


def _moment(date: str, clock: str) -> datetime | None:
    """2016-5-27 and 9:39:1.0."""
    days, parts = re.findall(r"\d+", date), re.match(r"(\d+):(\d+):([\d.]+)", clock)
    if len(days) != 3 or not parts:
        return None
    try:
        day = datetime(int(days[0]), int(days[1]), int(days[2]))
        return day + timedelta(hours=int(parts[1]), minutes=int(parts[2]), seconds=float(parts[3]))
    except ValueError:
        return None
