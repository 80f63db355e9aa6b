"""Shimmer Consensys tables: a separator line, names that begin with the unit's own, a line of units."""

from __future__ import annotations

import re
from os.path import commonprefix
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, Understood
from kinegraph.devices.formats.lab.text_lines import TextLines, separator_of
from kinegraph.stream.chunk import NS

FORM = re.compile(r"_(CAL|RAW|UNCAL)$")
AXIS = re.compile(r"_(X|Y|Z|W|CH\d+(_\w+)?)$")


def knows(head: str) -> bool:
    lines = head.splitlines()[:2]
    return len(lines) == 2 and bool(separator_of(lines[0])) and "_Timestamp_" in lines[1]


def read_consensys(path: Path, asked: Asked) -> Understood:
    """One stream for each sensor of each unit: .accel_ln, .emg, ... with calibrated values where both are there. Raises RecordingError."""
    text, at = TextLines.read(path, asked.skip_rows), asked.skip_rows
    cut = separator_of(text.lines[at])
    names, units = text.cells(at + 1, cut), text.cells(at + 2, cut)
    while names and not names[-1]:
        names.pop()
    made = Understood(path, "Shimmer Consensys table")
    clock = next((k for k, name in enumerate(names) if re.search(r"_Timestamp_(Unix_)?CAL$", name)), None)
    if clock is None:
        raise text.wrong(at + 1, "there is no column of calibrated times (Timestamp_Unix_CAL)")
    if units[clock] != "ms":
        raise text.wrong(at + 2, f"times are in {units[clock]!r}; only ms is known")
    prefix = commonprefix(names).rpartition("_")[0]  # noqa: RUF071 - of one unit, "Shimmer_1234"
    groups: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        if "_Timestamp_" in name or not FORM.search(name) or _is_doubled(name, names):
            continue
        signal = AXIS.sub("", FORM.sub("", name.removeprefix(f"{prefix}_")))
        groups.setdefault(signal.lower(), []).append(k)
    taken = sorted({clock, *(k for mine in groups.values() for k in mine)})
    table = text.columns(at + 3, cut, len(names), taken)
    first = table[0, clock] if len(table) else 0.0
    if first > 1e11:  # milliseconds since 1970, not since the unit was switched on
        made.begin = round(first * 1e3) * (NS // 10**6)
    for part, columns in groups.items():
        made.add_timed(
            part,
            (table[:, clock] - first) / 1e3,
            np.ascontiguousarray(table[:, columns]),
            at + 4,
            asked,
            channels=[names[k] for k in columns],
            units=tuple(_unit(units[k]) for k in columns),
        )
    if not made.series:
        raise text.wrong(at + 1, f"there is no column of a sensor among {', '.join(names)}")
    return made


def _is_doubled(name: str, names: list[str]) -> bool:
    """Whether a raw column has a calibrated one beside it."""
    return not name.endswith("_CAL") and re.sub(r"_(RAW|UNCAL)$", "_CAL", name) in names


def _unit(text: str) -> str:
    plain = text.replace("(", "").replace(")", "").replace("^", "")
    return "" if plain in ("no_units", "n/a", "u") else plain
