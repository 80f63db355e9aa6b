"""The session report as an outlet: numbers against numpy, every cycle in the CSV, resumed, interim, and bounded."""

from __future__ import annotations

import csv
import re
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.outlets.terminal.cycle_table import CycleTable
from kinegraph.devices.reports.session import SessionReport
from kinegraph.devices.reports.session import session as report_module
from kinegraph.devices.reports.session.contents.data import load
from kinegraph.stream.chunk import NS, Array, Chunk, Specs, StreamSpec
from kinegraph.stream.data.state import size_of
from kinegraph.stream.errors import DeviceError, InputError, ParameterError
from kinegraph.stream.graph import Edge, Graph, Node

START = 1_767_225_600 * NS
MUSCLES = ("TA", "SO", "GM")
META = {"side": "right", "normalisation": "none", "sites": {"TA": "shin", "SO": "calf"}}
WHEN = [("onset", "<i8"), ("end", "<i8"), ("number", "<i8")]
CLOSED = np.dtype([*WHEN, ("duration_s", "<f8"), ("stance_pct", "<f8"), ("cadence", "<f8"), ("rejected", "<U12")])
NUMBERS = np.dtype(
    [*WHEN, ("muscle", "<i4"), ("name", "<U16"), ("peak", "<f8"), ("peak_pct", "<f8"), ("deviation", "<f8")]
)
OVERALL = np.dtype(
    [*WHEN, ("muscle", "<i4"), ("name", "<U16"), ("cv_pct", "<f8"), ("variance_ratio", "<f8"), ("verdict", "<U16")]
)
PAIRS = np.dtype([*WHEN, ("first", "<U16"), ("second", "<U16"), ("mean_pct", "<f8")])
QUALITY = np.dtype(
    [("name", "<U16"), ("flag", "<U8"), ("reason", "<U16"), ("session_flag", "<U8"), ("session_reason", "<U16")]
)
SPECS: Specs = {
    "emg": StreamSpec((3,), rate_hz=1000.0, channels=MUSCLES, units=("uV",), meta=META),
    "closed": StreamSpec((), CLOSED, units=("ns", "ns", "", "s", "%", "strides/min", ""), meta=META),
    "cycles": StreamSpec((100, 3), channels=MUSCLES, units=("uV",), channel_axis=1, meta=META),
    "statistics": StreamSpec(
        (), NUMBERS, units=("ns", "ns", "", "", "", "uV", "%", ""), meta={"deviation_scale": "session"}
    ),
    "muscles": StreamSpec((), OVERALL, units=("ns", "ns", "", "", "", "%", "", "")),
    "pairs": StreamSpec((), PAIRS, units=("ns", "ns", "", "", "", "%")),
    "quality": StreamSpec((), QUALITY),
}


class Walk:
    """Made-up cycles 1..n; every fourth is rejected, SO is missing in the sixth."""

    def __init__(self, n: int) -> None:
        rng = np.random.default_rng(5)
        self.closed = np.zeros(n, CLOSED)
        touch = START + (np.arange(n + 1) * 1.05 * NS).astype(np.int64)
        self.closed["onset"], self.closed["end"], self.closed["number"] = touch[:-1], touch[1:], np.arange(1, n + 1)
        self.closed["duration_s"] = 1.05 + 0.01 * rng.standard_normal(n)
        self.closed["stance_pct"], self.closed["cadence"] = 60 + rng.random(n), 60 / self.closed["duration_s"]
        self.closed["rejected"][3::4] = "gap"
        self.curves = 50 + 5 * rng.standard_normal((n, 100, 3))
        self.curves[5:6, :, 1] = np.nan
        self.peak_pct = (99 + 2 * rng.standard_normal((n, 3))) % 100
        self.accepted = np.flatnonzero(self.closed["rejected"] == "")

    def feed(self, outlet: SessionReport | CycleTable, first: int, stop: int, ports: tuple[str, ...]) -> None:
        """Cycles first..stop-1, port by port as the merge gives them."""
        for i in range(first, stop):
            onset, end = int(self.closed["onset"][i]), int(self.closed["end"][i])
            if "emg" in ports:
                time = onset + np.arange(10) * 1_000_000
                outlet.process("emg", Chunk(time, np.zeros((10, 3)), end, 7 if i == 2 else 0))
            stamp = np.array([end + 1])
            outlet.process("closed", Chunk(stamp, self.closed[i : i + 1], end + 1))
            if self.closed["rejected"][i]:
                continue
            if "cycles" in ports:
                outlet.process("cycles", Chunk(stamp, self.curves[i : i + 1], end + 1))
            for port, rows in self.rows(i).items():
                if port in ports:
                    outlet.process(port, Chunk(stamp.repeat(len(rows)), rows, end + 1))

    def rows(self, i: int) -> dict[str, Array]:
        muscle = {dtype: np.zeros(3, dtype) for dtype in (NUMBERS, OVERALL)}
        for rows in muscle.values():
            rows["number"], rows["muscle"], rows["name"] = self.closed["number"][i], np.arange(3), MUSCLES
        muscle[NUMBERS]["peak"], muscle[NUMBERS]["peak_pct"] = self.curves[i].max(0), self.peak_pct[i]
        muscle[NUMBERS]["deviation"] = np.nan if i == 0 else 0.5
        muscle[OVERALL]["cv_pct"], muscle[OVERALL]["variance_ratio"] = 30 + i, 0.1
        muscle[OVERALL]["verdict"] = "repeatable", "not repeatable", ""
        pair = np.zeros(1, PAIRS)
        pair["first"], pair["second"], pair["mean_pct"] = "TA", "SO", 40 + i
        quality = np.array(
            [("SO", "bad" if i < 9 else "good", "clipping", "bad", "flat line"), ("Fz", "good", "", "good", "")],
            QUALITY,
        )
        return {"statistics": muscle[NUMBERS], "muscles": muscle[OVERALL], "pairs": pair, "quality": quality}


