"""EDF, EDF+ and BDF through edfio: signals by rate, annotations, the start with its fraction of a second."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.formats.import_result import Asked, Understood
from kinegraph.stream.errors import RecordingError

HEAD = 256
FIELDS = (
    (0, 8, "version"),
    (184, 192, "header's length"),
    (236, 244, "number of records"),
    (244, 252, "record's length"),
    (252, 256, "number of signals"),
)
STATUS = re.compile(r"^(BDF )?(Status|Trigger)$", re.IGNORECASE)


def knows(head: bytes) -> bool:
    return head[:8] in (b"0       ", b"\xffBIOSEMI") and len(head) >= HEAD


def read_edf(path: Path, asked: Asked) -> Understood:
    """.signals (with several rates .signals_100hz, ...), .status of a BDF file, .annotations. Raises RecordingError with the reason."""
    import edfio

    with path.open("rb") as file:
        head = file.read(HEAD)
        size = path.stat().st_size
        _check(path, head, size, file.read(int(head[252:256]) * HEAD if head[252:256].strip().isdigit() else 0))
    bdf = head[0] == 0xFF
    try:
        opened: Any = edfio.read_bdf(path) if bdf else edfio.read_edf(path)
    except (ValueError, LookupError, TypeError, ArithmeticError) as error:
        raise RecordingError(
            f"{path}: breaks the rules of {'BDF' if bdf else 'EDF'} ({' '.join(str(error).split())})"
        ) from None
    reserved = head[192:236].decode("latin-1").strip()
    if reserved.startswith(("EDF+D", "BDF+D")):
        raise RecordingError(
            f"{path}: is discontinuous ({reserved[:5]}): records with pauses between them, which are not read; save it as EDF+C"
        )
    made = Understood(path, f"{'BDF' if bdf else 'EDF'}{'+' if reserved[3:4] == '+' else ''}")
    _facts(made, opened, plus=reserved[3:4] == "+")
    by_rate: dict[float, list[Any]] = {}
    for signal in opened.signals:
        by_rate.setdefault(float(signal.sampling_frequency), []).append(signal)
    for rate, signals in by_rate.items():
        part = "signals" if len(by_rate) == 1 else f"signals_{rate:g}hz".replace(".", "_")
        _signals(made, part, rate, signals, asked)
    notes = list(opened.annotations)
    if notes:
        made.add_events("annotations", [float(note.onset) for note in notes], [str(note.text) for note in notes])
    if not made.series:
        raise RecordingError(f"{path}: there are no samples in it")
    return made


def _check(path: Path, head: bytes, size: int, rest: bytes) -> None:
    """The header's own numbers, each with what stands there if it is none."""
    told: dict[str, float] = {}
    for start, stop, name in FIELDS[1:]:
        text = head[start:stop].decode("latin-1").strip()
        try:
            told[name] = float(text)
        except ValueError:
            raise RecordingError(
                f"{path}: breaks the rules of EDF: its {name} (bytes {start} to {stop - 1}) is {text!r}"
            ) from None
    count = int(told["number of signals"])
    if len(rest) < count * HEAD or count < 1:
        raise RecordingError(f"{path}: breaks the rules of EDF: {count} signals are announced, the header ends before")
    samples = 0
    for k in range(count):
        at = count * 216 + 8 * k
        text = rest[at : at + 8].decode("latin-1").strip()
        if not text.isdigit():
            raise RecordingError(
                f"{path}: breaks the rules of EDF: the samples per record of signal {k + 1} are {text!r}"
            )
        samples += int(text)
    record = samples * (3 if head[0] == 0xFF else 2)
    records, body = told["number of records"], size - HEAD * (count + 1)
    if records >= 0 and records * record > body:
        raise RecordingError(
            f"{path}: {records:.0f} records are announced, {body // max(record, 1)} are there; the file was cut off"
        )
    if (length := told["record's length"]) <= 0 and samples:
        raise RecordingError(f"{path}: breaks the rules of EDF: a record lasts {length:g} s")


def _facts(made: Understood, opened: Any, *, plus: bool) -> None:
    """The start, and what is known of the person but the name and the day of birth."""
    try:
        moment: datetime = opened.startdatetime
        made.local_time(moment)
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        made.doubt(f"when it began is not told ({error})")
    if not plus:
        return  # a free text, in which a name may stand
    try:
        patient = opened.patient
        code, sex = str(patient.code), str(patient.sex)
    except (ValueError, LookupError, TypeError, AttributeError):
        return
    if code.strip("X "):
        made.facts["subject"] = code
    if sex in ("F", "M"):
        made.facts["sex"] = sex


def _signals(made: Understood, part: str, rate: float, signals: Sequence[Any], asked: Asked) -> None:
    status = [signal for signal in signals if STATUS.match(signal.label)]
    for name, mine in (("status", status), (part, [signal for signal in signals if not STATUS.match(signal.label)])):
        if not mine:
            continue
        data = np.stack([np.asarray(signal.data, np.float64) for signal in mine], axis=1)
        labels = [str(signal.label) for signal in mine]
        if len(set(labels)) < len(labels):
            made.doubt("labels stand there more than once; the later ones are numbered")
        units = tuple(str(signal.physical_dimension) or asked.unit for signal in mine)
        made.add(
            name,
            data,
            rate,
            channels=labels,
            units=units,
            meta={"prefilter": str(mine[0].prefiltering)} if mine[0].prefiltering else {},
        )
