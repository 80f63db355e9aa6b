"""Polar Sensor Logger's text files: the phone's time, the sensor's own in ns, then the signal."""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, Understood
from kinegraph.devices.formats.lab.text_lines import TextLines

PHONE, SENSOR = "Phone timestamp", "sensor timestamp [ns]"
OTHER_TIMES = re.compile(r"^timestamp \[ms\]$")


def knows(head: str) -> bool:
    return head.startswith(f"{PHONE};{SENSOR}")


def read_polar(path: Path, asked: Asked) -> Understood:
    """One stream, .ecg, .acc, .ppg ..., at the sensor's own times. Raises RecordingError."""
    text, at = TextLines.read(path, asked.skip_rows), asked.skip_rows
    names = text.cells(at, ";")
    made = Understood(path, "Polar Sensor Logger text")
    signals = [k for k, name in enumerate(names) if k > 1 and not OTHER_TIMES.match(name)]
    if not signals:
        raise text.wrong(at, "there is no column beside the times")
    table = text.columns(at + 1, ";", len(names), signals)
    stamps = text.integers(at + 1, ";", names.index(SENSOR))
    if not len(table):
        raise text.wrong(at, "there are no samples below the header")
    try:
        made.local_time(datetime.fromisoformat(text.cells(at + 1, ";")[0]))
    except ValueError:
        made.doubt("when it began is not stated: the phone's first time is not one")
    found = [re.match(r"(.*?)\s*\[(.*)\]$", names[k]) for k in signals]
    labels = [match[1] if match else names[k] for k, match in zip(signals, found, strict=True)]
    part = "acc" if {label.lower() for label in labels} == {"x", "y", "z"} else labels[0].lower().replace(" ", "_")
    made.add_timed(
        part,
        (stamps - stamps[0]) / 1e9,
        np.ascontiguousarray(table[:, signals]),
        at + 2,
        asked,
        channels=labels,
        units=tuple(match[2] if match else "" for match in found),
    )
    return made
