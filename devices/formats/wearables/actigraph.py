"""ActiGraph: raw recordings (.gt3x), ActiLife's tables of epochs (.agd), and its text exports (.csv) of both.

Source: github.com/actigraph/GT3X-File-Format; .agd is a SQLite file with the tables `settings` and `data`.
"""

from __future__ import annotations

import re
import sqlite3
import struct
import zipfile
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, RateMissing, Understood
from kinegraph.devices.formats.lab.text_lines import TextLines, delimiter_of, is_number
from kinegraph.devices.formats.wearables import UNTRIED
from kinegraph.stream.chunk import Samples
from kinegraph.stream.data.bounded import check_size
from kinegraph.stream.errors import RecordingError

SEPARATOR, ACTIVITY, ACTIVITY2 = 0x1E, 0, 26
SCALES = {"NEO": 341.0, "CLE": 341.0, "MRA": 341.0}
"""Counts per g by how serial numbers begin, where the file does not say it; 256 for all others."""
TICKS_1970 = 621_355_968_000_000_000
"""1970 in .NET's ticks of 100 ns."""
EPOCHS = "------------ Data File Created By ActiGraph"
AXES = ("x", "y", "z")
NOT_DATA = ("date", "time", "epoch", "timestamp")


def is_gt3x(head: bytes) -> bool:
    return head.startswith(b"PK") and (b"info.txt" in head or b"log.bin" in head or b"activity.bin" in head)


def is_agd(path: Path, head: bytes) -> bool:
    return head.startswith(b"SQLite format 3\0") and path.suffix.lower() == ".agd"


def is_csv(head: str) -> bool:
    return head.startswith(EPOCHS)


def read_gt3x(path: Path, asked: Asked) -> Understood:
    """.acc (g) of every second that was recorded; seconds in which the device slept are lost. Raises RecordingError."""
    made = Understood(path, "ActiGraph raw recording", doubts=[UNTRIED])
    with zipfile.ZipFile(path) as archive:
        members = {info.filename.lower(): info for info in archive.infolist()}
        if "log.bin" not in members or "info.txt" not in members:
            raise RecordingError(
                f"{path}: holds no log.bin: firmware before 3.0 wrote another format; export it as CSV from ActiLife"
            )
        size = sum(members[name].file_size for name in ("log.bin", "info.txt"))
        check_size(size, path.stat().st_size)
        facts = _facts(archive.read(members["info.txt"]).decode("utf-8", "replace"))
        log = archive.read(members["log.bin"])
    rate = float(facts.get("sample rate") or asked.rate_hz or 0)
    if not rate:
        raise RateMissing(f"{path}: info.txt states no sample rate; give --rate HZ")
    serial = facts.get("serial number", "")
    made.facts["device"] = f"ActiGraph {serial}"
    scale = float(facts.get("acceleration scale") or SCALES.get(serial[:3], 256.0))
    seconds, parts, bad = _records(log)
    if not parts:
        raise RecordingError(f"{path}: there are no samples of acceleration in it")
    if bad:
        made.doubt(f"{bad} records are damaged and left out")
    lost = np.zeros(sum(map(len, parts)), np.int64)
    at, ends = 0, float(seconds[0])
    for second, part in zip(seconds, parts, strict=True):
        lost[at] = max(0, round((second - ends) * rate))
        at, ends = at + len(part), max(ends, second) + len(part) / rate
    made.add("acc", np.concatenate(parts) / scale, rate, channels=AXES, units=("g",), lost=lost)
    made.local_time(datetime.fromtimestamp(seconds[0], UTC).replace(tzinfo=None))
    return made


def _facts(text: str) -> dict[str, str]:
    pairs = (line.partition(":") for line in text.splitlines())
    return {key.strip().lower(): value.strip() for key, _, value in pairs}


def _records(log: bytes) -> tuple[list[int], list[Samples], int]:
    """Of the records with acceleration: seconds since 1970 by the device's clock, counts (n, 3); and how many are damaged."""
    seconds, parts, at, bad = list[int](), list[Samples](), 0, 0
    while (at := log.find(SEPARATOR, at)) >= 0 and at + 9 <= len(log):
        kind, second, size = struct.unpack_from("<BIH", log, at + 1)
        end = at + 8 + size
        if end >= len(log) or not _is_whole(log[at : end + 1]):
            bad += kind in (ACTIVITY, ACTIVITY2)
            at += 1
            continue
        if kind == ACTIVITY and size > 1:
            seconds.append(second)
            parts.append(_twelve_bits(log[at + 8 : end])[:, [1, 0, 2]])
        elif kind == ACTIVITY2 and size > 1:
            counts = np.frombuffer(log[at + 8 : end - size % 6], "<i2").reshape(-1, 3)
            seconds.append(second)
            parts.append(counts.astype(np.float64))
        at = end + 1
    return seconds, parts, bad


def _is_whole(record: bytes) -> bool:
    """Whether the last byte is the complement of the exclusive or of all others."""
    return bool(np.bitwise_xor.reduce(np.frombuffer(record, np.uint8)) == 0xFF)


