"""What is reported of a whole session agrees with its single cycles, however long it is and whatever was revised on the way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from kinegraph.devices.reports.session.compose import compose
from kinegraph.devices.reports.session.contents.tally import add_chunk, nothing_yet, numbers
from kinegraph.operators.cycles.cycle import CLOSED_UNITS, POINTS
from kinegraph.operators.cycles.limb_cycles import LIMB_CLOSED
from kinegraph.operators.cycles.statistics.bursts import CycleBursts
from kinegraph.operators.cycles.statistics.ensemble import CycleEnsemble
from kinegraph.operators.cycles.statistics.median_frequency import MedianFrequency
from kinegraph.operators.cycles.statistics.operator import CycleStatistics
from kinegraph.operators.cycles.statistics.symmetry import LimbSymmetry
from kinegraph.stream.chunk import NS, Chunk, StreamSpec, grid
from tests.support.emg_run import drive

COUNT = 400
MUSCLES = ("L_TA", "L_SO", "R_TA", "R_SO")
META = {
    "limbs": {"left": MUSCLES[:2], "right": MUSCLES[2:]},
    "muscles": {name: name[2:] for name in MUSCLES},
    "normalisation": "mvc",
}
TAKEN_BACK, PUT_BACK = {41, 42, 155, 300}, {155}


def walked() -> dict[str, Any]:
    """400 cycles of two legs that turn slowly stronger; every 25th is rejected, some are taken back later, and one of these is put back."""
    rng = np.random.default_rng(1)
    closed = np.zeros(COUNT, LIMB_CLOSED)
    closed["number"] = np.arange(1, COUNT + 1)
    closed["onset"] = NS + np.arange(COUNT) * (NS // 2) + rng.integers(0, NS // 50, COUNT)
    closed["end"] = closed["onset"] + NS + rng.integers(0, NS // 50, COUNT)
    closed["limb"] = np.resize(["left", "right"], COUNT)
    closed["duration_s"] = (closed["end"] - closed["onset"]) / NS
    closed["cadence"] = 60 / closed["duration_s"]
    closed["stance_pct"] = 62 + rng.random(COUNT)
    closed["rejected"][24::25] = "irregular"
    places = np.arange(POINTS)[:, None]
    shape = 2 + 60 * np.exp(-(((places - np.array([15, 30, 15, 30])) / 7) ** 2))
    curves = shape * (1 + np.arange(COUNT) / COUNT + 0.2 * rng.random(COUNT))[:, None, None]
    curves += rng.random(curves.shape)
    curves[np.arange(COUNT) % 2 == 0, :, 2:] = np.nan
    curves[np.arange(COUNT) % 2 == 1, :, :2] = np.nan
    events, which = [], []
    for i in range(COUNT):
        events.append(closed[i])
        which.append(i)
        for number, reason, after in (
            *((n, "by hand", 20) for n in TAKEN_BACK),
            *((n, "", 40) for n in PUT_BACK),
        ):
            if i + 1 == number + after:
                again = closed[number - 1].copy()
                again["rejected"] = reason
                events.append(again)
                which.append(number - 1)
    rows = np.array(events, LIMB_CLOSED)
    stamps = np.maximum.accumulate(rows["end"]) + 20_000_000
    taken = rows["rejected"] == ""
    units = (*CLOSED_UNITS, "")
    return {
        "closed": (StreamSpec((), LIMB_CLOSED, units=units, meta=META), stamps, rows),
        "cycles": (
            StreamSpec((POINTS, 4), channels=MUSCLES, units=("% MVC",), channel_axis=1, meta=META),
            stamps[taken],
            curves[np.array(which)[taken]],
        ),
    }


@pytest.fixture(scope="module")
def walk() -> dict[str, Any]:
    return walked()


@pytest.fixture(scope="module")
def counted(walk: dict[str, Any]) -> dict[int, Any]:
    """The events of the cycles that count in the end, by number."""
    return {int(row["number"]): row for row in latest(walk["closed"][2]) if not row["rejected"]}


def latest(rows: np.ndarray) -> list[Any]:
    return list({int(row["number"]): row for row in rows}.values())


@pytest.fixture(scope="module")
def curves(walk: dict[str, Any], counted: dict[int, Any]) -> dict[str, np.ndarray]:
    """Each muscle's curves (n, 100) that count in the end."""
    taken = walk["closed"][2][walk["closed"][2]["rejected"] == ""]
    found = {int(row["number"]): curve for row, curve in zip(taken, walk["cycles"][2], strict=True)}
    every = np.array([found[number] for number in counted])
    return {name: every[np.isfinite(every[:, 0, i]), :, i] for i, name in enumerate(MUSCLES)}


@pytest.fixture(scope="module")
def statistics(walk: dict[str, Any]) -> tuple[StreamSpec, np.ndarray, np.ndarray]:
    return drive(CycleStatistics(), walk, 50)["out"]


def test_the_mean_symmetry_and_its_interval_are_of_all_pairs_of_the_session(walk, counted, statistics) -> None:
    rows = drive(LimbSymmetry(), {"closed": walk["closed"], "statistics": statistics}, 50)["out"][2]
    peaks = {(int(r["number"]), str(r["name"])): float(r["peak"]) for r in statistics[2]}
    left = [row for row in counted.values() if row["limb"] == "left"]
    indices = []
    for row in (row for row in counted.values() if row["limb"] == "right"):
        near = [r for r in left if row["onset"] - (row["end"] - row["onset"]) < r["onset"] < row["onset"]]
        if near:
            first = peaks[int(max(near, key=lambda r: int(r["onset"]))["number"]), "L_TA"]
            second = peaks[int(row["number"]), "R_TA"]
            indices.append(200 * (second - first) / (second + first))
    assert len(indices) > 170
    last = rows[(rows["name"] == "TA") & (rows["measure"] == "peak")][-1]
    assert last["pairs"] == len(indices)
    low, high = stats.t.interval(0.95, len(indices) - 1, np.mean(indices), stats.sem(indices))
    assert np.allclose([last["mean_pct"], last["low_pct"], last["high_pct"]], [np.mean(indices), low, high], atol=1e-9)


