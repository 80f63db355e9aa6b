"""A gentle alarm: an event at a movement shortly before a set time, and at that time at the latest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, time, timedelta
from typing import ClassVar
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Specs, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

ALARM = np.dtype([("onset", "<i8"), ("at", "<i8"), ("why", "U8")])
"""When to wake (`onset`), the set time (`at`), and why: movement, or clock."""
NEEDED = ("onset", "sleeper", "moved_s")


@dataclass(slots=True)
class GentleAlarmState:
    """
    at    the next set time (ns); NEVER: no sample has come yet
    rung  the alarm of `at` has been given
    lost  what the next emission says is missing before it
    """

    at: int
    rung: bool
    lost: int


@dataclass(frozen=True, slots=True)
class GentleAlarm(Operator[GentleAlarmState]):
    """Epochs of `operators.bed.activity.Activity` (`activity.epochs`) in; one event a day out.

    The first epoch with `min_s` of movement that is known in the last `window_min` before `at` gives the alarm (`movement`); without
    one it comes at the set time (`clock`), seen or not. Never before the window, never after the set time, once a day. Whether somebody
    who moves sleeps lightly is not known: movement is all that is looked at. What is done with the event is an automation's part; it does
    not replace an alarm clock, for it comes only while everything runs.

    Delay: an epoch is known at its end. Daylight saving: `at` is a time of the wall clock in `timezone`.

    >>> kind = [("onset", "<i8"), ("sleeper", "<U16"), ("moved_s", "<f8")]
    >>> epochs = events([23400, 23430, 23460], kind, onset=[23370, 23400, 23430], moved_s=[0, 5, 0])
    >>> apply(GentleAlarm(at="07:00"), epochs=epochs)["why"].tolist()
    ['movement']
    """

    inputs = {"epochs": Input()}
    exemptions: ClassVar[dict[str, str]] = {}

    at: str = param("07:00", help="the time to be up at, HH:MM")
    timezone: str = param("UTC", help="in which it is meant, e.g. Europe/Berlin")
    window_min: float = param(30.0, above=0.0, most=120.0, help="so long before a movement may give the alarm")
    min_s: float = param(2.0, above=0.0, most=30.0, help="how much movement in an epoch")
    days: str = param("mon,tue,wed,thu,fri,sat,sun", help="on which mornings")
    sleeper: str = param("", help="the sleeper, if `epochs` are of several")

    def open(self, specs: Specs) -> Specs:
        spec = specs["epochs"]
        if not set(NEEDED) <= set(spec.dtype.names or ()):
            raise InputError("epochs", spec.describe(), f"events with the fields {', '.join(NEEDED)}")
        self._zone()
        self._clock()
        self._weekdays()
        self.set_state(GentleAlarmState(NEVER, False, 0))
        return {"out": StreamSpec((), ALARM, units=("ns", "ns", ""), meta=dict(spec.meta))}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        emitted: list[tuple[str, Chunk]] = []
        made: list[tuple[int, int, str]] = []
        for k, stamp in enumerate(chunk.time.tolist()):
            self._pass(stamp - 1, made)
            if chunk.lost and k == 0:
                emitted.append(("out", self._chunk(made, stamp - 1)))
                made, s.lost = [], -1
            if s.at == NEVER:
                s.at = self._next(stamp - 1)
            row = chunk.data[k]
            mine = self.sleeper in ("", str(row["sleeper"]))
            near = s.at - round(self.window_min * 60 * NS) <= stamp < s.at
            if mine and near and not s.rung and float(row["moved_s"]) >= self.min_s:
                s.rung = True
                made.append((stamp, s.at, "movement"))
        if chunk.until != FOREVER:
            self._pass(chunk.until, made)
        return [*emitted, ("out", self._chunk(made, chunk.until))]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        dtype = np.dtype([("onset", "<i8"), ("sleeper", "U16"), ("moved_s", "<f8")])
        start = 1_700_000_000 * NS
        onset = start + np.arange(200) * 1200 * NS
        moved = np.where(np.arange(200) % 3, 0.0, 5.0)
        rows = np.array([(t, "", m) for t, m in zip(onset.tolist(), moved.tolist(), strict=True)], dtype)
        epochs = (StreamSpec((), dtype, units=("ns", "", "s")), onset + 1200 * NS, rows)
        return [
            Case(cls(window_min=60.0), {"epochs": epochs}, least=2),
            Case(cls(at="02:30", timezone="Europe/Berlin", min_s=9.0), {"epochs": epochs}, least=2),
        ]

    def _pass(self, until: int, made: list[tuple[int, int, str]]) -> None:
        """Every set time up to `until` is over: those not rung for are reported by the clock."""
        s = self.state
        while s.at != NEVER and s.at <= until:
            if not s.rung:
                made.append((s.at, s.at, "clock"))
            s.at, s.rung = self._next(s.at), False

    def _next(self, after: int) -> int:
        """The first set time after a stamp (ns)."""
        zone, (hour, minute), days = self._zone(), self._clock(), self._weekdays()
        day = datetime.fromtimestamp(after // NS, UTC).astimezone(zone).date()
        for k in range(-1, 9):
            at = datetime.combine(day + timedelta(k), time(hour, minute), zone)
            stamp = round(at.timestamp()) * NS
            if stamp > after and at.weekday() in days:
                return stamp
        raise AssertionError("a week has every day")

    def _zone(self) -> ZoneInfo:
        try:
            return ZoneInfo(self.timezone)
        except (ZoneInfoNotFoundError, ValueError):
            raise ParameterError("timezone", self.timezone, "a time zone's name, like Europe/Berlin") from None

    def _clock(self) -> tuple[int, int]:
        try:
            at = datetime.strptime(self.at, "%H:%M")
        except ValueError:
            raise ParameterError("at", self.at, "a time of day such as 07:00") from None
        return at.hour, at.minute

    def _weekdays(self) -> tuple[int, ...]:
        names = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
        given = [day.strip().lower() for day in self.days.split(",")]
        if not set(given) <= set(names):
            raise ParameterError("days", self.days, f"some of {','.join(names)}")
        return tuple(names.index(day) for day in given)

    def _chunk(self, made: list[tuple[int, int, str]], until: int) -> Chunk:
        s = self.state
        lost, s.lost = s.lost, 0
        return Chunk(np.array([t for t, *_ in made], np.int64), np.array(made, ALARM), until, lost)
