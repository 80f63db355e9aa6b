"""Motion Analysis Cortex: forces of plates (.forces), and raw counts of an analogue board (.anc)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, Understood
from kinegraph.devices.formats.lab.text_lines import TextLines, is_number

FORCE_UNITS = {"F": "N", "M": "Nmm", "X": "mm", "Y": "mm", "Z": "mm"}


def is_forces(head: str) -> bool:
    return head.startswith("[Force Data]")


def is_anc(head: str) -> bool:
    return head.startswith("File_Type:") and "Analog" in head[:200]


def read_forces(path: Path, asked: Asked) -> Understood:
    """.force: FX1, FY1, FZ1 (N), X1, Y1, Z1 (mm), MZ1 (Nmm) of every plate. Raises RecordingError."""
    text, at = TextLines.read(path, asked.skip_rows), asked.skip_rows + 1
    made, facts = Understood(path, "Cortex force table (.forces)"), {}
    while at < len(text.lines) and not text.lines[at].startswith("#"):
        key, equals, value = text.lines[at].partition("=")
        if equals:
            facts[key.strip()] = value.strip()
        at += 1
    names = [name for name in text.cells(at, "\t")[1:] if name]
    rate = text.number(at, facts.get("SampleRate", ""))
    if not rate > 0:
        raise text.wrong(asked.skip_rows, "there is no SampleRate")
    table = text.table(at + 1, "\t", 1 + len(names))
    if is_number(facts.get("NumberOfSamples", "")) and int(float(facts["NumberOfSamples"])) != len(table):
        made.doubt(f"{facts['NumberOfSamples']} samples are announced, {len(table)} are there")
    units = tuple(FORCE_UNITS.get(name[:1].upper(), "") for name in names)
    number = table[:, 0]
    lost = (
        np.concatenate([[0], np.diff(number).astype(np.int64) - 1])
        if np.isfinite(number).all() and len(number)
        else None
    )
    if lost is not None and (lost < 0).any():
        raise text.wrong(
            at + 1 + int(np.flatnonzero(lost < 0)[0]), "the samples' numbers run backwards, or appear twice"
        )
    made.add("force", np.ascontiguousarray(table[:, 1:]), rate, channels=names, units=units, lost=lost)
    return made


def read_anc(path: Path, asked: Asked) -> Understood:
    """.analog in V: counts of the board x range (mV) / 2^(bit depth - 1) / 1000, as a real file's C3D has them. Raises RecordingError."""
    text = TextLines.read(path, asked.skip_rows)
    made = Understood(path, "Cortex analogue table (.anc)")
    head = next((i for i, line in enumerate(text.lines) if line.startswith("Name\t")), None)
    if head is None:
        raise text.wrong(0, "there is no row of names")
    top = "\t".join(text.lines[asked.skip_rows : head])
    names = [name for name in text.cells(head, "\t")[1:] if name]
    rates, ranges = text.cells(head + 1, "\t"), text.cells(head + 2, "\t")
    if rates[:1] != ["Rate"] or ranges[:1] != ["Range"] or min(len(rates), len(ranges)) <= len(names):
        raise text.wrong(head + 1, "rows of rates and ranges must follow that of the names")
    depth = _fact(text, top, "BitDepth")
    rate = _fact(text, top, "PreciseRate")
    table = text.table(head + 3, "\t", 1 + len(names))
    if (length := re.search(r"Duration\(Sec\.\):\t+([\d.]+)", top)) and is_number(length[1]):
        announced = round(float(length[1]) * rate)
        if abs(announced - len(table)) > 1:
            made.doubt(
                f"{announced} samples ({length[1]} s) are announced, {len(table)} are there; was the file cut off?"
            )
    if (count := re.search(r"#Channels:\t+(\d+)", top)) and int(count[1]) != len(names):
        made.doubt(f"{count[1]} channels are announced, {len(names)} are there")
    factor = np.array([text.number(head + 2, cell) for cell in ranges[1 : 1 + len(names)]]) / 2 ** (depth - 1) / 1000
    if len({text.number(head + 1, cell) for cell in rates[1 : 1 + len(names)]}) > 1:
        made.doubt("its channels have several rates, but every row has a number of each: the rows are believed")
    spec = {"channels": names, "units": (asked.unit or "V",)}
    made.add_timed("analog", table[:, 0], table[:, 1:] * factor, head + 4, asked, rate_hz=rate, **spec)
    return made


def _fact(text: TextLines, top: str, key: str) -> float:
    match = re.search(rf"{key}:\t+([\d.]+)", top)
    if match is None or not 0 < float(match[1]) < 1e9 or (key == "BitDepth" and float(match[1]) > 64):
        raise text.wrong(0, f"{key} is missing")
    return float(match[1])
