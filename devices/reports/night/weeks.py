"""Nights side by side: which is a night and which a nap, what is missing, and how regular they are.

A day here is from noon to noon, named after its evening. Clock times are hours after that noon, by the clock that each night began with,
so that nothing wraps at midnight and daylight saving moves no bed time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import date, timedelta
from pathlib import Path
from typing import Literal

import numpy as np

from kinegraph.devices.reports.night import archive
from kinegraph.devices.reports.night.archive import Facts, LoggedEpochs, clock, night_zone
from kinegraph.stream.chunk import NS, Samples

NAP_H, NAP_FROM_H, NAP_TO_H = 4.0, 21.0, 9.0
"""A time in bed shorter than this, with its middle before 21:00 or after 9:00, is a nap."""
SLOTS, SLOT_S = 2880, 30
"""Half minutes of a day."""
FREE = (5, 6)
"""Mornings without work: Saturday and Sunday."""
MIN_PAIRS = 5
"""Fewer pairs of days tell nothing of regularity."""
Kind = Literal["night", "nap", "part", "unfinished"]


@dataclass(frozen=True, slots=True)
class NightRow:
    """One time in bed, or an evening of which nothing is known.

    kind     night; nap; part: a shorter time in bed of the same night; unfinished: it has no numbers
    bed, rise, middle   hours after the evening's noon: into bed, out of it, the middle of sleep; NaN: not known
    minutes  asleep, awake and unknown in the time in bed
    day      (2880,) what it says of each half minute from noon on: 1 asleep, 0 awake, NaN not known or not in bed
    breaths, lift, pauses   breaths per minute and lift of the chest (mm), each the median of the epochs; and how many times per hour no
                            effort was seen for 10 s; NaN: not known
    """

    name: str
    evening: date
    kind: Kind
    bed: float
    rise: float
    middle: float
    in_bed: float
    asleep: float
    awake: float
    unknown: float
    efficiency: float
    day: Samples
    breaths: float = math.nan
    lift: float = math.nan
    pauses: float = math.nan


def row(folder: Path, facts: Facts) -> NightRow:
    """Raises NightError where its epochs cannot be read."""
    epochs, zone, n = archive.read_epochs(folder), night_zone(facts), facts.numbers
    onset, end = int(n.get("onset", facts.begun)), int(n.get("end", epochs.end[-1] if len(epochs) else facts.begun))
    evening = archive.evening(onset, zone)
    noon = clock(onset, zone).replace(
        year=evening.year, month=evening.month, day=evening.day, hour=12, minute=0, second=0
    )
    start = round(noon.timestamp()) * NS
    part = epochs.part(onset, end)
    day = _day(part, start)
    if not n:
        nan = float("nan")
        return NightRow(
            folder.name, evening, "unfinished", _after(onset, start), nan, nan, nan, nan, nan, nan, nan, day
        )
    step = facts.epoch_s / 60
    counts = {state: float((part.texts["state"] == state).sum()) * step for state in ("sleep", "wake")}
    slept = np.flatnonzero(part.texts["state"] == "sleep")
    middle = _after((int(part.onset[slept[0]]) + int(part.end[slept[-1]])) // 2, start) if len(slept) else np.nan
    bed, rise, in_bed = _after(onset, start), _after(end, start), (end - onset) / (60 * NS)
    at = (bed + rise) / 2
    nap = in_bed < 60 * NAP_H and (at < NAP_FROM_H - 12 or at > NAP_TO_H + 12)
    asleep = float(n["tst"] or 0.0)
    return NightRow(
        folder.name, evening, "nap" if nap else "night", bed, rise, middle, in_bed, asleep, counts["wake"],
        max(0.0, in_bed - counts["sleep"] - counts["wake"]), 100 * asleep / in_bed if in_bed else np.nan, day,
        *_breath(part),
    )  # fmt: skip


def _breath(part: LoggedEpochs) -> tuple[float, float, float]:
    """Breaths per minute, lift (mm), pauses per hour; NaN where the log has none."""
    rate, lift, pauses = (part.numbers.get(name, np.empty(0)) for name in ("breaths_per_min", "lift_mm", "pauses"))
    rate, lift, pauses = (known[np.isfinite(known)] for known in (rate, lift, pauses))
    hours = len(pauses) * float(np.median(part.end - part.onset)) / (3600 * NS) if len(pauses) else 0.0
    return (
        float(np.median(rate)) if len(rate) else math.nan,
        float(np.median(lift)) if len(lift) else math.nan,
        float(pauses.sum()) / hours if hours else math.nan,
    )


def rows(root: Path, sleeper: str = "", missed: archive.Missed = lambda _: None) -> list[NightRow]:
    """Every time in bed of a sleeper, in order; of several in one night the longest is the night, shorter ones are its parts.

    Nights that cannot be read are passed over, and `missed` called with the reason.
    """
    found: list[NightRow] = []
    for folder, facts in archive.nights(root, missed):
        if facts.sleeper == sleeper:
            try:
                found.append(row(folder, facts))
            except archive.NightError as error:
                missed(error)
    return apart(found)


def apart(found: Sequence[NightRow]) -> list[NightRow]:
    """The same, with `part` for the shorter ones of several in one night."""
    longest: dict[date, NightRow] = {}
    for one in found:
        if one.kind == "night" and one.in_bed > (longest[one.evening].in_bed if one.evening in longest else 0.0):
            longest[one.evening] = one
    return [
        replace(one, kind="part") if one.kind == "night" and longest.get(one.evening, one) is not one else one
        for one in found
    ]


def missing(of: Sequence[NightRow], since: date | None = None, until: date | None = None) -> list[date]:
    """Evenings without a night between two days, or between the first night and the last."""
    there = {one.evening for one in of if one.kind == "night"}
    first, last = since or min(there, default=None), until or max(there, default=None)
    if first is None or last is None:
        return []
    return [day for k in range((last - first).days + 1) if (day := first + timedelta(k)) not in there]


def within(of: Iterable[NightRow], since: date | None, until: date | None) -> list[NightRow]:
    """Those with the evening between two days, both included."""
    return [r for r in of if (since is None or r.evening >= since) and (until is None or r.evening <= until)]


@dataclass(frozen=True, slots=True)
class Trend:
    """What several nights say together; NaN: too few to say. Minutes and hours after noon, as in `NightRow`.

    jet_lag     h: middle of sleep before free mornings less that before the others (Wittmann 2006)
    regularity  sleep regularity index, 100: the same half minute is the same every day, 0: by chance (Phillips 2017); of `pairs` of days
    """

    nights: int
    naps: int
    missing: int
    unfinished: int
    asleep: float
    asleep_sd: float
    efficiency: float
    awake: float
    unknown: float
    bed: float
    bed_sd: float
    rise: float
    rise_sd: float
    jet_lag: float
    regularity: float
    pairs: int
    breaths: float
    lift: float
    pauses: float


def trend(
    of: Sequence[NightRow], free: Sequence[int] = FREE, since: date | None = None, until: date | None = None
) -> Trend:
    """Of the nights between two days; naps count for the regularity only."""
    chosen = within(of, since, until)
    nights = [r for r in chosen if r.kind == "night"]
    index, pairs = regularity(chosen)
    return Trend(
        len(nights), sum(r.kind == "nap" for r in chosen), len(missing(chosen, since, until)),
        sum(r.kind == "unfinished" for r in chosen), *_both(nights, lambda r: r.asleep), _mean(nights, lambda r: r.efficiency),
        _mean(nights, lambda r: r.awake), _mean(nights, lambda r: r.unknown), *_both(nights, lambda r: r.bed),
        *_both(nights, lambda r: r.rise), jet_lag(nights, free), index, pairs,
        _mean(nights, lambda r: r.breaths), _mean(nights, lambda r: r.lift), _mean(nights, lambda r: r.pauses),
    )  # fmt: skip


def part_trend(of: Sequence[NightRow], free: Sequence[int], first: date, last: date) -> Trend:
    """Of a week or month of them; evenings miss a night from the very first night to the last: a new week misses no night yet."""
    lost = sum(first <= day <= last for day in missing(of))
    return replace(trend(of, free, first, last), missing=lost)


def jet_lag(nights: Sequence[NightRow], free: Sequence[int] = FREE) -> float:
    """Hours by which sleep before free mornings has its middle later (negative: earlier); `free`: weekdays, Monday is 0."""
    known = [one for one in nights if one.middle == one.middle]
    late = [one.middle for one in known if (one.evening + timedelta(1)).weekday() in free]
    early = [one.middle for one in known if (one.evening + timedelta(1)).weekday() not in free]
    return float(np.mean(late) - np.mean(early)) if late and early else float("nan")


def regularity(of: Sequence[NightRow]) -> tuple[float, int]:
    """The sleep regularity index, and of how many pairs of days it is: -100 + 200 times how likely half a minute is as 24 h before.

    A day counts if its night was logged; its unknown parts do not. Out of bed is taken for awake: sleep elsewhere is not seen.
    """
    days: dict[date, Samples] = {}
    for one in of:
        if one.kind in ("night", "part", "nap"):
            whole = days.setdefault(one.evening, np.zeros(SLOTS))
            here = ~np.isnan(one.day)
            whole[here] = one.day[here]
            whole[_blind(one)] = np.nan
    there = {one.evening for one in of if one.kind == "night"}
    broken = {one.evening for one in of if one.kind == "unfinished"}
    same = total = pairs = 0
    for day in sorted(there - broken):
        after = day + timedelta(1)
        if after in there - broken:
            both = ~np.isnan(days[day]) & ~np.isnan(days[after])
            same += int((days[day] == days[after])[both].sum())
            total += int(both.sum())
            pairs += 1
    return (-100 + 200 * same / total if total and pairs >= MIN_PAIRS else float("nan")), pairs


def _blind(one: NightRow) -> np.ndarray:
    """When in bed nothing is known."""
    at = np.arange(SLOTS) * SLOT_S / 3600
    return (at >= one.bed) & (at < one.rise) & np.isnan(one.day)


@dataclass(frozen=True, slots=True)
class Difference:
    """One number in two periods: means, how many nights, the difference with its 95 % interval (Welch); NaN below two nights."""

    name: str
    unit: str
    first: float
    second: float
    difference: float
    low: float
    high: float


NUMBERS: tuple[tuple[str, str, Callable[[NightRow], float]], ...] = (
    ("Asleep", "min", lambda r: r.asleep),
    ("Awake in bed", "min", lambda r: r.awake),
    ("Efficiency", "%", lambda r: r.efficiency),
    ("In bed from", "h", lambda r: r.bed),
    ("Out of bed at", "h", lambda r: r.rise),
    ("Middle of sleep", "h", lambda r: r.middle),
    ("Not known", "min", lambda r: r.unknown),
    ("Breathing rate", "/min", lambda r: r.breaths),
    ("Chest lift", "mm", lambda r: r.lift),
    ("No effort seen for 10 s", "/h", lambda r: r.pauses),
)


def compare(first: Sequence[NightRow], second: Sequence[NightRow]) -> list[Difference]:
    """The second period less the first, night by night taken as independent: it describes, and says nothing of causes."""
    from scipy.stats import t

    made = []
    for name, unit, of in NUMBERS:
        a, b = (np.array([of(r) for r in side if r.kind == "night" and of(r) == of(r)]) for side in (first, second))
        if not len(a) or not len(b):
            continue
        gap = float(b.mean() - a.mean())
        low = high = float("nan")
        if len(a) > 1 and len(b) > 1:
            va, vb = a.var(ddof=1) / len(a), b.var(ddof=1) / len(b)
            spread = va + vb
            if spread > 0:
                freedom = spread**2 / (va**2 / (len(a) - 1) + vb**2 / (len(b) - 1))
                half = float(t.ppf(0.975, freedom) * np.sqrt(spread))
                low, high = gap - half, gap + half
            else:
                low = high = gap
        made.append(Difference(name, unit, float(a.mean()), float(b.mean()), gap, low, high))
    return made


def by_weeks(of: Sequence[NightRow], months: bool = False) -> list[tuple[str, date, date]]:
    """(name, first evening, last) of every week (from Monday), or month, that holds a night."""
    found: dict[str, tuple[date, date]] = {}
    for one in of:
        day = one.evening
        if months:
            first = day.replace(day=1)
            last = (first + timedelta(31)).replace(day=1) - timedelta(1)
            found[f"{day:%Y-%m}"] = first, last
        else:
            first = day - timedelta(day.weekday())
            found[f"{day:%G-W%V}"] = first, first + timedelta(6)
    return [(name, *ends) for name, ends in sorted(found.items())]


def _day(part: LoggedEpochs, start: int) -> Samples:
    day = np.full(SLOTS, np.nan)
    for k in range(len(part)):
        state = str(part.texts["state"][k])
        if state in ("sleep", "wake"):
            first, stop = (round((int(t) - start) / (SLOT_S * NS)) for t in (part.onset[k], part.end[k]))
            day[max(0, first) : max(0, stop)] = float(state == "sleep")
    return day


def _after(time: int, start: int) -> float:
    """Hours, by the minute that has begun, as clocks and reports show it."""
    return (time - start) // (60 * NS) / 60


def _mean(of: Sequence[NightRow], value: Callable[[NightRow], float]) -> float:
    known = [value(r) for r in of if value(r) == value(r)]
    return float(np.mean(known)) if known else float("nan")


def _both(of: Sequence[NightRow], value: Callable[[NightRow], float]) -> tuple[float, float]:
    known = [value(r) for r in of if value(r) == value(r)]
    return _mean(of, value), float(np.std(known, ddof=1)) if len(known) > 1 else float("nan")
