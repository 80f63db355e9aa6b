"""Weeks on paper: a page with every night as a bar, trends by week or month, two periods compared; and all of it as tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.reports.night.numbers import CAVEATS, runs
from kinegraph.devices.reports.night.weeks import (
    SLOTS,
    Difference,
    NightRow,
    Trend,
    by_weeks,
    compare,
    missing,
    part_trend,
    trend,
    within,
)
from kinegraph.stream.data.csv_writer import sheet_text
from kinegraph.stream.system.atomic_file import write_complete
from kinegraph.stream.text import report
from kinegraph.stream.text.time_text import hour_of_day, in_hours

Period = tuple[date, date]
FINE = ("/min", "mm", "/h")
"""Units of which tenths are shown."""
WIDE, HIGH, LEFT = 720, 9, 96
COLUMNS = (
    "evening", "night", "kind", "in_bed_from", "out_of_bed_at", "middle_of_sleep", "in_bed_min", "asleep_min", "awake_min", "unknown_min",
    "efficiency_percent", "breaths_per_min", "chest_lift_mm", "pauses_per_h",
)  # fmt: skip


def table(of: Sequence[NightRow], since: date | None = None, until: date | None = None) -> str:
    """Every night, nap and part as a row of CSV, and a row for every evening without a night."""
    chosen = within(of, since, until)
    lost = [[day.isoformat(), "", "missing", *[""] * (len(COLUMNS) - 3)] for day in missing(chosen, since, until)]
    made = [
        [r.evening.isoformat(), r.name, r.kind, *(hour_of_day(t) if t == t else "" for t in (r.bed, r.rise, r.middle)),
         *(f"{v:.4g}" if v == v else "" for v in (r.in_bed, r.asleep, r.awake, r.unknown, r.efficiency, r.breaths, r.lift, r.pauses))]
        for r in chosen
    ]  # fmt: skip
    return sheet_text([list(COLUMNS), *sorted([*made, *lost], key=lambda line: (line[0], line[1]))])


def trends_table(of: Sequence[NightRow], free: Sequence[int], months: bool = False) -> str:
    """A row per week or month as CSV; clock times as HH:MM, the rest as `Trend` has it."""
    names = [f.name for f in fields(Trend)]
    lines = [["period", "from", "to", *names]]
    for name, first, last in by_weeks(of, months):
        found = part_trend(of, free, first, last)
        cells = [_cell(n, getattr(found, n)) for n in names]
        lines.append([name, first.isoformat(), last.isoformat(), *cells])
    return sheet_text(lines)


def write(
    folder: Path, of: Sequence[NightRow], free: Sequence[int], periods: Sequence[Period], *, months: bool
) -> list[Path]:
    """weeks.html, weeks.csv, nights.csv, and with two periods comparison.csv; what was written. Raises OSError."""
    differences = compare(*(within(of, *period) for period in periods)) if len(periods) == 2 else []
    written = {
        "weeks.html": page(of, free, periods, differences, months=months),
        "weeks.csv": trends_table(of, free, months),
        "nights.csv": table(of),
    }
    if differences:
        lines = [["number", "unit", "first", "second", "difference", "from", "to"]]
        lines += [[d.name, d.unit, *(f"{v:.4g}" if v == v else "" for v in _values(d))] for d in differences]
        written["comparison.csv"] = sheet_text(lines)
    for name, text in written.items():
        write_complete(folder / name, text)
    return [folder / name for name in written]


def page(
    of: Sequence[NightRow],
    free: Sequence[int],
    periods: Sequence[Period],
    differences: Sequence[Difference],
    *,
    months: bool,
) -> str:
    """The page's HTML; one file that needs nothing else."""
    spans = by_weeks(of, months)
    found = [(name, part_trend(of, free, first, last)) for name, first, last in spans]
    return report.render(
        Path(__file__).with_name("weeks.html.j2"),
        _title(of),
        whole=words(trend(of, free)),
        trends=[(name, *cells(t)) for name, t in found],
        heads=HEADS,
        days=_days(of),
        left=LEFT, wide=WIDE, high=HIGH,
        periods=[f"{a:%d.%m.%Y} to {b:%d.%m.%Y}" for a, b in periods],
        differences=[_written(d) for d in differences],
        caveats=CAVEATS,
    )  # fmt: skip


HEADS = (
    "", "nights", "missing", "naps", "asleep", "efficiency", "into bed", "out of bed", "social jet lag", "regularity", "breaths /min",
    "chest lift", "no effort seen /h",
)  # fmt: skip