def test_the_mean_curve_its_spread_and_likeness_are_of_all_cycles_of_the_session(walk, curves) -> None:
    found = drive(CycleEnsemble(pairs=(("L_TA", "L_SO"),)), walk, 50)
    mean, sd = found["mean"][2][-1], found["sd"][2][-1]
    for i, (name, mine) in enumerate(curves.items()):
        assert np.allclose(mean[:, i], mine.mean(axis=0)) and np.allclose(sd[:, i], mine.std(axis=0, ddof=1)), name
        row = found["muscles"][2][found["muscles"][2]["name"] == name][-1]
        n, centre = len(mine), mine.mean(axis=0)
        assert row["cycles"] == n
        assert np.isclose(row["cv_pct"], 100 * np.sqrt(mine.var(axis=0, ddof=1).mean()) / centre.mean())
        within = ((mine - centre) ** 2).sum() / (POINTS * (n - 1))
        assert np.isclose(row["variance_ratio"], within / (((mine - mine.mean()) ** 2).sum() / (POINTS * n - 1)))
    a, b = curves["L_TA"], curves["L_SO"]
    both = 200 * np.minimum(a, b).sum(axis=1) / (a + b).sum(axis=1)
    assert np.isclose(found["pairs"][2][-1]["mean_pct"], both.mean())


def test_the_bursts_of_a_session_are_those_of_its_cycles(walk, counted) -> None:
    found = drive(CycleBursts(), walk, 50)
    single = found["bursts"][2]
    for name in MUSCLES:
        last = found["session"][2][found["session"][2]["name"] == name][-1]
        mine = [
            single[(single["number"] == number) & (single["name"] == name)][-1]  # a cycle that was put back came twice
            for number, row in counted.items()
            if name in META["limbs"][str(row["limb"])]
        ]
        assert last["cycles"] == len(mine)
        length = [row["duration_pct"] for row in mine]
        assert np.allclose([last["duration_pct"], last["duration_sd_pct"]], [np.mean(length), np.std(length, ddof=1)])
        assert np.isclose(last["on_pct"], stats.circmean([row["on_pct"] for row in mine], high=100))


def test_the_slope_of_the_median_frequency_is_of_all_cycles_of_the_session(walk, counted) -> None:
    n = 210 * 500
    x = np.random.default_rng(3).standard_normal((n, 4))
    signal = (StreamSpec((4,), rate_hz=500.0, channels=MUSCLES, units=("uV",)), grid(500.0, n), x)
    rows = drive(MedianFrequency(high_hz=240.0), {"signal": signal, "closed": walk["closed"]}, 500)["out"][2]
    mine = rows[rows["name"] == "R_TA"]
    kept = {int(row["number"]): row for row in mine if int(row["number"]) in counted}
    assert mine[-1]["cycles"] == len(kept)
    minutes = np.array([row["onset"] for row in kept.values()], float) / (60 * NS)
    first = min(int(row["onset"]) for row in rows) / (60 * NS)
    slope, level = np.polyfit(minutes - first, [row["median_hz"] for row in kept.values()], 1)
    assert np.isclose(mine[-1]["slope_pct_per_min"], 100 * slope / level)


def test_the_numbers_of_the_report_are_of_all_cycles_of_the_session(walk, counted, curves, statistics) -> None:
    specs = {"closed": walk["closed"][0], "cycles": walk["cycles"][0], "statistics": statistics[0]}
    tally = nothing_yet(specs)
    given = {"closed": walk["closed"], "cycles": walk["cycles"], "statistics": statistics}
    pieces = [(t, k, port) for k, port in enumerate(given) for t in np.unique(given[port][1]).tolist()]
    for stamp, _, port in sorted(pieces):
        here = given[port][1] == stamp
        add_chunk(tally, specs, port, Chunk(given[port][1][here], given[port][2][here], stamp))
    report, drawn = compose(tally, specs, None, {})
    assert report.accepted == len(counted) and report.rejected == COUNT - len(counted)
    cadence = next(value for value in report.gait if value.label == "cadence")
    expected = [float(row["cadence"]) for row in counted.values()]
    assert np.allclose([cadence.value, cadence.spread], [np.mean(expected), np.std(expected, ddof=1)])
    final = {(int(row["number"]), str(row["name"])): row for row in statistics[2] if int(row["number"]) in counted}
    for i, (name, mine) in enumerate(curves.items()):
        assert np.allclose(drawn.mean[:, i], mine.mean(axis=0)) and np.allclose(
            drawn.sd[:, i], mine.std(axis=0, ddof=1)
        )
        for field, running in zip(numbers(specs["statistics"]), tally.fields, strict=True):
            if field == "peak_pct":
                continue  # a circular mean, compared above for bursts
            values = np.array([row[field] for (_, muscle), row in final.items() if muscle == name])
            values = values[np.isfinite(values)]
            assert np.isclose(running.centre()[i], values.mean()), (name, field)
            assert np.isclose(running.spread()[i], values.std(ddof=1)), (name, field)
