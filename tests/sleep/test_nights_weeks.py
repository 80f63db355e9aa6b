"""Weeks: naps kept apart from nights, missing nights shown, trends by hand, periods compared, all of it as a table and a page."""

from __future__ import annotations

import csv
from datetime import date, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from kinegraph.devices.reports.night import archive, weeks, weeks_page
from kinegraph.devices.reports.night.archive import COLUMNS, EPOCHS, Facts, iso
from kinegraph.devices.reports.night.page import draw
from kinegraph.devices.reports.night.summary import headline, sentence
from kinegraph.stream.chunk import NS
from kinegraph.stream.text.time_text import hour_of_day
from tests.support.command_line import Command, refused

ZONE = "Europe/Berlin"
STEP = 30 * NS


def logged(root: Path, begin: str, states: str, *, sleeper: str = "", numbers: bool = True) -> Path:
    """A night on the disk; `begin` by the wall clock, a letter for each half hour: s, w, ?."""
    onset = round(datetime.fromisoformat(begin).replace(tzinfo=ZoneInfo(ZONE)).timestamp()) * NS
    names = {"s": "sleep", "w": "wake", "?": "unknown"}
    each = [names[letter] for letter in states for _ in range(60)]
    end = onset + len(each) * STEP
    folder = archive.new_folder(root, onset, ZoneInfo(ZONE))
    folder.mkdir(parents=True)
    lines = [",".join(COLUMNS)]
    for k, state in enumerate(each):
        known = {"onset": iso(onset + k * STEP), "end": iso(onset + (k + 1) * STEP), "state": state, "bed": "in"}
        lines.append(",".join(known.get(name, "") for name in COLUMNS))
    (folder / EPOCHS).write_text("\n".join(lines) + "\n")
    tst = each.count("sleep") / 2
    facts = Facts(folder.name, onset, 30.0, ZONE, sleeper, closed=True, meta={"method": "thesis"})
    tib = len(each) / 2
    if numbers:
        waso = each.count("wake") / 2
        facts.numbers = {
            "onset": onset, "end": end, "tst": tst, "se": 100 * tst / tib, "tib": tib, "convention": "AASM", "estimated": True,
            "bed": "detected", "sol": 0.0, "waso": waso, "awakenings": 1, "mean_awakening": 1.0, "longest_bout": 60.0,
            "movement": 1.0, "fragmentation": 1.0,
        }  # fmt: skip
    facts.save(folder)
    return folder


@pytest.fixture
def fortnight(tmp_path: Path) -> Path:
    """Monday 2 to Sunday 15 November 2026: 23:00 to 7:00, before free mornings 1:00 to 9:00; one is missing, one afternoon is a nap."""
    root = tmp_path / "nights"
    for k in range(14):
        day = date(2026, 11, 2) + timedelta(k)
        late = (day + timedelta(1)).weekday() in (5, 6)
        if k != 9:
            begin = f"{day + timedelta(1)}T01:00" if late else f"{day}T23:00"
            logged(root, begin, "w" + "s" * 15 if k < 7 else "ww" + "s" * 14)
    logged(root, "2026-11-05T14:00", "sw")
    return root


def test_naps_are_no_nights_and_missing_ones_are_told(fortnight: Path) -> None:
    rows = weeks.rows(fortnight)
    assert [r.kind for r in rows].count("night") == 13
    (nap,) = (r for r in rows if r.kind == "nap")
    assert nap.evening == date(2026, 11, 5) and nap.asleep == 30
    assert weeks.missing(rows) == [date(2026, 11, 11)]


def test_an_evening_with_a_nap_alone_is_not_missing_before_the_first_night(tmp_path: Path) -> None:
    logged(tmp_path, "2026-11-03T14:00", "sw")
    rows = weeks.rows(tmp_path)
    assert [weeks.part_trend(rows, weeks.FREE, first, last).missing for _, first, last in weeks.by_weeks(rows)] == [0]
    page = weeks_page.page(rows, weeks.FREE, (), (), months=False)
    assert "missing</text>" not in page and "– %" not in page
    for day in (7, 10):
        logged(tmp_path, f"2026-11-{day:02d}T23:00", "s" * 16)
    rows = weeks.rows(tmp_path)
    found = [weeks.part_trend(rows, weeks.FREE, first, last) for _, first, last in weeks.by_weeks(rows)]
    assert [(t.nights, t.naps, t.missing) for t in found] == [(1, 1, 1), (1, 0, 1)]


def test_the_table_shows_the_minute_that_the_report_shows(tmp_path: Path) -> None:
    logged(tmp_path, "2026-11-02T23:00:45", "s" * 16)
    (one,) = weeks.rows(tmp_path)
    assert hour_of_day(one.bed) == "23:00" and one.in_bed == 480


