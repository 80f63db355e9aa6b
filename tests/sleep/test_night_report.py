"""A whole night as it lies on the disk in the morning: the log, the report, EDF+, and what they say of what was not seen."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from kinegraph.devices.reports.night import archive, figures
from kinegraph.devices.reports.night.numbers import CAVEATS, begun_after, exits, quality, span, table, unseen
from kinegraph.devices.reports.night.page import draw, render
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError
from tests.support import night_made
from tests.support.browser import Browser, needs_browser
from tests.support.command_line import Command, kinegraph, refused
from tests.support.night_made import EVENING, SPECS, STEP, Night, feed, logged, opened, states

__all__ = ["kinegraph"]


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Night]:
    """A whole night with its report: (folder of the night, what was reported)."""
    root = tmp_path_factory.mktemp("nights")
    night = night_made.whole(root)
    (folder,) = (path for path, _ in archive.nights(root))
    return folder, night


def test_what_is_logged_is_what_was_final(drawn: tuple[Path, Night]) -> None:
    folder, night = drawn
    epochs, facts = archive.read_epochs(folder), archive.Facts.load(folder)
    assert folder.name == "2025-12-31" and facts.closed and facts.breaks == []
    assert logged(folder) == states(night, night.inn)  # from the first epoch in bed on
    assert epochs.onset.tolist() == [night.onset(k) for k in range(night.inn, night.n)]
    assert epochs.texts["provisional"].tolist() == night.first[night.inn :].tolist()
    assert epochs.texts["bed"].tolist() == night.bed[night.inn :].tolist()
    np.testing.assert_allclose(epochs.numbers["breaths_per_min"], night.rate[night.inn :], rtol=1e-3)
    np.testing.assert_allclose(epochs.numbers["activity"], night.moved[night.inn :], rtol=1e-3)


def test_a_night_takes_less_than_a_megabyte(drawn: tuple[Path, Night]) -> None:
    folder, _ = drawn
    assert {path.name for path in folder.iterdir()} == {archive.FACTS, archive.EPOCHS, archive.MAP, *archive.DRAWN}
    assert archive.bytes_of(folder) < 1_000_000


@needs_browser
def test_a_browser_shows_the_report_and_prints_it_on_two_sheets(drawn: tuple[Path, Night], tmp_path: Path) -> None:
    page, browser = drawn[0] / "report.html", Browser(tmp_path)
    assert "Night of Wednesday" in browser.shown(page)
    assert browser.fits_a_phone(page)
    assert browser.sheets(page) == 2


def test_the_report_says_what_must_be_said(drawn: tuple[Path, Night]) -> None:
    folder, night = drawn
    page = (folder / "report.html").read_text()
    for words in (
        *CAVEATS,
        "Night of Wednesday, 31 December 2025",
        "estimated",
        "AASM",
        ">not scored<",
        "Hatched: not scored",
        "Gaussian-weighted",
    ):
        assert words in page, words
    assert "src=" not in page and "http://" not in page.replace("http://www.w3.org", "")  # needs nothing else
    assert (folder / "report.png").read_bytes()[:4] == b"\x89PNG"
    facts, epochs = archive.Facts.load(folder), archive.read_epochs(folder)
    rows = {row.name: row for row in table(facts, epochs)}
    tst = (night.state[night.inn : night.out] == "sleep").sum() / 2
    assert rows["Total sleep time (TST)"].value == f"{int(tst // 60)} h {round(tst) % 60:02d} min"
    assert rows["Total sleep time (TST)"].bounds and rows["Bed exits"].value == "1"
    (left,) = exits(facts)
    assert left.begin == night.onset(night.exit[0]) and left.end == night.onset(night.exit[-1] + 1)
    facts_shown = dict(quality(facts, epochs))
    assert "20 unknown" in facts_shown["Epochs"] and "(10 min)" in facts_shown["Not scored"]


def test_edf_opens_in_other_programs(drawn: tuple[Path, Night]) -> None:
    folder, night = drawn
    pyedflib, mne = pytest.importorskip("pyedflib"), pytest.importorskip("mne")
    path = str(folder / "hypnogram.edf")
    with pyedflib.EdfReader(path) as edf:
        assert edf.getSignalLabels() == ["Activity", "Breathing rate"]
        assert edf.getSampleFrequency(0) == pytest.approx(1 / 30)
        activity = edf.readSignal(0)
        starts, lengths, texts = edf.readAnnotations()
    begin = night.inn
    moved = night.moved[begin : begin + len(activity)]
    np.testing.assert_allclose(activity, np.where(np.isfinite(moved), moved, -1.0), atol=1e-3)
    stages = [(t, x) for t, x in zip(starts, texts, strict=True) if x.startswith("Sleep stage")]
    names = {"wake": "Sleep stage W", "sleep": "Sleep stage S", "unknown": "Sleep stage ?"}
    assert [x for _, x in stages] == [names[s] for s in states(night, begin)[: len(stages)]]
    assert [t for t, _ in stages[:3]] == [0.0, 30.0, 60.0] and set(lengths[: len(stages)]) <= {30.0, 360.0}
    assert "Out of bed" in texts
    raw = mne.io.read_raw_edf(path, verbose="error")
    assert raw.info["sfreq"] == pytest.approx(1 / 30) and raw.n_times == len(activity)
    assert sum(text.startswith("Sleep stage") for text in raw.annotations.description) == len(stages)
    assert raw.info["meas_date"].strftime("%Y-%m-%d %H:%M") == "2025-12-31 23:20"  # EDF's times are the wall clock's


def test_our_own_evaluation_reads_the_log_and_the_edf(drawn: tuple[Path, Night]) -> None:
    from kinegraph.operators.sleep.evaluation.reference import read_hypnogram

    folder, _ = drawn
    of_csv, of_edf = read_hypnogram(folder / "epochs.csv"), read_hypnogram(folder / "hypnogram.edf")
    n = len(of_edf.state)
    assert of_csv.state[:n].tolist() == of_edf.state.tolist() and of_csv.dated


def test_epochs_of_which_there_is_no_row_were_not_seen(drawn: tuple[Path, Night]) -> None:
    folder, night = drawn
    epochs, facts = archive.read_epochs(folder), archive.Facts.load(folder)
    there = np.ones(len(epochs), np.bool_)
    there[20:30] = False
    texts, numbers = ({n: c[there] for n, c in columns.items()} for columns in (epochs.texts, epochs.numbers))
    holed = archive.LoggedEpochs(epochs.onset[there], epochs.end[there], texts, numbers)
    assert [(s.begin, s.end) for s in unseen(holed)] == [
        (night.onset(night.inn + 20), night.onset(night.inn + 30)),
        (night.onset(night.gone[0]), night.onset(night.gone[-1] + 1)),
    ]
    assert "(5 min)" in dict(quality(facts, holed))["Not scored"]


def test_the_report_of_a_night_that_goes_on(tmp_path: Path) -> None:
    night, log = Night(), opened(tmp_path, report=False)
    log.begin()
    feed(log, night.chunks(0, 300))
    log.close()
    folder = tmp_path / "2025-12-31"
    facts, epochs = archive.Facts.load(folder), archive.read_epochs(folder)
    assert "not over" in render(facts, epochs, None, [])
    facts.closed = True  # another night has begun meanwhile
    assert "broken off" in (page := render(facts, epochs, None, [])) and "not over" not in page


@pytest.mark.parametrize(("dark", "whole"), [(None, True), (30, True), (100, True), (270, False)])
def test_numbers_of_a_new_session_do_not_pass_for_those_of_the_night(
    tmp_path: Path, dark: int | None, whole: bool
) -> None:
    """kinegraph was stopped in order and started again; who was in bed is noticed three minutes later. `dark`: lights off at this epoch."""
    night, switched = Night(), SPECS["lights"].dtype
    for begin, end, first in ((0, 250, 0), (262, night.n, 256)):
        log = opened(tmp_path, report=False)
        log.keep_time(SimpleNamespace(utc_ns=night.onset(first)))
        log.begin()
        cut = dark if dark and begin <= dark < end else end
        feed(log, night.chunks(begin, cut))
        if cut < end:
            log.process("lights", night_made.event(switched, night.onset(cut), False))
        if begin and dark and dark < begin:  # what the switch had been is reported again
            log.process("lights", night_made.event(switched, night.onset(begin), False))
        feed(log, night.chunks(cut, end))
        if begin:
            for port, chunk in night.end():
                if port == "nights":
                    chunk.data["onset"] = night.onset(dark if dark and dark > 262 else 262)
                    chunk.data["bed"] = "detected" if dark is None else "lights"
                feed(log, iter([(port, chunk)]))
        log.close()
    ((folder, facts),) = archive.nights(tmp_path)
    epochs = archive.read_epochs(folder)
    assert bool(begun_after(facts, epochs)) == whole == ("Numbers" in dict(quality(facts, epochs)))
    assert [what for _, what in facts.switched] == (["lights off"] if dark else [])
    if dark == 30:
        assert facts.switched == [[night.onset(30), "lights off"]]  # just before anybody was in bed
        facts.switched, facts.numbers["onset"] = [], night.onset(257)  # the switch says what it had been before
        assert begun_after(facts, epochs)
    assert ("of a night that began at 23:20" in render(facts, epochs, None, [])) == whole
    assert span(facts, epochs)[0] == (facts.begun if whole else night.onset(270) - 15 * 60 * NS)


def test_the_facts_are_plain_json(drawn: tuple[Path, Night]) -> None:
    facts_shown = json.loads((drawn[0] / archive.FACTS).read_text())
    assert facts_shown["begun"] == EVENING + 40 * STEP and facts_shown["numbers"]["convention"] == "AASM"


# every product by itself ---------------------------------------------------------------------------------------------


@pytest.fixture
def copied(drawn: tuple[Path, Night], tmp_path: Path) -> Path:
    """A night's folder of one's own, nothing drawn yet."""
    folder = tmp_path / "nights" / drawn[0].name
    shutil.copytree(drawn[0], folder)
    for name in archive.DRAWN:
        (folder / name).unlink()
    return folder


@pytest.mark.parametrize("lost", archive.DRAWN)
def test_a_product_that_cannot_be_written_takes_no_other_with_it(copied: Path, lost: str, kinegraph: Command) -> None:
    (copied / lost).mkdir()
    with pytest.raises(archive.NightError, match=lost):
        draw(copied)
    assert all((copied / name).is_file() for name in archive.DRAWN if name != lost)
    if lost != "report.html":
        assert f"Could not be made: {lost}" in (copied / "report.html").read_text()
    refused(kinegraph("sleep", "nights", "report", "last", "--path", copied.parent), lost)


@pytest.mark.parametrize("name", ["night_svg", "map_svg", "page_png"])
def test_a_figure_that_cannot_be_drawn_leaves_the_page_and_its_numbers(
    copied: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    def broken(*_: object) -> str:
        raise ValueError("no such font")

    monkeypatch.setattr(figures, name, broken)
    with pytest.raises(archive.NightError, match="ValueError: no such font"):
        draw(copied)
    page = (copied / "report.html").read_text()
    assert "Total sleep time" in page and "no such font" in page and (copied / "hypnogram.edf").is_file()


def test_a_session_whose_report_is_not_whole_says_which_part_and_fails(tmp_path: Path) -> None:
    night, log = Night(), opened(tmp_path)
    log.begin()
    feed(log, night.chunks())
    (tmp_path / "2025-12-31" / "report.png").mkdir()
    feed(log, night.end())
    with pytest.raises(DeviceError, match=r"report\.png.*nights report 2025-12-31"):
        log.close()
    assert (tmp_path / "2025-12-31" / "report.html").is_file() and (tmp_path / "2025-12-31" / "hypnogram.edf").is_file()


def test_the_report_says_when_the_camera_was_moved_and_why_epochs_are_unknown(tmp_path: Path) -> None:
    night, log = Night(), opened(tmp_path, report=False)
    log.begin()
    feed(log, night.chunks(0, 200))
    log.process(
        "view", night_made.event(SPECS["view"].dtype, night.onset(200), night.onset(200), "steady", np.nan, np.nan)
    )
    log.process("view", night_made.event(SPECS["view"].dtype, night.onset(200), night.onset(200), "moved", 0.0, 6.0))
    feed(log, night.chunks(200))
    feed(log, night.end())
    log.close()
    folder = tmp_path / "2025-12-31"
    facts, epochs = archive.Facts.load(folder), archive.read_epochs(folder)
    assert facts.moved == [[night.onset(200), 0.0, 6.0]]
    facts_shown = dict(quality(facts, epochs))
    assert (
        facts_shown["The camera was moved"] == "at 00:40"
        and facts_shown["Not judged because"] == "too little was seen: 20 epochs"
    )
    assert "The camera was moved" in render(facts, epochs, None, [])


def test_a_log_that_is_older_than_the_reasons_is_read(drawn: tuple[Path, Night], tmp_path: Path) -> None:
    folder = tmp_path / "old"
    shutil.copytree(drawn[0], folder)
    lines = [line.rpartition(",")[0] for line in (folder / archive.EPOCHS).read_text().splitlines()]
    (folder / archive.EPOCHS).write_text("\n".join(lines) + "\n")
    assert not lines[0].endswith("why") and set(archive.read_epochs(folder).texts["why"]) == {""}
    assert draw(folder).is_file()
