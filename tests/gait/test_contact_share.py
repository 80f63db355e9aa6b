"""What contacts that are off do to the means in stance and swing: beside these means, and marked in the report where it is much."""

from __future__ import annotations

import html
import re
from pathlib import Path

import numpy as np
import pytest

from kinegraph.operators.cycles.statistics.operator import CycleStatistics, share_of, shifted_pct
from kinegraph.stream.chunk import FOREVER, Chunk
from tests.support.command_line import Command


def bump(at: float, width: float) -> np.ndarray:
    place = np.arange(100)
    off = np.abs((place - at + 50) % 100 - 50)
    return 1.0 + 20.0 * np.exp(-0.5 * (off / width) ** 2)


def test_the_shares_of_an_interval_are_its_length_wherever_it_lies() -> None:
    assert share_of(0, 60).tolist() == 60 * [1.0] + 40 * [0.0]
    assert share_of(-1.5, 2.25).sum() == pytest.approx(3.75) and share_of(-1.5, 2.25)[[98, 99, 2]].tolist() == [
        0.5,
        1.0,
        0.25,
    ]
    assert share_of(62.5, 101.5).sum() == pytest.approx(39.0) and share_of(62.5, 101.5)[1] == 0.5


@pytest.mark.parametrize("by", [0.7, 1.8, 4.0])
def test_it_is_what_cycles_cut_at_moved_contacts_would_have(by: float) -> None:
    """Ten times as fine a curve, cut at both contacts `by` later and earlier."""
    for at, width, stance in ((97.0, 4.0, 62.0), (30.0, 8.0, 62.0), (61.0, 3.0, 58.3)):
        curve = bump(at, width)
        fine = np.repeat(curve, 1000)
        found = []
        for moved in (0.0, by, -by):
            turned = np.roll(fine, -round(1000 * moved))
            cut = round(1000 * stance)
            found.append((turned[:cut].mean(), turned[cut:].mean()))
        before, *after = np.array(found)
        assert shifted_pct(curve[:, None], stance, by)[0] == pytest.approx(
            100 * np.abs(np.array(after) / before - 1).max(), rel=1e-6
        )


def test_every_cycle_has_it_and_what_is_not_known_is_nan() -> None:
    (case, *_), operator = CycleStatistics.cases(), CycleStatistics()
    spec = operator.open({port: given[0] for port, given in case.inputs.items()})["out"]
    assert spec.unit_of("contact_pct") == "%" and spec.meta["contact_s"] == 0.02
    _, stamps, rows = case.inputs["closed"]
    closed = rows.copy()
    closed["stance_pct"][closed["number"] % 2 == 1] = np.nan
    operator.process("closed", Chunk(stamps, closed, FOREVER))
    _, time, curves = case.inputs["cycles"]
    out = operator.process("cycles", Chunk(time, curves, FOREVER))
    assert out is not None
    there = (out.data["number"] % 2 == 0) & np.isfinite(out.data["mean"])
    assert there.any() and (np.isfinite(out.data["contact_pct"]) == there).all()


def test_the_report_marks_a_mean_that_hangs_on_contacts(kinegraph: Command) -> None:
    """In the simulated walk the vastus is active across the touch-down; the table lists every muscle."""
    out = ("--set", "treadmill.realtime=false", "--set", "treadmill.duration_s=20")
    assert kinegraph("run", "treadmill_emg", *out, "--out", "walk", "--view", "none")[0] == 0
    page = Path("walk/report.html").read_text()
    sentence = re.search(r"Contacts that come 20 ms earlier or later change (.+?)\.", page)
    assert sentence and re.search(r"\bVM by \d\d %", sentence[1]) and "GM by" not in sentence[1], sentence
    assert "Slow changes of a muscle's activity were not watched for: that takes 69 cycles" in html.unescape(page)
    assert "Swapped leads" not in page, "18 cycles are enough for these"
    with Path("walk/report.csv").open() as file:
        assert ",VM contact_pct," in file.readline()
