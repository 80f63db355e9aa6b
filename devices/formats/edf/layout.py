"""EDF, EDF+ and BDF as bytes: the header, the samples of each signal, and the annotation lists of each record.

Read here and not by a library, because what files really hold decides what their numbers mean: headers with decimal commas or Latin
letters, ranges that are empty, records of no length, and records with pauses between them. After B. Kemp and J. Olivan, European data
format 'plus', Clin. Neurophysiol. 114, 2003.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.errors import RecordingError

HEAD = 256
FIXED = {
    "version": (0, 8),
    "patient": (8, 88),
    "recording": (88, 168),
    "date": (168, 176),
    "time": (176, 184),
    "header's length": (184, 192),
    "reserved": (192, 236),
    "number of records": (236, 244),
    "record's length": (244, 252),
    "number of signals": (252, 256),
}
WIDTHS = {
    "label": 16,
    "transducer": 80,
    "unit": 8,
    "physical minimum": 8,
    "physical maximum": 8,
    "digital minimum": 8,
    "digital maximum": 8,
    "prefilter": 80,
    "samples per record": 8,
    "reserved": 32,
}
ANNOTATIONS = ("EDF Annotations", "BDF Annotations")


@dataclass(frozen=True, slots=True)
class RawSignal:
    """One signal. `digital` has the shape (records, samples per record)."""

    label: str
    unit: str
    prefilter: str
    digital: NDArray[np.int32]
    physical: tuple[float, float] | None
    """The values of `range`; None: the header names no range that has a length."""
    range: tuple[int, int]

    @property
    def samples(self) -> Samples:
        """(records, samples per record), in the signal's unit; raw numbers where the header has no range."""
        if self.physical is None:
            return self.digital.astype(np.float64)
        gain = (self.physical[1] - self.physical[0]) / (self.range[1] - self.range[0])
        offset = self.physical[1] / gain - self.range[1]
        return (self.digital.astype(np.float64) + offset) * gain


@dataclass(frozen=True, slots=True)
class Annotation:
    """A text with its onset (ns since the file's time of day) and its length (ns; None: a moment)."""

    onset: int
    length: int | None
    text: str


@dataclass(slots=True)
class EdfFile:
    """A whole file.

    fields   of the header, by the names in FIXED
    onsets   of each record (ns since the file's time of day); None in a file without annotation lists
    doubts   in words
    """

    is_bdf: bool
    fields: dict[str, str]
    record_ns: int = 0
    signals: list[RawSignal] = field(default_factory=list)
    annotations: list[Annotation] = field(default_factory=list)
    onsets: NDArray[np.int64] | None = None
    doubts: list[str] = field(default_factory=list)

    @property
    def kind(self) -> str:
        return f"{'BDF' if self.is_bdf else 'EDF'}{'+' if self.is_plus else ''}"

    @property
    def is_plus(self) -> bool:
        return self.fields["reserved"][3:4] == "+"

    @property
    def is_declared_continuous(self) -> bool:
        return self.fields["reserved"][4:5] != "D"

    def doubt(self, words: str) -> None:
        if words not in self.doubts:
            self.doubts.append(words)


def read_layout(path: Path) -> EdfFile:
    """The file. Raises RecordingError with what breaks the format's rules."""
    whole = path.read_bytes()
    if len(whole) < HEAD:
        raise RecordingError(f"{path}: breaks the rules of EDF: it ends within its header")
    made = EdfFile(whole[0] == 0xFF, {})
    made.fields = {name: _text(whole[a:b], made) for name, (a, b) in FIXED.items() if a}
    count = _count(path, made, "number of signals")
    if count < 1 or len(whole) < HEAD * (count + 1):
        raise RecordingError(f"{path}: breaks the rules of EDF: {count} signals are announced, the header ends before")
    _count(path, made, "header's length")
    columns, at = dict[str, list[str]](), HEAD
    for name, width in WIDTHS.items():
        columns[name] = [_text(whole[at + k * width : at + (k + 1) * width], made) for k in range(count)]
        at += count * width
    sizes = []
    for k, text in enumerate(columns["samples per record"]):
        if not text.isdigit():
            raise RecordingError(
                f"{path}: breaks the rules of EDF: the samples per record of signal {k + 1} are {text!r}"
            )
        sizes.append(int(text))
    made.record_ns = round(_number(path, made, "record's length") * NS)
    if made.record_ns <= 0 and any(
        n for n, label in zip(sizes, columns["label"], strict=True) if label not in ANNOTATIONS
    ):
        raise RecordingError(f"{path}: breaks the rules of EDF: a record lasts {made.record_ns / NS:g} s")
    _read_records(path, made, whole, columns, sizes)
    return made


