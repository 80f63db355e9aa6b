"""EDF, EDF+ and BDF: signals by rate, with the pauses between their records; annotations; the start with its fraction of a second."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.edf.layout import HEAD, EdfFile, RawSignal, read_layout
from kinegraph.devices.formats.import_result import Asked, Understood
from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.errors import RecordingError

STATUS = re.compile(r"^(BDF )?(Status|Trigger)$", re.IGNORECASE)
MONTHS = ["JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC"]
SNAP_NS = 1_000
"""Records with times this close to the end of the record before follow it without a pause."""


def knows(head: bytes) -> bool:
    return head[:8] in (b"0       ", b"\xffBIOSEMI") and len(head) >= HEAD


def read_edf(path: Path, asked: Asked) -> Understood:
    """.signals (with several rates .signals_100hz, ...), .status of a BDF file, .annotations. Raises RecordingError with the reason."""
    file = read_layout(path)
    made = Understood(path, file.kind)
    for words in file.doubts:
        made.find(f"to be {file.kind}", words, "it is read all the same", "compare it with the program that wrote it")
    begun = _begun(file, made)
    if begun is not None:
        made.local_time(begun)
    if file.is_plus:
        _person(file, made)
    first = int(file.onsets[0]) if file.onsets is not None and len(file.onsets) else 0
    lost_ns = _pauses(file, made)
    by_rate: dict[float, list[RawSignal]] = {}
    for signal in file.signals:
        by_rate.setdefault(signal.digital.shape[1] / (file.record_ns / NS), []).append(signal)
    for rate, signals in by_rate.items():
        part = "signals" if len(by_rate) == 1 else f"signals_{rate:g}hz".replace(".", "_")
        _signals(made, part, rate, signals, lost_ns, asked)
    if file.annotations:
        notes = file.annotations
        onsets, texts = [(note.onset - first) / NS for note in notes], [note.text for note in notes]
        lengths = [(note.length or 0) / NS for note in notes]
        made.add_events("annotations", onsets, texts, lengths if any(lengths) else None)
    if not made.series:
        raise RecordingError(f"{path}: there are no samples in it")
    return made


def _pauses(file: EdfFile, made: Understood) -> Array | None:
    """How long the pause before each record is (ns); None where there is no pause."""
    if file.onsets is None or not file.record_ns or not file.signals:
        return None
    pauses = np.diff(file.onsets) - file.record_ns
    pauses[np.abs(pauses) <= SNAP_NS] = 0
    if not pauses.any():
        return None
    if (pauses < 0).any():
        at = int(np.flatnonzero(pauses < 0)[0])
        raise RecordingError(
            f"{made.path}: record {at + 2} begins {-pauses[at] / NS:g} s before the record before it has ended"
        )
    longest = float(pauses.max()) / NS
    count = int((pauses > 0).sum())
    if file.is_declared_continuous:
        made.find(
            "continuous records", f"times of records that leave {count} pauses (up to {longest:g} s)", "they are gaps",
            "the program that wrote it should call it discontinuous",
        )  # fmt: skip
    return np.concatenate([[0], pauses])


def _begun(file: EdfFile, made: Understood) -> datetime | None:
    """When the first record began, by the clock on the wall."""
    day, clock = file.fields["date"], file.fields["time"]
    try:
        moment = datetime.strptime(f"{day} {clock}".replace(":", ".").replace("-", "."), "%d.%m.%y %H.%M.%S")
    except ValueError:
        made.doubt(f"when it began is not stated (its date is {day!r}, its time {clock!r})")
        return None
    moment = moment.replace(year=moment.year % 100 + (1900 if moment.year % 100 >= 85 else 2000))
    result = re.match(r"Startdate (\d{1,2})-([A-Z]{3})-(\d{4})\b", file.fields["recording"], re.IGNORECASE)
    if file.is_plus and result and result[2].upper() in MONTHS:
        moment = moment.replace(year=int(result[3]), month=MONTHS.index(result[2].upper()) + 1, day=int(result[1]))
    first = int(file.onsets[0]) if file.onsets is not None and len(file.onsets) else 0
    return moment + timedelta(microseconds=first // 1000)


def _person(file: EdfFile, made: Understood) -> None:
    """The code and the sex, not the name and the day of birth."""
    code, sex, *_ = [*file.fields["patient"].split(), "X", "X"]
    if code.strip("X "):
        made.facts["subject"] = code
    if sex in ("F", "M"):
        made.facts["sex"] = sex


def _signals(
    made: Understood, part: str, rate: float, signals: Sequence[RawSignal], pauses: Array | None, asked: Asked
) -> None:
    status = [signal for signal in signals if STATUS.match(signal.label)]
    for name, mine in (("status", status), (part, [signal for signal in signals if not STATUS.match(signal.label)])):
        if not mine:
            continue
        data = np.stack([signal.samples.reshape(-1) for signal in mine], axis=1)
        labels = [signal.label for signal in mine]
        if len(set(labels)) < len(labels):
            made.doubt("labels occur more than once; the later ones are numbered")
        lost = None
        if pauses is not None:
            lost = np.zeros(len(data), np.int64)
            lost[:: mine[0].digital.shape[1]] = np.round(pauses * (rate / NS)).astype(np.int64)
        units = tuple(signal.unit or ("" if signal.physical is None else asked.unit) for signal in mine)
        meta = {"prefilter": mine[0].prefilter} if mine[0].prefilter else {}
        made.add(name, data, rate, channels=labels, units=units, meta=meta, lost=lost)