def opened(path: Path, ports: tuple[str, ...] = tuple(SPECS), **given: float) -> SessionReport:
    outlet = SessionReport(str(path), **given)  # type: ignore[arg-type]
    assert outlet.open({port: SPECS[port] for port in ports}) == {}
    graph = Graph("walk", {}, "nodes: {}", session={"subject": "K-017", "speed_m_s": 1.2})
    graph.nodes["report"] = Node(
        "report", outlet, "devices.reports.session.SessionReport", {"emg": Edge("treadmill", "emg")}
    )
    outlet.meet(graph)
    return outlet


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_report_holds_what_numpy_says(tmp_path: Path) -> None:
    walk = Walk(30)
    outlet = opened(tmp_path / "s.html")
    outlet.begin()
    walk.feed(outlet, 0, 30, tuple(SPECS))
    report, curves = outlet.report()
    good = walk.accepted
    np.testing.assert_allclose(curves.mean, np.nanmean(walk.curves[good], 0), rtol=1e-12)
    np.testing.assert_allclose(curves.sd, np.nanstd(walk.curves[good], 0, ddof=1), rtol=1e-11)
    np.testing.assert_allclose(curves.single, walk.curves[good], rtol=1e-6)
    assert (report.accepted, report.rejected, report.reasons) == (23, 7, [("gap in the signal or the contacts", 7)])
    cadence, steps, cycle, stance = report.gait
    assert (steps.value, steps.unit) == (2 * cadence.value, "steps/min")
    for value, field in ((cadence, "cadence"), (cycle, "duration_s"), (stance, "stance_pct")):
        assert abs(value.value - walk.closed[field][good].mean()) < 1e-9
        assert abs(value.spread - walk.closed[field][good].std(ddof=1)) < 1e-9
    assert [c.heading for c in report.columns] == ["Peak", "Peak at", "Deviation", "CV", "VR"]
    so = report.muscles[1]
    assert (so.name, so.site, so.verdict, so.remark) == (
        "SO",
        "calf",
        "bad",
        "flat line, 7 of 23 windows not good; left out of 1 of 23 cycles; not repeatable",
    )
    assert abs(so.values[0][0] - np.nanmean(walk.curves[good].max(1)[:, 1])) < 1e-9
    assert (so.values[1][0] > 97 or so.values[1][0] < 1) and so.values[1][1] < 3
    assert so.values[3][0] == 30 + good[-1]
    assert report.pairs[0].label == "TA / SO" and report.pairs[0].value == 40 + good[-1]
    assert (
        ("Subject", "K-017") in report.facts
        and ("Speed", "1.2 m/s") in report.facts
        and ("Side", "right") in report.facts
    )
    stream = report.streams[0]
    assert (stream.name, stream.samples, stream.gaps, stream.lost) == ("treadmill.emg", 300, 1, 7)
    assert report.rejections[0].time_s == pytest.approx(3 * 1.05, abs=1e-6)
    outlet.close()


