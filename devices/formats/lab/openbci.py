"""The OpenBCI GUI's text recordings: lines of facts behind %, then samples with a counter of one byte."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, RateMissing, Understood
from kinegraph.devices.formats.lab.text_lines import TextLines
from kinegraph.devices.formats.timing import lost_by_counter
from kinegraph.stream.chunk import NS

KINDS = (
    ("exg", r"^EXG Channel \d+$", "uV"),
    ("accel", r"^Accel Channel \d+$", "g"),
    ("analog", r"^Analog Channel \d+$", ""),
)
"""Stream, the names of its columns, its unit."""


def knows(head: str) -> bool:
    return head.startswith("%OpenBCI Raw")


def read_openbci(path: Path, asked: Asked) -> Understood:
    """.exg (uV), .accel (g), .analog: as far as the columns exist and hold values. Raises RecordingError."""
    text, at = TextLines.read(path, asked.skip_rows), asked.skip_rows
    made, facts = Understood(path, "OpenBCI GUI text"), {}
    while at < len(text.lines) and text.lines[at].startswith("%"):
        key, _, value = text.lines[at].lstrip("%").partition("=")
        facts[key.strip().lower()] = value.strip()
        at += 1
    names = text.cells(at, ",")
    if names[0] != "Sample Index":
        raise text.wrong(at, "the first column must be Sample Index")
    found = re.match(r"([\d.]+)\s*Hz", facts.get("sample rate", ""))
    rate = float(found[1]) if found else asked.rate_hz
    if not rate:
        raise RateMissing(f"{path}: it states no sample rate; give --rate HZ")
    if board := facts.get("board"):
        made.facts["device"] = board.rpartition("$")[2]
    table = text.columns(at + 1, ",", len(names), [k for k, name in enumerate(names) if _is_read(name)])
    kept, lost, doubt = lost_by_counter(table[:, 0], f"{path}: line {at + 2} on: counter", repeated=asked.repeated)
    if doubt:
        made.doubt(doubt)
    table = table[kept]
    if "Timestamp" in names and len(table):
        begin = float(table[0, names.index("Timestamp")])
        made.begin = round(begin * 1e6) * (NS // 10**6) if np.isfinite(begin) and begin > 1e9 else None
    for part, pattern, unit in KINDS:
        columns = [k for k, name in enumerate(names) if re.match(pattern, name)]
        data = np.ascontiguousarray(table[:, columns])
        if columns and (part == "exg" or data.any()):  # a board without these sensors writes zeros
            made.add(part, data, rate, channels=[names[k] for k in columns], units=(unit,), lost=lost)
    if not made.series:
        raise text.wrong(at, f"there is no column of a signal among {', '.join(names)}")
    return made


def _is_read(name: str) -> bool:
    return name in ("Sample Index", "Timestamp") or any(re.match(pattern, name) for _, pattern, _ in KINDS)
