"""Where nights lie: a folder for each, named after the evening it began on.

epochs.csv   a row per final epoch, there as soon as it was final
night.json   everything else: what was switched, gaps, the numbers, settings
map.npy      the night's motion map, (rows, columns) mm
report.html, report.png, hypnogram.edf   drawn from the others
"""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, date, datetime, timedelta, timezone, tzinfo
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np

from kinegraph.stream.chunk import NS, Array, Samples
from kinegraph.stream.data.bounded import DAMAGE, reading
from kinegraph.stream.errors import DeviceError, KinegraphError
from kinegraph.stream.system.atomic_file import write_complete

FACTS, EPOCHS, MAP = "night.json", "epochs.csv", "map.npy"
DRAWN = ("report.html", "report.png", "hypnogram.edf")
VERSION = 1
COLUMNS = (
    "onset", "end", "state", "provisional", "rescored", "score", "activity", "bed", "moved_s", "seen", "crosstalk", "breaths_per_min",
    "confidence", "rate_error", "lift_mm", "regularity", "pauses", "paused_s", "wave", "cause", "mover", "weight", "adds", "rule", "why",
)  # fmt: skip
TEXTS = ("state", "provisional", "bed", "why", "cause", "mover", "rule", "wave")
BREATHS = ("rate_error", "lift_mm", "regularity", "pauses", "paused_s", "wave")
ADDED = ("why", "cause", "mover", "weight", "adds", "rule", *BREATHS)
"""Columns that the logs of older versions lack."""
NOON_H = 12


class NightError(KinegraphError):
    """A night that is not there, or cannot be read."""


Missed = Callable[[NightError], object]


@dataclass(slots=True)
class Facts:
    """What is known of a night but its epochs. Times in ns UTC.

    begun      onset of the first epoch that was written
    breaks     [from, to]: kinegraph did not run, though the night went on
    switched   [time, what]: "lights off", "lights on"
    exits      [time, state of the bed]: in, out, unknown
    moved      [time, down, right]: when the camera was moved, and by how many pixels the picture (null: unknown)
    numbers    the row of the night's statistics; empty while the night goes on
    meta       of the scored stream: method, threshold, calibration
    settings   [node, use, parameters] of the graph
    run        which session writes it, over all its restarts
    """

    name: str
    begun: int
    epoch_s: float
    timezone: str = ""
    sleeper: str = ""
    closed: bool = False
    breaks: list[list[int]] = field(default_factory=list)
    switched: list[list[Any]] = field(default_factory=list)
    exits: list[list[Any]] = field(default_factory=list)
    moved: list[list[Any]] = field(default_factory=list)
    numbers: dict[str, Any] = field(default_factory=dict)
    meta: dict[str, Any] = field(default_factory=dict)
    session: dict[str, Any] = field(default_factory=dict)
    settings: list[list[str]] = field(default_factory=list)
    versions: list[list[str]] = field(default_factory=list)
    run: str = ""
    version: int = VERSION

    def save(self, folder: Path) -> None:
        """Write whole or not at all, durably. Raises OSError."""
        write_complete(folder / FACTS, json.dumps(asdict(self), indent=1, default=_plain))

    def check(self) -> None:
        """Raises ValueError or TypeError where a value cannot be."""
        lists = (self.breaks, self.switched, self.exits, self.settings, self.versions)
        if not all(isinstance(part, list) for part in lists) or not isinstance(self.session, dict):
            raise TypeError("a field is not the list or mapping that it must be")
        times = [self.begun, *(self.numbers.get(name, self.begun) for name in ("onset", "end"))]
        if any(not abs(time) < 1 << 62 for time in times) or not 0 < self.epoch_s < 86400:
            raise ValueError("a time or a length is out of range")
        if self.numbers and not {"se", "end"} <= self.numbers.keys():
            raise ValueError("its numbers are not whole")
        float(self.numbers.get("se") or 0), float(self.numbers.get("tst") or 0), zone_of(self.timezone)

    @staticmethod
    def load(folder: Path) -> Facts:
        """Raises NightError."""
        try:
            record = json.loads((folder / FACTS).read_text(encoding="utf-8"))
            if record["version"] > VERSION:
                raise NightError(
                    f"{folder}: written by a newer kinegraph (format {record['version']}); update this one"
                )
            facts = Facts(**{f.name: record[f.name] for f in fields(Facts) if f.name in record})
            facts.check()
            return facts
        except FileNotFoundError:
            raise NightError(f"{folder} holds no night") from None
        except (OSError, *DAMAGE) as error:
            raise NightError(f"{folder / FACTS} cannot be read: {error}") from None


@dataclass(frozen=True, slots=True)
class LoggedEpochs:
    """A night's epochs in order: (n,) each; NaN and "" where not known. Times in ns UTC."""

    onset: Array
    end: Array
    texts: dict[str, Array]
    numbers: dict[str, Samples]

    def __len__(self) -> int:
        return len(self.onset)

    def part(self, begin: int, end: int) -> LoggedEpochs:
        """Those with the middle between two times."""
        middle = (self.onset + self.end) // 2
        here = (middle >= begin) & (middle < end)
        texts = {name: column[here] for name, column in self.texts.items()}
        return LoggedEpochs(self.onset[here], self.end[here], texts, {n: c[here] for n, c in self.numbers.items()})


