"""Mixtures of activation peaks in a session: scikit-learn's, the same with and without a pace, and honest where there is nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinegraph.operators.cycles.cycle import CLOSED, POINTS
from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.operators.emg.mixtures.operator import PeakMixtures, some_maxima
from kinegraph.operators.emg.mixtures.peak_window import PeakWindow
from kinegraph.operators.emg.mixtures.refit import Refit
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.laws.case_samples import tapes_of
from kinegraph.stream.laws.chunking import whole
from kinegraph.stream.laws.play import Player
from tests.gait.test_emg_mixture import as_scikit_learn
from tests.support.emg_run import drive, enveloped, treadmill
from tests.support.steep_walk import cut, steep_walk

CENTRES = (10.0, 40.0, 99.0)


@pytest.fixture(scope="module")
def walk():
    streams = treadmill()
    inputs = {"signal": enveloped(streams["emg"]), "touchdown": streams["touchdown"], "liftoff": streams["liftoff"]}
    made = drive(Cycles(), inputs)
    return {port: made[port] for port in ("maxima", "closed", "cycles")}


def bursts(count, centres=CENTRES, heights=None, seed=3, names=("TA", "SO")):
    """Cycles with bursts at these places in % (1 % apart from cycle to cycle), a little higher or lower each time."""
    rng = np.random.default_rng(seed)
    place = np.arange(POINTS)
    curves = np.empty((count, POINTS, len(names)))
    for k in range(count):
        for m in range(len(names)):
            apart = [(place - c - rng.normal(0, 1.0) + 50) % 100 - 50 for c in centres]
            sizes = rng.normal(1.0, 0.1, len(centres)) * (heights or [1.0] * len(centres))
            curves[k, :, m] = 0.1 + sum(h * np.exp(-0.5 * a**2 / 16) for h, a in zip(sizes, apart, strict=True))
    closed = np.zeros(count, CLOSED)
    touch = NS * np.arange(1, count + 2)
    closed["onset"], closed["end"], closed["number"], closed["duration_s"] = (
        touch[:-1],
        touch[1:],
        np.arange(1, count + 1),
        1.0,
    )
    spec = StreamSpec((POINTS, len(names)), channels=names, units=("uV",), channel_axis=1)
    made = {
        "closed": (StreamSpec((), CLOSED, units=("",)), touch[1:] + 1000, closed),
        "cycles": (spec, touch[1:] + 1000, curves),
    }
    return {"maxima": some_maxima(made), **made}


def paced(inputs, rate_hz=60.0):
    n = int((inputs["closed"][1][-1] / NS + 2) * rate_hz)
    time = np.round(np.arange(n) * NS / rate_hz).astype(np.int64)
    return {**inputs, "pace": (StreamSpec((1,), rate_hz=rate_hz), time, np.zeros((n, 1)))}


def last(made, name):
    rows = made["mixture"][2]
    return rows[rows["name"] == name][-1]


def test_without_turns_it_is_scikit_learns_on_the_real_walk(walk):
    operator = PeakMixtures(
        circular=False, merge_nats=0.0, tolerance=1e-6, fewest_cycles=4, contrast=1.0, min_pct=0.5, min_height=0.01
    )
    rows = drive(operator, walk)["mixture"][2]
    rows = rows[rows["number"] == rows["number"].max()]
    assert len(rows) == len(walk["cycles"][0].channels) and (rows["unknown"] == "").all()
    window = PeakWindow.empty(20, len(rows))
    window.note_peaks(walk["maxima"][2])
    for number, curve in zip(walk["closed"][2]["number"].tolist(), walk["cycles"][2], strict=True):
        window.accept(number, curve)
    for m, row in enumerate(rows):
        refit = Refit.empty(20, 1)
        refit.begin(window, window.latest(20), np.array([m]), operator.fitting())
        start = tuple(part.copy() for part in refit.mixture())
        peer, _ = as_scikit_learn(refit.points[: refit.count], start, np.sqrt(refit.least / 1e-6))
        order = np.argsort(-peer[1][:, 1], kind="stable")
        k = row["modes"]
        for field, theirs in zip(("weight", "mean", "covariance"), peer, strict=True):
            scale = np.abs(theirs).max()
            np.testing.assert_allclose(row[field][:k] / scale, theirs[order] / scale, atol=1e-8, err_msg=row["name"])


def test_a_pace_spreads_the_work_and_changes_no_mixture(walk):
    whole, spread = drive(PeakMixtures(fewest_cycles=2), walk), drive(PeakMixtures(fewest_cycles=2), paced(walk, 120.0))
    for name in ("mixture", "modes"):
        a, b = (np.sort(made[name][2], order=["number", "muscle"]) for made in (whole, spread))
        assert len(a) and a.tobytes() == b.tobytes()
    assert len(np.unique(spread["mixture"][1])) == len(spread["mixture"][1]), "one mixture a sample at most"


def test_a_burst_across_touch_down_is_one_mode_and_the_highest_two_are_told_apart():
    made = drive(PeakMixtures(), bursts(20, heights=[0.6, 0.8, 1.0]))
    row = last(made, "TA")
    assert row["modes"] == 3 and row["unknown"] == ""
    np.testing.assert_allclose((row["mean"][:3, 0] - [99, 40, 10] + 50) % 100, 50, atol=1.0)
    assert row["apart_pct"] == pytest.approx(41, abs=1.0), "99 % to 40 % over touch-down"
    modes = made["modes"][2][-3:]
    assert modes["weight"].sum() == pytest.approx(1.0) and (np.diff(modes["height"]) < 0).all()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda curves: curves[:, :, 0].fill(0.0), "no burst"),
        (lambda curves: curves[:, :, 0].fill(3.0), "no burst"),
        (lambda curves: curves[:, :, 0].fill(np.nan), "too few cycles"),
        (lambda curves: curves[3:, :, 0].fill(np.nan), "too few cycles"),
    ],
    ids=["silent", "always active", "never there", "died in the session"],
)
def test_what_is_not_known_is_said(change, why):
    inputs = bursts(20)
    change(inputs["cycles"][2])
    inputs["maxima"] = some_maxima(inputs)
    made = drive(PeakMixtures(), inputs)
    row = last(made, "TA")
    assert row["unknown"] == why and row["modes"] == 0 and np.isnan(row["weight"]).all() and np.isnan(row["likelihood"])
    assert last(made, "SO")["modes"] == 3, "the other muscle is not touched"


def test_two_cycles_are_too_few():
    made = drive(PeakMixtures(), bursts(2))
    assert (made["mixture"][2]["unknown"] == "too few cycles").all() and not len(made["modes"][2])


def test_equal_heights_have_the_floor_and_a_mode_that_dies_out_goes():
    inputs = bursts(40)
    curves = inputs["cycles"][2]
    curves[:20] = curves[0]
    curves[20:] = curves[20]
    curves[20:, 25:75] = 0.1
    inputs["maxima"] = some_maxima(inputs)
    rows = drive(PeakMixtures(), inputs)["mixture"][2]
    early, late = (rows[(rows["name"] == "TA") & (rows["number"] == n)][0] for n in (20, 40))
    assert early["modes"] == 3 and late["modes"] == 2
    floor = [1.0, (0.05 * curves[0, :, 0].max()) ** 2]
    np.testing.assert_allclose(early["covariance"][:3, [0, 2]], [floor] * 3, rtol=1e-6)


def test_a_cycle_that_is_taken_back_is_in_no_later_mixture():
    inputs = bursts(12)
    spec, time, closed = inputs["closed"]
    back = closed[5:6].copy()
    back["rejected"] = "irregular"
    revised = {**inputs, "closed": (spec, np.insert(time, 8, time[7]), np.insert(closed, 8, back))}
    never = {port: (s, t, d) for port, (s, t, d) in inputs.items()}
    closed2 = closed.copy()
    closed2["rejected"][5] = "irregular"
    never["closed"] = (spec, time, closed2)
    never["cycles"] = (inputs["cycles"][0], np.delete(time, 5), np.delete(inputs["cycles"][2], 5, axis=0))
    a, b = (last(drive(PeakMixtures(), given), "SO") for given in (revised, never))
    assert a["cycles"] == b["cycles"] == 11 and a.tobytes() == b.tobytes()


def test_joint_channels_make_one_mixture_of_all_their_peaks():
    inputs = bursts(12, names=("GM1", "GM2", "SO"))
    made = drive(PeakMixtures(joint=(("GM1", "GM2"),)), inputs)
    alone = drive(PeakMixtures(), inputs)
    row = last(made, "GM1+GM2")
    assert row["cycles"] == 24 and row["peaks"] == last(alone, "GM1")["peaks"] + last(alone, "GM2")["peaks"]
    assert last(made, "SO")["mean"].tobytes() == last(alone, "SO")["mean"].tobytes()


def test_a_wrong_joint_is_refused():
    with pytest.raises(Exception, match="joint"):
        drive(PeakMixtures(joint=(("GM", "TA"),)), bursts(2))
    with pytest.raises(Exception, match="fewest_cycles"):
        drive(replace(PeakMixtures(), cycles=4, fewest_cycles=5), bursts(2))


@pytest.mark.parametrize("field", ["position_pct", "height"])
def test_a_maximum_without_a_place_or_a_height_is_as_if_it_were_not_there(field: str) -> None:
    case = PeakMixtures.cases()[0]
    spec, time, rows = case.inputs["maxima"]
    bad = rows.copy()
    bad[field][2::5] = np.nan
    good = np.arange(len(rows)) % 5 != 2
    tried = [
        replace(case, inputs={**case.inputs, "maxima": (spec, *m)}) for m in ((time, bad), (time[good], rows[good]))
    ]
    given = [Player(one).play(whole(tapes_of(one))) for one in tried]
    assert len(given[0].outputs["modes"]) > 20
    for name, output in given[0].outputs.items():
        assert output.data.tobytes() == given[1].outputs[name].data.tobytes()


def test_maxima_of_baseline_noise_are_no_activity() -> None:
    """A soleus with one burst at 18 to 52 % of the cycle has no mode elsewhere, however many maxima its rest has."""
    made = cut(steep_walk(30, noise_uv=2.0))
    given = {port: made[port] for port in ("maxima", "closed", "cycles")}
    rows = drive(PeakMixtures(), given, 100)["modes"][2]
    for name in ("L_SO", "R_SO"):
        last = rows[(rows["name"] == name) & (rows["number"] == rows["number"][rows["name"] == name][-1])]
        assert len(last) and (last["place_pct"] > 15).all() and (last["place_pct"] < 55).all(), last[
            ["place_pct", "height"]
        ]
    every = drive(PeakMixtures(rest_sd=0.0, of_peak=0.0), given, 100)["modes"][2]
    silent = every[(every["name"] == "L_SO") & ((every["place_pct"] < 15) | (every["place_pct"] > 55))]
    assert len(silent), "without the threshold silence has modes"
