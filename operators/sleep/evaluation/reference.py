"""Hypnograms to compare with: from EDF+ annotations, CSV tables, or a recording of ours."""

from __future__ import annotations

import csv
import re
import warnings
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from kinegraph.operators.sleep.scorer import EPOCH, REASONED
from kinegraph.stream.chunk import NS, Times
from kinegraph.stream.data.bounded import reading
from kinegraph.stream.domain.night import SLEEP, UNKNOWN, WAKE, States
from kinegraph.stream.errors import KinegraphError, RecordingError

STAGES = {
    **dict.fromkeys(("w", "wake", "0", "awake"), WAKE),
    **dict.fromkeys(
        ("n1", "n2", "n3", "n4", "1", "2", "3", "4", "5", "r", "rem", "sleep", "s", "asleep", "nrem"), SLEEP
    ),
    **dict.fromkeys(
        ("?", "-1", "unknown", "m", "movement", "movement time", "9", "nan", "", "unscored", "artifact"), UNKNOWN
    ),
}
"""What stages are called, in small letters and without "sleep stage": Rechtschaffen-Kales, AASM, numbers (0 wake, 5 REM)."""

ONSETS = {"onset", "time (utc)", "time", "onset (s)", "onset_s", "t", "t_s", "seconds", "seconds (s)"}
FIRST_YEAR, LAST_YEAR = 1900, 2200
"""No night is outside of these, and int64 nanoseconds end in 2262."""
LABELS = ("state", "stage", "sleep", "label", "annotation", "description")


@dataclass(frozen=True, slots=True)
class Hypnogram:
    """Epochs in order: onset and end (n,) ns UTC, state (n,).

    dated   whether the times are of the clock or count from 0
    zoned   whether it is known of which time zone; where it is not, as in every EDF file, they are taken for UTC
    damage  what is wrong with the file that they stand in; "" where nothing is
    """

    onset: Times
    end: Times
    state: States
    dated: bool
    zoned: bool = False
    damage: str = ""

    def at(self, time: Times) -> States:
        """The state at each time; unknown where no epoch is."""
        place = np.searchsorted(self.onset, time, side="right") - 1
        inside = (place >= 0) & (time < self.end[np.maximum(place, 0)])
        return np.where(inside, self.state[np.maximum(place, 0)], UNKNOWN).astype(np.int8)

    def later(self, shift_ns: int) -> Hypnogram:
        return replace(self, onset=self.onset + shift_ns, end=self.end + shift_ns)


def read_hypnogram(path: Path, *, stream: str = "", epoch_s: float = 30.0) -> Hypnogram:
    """A hypnogram from .edf (annotations "Sleep stage W"), .csv, or a recording with final scores (.mcap or a session's folder).

    A CSV table needs a column with the epochs' onset (seconds, or ISO times) and one with the state or stage; `end` or `duration`
    if the epochs' length changes or is not `epoch_s`. Of a table of scores, rows with `final` 0 are left out.
    Raises KinegraphError, which names the file and the line.
    """
    if not path.exists():
        raise KinegraphError(f"{path}: there is no such file")
    with reading(path, "a hypnogram", KinegraphError):
        if path.suffix.lower() == ".edf":
            return _edf(path)
        if path.suffix.lower() in (".csv", ".tsv", ".txt"):
            return _csv(path, epoch_s)
        return _recording(path, stream)


def stage(text: str) -> int | None:
    """The state that a stage's name means; None for another text."""
    return STAGES.get(text.strip().lower().removeprefix("sleep stage").strip())