def cells(of: Trend) -> list[str]:
    """A line of the table of trends, as in HEADS."""
    spread = [f" ± {60 * s:.0f} min" if s == s else "" for s in (of.bed_sd, of.rise_sd)]
    asleep = in_hours(of.asleep) if of.asleep == of.asleep else "–"
    efficiency = f"{of.efficiency:.0f} %" if of.efficiency == of.efficiency else "–"
    lag = f"{_signed(60 * of.jet_lag)} min" if of.jet_lag == of.jet_lag else "–"
    times = (hour_of_day(of.bed) + spread[0], hour_of_day(of.rise) + spread[1])
    counts = (str(of.nights), str(of.missing), str(of.naps))
    breath = [f"{v:.1f}{unit}" if v == v else "–" for v, unit in ((of.breaths, ""), (of.lift, " mm"), (of.pauses, ""))]
    return [*counts, asleep, efficiency, *times, lag, _whole(of.regularity), *breath]


def _whole(value: float) -> str:
    return f"{value:.0f}" if value == value else "–"


def words(of: Trend) -> list[str]:
    """What several nights say, in sentences; the ones that too few nights allow are left out."""
    lines = [f"{_many(of.nights, 'night')}, {_many(of.naps, 'nap')}, {_many(of.missing, 'evening')} without a night."]
    if of.unfinished:
        lines.append(f"{_many(of.unfinished, 'night')} without numbers.")
    if of.nights:
        lines.append(f"Asleep {in_hours(of.asleep)} a night, {of.efficiency:.0f} % of the time in bed.")
        lines.append(f"In bed from {hour_of_day(of.bed)} to {hour_of_day(of.rise)} on average.")
    if of.bed_sd == of.bed_sd:
        lines.append(f"Bed time scatters by {60 * of.bed_sd:.0f} min, rise time by {60 * of.rise_sd:.0f} min (SD).")
    if of.jet_lag == of.jet_lag:
        way = "later" if of.jet_lag >= 0 else "earlier"
        lines.append(
            f"Social jet lag: before free mornings the middle of sleep lies {60 * abs(of.jet_lag):.0f} min {way}."
        )
    if of.regularity == of.regularity:
        lines.append(
            f"Sleep regularity index: {of.regularity:.0f} (of {of.pairs} pairs of days; 100: every day the same)."
        )
    if of.breaths == of.breaths:
        lines.append(
            f"{of.breaths:.1f} breaths per minute, lift of the chest {of.lift:.1f} mm (medians of nights, mean)."
        )
    return lines


def _many(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _title(of: Sequence[NightRow]) -> str:
    return f"Nights from {min(r.evening for r in of):%d.%m.%Y} to {max(r.evening for r in of):%d.%m.%Y}"


def _days(of: Sequence[NightRow]) -> list[dict[str, Any]]:
    """For the picture: a line per evening from the first to the last, each with its bars (x, width, what)."""
    first, last = min(r.evening for r in of), max(r.evening for r in of)
    lines, lost = [], set(missing(of))
    for k in range((last - first).days + 1):
        day = first + timedelta(k)
        here = [r for r in of if r.evening == day]
        bars: list[tuple[float, float, str]] = []
        for one in here:
            if one.rise == one.rise:
                bars.append((*_place(one.bed, one.rise), "unknown"))
            for state, what in ((1.0, "sleep"), (0.0, "wake")):
                bars += [(LEFT + a * WIDE / SLOTS, (b - a) * WIDE / SLOTS, what) for a, b in runs(one.day == state)]
        lines.append({"name": f"{day:%a %d.%m.}", "bars": bars, "missing": day in lost})
    return lines


def _place(begin: float, end: float) -> tuple[float, float]:
    return LEFT + begin * WIDE / 24, (min(end, 24.0) - begin) * WIDE / 24


def _values(d: Difference) -> tuple[float, ...]:
    return d.first, d.second, d.difference, d.low, d.high


def _written(d: Difference) -> list[str]:
    clock = d.unit == "h"
    fine = int(d.unit in FINE)
    sides = [hour_of_day(v) if clock else f"{v:.{fine}f} {d.unit}" for v in (d.first, d.second)]
    scale, unit = (60, "min") if clock else (1, d.unit)
    known = np.isfinite([d.low, d.high]).all()
    interval = f"{_signed(scale * d.low, fine)} to {_signed(scale * d.high, fine)}" if known else "–"
    return [d.name, *sides, f"{_signed(scale * d.difference, fine)} {unit}", interval]


def _signed(value: float, decimals: int = 0) -> str:
    """A number with its sign; what rounds to 0 has no sign."""
    return f"{value:+.{decimals}f}" if abs(value) > 0.5 * 10**-decimals or value != value else "0"


def _cell(name: str, value: float) -> str:
    if value != value:
        return ""
    return hour_of_day(value) if name in ("bed", "rise") else f"{value:.4g}"
