"""EDF+ as bytes: signals with one number or more per record, and annotations; all arithmetic of records in whole numbers.

After B. Kemp and J. Olivan, European data format 'plus', Clin. Neurophysiol. 114, 2003. A library that counts records by dividing
floating-point seconds refuses some lengths of a night; here a length is a number of records, and a time a number of nanoseconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.errors import DeviceError

LOWEST, HIGHEST = -32768, 32767
MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")
FIRST_YEAR, LAST_YEAR = 1985, 2084


@dataclass(frozen=True, slots=True)
class Head:
    """Who was recorded (one word), by what (one word), and since when, on the wall clock."""

    subject: str
    equipment: str
    begun: datetime


@dataclass(frozen=True, slots=True)
class EdfSignal:
    """Its name, its unit, between which values it lies, and the values: (records,), or (records, n) for n in each."""

    label: str
    unit: str
    low: float
    high: float
    values: Samples


@dataclass(frozen=True, slots=True, order=True)
class Note:
    """An annotation: its onset since the beginning and its length (ns; None: a moment), and its text."""

    onset: int
    length: int | None
    text: str


def encode(head: Head, record_ns: int, signals: Sequence[EdfSignal], notes: Iterable[Note]) -> bytes:
    """The file: at least one signal, all of as many records. Raises DeviceError where EDF cannot say so."""
    records = len(signals[0].values)
    result = _annotations(records, record_ns, sorted(notes, key=lambda n: (n.onset, n.length or -1, n.text)))
    size = -(-max(map(len, result)) // 2)
    data = [_digital(signal) for signal in signals]
    body = b"".join(
        b"".join(column[k : k + 1].tobytes() for column in data) + result[k].ljust(2 * size, b"\0")
        for k in range(records)
    )
    return _header(head, record_ns, records, signals, size) + body


def _header(head: Head, record_ns: int, records: int, signals: Sequence[EdfSignal], size: int) -> bytes:
    """The header; an annotation record has `size` samples of two bytes."""
    begun = head.begun
    if not FIRST_YEAR <= begun.year <= LAST_YEAR:
        raise DeviceError(f"EDF cannot represent the year {begun.year}; its range is {FIRST_YEAR} to {LAST_YEAR}")
    length = _decimal(record_ns)
    if len(length) > 8:
        raise DeviceError(f"EDF cannot represent epochs of {length} s: its field has eight places")
    count = len(signals) + 1
    date = f"{begun.day:02d}-{MONTHS[begun.month - 1]}-{begun.year}"
    fixed = (
        ("0", 8), (f"{head.subject} X X X", 80), (f"Startdate {date} X X {head.equipment}", 80),
        (f"{begun:%d.%m.%y}", 8), (f"{begun:%H.%M.%S}", 8), (str(256 * (count + 1)), 8), ("EDF+C", 44),
        (str(records), 8), (length, 8), (str(count), 4),
    )  # fmt: skip
    columns = (
        (16, [s.label for s in signals], "EDF Annotations"), (80, [""] * len(signals), ""),
        (8, [s.unit for s in signals], ""), (8, [_number(s.low) for s in signals], str(LOWEST)),
        (8, [_number(s.high) for s in signals], str(HIGHEST)), (8, [str(LOWEST)] * len(signals), str(LOWEST)),
        (8, [str(HIGHEST)] * len(signals), str(HIGHEST)), (80, [""] * len(signals), ""),
        (8, [str(s.values[0].size) for s in signals], str(size)), (32, [""] * len(signals), ""),
    )  # fmt: skip
    text = b"".join(_field(value, wide) for value, wide in fixed)
    return text + b"".join(_field(value, wide) for wide, values, last in columns for value in [*values, last])


def _annotations(records: int, record_ns: int, notes: Sequence[Note]) -> list[bytes]:
    """Of every record its annotations: first its own time, then those that begin in it; the last one holds the rest."""
    rows: list[bytes] = []
    next_one = 0
    for k in range(records):
        lists = [_told(Note(k * record_ns, None, ""))]
        while next_one < len(notes) and (notes[next_one].onset < (k + 1) * record_ns or k == records - 1):
            lists.append(_told(notes[next_one]))
            next_one += 1
        rows.append(b"".join(lists))
    return rows


def _told(note: Note) -> bytes:
    """A time-stamped annotation list."""
    sign = "-" if note.onset < 0 else "+"
    length = "" if note.length is None else f"\x15{_decimal(note.length)}"
    text = "".join(" " if c in "\x14\x15\0" else c for c in note.text)
    return f"{sign}{_decimal(abs(note.onset))}{length}\x14{text}\x14\0".encode()


def _digital(signal: EdfSignal) -> np.ndarray:
    """The values as whole numbers of 16 bits."""
    gain = (signal.high - signal.low) / (HIGHEST - LOWEST)
    return np.round(signal.values / gain - (signal.high / gain - HIGHEST)).astype("<i2")


def _decimal(ns: int) -> str:
    """Seconds, exactly."""
    whole, rest = divmod(ns, NS)
    return f"{whole}.{rest:09d}".rstrip("0").rstrip(".")


def _number(value: float) -> str:
    return str(int(value)) if float(value).is_integer() else str(value)


def _field(text: str, wide: int) -> bytes:
    """A field of the header: printable ASCII, filled up with spaces. Raises DeviceError where it does not fit."""
    if len(text) > wide or not text.isascii() or not (text.isprintable() or not text):
        raise DeviceError(f"EDF has {wide} places for {text!r}, in plain letters")
    return text.encode().ljust(wide)
