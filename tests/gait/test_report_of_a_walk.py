"""The report's tables of remarks, of every burst and of median frequencies; numbers and units as people read them."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.reports.session.compose import compose
from kinegraph.devices.reports.session.contents.cycle_store import circular
from kinegraph.devices.reports.session.contents.data import Grid, LimbPanel, Report
from kinegraph.devices.reports.session.contents.grids import _beside, _bursts
from kinegraph.devices.reports.session.contents.groups import Groups
from kinegraph.devices.reports.session.contents.labels import column
from kinegraph.devices.reports.session.contents.tally import Tally, add_chunk, nothing_yet
from kinegraph.devices.reports.session.page import render
from kinegraph.operators.cycles.statistics.bursts import CycleBursts
from kinegraph.operators.cycles.statistics.median_frequency import MedianFrequency
from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec
from kinegraph.stream.manual import ANNOTATION
from tests.support.emg_run import drive
from tests.support.steep_walk import cut, steep_walk


@pytest.fixture(scope="module")
def heard() -> tuple[Tally, Specs]:
    """What a report has been given of a walk of two legs, in which somebody typed three remarks."""
    walk = steep_walk(30)
    made = cut(walk)
    both = {port: made[port] for port in ("closed", "cycles")}
    bursts = drive(CycleBursts(), both, 50)
    notes = np.array([(12 * NS, "stumbled"), (14 * NS, "leave out last"), (1, "before the walk")], ANNOTATION)
    given = {
        **both,
        "bursts": bursts["session"],
        "each_burst": bursts["bursts"],
        "frequency": drive(MedianFrequency(), {"signal": walk["emg"], "closed": made["closed"]}, 500)["out"],
        "annotations": (StreamSpec((), ANNOTATION, units=("ns", "")), np.array([12, 16, 17]) * NS, notes),
    }
    specs = {port: each[0] for port, each in given.items()}
    tally = nothing_yet(specs)
    pieces = [(t, k, port) for k, port in enumerate(given) for t in np.unique(given[port][1]).tolist()]
    for stamp, _, port in sorted(pieces):
        here = given[port][1] == stamp
        add_chunk(tally, specs, port, Chunk(given[port][1][here], given[port][2][here], stamp))
    return tally, specs


@pytest.fixture(scope="module")
def report(heard: Any) -> Report:
    return compose(*heard, None, {})[0]


def table(report: Report, title: str) -> Grid:
    return next(grid for grid in report.grids if grid.title == title)


def test_remarks_have_their_time_and_cycle_in_the_report_and_in_a_table(heard: Any, tmp_path: Path) -> None:
    tally, specs = heard
    rows = {text: (float(at), cycle) for text, at, cycle in table(compose(tally, specs, None, {})[0], "Remarks").rows}
    closed = {}
    for name, onset in (("stumbled", 12 * NS), ("leave out last", 14 * NS)):
        assert rows[name][0] == pytest.approx((onset - tally.started) / NS, abs=0.06)
        closed[name] = rows[name][1]
    assert "left " in closed["stumbled"] and "right " in closed["stumbled"] and rows["before the walk"][1] == "–"
    tally.typed.write(tmp_path / "remarks.csv", tally.started, "walk")
    with (tmp_path / "remarks.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    assert [row["remark"] for row in read] == ["before the walk", "stumbled", "leave out last"]
    assert read[1]["cycle"] == closed["stumbled"] and read[1]["recording"] == "walk"


def test_every_burst_is_in_numbers(report: Report) -> None:
    rows = table(report, "Every burst").rows
    swing, load = ([float(cell.split(" ± ")[0]) for cell in row[1:]] for row in rows if row[0] == "L_TA")
    assert swing[:4] == pytest.approx([100, 60, 75, 15], abs=3) and load[:4] == pytest.approx([100, 95, 8, 13], abs=3)
    assert [row[0] for row in rows].count("L_SO") == 1


def test_the_median_frequency_is_in_the_report(report: Report) -> None:
    rows = table(report, "Median frequency").rows
    assert [row[0] for row in rows] == ["L_TA", "L_SO", "L_GM", "L_BF", "R_TA", "R_SO", "R_GM", "R_BF"]
    assert all(100 < float(row[2].split(" ± ")[0]) < 300 for row in rows)


def test_the_cadence_is_in_steps_per_minute_too(report: Report) -> None:
    strides, steps = (value for value in report.gait if value.label == "cadence")
    assert (strides.unit, steps.unit) == ("strides/min", "steps/min") and steps.value == 2 * strides.value
    grid = table(report, "Limb by limb")
    assert ("Cadence", "steps/min") in grid.columns and float(grid.rows[0][3]) == pytest.approx(2 * 54.5, abs=2)


def test_no_number_is_minus_nothing_and_microvolts_are_printed_with_the_micro_sign(heard: Any) -> None:
    tally, specs = heard
    page = render(*compose(tally, specs, None, {}))
    assert "-0<" not in page and "± -0" not in page and "µV" in page and "uV" not in page
    groups = Groups.empty(specs)
    groups.burst_names, groups.bursts = ["TA"], [np.array([9, 1.0, 18.0, -0.0, 52.0, -0.0, 34.0, -0.0])]
    assert _bursts(groups, ["TA"]).rows == [["TA", "9", "1.0", "18 ± 0", "52 ± 0", "34 ± 0"]]
    assert circular(np.array([18.0, 18.0]))[1] == 0.0


def test_angles_of_both_legs_are_compared_at_the_same_percentage_and_in_degrees() -> None:
    """A ratio of angles means nothing: they have two signs. So ranges, and by how many degrees one leg differs from the other."""
    left = 20.0 * np.sin(np.linspace(0, 2 * np.pi, 100, endpoint=False))
    right = left.copy()
    right[40] += 5.0
    mean = np.stack([left, right, np.full(100, np.nan)], axis=1)
    panels = [
        LimbPanel("Knee.flexion", [0, 1], ["left", "right"]),
        LimbPanel("Elbow.flexion", [0, 2], ["left", "right"]),
    ]
    grid = _beside(panels, mean, ["left", "right"])
    assert grid.title == "Left beside right" and [heading for heading, _ in grid.columns][1] == "left, from to"
    assert grid.rows == [
        ["Knee.flexion", "-20.0 to 20.0", "-20.0 to 20.0", "40.0", "40.0", "0.5", "+5.0 at 40 %"]
    ]  # fmt: skip


def test_legs_without_an_angle_in_common_are_not_compared() -> None:
    panels = [LimbPanel("Knee.flexion", [0], ["left"]), LimbPanel("Hip.flexion", [1], ["right"])]
    assert not _beside(panels, np.zeros((100, 2)), ["left", "right"]).rows


def test_what_only_amplitudes_have_is_not_printed_of_angles() -> None:
    def statistics(unit: str) -> StreamSpec:
        return StreamSpec(
            (), np.dtype([("peak", "<f8"), ("integrated", "<f8"), ("cv_pct", "<f8")]), units=(unit, f"{unit} s", "%")
        )

    shown = {
        unit: [field for field in ("peak", "integrated", "cv_pct") if column(field, statistics(unit))]
        for unit in ("deg", "uV")
    }
    assert shown == {"deg": ["peak"], "uV": ["peak", "integrated", "cv_pct"]}
