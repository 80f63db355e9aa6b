"""Nights for a study, without what identifies the sleeper: only what is named here is written, under a code and on other dates.

Written are `epochs.csv`, `night.json` and `hypnogram.edf` of each night, in a folder CODE/1, CODE/2, ...: states with their reasons,
movement, breath with its wave, the night's numbers, and times by the wall clock. Dates are moved by whole weeks so that the first week is
that of 2000-01-03; times of day, weekdays, and days between nights stay. Left out: names, subject, time zone, settings, addresses, paths,
the motion map, and pictures. Habits remain: who knows when somebody sleeps may recognise a night.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, replace
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.reports.night import archive
from kinegraph.devices.reports.night.archive import COLUMNS, EPOCHS, FACTS, TEXTS, Facts, LoggedEpochs, iso, nanoseconds
from kinegraph.devices.reports.night.edf import write_edf
from kinegraph.stream.chunk import NS
from kinegraph.stream.data.csv_writer import sheet_text
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder, write_complete

FIRST = date(2000, 1, 3)
"""The Monday of a study's first week."""
META = ("method", "threshold", "epoch_s", "convention", "simulated")
CODE = re.compile(r"[A-Za-z0-9_-]{1,20}")


def export(nights: Sequence[tuple[Path, Facts]], code: str, output: Path) -> list[Path]:
    """Write these nights of one sleeper; the folders. Raises NightError where one cannot be read, and KinegraphError for a wrong code."""
    if not CODE.fullmatch(code):
        raise KinegraphError(f"--code is {code!r}; it must be 1 to 20 letters, digits, - or _, such as P01")
    evenings = [archive.evening(facts.begun, archive.night_zone(facts)) for _, facts in nights]
    monday = min(evenings) - timedelta(min(evenings).weekday())
    made = []
    for number, (folder, facts) in enumerate(nights, 1):
        offset = archive.clock(facts.begun, archive.night_zone(facts)).utcoffset() or timedelta()
        shift = round((offset + (FIRST - monday)).total_seconds())
        into = output / code / str(number)
        if into.exists():
            raise KinegraphError(f"{into} exists; name another folder or code")
        private_folder(into)
        _write(into, *_without(facts, archive.read_epochs(folder), code, shift * NS))
        made.append(into)
    return made


def _without(facts: Facts, epochs: LoggedEpochs, code: str, shift: int) -> tuple[Facts, LoggedEpochs]:
    """Both as the study has them: moved by `shift` ns, and nothing that is not wanted."""

    def moved(rows: list[list[Any]]) -> list[list[Any]]:
        return [[v + shift if _is_time(v) else v for v in row] for row in rows]

    kept = Facts(
        code, facts.begun + shift, facts.epoch_s, "UTC", code, facts.closed,
        breaks=moved(facts.breaks), switched=moved(facts.switched), exits=moved(facts.exits), moved=moved(facts.moved),
        numbers={name: v + shift if _is_time(v) else v for name, v in facts.numbers.items()},
        meta={name: facts.meta[name] for name in META if name in facts.meta},
        session={"subject": code}, versions=facts.versions,
    )  # fmt: skip
    movers = [iso(nanoseconds(text) + shift) if text else "" for text in epochs.texts["mover"].tolist()]
    texts = {**epochs.texts, "mover": np.array(movers, np.str_)}
    return kept, replace(epochs, onset=epochs.onset + shift, end=epochs.end + shift, texts=texts)


def _is_time(value: object) -> bool:
    """Stamps are nanoseconds since 1970; no other number of a night is as large."""
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) > 10**17


def _write(folder: Path, facts: Facts, epochs: LoggedEpochs) -> None:
    lines = [list(COLUMNS)]
    for k in range(len(epochs)):
        cells = {"onset": iso(int(epochs.onset[k])), "end": iso(int(epochs.end[k]))}
        cells |= {name: str(epochs.texts[name][k]) for name in TEXTS}
        cells |= {name: f"{v:.6g}" if (v := float(column[k])) == v else "" for name, column in epochs.numbers.items()}
        lines.append([cells[name] for name in COLUMNS])
    write_complete(folder / EPOCHS, sheet_text(lines))
    write_complete(folder / FACTS, json.dumps(asdict(facts), indent=1))
    if len(epochs):
        write_edf(folder / archive.DRAWN[2], facts, epochs)