def test_a_session_leaves_a_page_and_a_table(tmp_path: Path) -> None:
    walk = Walk(9)
    outlet = opened(tmp_path / "deep" / "s.html")
    outlet.begin()
    walk.feed(outlet, 0, 9, tuple(SPECS))
    outlet.close()
    assert sorted(p.name for p in (tmp_path / "deep").iterdir()) == ["s-curves.csv", "s.csv", "s.html"]
    page = (tmp_path / "deep" / "s.html").read_text()
    assert "K-017" in page and "Interim report" not in page and "s.csv" in page and page.count("<svg") == 3
    rows = table(tmp_path / "deep" / "s.csv")
    assert [row["number"] for row in rows] == [str(i) for i in range(1, 10)]
    assert [row["rejected"] for row in rows] == list(walk.closed["rejected"])
    for i, row in enumerate(rows):
        taken = not row["rejected"]
        assert float(row["duration_s"]) == walk.closed["duration_s"][i]
        assert row["TA peak (uV)"] == (repr(float(walk.curves[i, :, 0].max())) if taken else "nan")
        assert row["GM peak_pct"] == (repr(float(walk.peak_pct[i, 2])) if taken else "nan")
    assert {row["amplitudes"] for row in rows} == {"not normalised"}
    assert rows[1]["touch-down (UTC)"] == "2026-01-01T00:00:01.050000000Z"


def test_curves_and_events_alone_suffice(tmp_path: Path) -> None:
    ports = ("closed", "cycles")
    outlet = opened(tmp_path / "s.html", ports)
    outlet.begin()
    Walk(6).feed(outlet, 0, 6, ports)
    outlet.close()
    assert [row["rejected"] for row in table(tmp_path / "s.csv")] == ["", "", "", "gap", "", ""]
    assert "Not judged in this session" in (tmp_path / "s.html").read_text()


def test_a_cycle_whose_numbers_never_came_keeps_its_row(tmp_path: Path) -> None:
    walk = Walk(3)
    outlet = opened(tmp_path / "s.html")
    outlet.begin()
    walk.feed(outlet, 0, 1, ("closed",))
    walk.feed(outlet, 1, 3, tuple(SPECS))
    outlet.close()
    rows = table(tmp_path / "s.csv")
    assert [row["number"] for row in rows] == ["1", "2", "3"] and rows[0]["TA peak (uV)"] == "nan" != rows[1][
        "TA peak (uV)"
    ]


