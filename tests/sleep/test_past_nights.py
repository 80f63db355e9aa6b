"""The nights on the disk as streams, and the page's panel of weeks that draws them, in a real browser."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.reports.night.past_nights import BINS, NightsFolder, PastNights
from tests.sleep.test_nights_weeks import fortnight, logged
from tests.support.browser import needs_browser
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import needs_page, page_process

__all__ = ["fortnight"]

GRAPH = """
name: weeks
record: [treadmill.force]
page:
  panels:
    - {kind: weeks, of: [past, past.weeks], title: weeks, wide: 4}
    - {kind: weeks, of: [right, right.weeks], title: of somebody else}
nodes:
  treadmill: {use: devices.people.treadmill.Treadmill}
  past: {use: devices.reports.night.past_nights.PastNights, path: nights}
  right: {use: devices.reports.night.past_nights.PastNights, path: nights, sleeper: right}
"""
LEFT, HEAD, LINE = 92, 18, 14


def test_every_night_and_every_week_once_and_again_what_changes(fortnight: Path) -> None:
    nights = NightsFolder(fortnight, "", 100)
    first = nights.look()
    names, kinds, days = ([row[i] for row in first["out"]] for i in (0, 2, 9))
    assert len(names) == len(set(names)) == 14 and kinds.count("night") == 13 and kinds.count("nap") == 1
    assert all(len(day) == BINS for day in days)
    monday = dict(zip(names, days, strict=True))["2026-11-02"]
    assert monday == " " * 132 + "w" * 6 + "s" * 90 + " " * 60, "23:00 to 7:00, the first half hour awake"
    weeks = {
        row[0]: dict(zip(PastNights().specs()["weeks"].dtype.names or (), row, strict=True)) for row in first["weeks"]
    }
    assert [(w["nights"], w["missing"], w["naps"]) for w in weeks.values()] == [(7, 0, 1), (6, 1, 0)]
    assert weeks["2026-W45"]["asleep"] == 450 and abs(weeks["2026-W45"]["jet_lag"] - 2) < 0.01
    assert math.isfinite(weeks["2026-W45"]["regularity"])

    assert nights.look() == {"out": [], "weeks": []}
    logged(fortnight, "2026-11-16T23:00", "ss??")
    later = nights.look()
    assert [(row[0], row[9].strip()) for row in later["out"]] == [("2026-11-16", "s" * 12 + "?" * 12)]
    assert [row[0] for row in later["weeks"]] == ["2026-W47"]
    shutil.rmtree(fortnight / "2026-11-16")
    assert [(row[0], row[2]) for row in nights.look()["out"]] == [("2026-11-16", "deleted")]
    assert nights.look() == {"out": [], "weeks": []}


def test_a_night_that_cannot_be_read_is_told_of_once(fortnight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def warnings() -> list[str]:
        return [line for line in capsys.readouterr().out.splitlines() if "left out" in line]

    nights = NightsFolder(fortnight, "", 100)
    (fortnight / "2026-11-03" / "epochs.csv").write_text("onset\nnonsense\n")
    (fortnight / "2026-11-04" / "night.json").write_text("{")
    (fortnight / "2026-11-05" / "night.json").unlink()
    assert len(nights.look()["out"]) == 11 and not warnings(), "a night that has just begun may not be whole yet"
    nights.look()
    assert [day for line in warnings() for day in ("03", "04", "05") if f"2026-11-{day}" in line] == ["03", "04", "05"]
    nights.look()
    assert not warnings()


def test_other_sleepers_older_nights_and_damaged_ones_are_left_out(tmp_path: Path) -> None:
    for day in (2, 3, 4):
        logged(tmp_path, f"2026-11-0{day}T23:00", "ss", sleeper="left" if day != 3 else "right")
    broken = logged(tmp_path, "2026-11-05T23:00", "ss", sleeper="left")
    (broken / "epochs.csv").write_text("onset\nnonsense\n")
    assert [row[0] for row in NightsFolder(tmp_path, "left", 100).look()["out"]] == ["2026-11-02", "2026-11-04"]
    assert [row[0] for row in NightsFolder(tmp_path, "left", 2).look()["out"]] == ["2026-11-04"]
    assert NightsFolder(tmp_path / "none", "", 2).look() == {"out": [], "weeks": []}


# in a browser --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    with live_browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


@needs_page
@needs_browser
@pytest.mark.timeout(280)
def test_weeks_are_drawn_night_by_night_and_grow(browser: LiveBrowser, tmp_path: Path, fortnight: Path) -> None:
    logged(fortnight, "2026-11-03T23:00", "ww", sleeper="right")
    (tmp_path / "weeks.yaml").write_text(GRAPH)
    panel, other = (f"document.querySelectorAll('.weeks')[{i}]" for i in (0, 1))
    with page_process(tmp_path, "run", "weeks.yaml", "--view", "none", "-o", "s") as process:
        browser.open(process.url)
        browser.wait(f"{panel}?.dataset.nights === '13' && {panel}.dataset.without === '1'")
        assert browser.value(f"{other}.dataset.nights") == "1", "each sleeper has weeks of their own"
        browser.value("document.documentElement.dataset.theme = 'light'")
        browser.wait(f"{panel}.querySelector('canvas').height >= {HEAD + 14 * LINE}")
        drawn(browser, evenings=14)
        rows = json.loads(
            browser.value(
                f"JSON.stringify([...{panel}.querySelectorAll('tr')].map(r => [...r.children].map(c => c.textContent)))"
            )
        )
        assert rows[0][:5] == ["week", "nights", "missing", "naps", "asleep"]
        assert rows[1][:9] == ["2026-W46", "6", "1", "0", "7 h 00 min", "88 %", "23:40", "07:40", "+120 min"]
        assert rows[2][:5] == ["2026-W45", "7", "0", "1", "7 h 30 min"]
        browser.picture(tmp_path / "page-weeks.png", ".weeks")

        logged(fortnight, "2026-11-16T23:00", "ssssss")
        browser.wait(f"{panel}.dataset.nights === '14'")
        browser.wait(f"{panel}.querySelector('canvas').height >= {HEAD + 15 * LINE}")
        drawn(browser, evenings=15)
        assert browser.complaints == []
        assert process.stop() == 0

    with page_process(tmp_path, "view", "s") as process:
        browser.open(process.url)
        browser.wait(f"{panel}?.dataset.nights === '14'")
        assert browser.complaints == []


def drawn(browser: LiveBrowser, evenings: int) -> None:
    """Sleep and waking stand where and when they were, on the canvas; an evening without a night has neither."""
    width = browser.value("document.querySelector('.weeks canvas').width")
    sleep, wake = (np.array(browser.like(".weeks canvas", name, within=20)) for name in ("accent", "warn"))

    def hours(pixels: np.ndarray, line: int) -> tuple[float, float]:
        """From when to when a line holds these pixels, in hours after noon; NaN without any."""
        top = HEAD + LINE * line
        x = pixels[(pixels[:, 1] >= top) & (pixels[:, 1] < top + LINE) & (pixels[:, 0] >= LEFT), 0]
        span = 24 / (width - LEFT - 8)
        return ((x.min() - LEFT) * span, (x.max() + 1 - LEFT) * span) if len(x) else (math.nan, math.nan)

    assert sleep[:, 1].max() < HEAD + LINE * evenings
    near = pytest.approx((11.5, 19.0), abs=0.1)
    assert hours(sleep, 0) == near and hours(wake, 0) == pytest.approx((11.0, 11.5), abs=0.1)
    assert hours(sleep, 4) == pytest.approx((13.5, 21.0), abs=0.1), "the night before a free morning is later"
    assert hours(sleep, 3)[0] == pytest.approx(2.0, abs=0.1), "the nap of the afternoon stands in the same line"
    assert math.isnan(hours(sleep, 9)[0]) and math.isnan(hours(wake, 9)[0]), "there was no night"
