"""Xsens MT Manager's text exports: lines of facts behind //, then a table of one sensor; and those of Movella DOT, without facts."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, RateMissing, Understood
from kinegraph.devices.formats.lab.text_lines import TextLines, separator_of
from kinegraph.devices.formats.timing import lost_by_counter, snapped
from kinegraph.stream.chunk import Samples

NO_SIGNAL = (
    "packetcounter",
    "sampletimefine",
    "utc",
    "year",
    "month",
    "day",
    "hour",
    "minute",
    "second",
    "nano",
    "statusword",
)
KINDS = (
    ("acc", r"^Acc_[XYZ]$", "m/s2"),
    ("free_acc", r"^FreeAcc_[ENUXYZ]$", "m/s2"),
    ("gyr", r"^Gyr_[XYZ]$", "rad/s"),
    ("mag", r"^Mag_[XYZ]$", ""),
    ("quat", r"^Quat_(q[0-3]|[wxyz])$", ""),
    ("euler", r"^(Roll|Pitch|Yaw|Euler_[XYZ])$", "deg"),
    ("mat", r"^Mat\[\d\]\[\d\]$", ""),
    ("vel_inc", r"^VelInc_[XYZ]$", "m/s"),
    ("ori_inc", r"^OriInc_q[0-3]$", ""),
)
FINE_HZ, DOT_HZ = 10_000, 1_000_000
"""SampleTimeFine counts tenths of a millisecond, or microseconds in files of Movella DOT, which have no lines of facts."""


def knows(head: str) -> bool:
    """The first line that is no remark names a packet counter or a fine time."""
    lines = (x for x in head.splitlines() if x.strip() and not x.startswith("//") and not separator_of(x))
    line = next(lines, "")
    return line.startswith(("PacketCounter", "SampleTimeFine"))


def read_mt_manager(path: Path, asked: Asked) -> Understood:
    """.acc, .gyr, .mag, .quat, .euler, .mat: of each as many columns as there are, in the file's order. Raises RecordingError."""
    text, at = TextLines.read(path, asked.skip_rows), asked.skip_rows
    made, facts = Understood(path, "Xsens MT Manager text"), {}
    if text.lines[at : at + 1] and separator_of(text.lines[at]):
        at += 1
    is_dot = text.lines[at : at + 1] and not text.lines[at].startswith("//")
    if is_dot:
        made.kind = "Movella DOT table"
    while at < len(text.lines) and (text.lines[at].startswith("//") or not text.lines[at].strip()):
        key, colon, value = text.lines[at].lstrip("/").strip().partition(":")
        if colon:
            facts[key.strip().lower()] = value.strip()
        at += 1
    if at == len(text.lines):
        raise text.wrong(at - 1, "there is no header below the remarks")
    delimiter = next((d for d in "\t;, " if d in text.lines[at].strip()), "\t")
    names = [name.strip() for name in text.lines[at].strip().split(delimiter)]
    table = text.table(at + 1, delimiter, len(names))
    made.facts |= {
        k: v for k, v in (("device", facts.get("productcode")), ("firmware", facts.get("firmware version"))) if v
    }
    lost = None
    if names[0] == "PacketCounter" and np.isfinite(table[:, 0]).all() and len(table):
        where = f"{text.path}: line {at + 2} on: packet counter"
        kept, lost, doubt = lost_by_counter(table[:, 0], where, repeated=asked.repeated)
        table = table[kept]
        if doubt:
            made.doubt(doubt)
    rate = _rate(text, names, table, facts, asked, DOT_HZ if is_dot else FINE_HZ)
    meta = {"device_id": facts.get("deviceid", ""), "coordinate_system": facts.get("coordinate system", "")}
    taken = set()
    for part, pattern, unit in KINDS:
        columns = [k for k, name in enumerate(names) if re.match(pattern, name)]
        if not columns:
            continue
        taken |= set(columns)
        channels = [names[k] for k in columns]
        made.add(
            part, np.ascontiguousarray(table[:, columns]), rate, channels=channels, units=(unit,), meta=meta, lost=lost
        )
    rest = [k for k, name in enumerate(names) if k not in taken and not name.lower().startswith(NO_SIGNAL) and name]
    if rest:
        made.add(
            "other", np.ascontiguousarray(table[:, rest]), rate, channels=[names[k] for k in rest], meta=meta, lost=lost
        )
    if not made.series:
        raise text.wrong(at, f"there is no column of a sensor among {', '.join(names)}")
    return made


def _rate(
    text: TextLines, names: list[str], table: Samples, facts: dict[str, str], asked: Asked, fine_hz: int
) -> float:
    result = re.match(r"([\d.]+)\s*Hz", facts.get("update rate", ""))
    rate = float(result[1]) if result else _by_fine_time(names, table, fine_hz) or asked.rate_hz
    if not rate:
        raise RateMissing(f"{text.path}: it holds neither an update rate nor times; give --rate HZ")
    return rate


def _by_fine_time(names: list[str], table: Samples, fine_hz: int) -> float:
    if "SampleTimeFine" not in names:
        return 0.0
    fine = table[:, names.index("SampleTimeFine")]
    steps = np.diff(fine)
    if len(steps) < 2 or not np.isfinite(fine).all() or np.median(steps) <= 0:
        return 0.0
    return snapped(fine_hz / float(np.median(steps)))