def _twelve_bits(data: bytes) -> Samples:
    """Signed numbers of 12 bits, most significant first, as samples (n, 3)."""
    count = len(data) * 8 // 36 * 3
    pieces = np.frombuffer(data + bytes(-len(data) % 3), np.uint8).astype(np.int64).reshape(-1, 3)
    numbers = np.stack([pieces[:, 0] << 4 | pieces[:, 1] >> 4, (pieces[:, 1] & 15) << 8 | pieces[:, 2]], axis=1).ravel()
    return np.where(numbers > 2047, numbers - 4096, numbers)[:count].reshape(-1, 3).astype(np.float64)


def read_agd(path: Path, asked: Asked) -> Understood:
    """.counts: counts by axis, and steps, for each epoch. Raises RecordingError."""
    made = Understood(path, "ActiLife epochs", doubts=[UNTRIED])
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as opened:
            settings = {
                str(k).lower(): str(v) for k, v in opened.execute("SELECT settingName, settingValue FROM settings")
            }
            cursor = opened.execute("SELECT * FROM data ORDER BY dataTimestamp")
            names = [str(column[0]) for column in cursor.description]
            rows = cursor.fetchall()
    except sqlite3.Error as error:
        raise RecordingError(f"{path}: cannot be read as ActiLife's epochs ({error})") from None
    wanted = [k for k, name in enumerate(names) if name.lower() in ("axis1", "axis2", "axis3", "steps", "lux", "hr")]
    if not rows or not wanted or "dataTimestamp" not in names:
        raise RecordingError(f"{path}: there are no epochs in it")
    if serial := settings.get("deviceserial"):
        made.facts["device"] = f"ActiGraph {serial}"
    ticks = np.array([int(row[names.index("dataTimestamp")]) for row in rows], np.int64)
    data = np.array([[np.nan if row[k] is None else float(row[k]) for k in wanted] for row in rows])
    length = settings.get("epochlength", "")
    rate = {"rate_hz": 1.0 / int(length)} if length.isdigit() and int(length) else {}
    channels = [names[k] for k in wanted]
    made.add_timed("counts", (ticks - ticks[0]) / 1e7, data, 1, asked, channels=channels, units=("",), **rate)
    made.local_time(datetime(1970, 1, 1) + timedelta(microseconds=(int(ticks[0]) - TICKS_1970) / 10))
    return made


def read_csv(path: Path, asked: Asked) -> Understood:
    """.acc (g) at the header's rate, or .counts of epochs. Raises RecordingError."""
    made = Understood(path, "ActiLife text export", doubts=[UNTRIED])
    text = TextLines.read(path)
    header = next((k for k, line in enumerate(text.lines) if k and line.startswith("-----")), 0)
    if not header or header + 1 >= len(text.lines):
        raise text.wrong(0, "ActiLife's header has no end, or nothing follows it")
    facts = "\n".join(text.lines[: header + 1])
    found = re.search(r"at\s*([\d.]+)\s*Hz", text.lines[0])
    epoch_s = _clock(_after(facts, r"Epoch Period \(hh:mm:ss\)"))
    rate = 1.0 / epoch_s if epoch_s else float(found[1]) if found else asked.rate_hz
    if not rate:
        raise RateMissing(f"{path}: its header states neither a rate nor an epoch; give --rate HZ")
    if serial := _after(facts, "Serial Number:"):
        made.facts["device"] = f"ActiGraph {serial}"
    begin = header + 1
    delimiter = delimiter_of(text.lines[begin])
    comma = delimiter == ";"
    cells = text.cells(begin, delimiter)
    named = not any(is_number(cell, comma=comma) for cell in cells)
    begin += named
    wanted = [k for k, cell in enumerate(cells) if not (named and cell.lower() in NOT_DATA)]
    data = np.ascontiguousarray(text.columns(begin, delimiter, len(cells), wanted, comma=comma)[:, wanted])
    raw = not epoch_s
    usual = AXES if raw else ("axis1", "axis2", "axis3", "steps", *(f"column{k}" for k in range(5, 100)))
    channels = [cells[k] for k in wanted] if named and not raw else list(usual[: len(wanted)])
    if raw and len(wanted) != 3:
        raise text.wrong(begin, f"{len(wanted)} columns of acceleration, where three are expected")
    made.add("acc" if raw else "counts", data, rate, channels=channels, units=("g" if raw else "",))
    made.local_time(_begin(text, facts))
    return made


def _after(text: str, what: str) -> str:
    found = re.search(rf"^{what}\s*(.+?)\s*$", text, re.MULTILINE)
    return found[1] if found else ""


def _clock(text: str) -> float:
    parts = [int(part) for part in re.findall(r"\d+", text)]
    return float(parts[0] * 3600 + parts[1] * 60 + parts[2]) if len(parts) >= 3 else 0.0


def _begin(text: TextLines, facts: str) -> datetime | None:
    """The start, by the date format that the first line states (M/d/yyyy, dd/MM/yyyy, ...)."""
    form = re.search(r"date format (\S+)", text.lines[0])
    order = [
        letter for letter, _ in re.findall(r"(([yMd])\2*)", form[1] if form else "M/d/yyyy") for letter in [letter[0]]
    ]
    numbers = [int(n) for n in re.findall(r"\d+", _after(facts, "Start Date"))]
    if sorted(order) != ["M", "d", "y"] or len(numbers) < 3:
        return None
    date = dict(zip(order, numbers, strict=False))
    try:
        return datetime(date["y"], date["M"], date["d"]) + timedelta(seconds=_clock(_after(facts, "Start Time")))
    except ValueError:
        return None