def _read_records(path: Path, made: EdfFile, whole: bytes, columns: dict[str, list[str]], sizes: list[int]) -> None:
    width = 3 if made.is_bdf else 2
    start, record = HEAD * (len(sizes) + 1), sum(sizes) * width
    result = _count(path, made, "number of records")
    there = (len(whole) - start) // record if record else 0
    if result > there:
        raise RecordingError(f"{path}: {result} records are announced, {there} are there; the file was cut off")
    if result < 0:  # as it stands while a recording runs
        made.doubt("the number of its records is not stated: it was not closed properly; all that are there are read")
        result = there
    body = np.frombuffer(whole, np.uint8, result * record, start).reshape(result, record)
    at = 0
    for k, size in enumerate(sizes):
        part = body[:, at * width : (at + size) * width]
        at += size
        if columns["label"][k] in ANNOTATIONS:
            _read_annotations(path, made, part)
        else:
            made.signals.append(_signal(path, made, part, width, {name: column[k] for name, column in columns.items()}))


def _signal(path: Path, made: EdfFile, part: NDArray[np.uint8], width: int, column: dict[str, str]) -> RawSignal:
    if width == 2:
        digital = np.ascontiguousarray(part).view("<i2").astype(np.int32)
    else:
        digits = part.reshape(len(part), -1, 3).astype(np.int32)
        digital = (digits[..., 0] | digits[..., 1] << 8 | digits[..., 2] << 16) << 8 >> 8
    ends = [_value(column[name], made) for name in ("physical minimum", "physical maximum")]
    limits = [_value(column[name], made) for name in ("digital minimum", "digital maximum")]
    whole = all(limit is not None and limit == int(limit) for limit in limits)
    if not whole or None in ends or limits[0] == limits[1] or ends[0] == ends[1]:
        made.doubt(
            f"{column['label']!r} has no range: digital {column['digital minimum']!r} to {column['digital maximum']!r} for "
            f"{column['physical minimum']!r} to {column['physical maximum']!r}; its raw numbers are read, without a unit"
        )
        return RawSignal(column["label"], "", column["prefilter"], digital, None, (0, 0))
    physical = float(ends[0] or 0.0), float(ends[1] or 0.0)
    return RawSignal(
        column["label"],
        column["unit"],
        column["prefilter"],
        digital,
        physical,
        (int(limits[0] or 0), int(limits[1] or 0)),
    )


def _read_annotations(path: Path, made: EdfFile, part: NDArray[np.uint8]) -> None:
    """The lists of one annotation signal; the first list of each record of the first such signal is the record's own onset."""
    first = made.onsets is None
    onsets = np.zeros(len(part), np.int64)
    for k, row in enumerate(part):
        lists = [one for one in row.tobytes().split(b"\0") if one.strip(b"\x14\0")]
        for j, one in enumerate(lists):
            head, *texts = one.split(b"\x14")
            start, _, length = head.partition(b"\x15")
            onset = _seconds(start)
            if onset is None:
                made.doubt(f"an annotation of record {k + 1} has no time ({head[:20]!r}) and is left out")
                continue
            if j == 0 and first:
                onsets[k] = onset
            lasts = _seconds(length) if length else None
            made.annotations += [Annotation(onset, lasts, _text(text, made)) for text in texts if text]
        if first and not lists:
            raise RecordingError(f"{path}: breaks the rules of EDF+: record {k + 1} does not state its time")
    if first:
        made.onsets = onsets


def _seconds(text: bytes) -> int | None:
    """Seconds in decimal digits, as whole nanoseconds; None where the text is something else."""
    sign, digits = (-1, text[1:]) if text[:1] == b"-" else (1, text.removeprefix(b"+"))
    whole, _, part = digits.partition(b".")
    if not (whole + part).isdigit() or len(whole) > 9:
        return None
    return sign * (int(whole or b"0") * NS + int(part[:9].ljust(9, b"0")))


def _text(data: bytes, made: EdfFile) -> str:
    """ASCII as the format wants it, else UTF-8, else Latin-1, in which European programs write."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
        made.doubt("text is in Latin-1 instead of ASCII or UTF-8")
    return text.strip(" \0")


def _value(text: str, made: EdfFile) -> float | None:
    """A number of the header; None where the text is something else."""
    try:
        return float(text)
    except ValueError:
        pass
    try:
        number = float(text.replace(",", "."))
    except ValueError:
        return None
    made.doubt("numbers in its header have decimal commas")
    return number


def _number(path: Path, made: EdfFile, name: str) -> float:
    number = _value(made.fields[name], made)
    if number is None or not np.isfinite(number):
        a, b = FIXED[name]
        raise RecordingError(
            f"{path}: breaks the rules of {'BDF' if made.is_bdf else 'EDF'}: its {name} (bytes {a} to {b - 1}) is {made.fields[name]!r}"
        )
    return number


def _count(path: Path, made: EdfFile, name: str) -> int:
    return int(_number(path, made, name))