def test_a_night_in_two_parts_is_one_night(tmp_path: Path) -> None:
    logged(tmp_path, "2026-11-02T22:00", "ssssss")
    logged(tmp_path, "2026-11-03T02:00", "ssssssssss")
    assert [r.kind for r in weeks.rows(tmp_path)] == ["part", "night"]


def test_trends_by_hand(fortnight: Path) -> None:
    found = weeks.trend(weeks.rows(fortnight))
    assert (found.nights, found.naps, found.missing, found.unfinished) == (13, 1, 1, 0)
    assert found.asleep == pytest.approx((7 * 450 + 6 * 420) / 13)
    # a night's sleep begins 30 or 60 min after going to bed: its middle lies 15 min later in the second week
    work, free = [3.25 + 12] * 5 + [3.5 + 12] * 4, [5.25 + 12] * 2 + [5.5 + 12] * 2
    assert found.jet_lag == pytest.approx(np.mean(free) - np.mean(work))
    assert hour_of_day(found.bed) == "23:37" and hour_of_day(12.5) == "00:30" and hour_of_day(11.999) == "00:00"
    assert found.bed_sd == pytest.approx(np.std([11.0] * 9 + [13.0] * 4, ddof=1))


def test_the_same_every_day_is_100_and_the_opposite_is_minus_100(tmp_path: Path) -> None:
    for k in range(8):
        day = date(2026, 11, 2) + timedelta(k)
        logged(tmp_path / "same", f"{day}T23:00", "s" * 16)
        logged(tmp_path / "shifted", f"{day if k % 2 else day + timedelta(1)}T{'23' if k % 2 else '01'}:00", "s" * 16)
    assert weeks.regularity(weeks.rows(tmp_path / "same")) == (100.0, 7)
    index, _ = weeks.regularity(weeks.rows(tmp_path / "shifted"))
    assert index == pytest.approx(-100 + 200 * 20 / 24), "four of 24 hours differ every day"
    assert np.isnan(weeks.regularity(weeks.rows(tmp_path / "same")[:5])[0]), "four pairs are too few"


def test_daylight_saving_moves_no_bed_time(tmp_path: Path) -> None:
    for day in ("2026-10-23", "2026-10-24", "2026-10-25"):
        logged(tmp_path, f"{day}T23:00", "s" * 16)
    assert [hour_of_day(r.bed) for r in weeks.rows(tmp_path)] == ["23:00"] * 3


def test_what_nobody_knows_counts_on_neither_side(tmp_path: Path) -> None:
    for k in range(8):
        logged(tmp_path, f"{date(2026, 11, 2) + timedelta(k)}T23:00", "s" * 8 + ("?" if k % 2 else "s") * 8)
    rows = weeks.rows(tmp_path)
    assert weeks.regularity(rows)[0] == 100.0 and rows[1].unknown == 240 and rows[1].asleep == 240


def test_periods_are_compared_with_welchs_interval(fortnight: Path) -> None:
    from scipy.stats import ttest_ind

    rows = weeks.rows(fortnight)
    first = weeks.within(rows, date(2026, 11, 2), date(2026, 11, 8))
    second = weeks.within(rows, date(2026, 11, 9), date(2026, 11, 15))
    found = {d.name: d for d in weeks.compare(first, second)}
    assert found["Asleep"].difference == pytest.approx(-30)
    beds = [[r.bed for r in side if r.kind == "night"] for side in (first, second)]
    interval = ttest_ind(beds[1], beds[0], equal_var=False).confidence_interval()
    assert (found["In bed from"].low, found["In bed from"].high) == pytest.approx((interval.low, interval.high))


def test_the_command_reports_compares_and_exports(kinegraph: Command, fortnight: Path, tmp_path: Path) -> None:
    code, listed, _ = kinegraph("sleep", "nights", "--path", fortnight)
    assert code == 0
    assert "missing" in listed and "nap" in listed and "Social jet lag" in listed and "13 nights and 1 nap in" in listed
    out = tmp_path / "weeks"
    periods = ("--compare", "2026-11-02..2026-11-08", "--compare", "2026-11-09..2026-11-15")
    assert kinegraph("sleep", "nights", "weeks", "--path", fortnight, "-o", out, *periods)[0] == 0
    page = (out / "weeks.html").read_text()
    assert "2026-W46" in page and "11.11. missing" in page and "social jet lag" in page and "-30 min" in page
    assert "not a medical device" in page
    assert {p.name for p in out.iterdir()} == {"weeks.html", "weeks.csv", "nights.csv", "comparison.csv"}
    kinegraph("sleep", "nights", "export", "--path", fortnight, "-o", tmp_path / "all.csv", "--since", "2026-11-09")
    with (tmp_path / "all.csv").open() as file:
        table = list(csv.DictReader(file))
    assert len(table) == 7 and table[2]["kind"] == "missing" and table[0]["asleep_min"] == "420"


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--compare", "2026-11-02..2026-11-08"], "twice"),
        (["--compare", "x..y", "--compare", "x..y"], "not a date"),
        (["--free", "noday"], "sat,sun"),
        (["--since", "2030-01-01"], "no nights"),
    ],
)
def test_what_cannot_be_asked_is_refused(kinegraph: Command, fortnight: Path, more: list[str], message: str) -> None:
    refused(kinegraph("sleep", "nights", "weeks", "--path", fortnight, *more), message)


