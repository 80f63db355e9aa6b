"""The nights on the disk as streams, for the page: a row for every night, and one for every week."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import structlog

from kinegraph.devices.reports.night import archive
from kinegraph.devices.reports.night.weeks import FREE, SLOTS, NightRow, apart, by_weeks, part_trend, row
from kinegraph.stream.chunk import Chunk, Specs, StreamSpec, empty
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

BINS = 288
"""Stretches of five minutes from noon to noon."""
PAST_NIGHT = np.dtype(
    [("night", "U24"), ("evening", "U10"), ("kind", "U10"), ("bed", "<f8"), ("rise", "<f8"), ("asleep", "<f8"), ("awake", "<f8"),
     ("unknown", "<f8"), ("efficiency", "<f8"), ("day", f"U{BINS}")]
)  # fmt: skip
PAST_WEEK = np.dtype(
    [("week", "U8"), ("from", "U10"), ("to", "U10"), ("nights", "<i8"), ("missing", "<i8"), ("naps", "<i8"), ("asleep", "<f8"),
     ("efficiency", "<f8"), ("bed", "<f8"), ("rise", "<f8"), ("jet_lag", "<f8"), ("regularity", "<f8")]
)  # fmt: skip
EVERY_S, QUIET_S = 2.0, 0.25
"""How often the folder is looked at, and how often an empty chunk is emitted."""
DELETED = "deleted"
log = structlog.get_logger(__name__)

Stamps = tuple[int, int]


@dataclass(frozen=True, slots=True)
class PastNights(Source):
    """The nights that `devices.reports.night.NightLog` has written: all at the start, and each again when it changes (it is over).

    out    an event per night. kind: night, nap, part (a shorter time in bed of the same night), unfinished (it has no numbers), deleted.
           bed, rise: hours after the evening's noon; asleep, awake, unknown: minutes in bed; efficiency: %; NaN: not known. day: a letter
           for every five minutes from noon on: s asleep, w awake, ? in bed and not known, a space: not in bed. The newest event of a night
           holds
    weeks  an event per week, from Monday: how many nights, evenings without one, and naps; means of asleep (min), efficiency (%), bed and
           rise (hours after noon); social jet lag (h) and sleep regularity index, NaN where too few nights tell

    It reads; it writes and deletes nothing. A night that cannot be read is passed over, and the log says so once.
    """

    background: ClassVar[bool] = True
    outputs: ClassVar[tuple[str, ...]] = ("out", "weeks")

    path: str = param("nights", help="the folder of nights")
    sleeper: str = param("", help="the sleeper's name, if there are two")
    evenings: int = param(56, least=1, most=1000, help="how many of the newest nights, naps and parts")

    def specs(self) -> Specs:
        night = ("", "", "", "h", "h", "min", "min", "min", "%", "")
        week = ("", "", "", "", "", "", "min", "%", "h", "h", "h", "")
        return {"out": StreamSpec((), PAST_NIGHT, units=night), "weeks": StreamSpec((), PAST_WEEK, units=week)}

    def read(self, feed: Feed) -> None:
        folder, specs, looked = NightsFolder(Path(self.path), self.sleeper, self.evenings), self.specs(), 0
        feed.ready()
        while not feed.stopped:
            news = folder.look() if not looked else {}
            looked = (looked + 1) % round(EVERY_S / QUIET_S)
            now = feed.now()
            for name, spec in specs.items():
                rows = news.get(name, ())
                made = (
                    Chunk(np.full(len(rows), now), np.array(list(rows), spec.dtype), now) if rows else empty(spec, now)
                )
                feed.emit(made, name)
            feed.wait(QUIET_S)


@dataclass(slots=True)
class NightsFolder:
    """A folder of nights as it was looked at last.

    read    per folder: what its files' stamps were, and the row
    sent    per output and night or week: the event that was given last
    missed  why nights could not be read; a night that has just begun may not be whole yet, so it is reported the second time
    reported  of these, what the log has
    """

    root: Path
    sleeper: str
    most: int
    read: dict[str, tuple[Stamps, NightRow]] = field(default_factory=dict)
    sent: dict[str, dict[str, tuple[Any, ...]]] = field(default_factory=lambda: {"out": {}, "weeks": {}})
    missed: set[str] = field(default_factory=set)
    reported: set[str] = field(default_factory=set)

    def look(self) -> dict[str, list[tuple[Any, ...]]]:
        """The events that are new, by output."""
        found = apart(self._rows())
        now: dict[str, dict[str, tuple[Any, ...]]] = {
            "out": {one.name: _night(one) for one in found},
            "weeks": {name: _week(name, found, first, last) for name, first, last in by_weeks(found)},
        }
        for name in self.sent["out"].keys() - now["out"].keys():
            nan = (float("nan"),) * 6
            now["out"][name] = (name, self.sent["out"][name][1], DELETED, *nan, "")
        news = {
            output: [event for key, event in rows.items() if repr(event) != repr(self.sent[output].get(key))]
            for output, rows in now.items()
        }
        self.sent = now
        return news

    def _rows(self) -> list[NightRow]:
        """The newest nights, the oldest first; what has not changed is not read again."""
        kept: dict[str, tuple[Stamps, NightRow]] = {}
        missed: set[str] = set()
        found = archive.nights(self.root, lambda error: missed.add(str(error)))
        nights = [(folder, facts) for folder, facts in found if facts.sleeper == self.sleeper]
        for folder, facts in nights[-self.most :]:
            try:
                stamps = (folder / archive.FACTS).stat().st_mtime_ns, _stamp(folder / archive.EPOCHS, facts.closed)
                before = self.read.get(folder.name)
                same = before is not None and before[0] == stamps
                kept[folder.name] = before if same and before else (stamps, row(folder, facts))
            except (archive.NightError, OSError) as error:
                missed.add(str(error))
        for why in sorted(missed & self.missed - self.reported):
            log.warning("a night is left out", error=why)
            self.reported.add(why)
        self.missed, self.read = missed, kept
        return [one for _, one in kept.values()]


def _stamp(path: Path, closed: bool) -> int:
    """When a table was written; of a night that goes on only that it does: it grows with every epoch."""
    return path.stat().st_mtime_ns if closed else -1


def _night(one: NightRow) -> tuple[Any, ...]:
    numbers = (one.bed, one.rise, one.asleep, one.awake, one.unknown, one.efficiency)
    return (one.name, one.evening.isoformat(), one.kind, *numbers, _letters(one))


def _letters(one: NightRow) -> str:
    """What most of every five minutes was."""
    at = np.arange(SLOTS) * 24 / SLOTS
    unknown = (at >= one.bed) & (at < one.rise) & np.isnan(one.day)
    states = (one.day == 1, one.day == 0, unknown)
    shares = np.stack([which.reshape(BINS, -1).mean(axis=1) for which in states])
    letters = np.array(["s", "w", "?"])[shares.argmax(axis=0)]
    return "".join(np.where(shares.max(axis=0) > 0, letters, " ").tolist())


def _week(name: str, of: Sequence[NightRow], first: Any, last: Any) -> tuple[Any, ...]:
    found = part_trend(of, FREE, first, last)
    counts = (found.nights, found.missing, found.naps)
    means = (found.asleep, found.efficiency, found.bed, found.rise, found.jet_lag, found.regularity)
    return (name, first.isoformat(), last.isoformat(), *counts, *means)
