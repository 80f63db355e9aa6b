"""The report's page: one file that needs nothing else, every number with its unit and normalisation, opened by a real browser."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from kinegraph.devices.reports.session.contents.data import (
    Column,
    Curves,
    Muscle,
    Rejected,
    Report,
    ReportValue,
    Setting,
    Stream,
    load,
    save,
)
from kinegraph.devices.reports.session.contents.labels import decimals
from kinegraph.devices.reports.session.contents.peaks import MODE, MOVED, Peaks
from kinegraph.devices.reports.session.curves import _ellipse, draw, draw_modes
from kinegraph.devices.reports.session.page import quality_sentence, render, write
from tests.support.browser import Browser, needs_browser

NAN = float("nan")
VOID = {"meta", "br", "link", "img", "input", "hr"}


def sample(muscles: tuple[str, ...] = ("TA", "SO"), accepted: int = 12) -> tuple[Report, Curves]:
    phase = np.arange(100)[:, None] / 100
    mean = 50 + 40 * np.sin(2 * np.pi * (phase + np.arange(len(muscles)) / 7))
    single = mean + np.random.default_rng(0).normal(0, 5, (accepted, 1, len(muscles)))
    report = Report(
        title="Treadmill EMG",
        unit="uV",
        normalisation="none",
        started=1_767_225_600_000_000_000,
        ended=1_767_225_690_000_000_000,
        facts=[("Subject", "K-017 <script>alert(1)</script>"), ("Side", "right")],
        accepted=accepted,
        rejected=2,
        reasons=[("gap", 2)],
        rejections=[Rejected(3.25, 1.5, "gap"), Rejected(9.0, NAN, "gap")],
        gait=[ReportValue("cadence", 57.1, "strides/min", 0.9), ReportValue("stance", NAN, "%")],
        columns=[Column("Peak", "uV"), Column("Peak at", "% of cycle", 0, "circular")],
        muscles=[Muscle(m, f"{m} right", "good", "", [(91.2, 3.4), (25.0, NAN)]) for m in muscles],
        pairs=[ReportValue("TA / SO", 31.5, "%", 2.5)],
        streams=[Stream("treadmill.emg", "2 channels", 90000, 1, 30)],
        settings=[Setting("envelope", "operators.emg.Envelope", "cutoff_hz: 10", 212.0)],
        versions=[("kinegraph", "0.1.0")],
        graph="nodes: {}",
        table_file="cycles.csv",
        stance_percent=63.0,
    )
    return report, Curves(mean, np.full_like(mean, 5.0), single)


class Page(HTMLParser):
    """Fails on tags that do not match; gathers the text, and every attribute that could load something."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self.loads: list[str] = []
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.loads += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "data")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] not in ("style", "title"):
            self.text += data + " "


def test_the_page_stands_alone() -> None:
    html = render(*sample())
    page = Page(html)
    assert all(address.startswith("#") for address in page.loads)
    assert "script" not in page.tags and "@import" not in html and "url(http" not in html
    ids = re.findall(r'\bid="([^"]+)"', html)
    assert len(ids) == len(set(ids)) and page.tags.count("svg") == 2


def test_the_page_says_what_a_reader_needs() -> None:
    text = " ".join(Page(render(*sample())).text.split())
    for reported in (
        "K-017 <script>alert(1)</script>",
        "12 cycles (2 rejected)",
        "57.1 ± 0.9 cadence (strides/min)",
        "– stance (%)",
        "1:30 session",
        "of the right leg",
        "mean lift-off at 63.0 %",
        "Amplitude: µV, not normalised.",
        "Amplitudes in µV, not normalised.",
        "TA / SO 31.5 ± 2.5 %",
        "3.25 1.500 gap 9.00 – gap",
        "90 000 1 30",
        "operators.emg.Envelope cutoff_hz: 10 212",
        "All 2 channels are good.",
        "cycles.csv",
        "Amplitudes are not normalised. They depend on electrodes",
    ):
        assert reported in text, reported
    assert "Interim" not in text and "uncertain" not in text


def test_modes_are_ellipses_from_half_a_cycle_before_to_half_a_cycle_after() -> None:
    """One across the touch-down is drawn whole there, and again a cycle later; its numbers stand in the table."""
    report, curves = sample()
    peaks = Peaks()
    mode = np.dtype([("name", "<U16"), ("number", "<i8"), *((name, "<f8") for name in MODE)])
    peaks.add(
        "modes",
        np.array(
            [
                ("TA", 7, 99.0, 80.0, 3.0, 5.0, 0.2, 0.6),
                ("TA", 8, 50.0, 70.0, 2.0, 4.0, 0.0, 0.7),
                ("TA", 8, 98.0, 80.0, 3.0, 5.0, 0.2, 0.3),
            ],
            mode,
        ),
    )
    moved = np.dtype([("name", "<U16"), *((name, "<f8") for name in MOVED)])
    peaks.add("distance", np.array([("TA", 0.25, 0.125, np.nan)], moved))
    report.modes = [peaks.of("TA").tolist(), peaks.of("SO").tolist()]
    report.grids = [peaks.grid("uV")]
    assert len(report.modes[0]) == 2 and report.modes[1] == [], "only the newest cycle's, and empty if unknown"
    text = Page(render(report, curves)).text
    assert "50 ± 2 %: 70 ± 4 (70%); 98 ± 3 %: 80 ± 5 (30%)" in text and "0.250" in text and "0.125" in text
    place, height = _ellipse(98.0, 80.0, 3.0, 5.0, 0.2)
    assert place.max() == 104.0 and place.min() == 92.0 and abs(height.max() - 90.0) < 0.1
    svg = draw_modes(curves, ["TA", "SO"], report.modes, "uV")
    assert svg[0].count("stroke: #b25b00") == 6 and "#b25b00" not in svg[1], (
        "each mode three times: a cycle before, now, a cycle after"
    )
    assert "150" in svg[0] and "−50" in svg[0]