def test_a_night_that_is_left_out_of_the_weeks_is_named(kinegraph: Command, tmp_path: Path, fortnight: Path) -> None:
    (fortnight / "2026-11-03" / "epochs.csv").write_text("onset\nnonsense\n")
    (fortnight / "2026-11-04" / "night.json").write_text("{")
    code, out, err = kinegraph("sleep", "nights", "weeks", "--path", fortnight, "-o", tmp_path / "out")
    shown = [line for line in (out + err).splitlines() if "left out" in line]
    assert code == 0 and len(shown) == 2 and all(f"2026-11-{day}" in "".join(shown) for day in ("03", "04"))


def test_two_sleepers_nights_are_not_mixed(kinegraph: Command, tmp_path: Path) -> None:
    for who in ("left", "right"):
        logged(tmp_path, "2026-11-02T23:00", "s" * 16, sleeper=who)
    refused(kinegraph("sleep", "nights", "export", "--path", tmp_path), "name one with --sleeper")
    assert len(weeks.rows(tmp_path, "left")) == 1


def test_a_sentence_for_whoever_slept_stands_on_top(tmp_path: Path) -> None:
    folder = logged(tmp_path, "2026-11-02T23:05", "wssswssssssssss?")
    facts, epochs = archive.Facts.load(folder), archive.read_epochs(folder)
    error = "5 h 02 min to 7 h 02 min by the published error of such scores"
    shown = f"Asleep 6 h 30 min ({error}), awake 1 h 00 min in two stretches; in bed 23:05 to 07:05; 30 min not known."
    assert sentence(facts, epochs) == shown
    assert headline(facts) == "Asleep 6 h 30 min (5.0–7.0 h), 81 %, 23:05 to 07:05" and len(headline(facts)) <= 60
    page = draw(folder).read_text()
    assert page.index(shown) < page.index("Total sleep time") and f'content="{headline(facts)}"' in page


def test_the_page_of_a_single_night_is_drawn(tmp_path: Path) -> None:
    logged(tmp_path, "2026-11-02T23:05", "ssss")
    assert "1 night," in weeks_page.page(weeks.rows(tmp_path), weeks.FREE, [], [], months=True)


def test_a_night_is_handed_over_as_one_page(kinegraph: Command, tmp_path: Path) -> None:
    logged(tmp_path, "2026-11-02T23:05", "wsssw")
    code, out, _ = kinegraph("sleep", "nights", "report", "last", "--path", tmp_path, "-o", tmp_path / "night.pdf")
    content = (tmp_path / "night.pdf").read_bytes()
    assert code == 0 and "night.pdf" in out
    assert content.startswith(b"%PDF-") and content.count(b"/Type /Page\n") + content.count(b"/Type /Page ") == 1
    refused(kinegraph("sleep", "nights", "report", "last", "--path", tmp_path, "-o", "x.png"), "ends in .pdf")


def test_breath_has_a_trend_over_weeks_and_nights_of_older_versions_have_none(tmp_path: Path) -> None:
    """14 breaths per minute in the first week, 16 in the second; a pause every ten minutes."""
    for k, rate in enumerate((14.0, 14.2, 16.0, 16.2)):
        folder = logged(tmp_path, f"2026-11-{(3, 4, 10, 11)[k]:02}T23:00", "s" * 14)
        lines = (folder / EPOCHS).read_text().splitlines()
        known = {"breaths_per_min": f"{rate}", "lift_mm": "4.5"}
        made = [lines[0]]
        for n, line in enumerate(lines[1:]):
            cells = dict(zip(COLUMNS, line.split(","), strict=True))
            made.append(",".join({**cells, **known, "pauses": str(int(n % 20 == 0))}[name] for name in COLUMNS))
        (folder / EPOCHS).write_text("\n".join(made) + "\n")
    older = logged(tmp_path, "2026-11-12T23:00", "s" * 14)
    rows = weeks.rows(tmp_path)
    assert [(r.breaths, r.lift, r.pauses) for r in rows[:1]] == [(14.0, 4.5, 6.0)] and np.isnan(rows[-1].breaths), older
    trends = list(csv.DictReader(weeks_page.trends_table(rows, weeks.FREE).splitlines()))
    assert [line["breaths"] for line in trends] == ["14.1", "16.1"]
    found = {d.name: d for d in weeks.compare(rows[:2], rows[2:])}
    assert found["Breathing rate"].difference == pytest.approx(2.0)
    page = weeks_page.page(rows, weeks.FREE, (), (), months=False)
    assert "14.1 mm" not in page and "4.5 mm" in page and "no effort seen /h" in page