def _hypnogram(rows: list[tuple[int, int, int]], path: Path, *, dated: bool, zoned: bool = False) -> Hypnogram:
    rows.sort()
    if not rows:
        raise KinegraphError(f"{path}: holds no sleep stages")
    onset, end, state = (np.array(column, np.int64) for column in zip(*rows, strict=True))
    if (onset[1:] < end[:-1] - NS // 100).any():
        k = int(np.argmax(onset[1:] < end[:-1] - NS // 100))
        raise KinegraphError(f"{path}: epochs overlap: number {k + 2} begins before number {k + 1} ends")
    return Hypnogram(onset, end, state.astype(np.int8), dated, zoned)


def _edf(path: Path) -> Hypnogram:
    import edfio

    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            edf = edfio.read_edf(path)
        begin = round(edf.startdatetime.replace(tzinfo=UTC).timestamp() * NS)
        dated = edf.startdatetime.year > 1985
        annotations = edf.annotations
    except Exception as error:  # noqa: BLE001  (whatever a damaged file makes the reader raise)
        raise KinegraphError(f"{path}: cannot be read as EDF+: {error}") from None
    rows = []
    for note in annotations:
        state = stage(note.text) if note.text.lower().startswith("sleep stage") else None
        if state is not None:
            onset = begin + round(note.onset * NS)
            rows.append((onset, onset + round((note.duration or 30.0) * NS), state))
    damage = "; ".join(sorted({str(warning.message) for warning in warned}))
    return replace(_hypnogram(rows, path, dated=dated), damage=damage)


def _csv(path: Path, epoch_s: float) -> Hypnogram:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            sample = file.read(4096)
            file.seek(0)
            table = list(
                csv.reader(
                    file, delimiter=";" if sample.count(";") > sample.count(",") else "\t" if "\t" in sample else ","
                )
            )
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise KinegraphError(f"{path}: cannot be read as CSV: {error}") from None
    names = [name.strip().lower() for name in table[0]] if table else []
    where = {name: names.index(name) for name in names}
    bare = {name.partition(" (")[0]: place for name, place in where.items()}
    label = next((bare[name] for name in LABELS if name in bare), None)
    start = bare.get("onset", next((place for name, place in where.items() if name in ONSETS), None))
    if label is None or start is None:
        raise KinegraphError(
            f"{path}: the header is {', '.join(names) or 'empty'}; it must name the epochs' onset (seconds or ISO times) "
            "and their state or stage"
        )
    rows, dated, zoned = [], True, True
    for line, row in enumerate(table[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        try:
            if "final" in bare and row[bare["final"]].strip().lower() in ("0", "false"):
                continue
            state = stage(row[label])
            onset, clock = _moment(row[start])
            zoned = zoned and _has_zone(row[start])
            if "end" in bare and row[bare["end"]].strip():
                end = _moment(row[bare["end"]])[0]
            else:
                end = onset + round(float(row[bare["duration"]] if "duration" in bare else epoch_s) * NS)
        except (ValueError, IndexError):
            raise KinegraphError(
                f"{path}, line {line}: {','.join(row)!r} is not an epoch: it must have a time and a stage"
            ) from None
        if state is None or end <= onset:
            raise KinegraphError(
                f"{path}, line {line}: {row[label]!r} is not a stage; there are W, N1, N2, N3, R, sleep, wake, unknown, ?, 0 to 5"
            )
        dated = dated and clock
        rows.append((onset, end, state))
    return _hypnogram(rows, path, dated=dated, zoned=zoned)


def _has_zone(text: str) -> bool:
    """Whether an ISO time ends in Z or an offset."""
    return re.search(r"T.*(Z|[+-]\d\d:?\d\d)$", text.strip()) is not None


def _moment(text: str) -> tuple[int, bool]:
    """ns of a time in seconds, or of an ISO time (without a zone: UTC); and whether it was the latter."""
    try:
        return round(float(text) * NS), False
    except ValueError:
        clock = text.strip()
    whole, dot, rest = clock.rstrip("Z").partition(".")  # nanoseconds, which Python's own times do not hold
    moment = datetime.fromisoformat(whole if dot and rest.isdigit() else clock)
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    below = int(rest.ljust(9, "0")[:9]) if dot and rest.isdigit() else moment.microsecond * 1000
    if not FIRST_YEAR <= moment.year <= LAST_YEAR:
        raise ValueError(f"the year {moment.year} lies outside {FIRST_YEAR} to {LAST_YEAR}")
    return round(moment.replace(microsecond=0).timestamp()) * NS + below, True


def _recording(path: Path, stream: str) -> Hypnogram:
    from kinegraph.stream.batch.sessions import open_session

    with open_session(path) as opened:
        found = [name for name, s in opened.streams.items() if s.spec.dtype in (EPOCH, REASONED)]
        if not stream and len(found) != 1:
            raise RecordingError(
                f"{path}: holds {len(found) or 'no'} streams of scored epochs{': ' + ', '.join(found) if found else ''}; "
                "record a SleepScorer's output (`record: [scorer]`), or name one with --stream"
            )
        name = stream or found[0]
        if opened.stream(name).spec.dtype not in (EPOCH, REASONED):
            raise RecordingError(
                f"{path}: {name!r} holds no scored epochs; there {'are' if found else 'is'} {', '.join(found) or 'no other'}"
            )
        _, events = opened.read(name)
    kept = events[events["final"]]
    return _hypnogram(
        [(int(e["onset"]), int(e["end"]), ("unknown", "wake", "sleep").index(str(e["state"]))) for e in kept],
        path,
        dated=True,
        zoned=True,
    )