def test_an_angle_is_drawn_below_zero_and_is_called_no_muscle() -> None:
    report, curves = sample(("hip",))
    below = Curves(curves.mean - 80.0, curves.sd, curves.single - 80.0)
    report.unit, report.envelopes = "deg", False
    (above,), (angle,) = (draw(part, 63.0, "deg", ["hip"]) for part in (curves, below))
    assert "−50" in angle and "−50" not in above
    text = " ".join(Page(render(report, below)).text.split())
    assert "Signals over the gait cycle 12 accepted cycles" in text and "Amplitude: deg. Every panel" in text
    assert not any(
        reported in text for reported in ("Linear envelope", "Surface electrodes", "not normalised", "uscle")
    )


def test_few_cycles_interim_and_normalised() -> None:
    report, curves = sample(accepted=4)
    report.interim, report.normalisation, report.unit = True, "MVC of 2026-01-01", "%"
    text = " ".join(Page(render(report, curves)).text.split())
    assert "Interim report: the session was still running at 00:01:30 UTC" in text
    assert "Only 4 cycles were accepted" in text
    assert text.count("%, normalised to MVC of 2026-01-01") == 2 and "not normalised" not in text


def test_a_long_unit_does_not_stick_out_of_its_panel() -> None:
    report, curves = sample(accepted=4)
    for unit in ("µV", "% task peak"):
        report.unit = unit
        place = re.search(
            rf'<text style="[^"]*text-anchor: (\w+)[^"]*" x="([-0-9.]+)"[^>]*>{unit}<', render(report, curves)
        )
        assert place and float(place[2]) >= 0
        assert place[1] == ("start" if unit[0] == "%" else "end")


def test_amplitudes_in_millivolts_keep_their_figures() -> None:
    """The numbers beside the axis are the marks' own, and the table is not all zeros."""
    _, curves = sample()
    svg = draw(Curves(curves.mean / 1000, curves.sd / 1000, curves.single / 1000), 63.0, "mV", ["TA", "SO"])[0]
    marks = [float(text) for text in re.findall(r"<text[^>]*>(\d\.\d+)</text>", svg)]
    assert len(marks) >= 3 and np.allclose(np.diff(marks), np.diff(marks)[0], atol=1e-9), marks
    assert decimals("peak", 1, np.array([0.0675, NAN, 0.0636])) == 4
    assert decimals("peak", 1, np.array([67.5])) == decimals("peak", 1, np.full(2, NAN)) == 1
    assert decimals("deviation", 2, np.array([0.41])) == 2


def test_a_session_without_a_single_cycle_has_a_page() -> None:
    report, _ = sample(accepted=0)
    report.muscles[:2] = [replace(muscle, values=[(NAN, NAN), (NAN, NAN)]) for muscle in report.muscles[:2]]
    report.stance_percent = NAN
    nothing = np.full((100, 2), np.nan)
    text = Page(render(report, Curves(nothing, nothing, np.empty((0, 100, 2))))).text
    assert text.count("no valid cycle") == 2 and "No cycle was accepted" in text and "Only 0" not in text
    assert "2 of 2 cycles were left out" in text
    report.rejected, report.rejections, report.reasons = 0, [], []
    text = Page(render(report, Curves(nothing, nothing, np.empty((0, 100, 2))))).text
    assert "no two touch-downs were found" in text and "all 0 cycles" not in text


def test_the_sentence_on_quality_names_bad_channels() -> None:
    muscles = [Muscle("TA", "", "good"), Muscle("SO", "", "bad", "flat line"), Muscle("GM", "", "doubtful")]
    assert quality_sentence(muscles) == "1 of 3 channels are good. Look at: SO bad (flat line); GM doubtful."
    muscles = [
        Muscle("TA", "", "good", "hum, 1 of 9 windows not good", troubled=1 / 9),
        Muscle("SO", "", "good", "x", troubled=0.01),
    ]
    assert quality_sentence(muscles) == "All 2 channels are good. At times not good: TA (hum, 1 of 9 windows not good)."
    assert "Not judged" in quality_sentence([Muscle("TA")])


def test_what_is_saved_is_what_is_drawn(tmp_path: Path) -> None:
    report, curves = sample()
    save(tmp_path / "data.npz", report, curves)
    again, same = load(tmp_path / "data.npz")
    assert repr(again) == repr(report)
    assert np.array_equal(same.mean, curves.mean) and np.allclose(same.single, curves.single, rtol=1e-6)
    subprocess.run(
        [sys.executable, "-m", "kinegraph.devices.reports.session.page", tmp_path / "data.npz", tmp_path / "page.html"],
        check=True,
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["data.npz", "page.html"]
    Page((tmp_path / "page.html").read_text())


@needs_browser
def test_a_browser_shows_it_and_prints_it_on_few_sheets(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    report, curves = sample(tuple(f"M{i}" for i in range(13)))
    report.settings.append(
        Setting("ensemble", "operators.cycles.statistics.ensemble.CycleEnsemble", "repeatable_below: 0.65", 0.0)
    )
    write(page, report, curves)
    browser = Browser(tmp_path)
    assert "M12 right" in browser.shown(page)
    assert browser.fits_a_phone(page)
    assert 2 <= browser.sheets(page) <= 4