def test_resumed_at_any_place_the_files_are_the_same(tmp_path: Path) -> None:
    walk = Walk(12)
    whole = opened(tmp_path / "whole.html")
    whole.begin()
    walk.feed(whole, 0, 12, tuple(SPECS))
    expected = repr(whole.report()[0]).replace("whole", "s"), whole.report()[1]
    whole.close()
    first = opened(tmp_path / "s.html")
    first.begin()
    walk.feed(first, 0, 5, tuple(SPECS))
    checkpoint = first.snapshot()
    walk.feed(first, 5, 8, tuple(SPECS))
    first.runtime.lock.release()  # type: ignore[union-attr]  # as when the process dies
    again = opened(tmp_path / "s.html")
    again.restore(checkpoint)
    again.begin()
    walk.feed(again, 5, 12, tuple(SPECS))
    assert repr(again.report()[0]) == expected[0]
    np.testing.assert_array_equal(again.report()[1].mean, expected[1].mean)
    again.close()
    assert (tmp_path / "s.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_a_crash_leaves_an_interim_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_module, "FIRST_INTERIM_S", 0.0)
    outlet = opened(tmp_path / "s.html")
    outlet.begin()
    Walk(6).feed(outlet, 0, 6, tuple(SPECS))
    end = time.monotonic() + 60
    while not (tmp_path / "s.html").exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert "Interim report" in (tmp_path / "s.html").read_text()
    outlet.close()
    assert "Interim report" not in (tmp_path / "s.html").read_text()


def test_nothing_is_overwritten_and_a_second_instance_is_refused(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text("precious")
    first, second = opened(tmp_path / "s.html"), opened(tmp_path / "s.html")
    assert first.file == str(tmp_path / "s.html")
    first.begin()
    with pytest.raises(DeviceError, match="another session"):
        second.begin()
    first.close()
    assert first.file == str(tmp_path / "s-2.html")
    assert (tmp_path / "s.csv").read_text() == "precious" and (tmp_path / "s-2.html").exists()
    assert (tmp_path / "s-2.csv").exists()


def test_a_report_lies_with_its_recording_and_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for recorded, place in (("walk", "walk/report"), ("again.mcap", "again-report"), ("", "reports/walk-report")):
        outlet = SessionReport()
        outlet.open(SPECS)
        graph = Graph("walk", {}, "nodes: {}", recorded_in=recorded)
        graph.nodes["report"] = Node("report", outlet, "devices.reports.session.SessionReport")
        outlet.meet(graph)
        outlet.begin()
        Walk(4).feed(outlet, 0, 4, tuple(SPECS))
        outlet.close()
        assert outlet.file == f"{place}.html"
        for name in (place, f"{place}-curves"):
            assert {row["recording"] for row in table(Path(f"{name}.csv"))} == {recorded}
        assert (f"Recording <b>{recorded}</b>" in Path(f"{place}.html").read_text()) == bool(recorded)


def test_a_page_that_cannot_be_drawn_is_told_and_its_data_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outlet = opened(tmp_path / "s.html")
    outlet.begin()
    walk = Walk(4)
    walk.feed(outlet, 0, 4, tuple(SPECS))
    (tmp_path / "s.html").mkdir()
    with pytest.raises(DeviceError, match=r"could not be drawn: .*s\.html.*; its data are in"):
        outlet.close()
    assert len(table(tmp_path / "s.csv")) == 4
    report, _ = load(tmp_path / ".s.npz")
    assert report.accepted == 3
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    lost = opened(tmp_path / "t.html")
    lost.begin()
    with pytest.raises(DeviceError, match="cannot be written: No such file"):
        lost.close()


def test_memory_stops_growing(tmp_path: Path) -> None:
    walk, sizes = Walk(12), []
    outlet = opened(tmp_path / "s.html")
    outlet.begin()
    for _ in range(60):
        walk.feed(outlet, 0, 12, tuple(SPECS))
        walk.closed["number"] += 12
        sizes.append(size_of(outlet.state))
    assert outlet.state.tally.accepted == 540 and len(outlet.report()[1].single) <= 200
    assert len(set(sizes[1:])) == 1
    outlet.close()


def test_what_cannot_be_reported_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"ends with \.html"):
        opened(tmp_path / "s.pdf")
    with pytest.raises(InputError, match="cycles"):
        SessionReport(str(tmp_path / "s.html")).open({**SPECS, "cycles": SPECS["emg"]})
    with pytest.raises(InputError, match="duration_s"):
        SessionReport(str(tmp_path / "s.html")).open({**SPECS, "closed": SPECS["pairs"]})


def test_cycles_appear_as_lines_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    walk = Walk(4)
    outlet = CycleTable(fields=("peak", "peak_pct"))
    outlet.open({port: SPECS[port] for port in ("closed", "statistics")})
    outlet.begin()
    walk.feed(outlet, 0, 4, ("closed", "statistics"))
    first, _, _, last = capsys.readouterr().out.splitlines()
    assert re.match(
        r"cycle 1  1\.0\d\d s  stance 6\d\.\d %  5\d\.\d strides/min  peak in µV, not normalised: TA \d\d\.\d@\d+%, SO \d\d\.\d@",
        first,
    )
    assert re.match(r"cycle 4  1\.0\d\d s  rejected: gap$", last)
    with pytest.raises(ParameterError, match="did you mean 'peak'"):
        CycleTable(fields=("peek",)).open({port: SPECS[port] for port in ("closed", "statistics")})


def test_a_cycle_that_is_told_again_replaces_what_was_told_first(tmp_path: Path) -> None:
    """The second is taken back after the sixth; the fourth, rejected at first, counts after all."""
    walk, ports = Walk(12), tuple(SPECS)
    reported = opened(tmp_path / "twice.html")
    reported.begin()
    walk.feed(reported, 0, 6, ports)
    walk.closed["rejected"][1], walk.closed["rejected"][3] = "irregular", ""
    walk.feed(reported, 1, 2, ("closed", "cycles", "statistics"))
    walk.feed(reported, 3, 4, ("closed", "cycles", "statistics"))
    walk.feed(reported, 6, 12, ports)
    once = opened(tmp_path / "once.html")
    once.begin()
    walk.feed(once, 0, 12, ports)
    (report, curves), (expected, expected_curves) = reported.report(), once.report()
    assert (report.accepted, report.rejected) == (expected.accepted, expected.rejected) == (9, 3)
    assert dict(report.reasons) == dict(expected.reasons)
    np.testing.assert_allclose(curves.mean, expected_curves.mean, rtol=1e-12)
    np.testing.assert_allclose(curves.sd, expected_curves.sd, rtol=1e-9)
    assert sorted(curves.single[:, 0, 0]) == sorted(expected_curves.single[:, 0, 0])
    for muscle, other in zip(report.muscles, expected.muscles, strict=True):
        np.testing.assert_allclose(muscle.values[:3], other.values[:3], rtol=1e-9)
    reported.close()
    once.close()
    assert table(tmp_path / "twice.csv") == table(tmp_path / "once.csv")


def test_a_cycle_that_is_taken_back_is_a_line_and_counts_no_more(capsys: pytest.CaptureFixture[str]) -> None:
    walk, outlet = Walk(3), CycleTable(fields=("peak",))
    outlet.open({port: SPECS[port] for port in ("closed", "statistics")})
    walk.feed(outlet, 0, 3, ("closed", "statistics"))
    walk.closed["rejected"][0] = "irregular"
    walk.feed(outlet, 0, 1, ("closed", "statistics"))
    assert "cycle 1 " in (last := capsys.readouterr().out.splitlines()[-1]) and "irregular (taken back)" in last
    assert (outlet.state.accepted, outlet.state.rejected) == (2, 1)