def read_epochs(folder: Path) -> LoggedEpochs:
    """All whole rows of a night; a last row that a power cut left unfinished is passed over. Raises NightError."""
    with reading(folder / EPOCHS, "a night's table", NightError):
        return _epochs(folder)


def _epochs(folder: Path) -> LoggedEpochs:
    try:
        text = (folder / EPOCHS).read_text(encoding="utf-8")
    except OSError as error:
        raise NightError(f"{folder / EPOCHS} cannot be read: {error.strerror}") from None
    rows = list(csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1])))
    try:
        onset, end = (np.array([nanoseconds(row[name]) for row in rows], np.int64) for name in ("onset", "end"))
        texts = {name: np.array([_cell(row, name) for row in rows], np.str_) for name in TEXTS}
        names = [name for name in COLUMNS[2:] if name not in TEXTS]
        numbers = {name: np.array([float(_cell(row, name) or "nan") for row in rows]) for name in names}
    except (KeyError, ValueError, TypeError) as error:
        raise NightError(f"{folder / EPOCHS} is damaged: {error}") from None
    return LoggedEpochs(onset, end, texts, numbers)


def _cell(row: dict[str, str], name: str) -> str:
    """A cell of a row; "" where the log is older than the column. Raises KeyError."""
    return (row.get(name) or "") if name in ADDED else row[name]


def read_map(folder: Path) -> Samples | None:
    """The night's motion map (rows, columns), or None."""
    try:
        return np.asarray(np.load(folder / MAP, allow_pickle=False), np.float64)
    except (OSError, ValueError):
        return None


def nights(root: Path, missed: Missed = lambda _: None) -> list[tuple[Path, Facts]]:
    """Every night under a folder, the oldest first. One that cannot be read is passed over, and `missed` called with the reason."""
    found = []
    for folder in root.iterdir() if root.is_dir() else ():
        if _holds_night(folder):
            try:
                found.append((folder, Facts.load(folder)))
            except NightError as error:
                missed(error)
    return sorted(found, key=lambda night: (night[1].begun, night[0].name))


def damaged(root: Path) -> list[Path]:
    """Folders of nights that cannot be read: a power cut may leave one, and what it holds can still be deleted."""
    readable = {folder for folder, _ in nights(root)}
    return sorted(f for f in (root.iterdir() if root.is_dir() else ()) if _holds_night(f) and f not in readable)


def _holds_night(folder: Path) -> bool:
    return (folder / FACTS).is_file() or (folder / EPOCHS).is_file()


def new_folder(root: Path, begun: int, zone: tzinfo | None) -> Path:
    """The folder of a night that begins now: the evening's date, and a number if there is one already."""
    name = evening(begun, zone).isoformat()
    number, folder = 1, root / name
    while folder.exists():
        number += 1
        folder = root / f"{name}-{number}"
    return folder


def evening(begun: int, zone: tzinfo | None) -> date:
    """The date of the evening that a night belongs to: before noon, yesterday's."""
    return (clock(begun, zone) - timedelta(hours=NOON_H)).date()


def find(root: Path, name: str) -> Path:
    """A night by its name, or "last". Raises NightError."""
    known = [folder for folder, _ in nights(root)]
    if name == "last" and known:
        return known[-1]
    for folder in [*known, *damaged(root)]:
        if folder.name == name:
            return folder
    there = ", ".join(folder.name for folder in known[-5:]) or "no nights"
    raise NightError(f"there is no night {name!r} in {root}; the latest are: {there}")


def remove(folder: Path) -> None:
    """Delete a night with everything in it; only a folder that holds one. Raises DeviceError."""
    if not _holds_night(folder):
        raise NightError(f"{folder} holds no night")
    try:
        shutil.rmtree(folder)
    except OSError as error:
        raise DeviceError(f"{folder} cannot be deleted: {error.strerror}") from None


def bytes_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def zone_of(name: str) -> tzinfo | None:
    """A time zone by its name; by default None, the computer's own. Raises KeyError or ValueError."""
    return ZoneInfo(name) if name else None


def night_zone(facts: Facts) -> tzinfo:
    """The clock that a night began with, in which all its times are given: no hour comes twice where the clocks change."""
    begun = clock(facts.begun, zone_of(facts.timezone))
    return timezone(begun.utcoffset() or timedelta(), begun.tzname() or "UTC")


def clock(time: int, zone: tzinfo | None) -> datetime:
    """A stamp on the wall clock."""
    return datetime.fromtimestamp(time // NS, UTC).astimezone(zone)


def iso(time: int) -> str:
    """A stamp as text that `nanoseconds` reads back."""
    return f"{np.datetime_as_string(np.datetime64(time, 'ns'), unit='ns' if time % NS else 's')}Z"


def nanoseconds(text: str) -> int:
    return int(np.datetime64(text.removesuffix("Z"), "ns").astype(np.int64))


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{value!r} is not a plain value")
