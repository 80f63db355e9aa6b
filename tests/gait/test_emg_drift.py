"""How far a muscle has moved from its reference: reported when it has moved, and only then."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.emg.mixtures.drift import MixtureDrift
from kinegraph.operators.emg.mixtures.operator import PeakMixtures, some_maxima
from kinegraph.operators.emg.mixtures.pairs import pairing
from kinegraph.operators.emg.mixtures.peak_window import PeakWindow
from kinegraph.operators.emg.mixtures.reference import chance_limit
from kinegraph.operators.emg.mixtures.refit import Refit
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from tests.gait.test_emg_mixtures_live import bursts, paced
from tests.support.emg_run import drive

FROM = 61


def moved(inputs, since=FROM, by=6):
    """TA is active `by` % later from cycle `since` on."""
    curves = inputs["cycles"][2]
    curves[since - 1 :, :, 0] = np.roll(curves[since - 1 :, :, 0], by, axis=1)
    return {**inputs, "maxima": some_maxima(inputs)}


def drifted(inputs, operator=None, mixer=None, **more):
    mixer = mixer or PeakMixtures()
    mixture = drive(mixer, inputs)["mixture"]
    with_pace = {"pace": inputs.pop("pace")} if "pace" in inputs else {}
    return drive(operator or MixtureDrift(first=20), {**inputs, **more, "mixture": mixture, **with_pace})


def test_a_muscle_that_moves_is_told_within_ten_cycles_and_nothing_before():
    made = drifted(moved(bursts(90)))
    _, times, alarms = made["change"]
    assert [str(name) for name in alarms["subject"]] == ["TA"] and str(alarms["state"][0]) == "on"
    assert "first 20 cycles" in str(alarms["what"][0]) and alarms["advice"][0]
    rows = made["distance"][2]
    reported = rows[(rows["name"] == "TA") & (rows["moved"] == "first")]["number"].min()
    assert FROM < reported <= FROM + 10
    ta = rows[(rows["name"] == "TA") & (rows["number"] > FROM + 20)]
    assert (ta["from_first"] > ta["limit"]).all()
    assert times[0] == made["distance"][1][(rows["name"] == "TA") & (rows["number"] == reported)][0]
    assert np.isnan(rows["from_stored"]).all() and np.isnan(rows["from_other"]).all(), "nothing is invented"


def test_it_is_over_when_the_muscle_comes_back():
    inputs = moved(moved(bursts(120), 40, 6), 70, -6)
    alarms = drifted(inputs)["change"][2]
    assert [str(state) for state in alarms["state"]] == ["on", "over"] and alarms["onset"][0] == alarms["onset"][1]


def test_a_pace_spreads_the_reference_over_samples_and_changes_no_distance():
    plain, spread = drifted(moved(bursts(60), 45)), drifted(paced(moved(bursts(60), 45), 120.0))
    a, b = plain["distance"][2], np.sort(spread["distance"][2], order=["number", "muscle"])
    both = np.isfinite(b["limit"]) & np.isfinite(b["from_first"])
    assert both[-20:].all() and not both[:40].any()
    assert a[both].tobytes() == b[both].tobytes()


def test_peaks_tell_signal_from_noise_better_than_from_the_full_curves():
    row = drifted(bursts(30))["distance"][2][-1]
    assert 0 < row["full"] < row["noise"]


def test_the_other_leg_is_compared_muscle_by_muscle():
    mine, other = bursts(30, names=("LTA", "LSO")), bursts(30, centres=(10.0, 45.0, 99.0), seed=8, names=("RTA", "RGM"))
    theirs = drive(PeakMixtures(), other)["mixture"]
    rows = drifted(mine, other=theirs)["distance"][2]
    late = rows[rows["number"] > 10]
    assert (late["from_other"][late["name"] == "LTA"] > 0).all(), "against RTA"
    assert np.isnan(late["from_other"][late["name"] == "LSO"]).all(), "the other leg has no SO"
    assert pairing(["TA", "GM_L", "SO"], ["SO", "TA", "GM_R"]).tolist() == [1, 2, 0]


def test_a_muscle_without_bursts_has_no_reference_and_no_alarm():
    inputs = bursts(40)
    inputs["cycles"][2][:, :, 0] = 1.0
    inputs["cycles"][2][30:, 50, 0] = 9.0
    inputs["maxima"] = some_maxima(inputs)
    made = drifted(inputs)
    rows = made["distance"][2]
    assert not len(made["change"][2]) and np.isnan(rows["from_first"][rows["name"] == "TA"]).all()
    assert np.isfinite(rows["from_first"][(rows["name"] == "SO") & (rows["number"] > 20)]).all()


def test_what_cannot_be_is_refused():
    inputs = bursts(3)
    with pytest.raises(ParameterError, match="twice the fewest_cycles"):
        drifted(inputs, MixtureDrift(first=8))
    with pytest.raises(InputError, match="mixture"):
        drive(MixtureDrift(), {**inputs, "mixture": inputs["closed"]})


def test_a_limit_is_what_later_windows_seldom_exceed():
    """Of squared distances in two dimensions, known from 20 windows; the largest of so few says less."""
    rng = np.random.default_rng(5)
    shares = []
    for _ in range(200):
        limit = chance_limit(rng.chisquare(2, 20), 20)
        shares.append((rng.chisquare(2, 1000) > limit).mean())
    assert 0.004 < np.mean(shares) < 0.02 and np.quantile(shares, 0.95) < 0.06
    many = chance_limit(rng.chisquare(2, 20000), 20000)
    assert many == pytest.approx(-2 * np.log(0.01), rel=0.1)
    assert chance_limit(np.zeros(50), 10) == 0.0


def test_two_cycles_only_are_not_known():
    made = drifted(bursts(2))
    rows = made["distance"][2]
    assert not len(made["change"][2]) and np.isnan(rows["from_first"]).all() and np.isnan(rows["limit"]).all()


def test_a_muscle_that_dies_in_mid_session_is_not_known_from_then_on_and_the_others_are_untouched():
    whole, dead = bursts(60), bursts(60)
    dead["cycles"][2][30:, :, 0] = np.nan
    dead["maxima"] = some_maxima(dead)
    a, b = drifted(whole)["distance"][2], drifted(dead)["distance"][2]
    late = b["number"] > 34
    assert np.isnan(b["from_first"][late & (b["name"] == "TA")]).all(), "nothing is invented"
    for name in ("from_first", "limit"):
        np.testing.assert_array_equal(a[name][a["name"] == "SO"], b[name][b["name"] == "SO"])


def test_random_parts_swept_a_little_at_a_time_are_those_fitted_at_once():
    inputs = bursts(20)
    window, group = PeakWindow.empty(20, 2), np.zeros(1, np.int64)
    window.note_peaks(inputs["maxima"][2])
    for row, curve in zip(inputs["closed"][2], inputs["cycles"][2], strict=True):
        window.accept(int(row["number"]), curve)
    how = PeakMixtures().fitting()
    whole, slots = Refit.empty(20, 1), window.latest(20)
    whole.begin(window, slots, group, how)
    whole.finish(how)
    start = tuple(part.copy() for part in whole.mixture())
    one, other = Refit.empty(20, 1), Refit.empty(20, 1)
    one.follow(window, slots[:5], group, how, start)
    other.begin_from(window, slots[:5], group, how, start)
    calls = 1
    while not other.sweep(how):
        calls += 1
    assert calls <= how.most_sweeps and one.sweeps == other.sweeps
    for mine, theirs in zip(one.mixture(), other.mixture(), strict=True):
        assert mine.tobytes() == theirs.tobytes()


def two_legs(count, since=0):
    """Each leg's cycles alone, and both in one stream, the left's with odd numbers; the right TA moves with its cycle `since`."""
    left = bursts(count, names=("L_TA", "L_SO"))
    right = bursts(count, centres=(12.0, 44.0, 99.0), seed=8, names=("R_SO", "R_TA"))
    if since:
        right["cycles"][2][since - 1 :, :, 1] = np.roll(right["cycles"][2][since - 1 :, :, 1], 8, axis=1)
        right["maxima"] = some_maxima(right)
    meta = {
        "limbs": {"left": ["L_TA", "L_SO"], "right": ["R_SO", "R_TA"]},
        "muscles": {"L_TA": "TA", "L_SO": "SO", "R_SO": "SO", "R_TA": "TA"},
    }
    spec = left["cycles"][0].derive(shape=(100, 4), channels=("L_TA", "L_SO", "R_SO", "R_TA"), meta=meta)
    both = {}
    for port in ("maxima", "closed", "cycles"):
        stamps, rows = [], []
        for leg, one in enumerate((left, right)):
            data = one[port][2].copy()
            if port == "cycles":
                data = np.full((len(data), 100, 4), np.nan)
                data[:, :, 2 * leg : 2 * leg + 2] = one[port][2]
            else:
                data["number"] = 2 * data["number"] - 1 + leg
            if port == "maxima":
                data["muscle"] += 2 * leg
            stamps.append(one[port][1] + leg * 400_000_000)
            rows.append(data)
        order = np.argsort(np.concatenate(stamps), kind="stable")
        both[port] = (
            spec if port == "cycles" else one[port][0],
            np.concatenate(stamps)[order],
            np.concatenate(rows)[order],
        )
    return left, right, both


def test_each_of_two_legs_is_as_it_would_be_alone_and_beside_the_other():
    left, right, both = two_legs(40, since=30)
    rows, alarms = drifted(both)["distance"][2], drifted(both)["change"][2]
    assert [str(name) for name in alarms["subject"]] == ["R_TA"], "of the leg that moved, and no other"
    for one in (left, right):
        alone = drifted(one)["distance"][2]
        for name in np.unique(alone["name"]):
            mine, its = rows[rows["name"] == name], alone[alone["name"] == name]
            assert np.array_equal((mine["number"] + 1) // 2, its["number"])
            assert (
                np.array_equal(mine["from_first"], its["from_first"], equal_nan=True)
                and np.isfinite(its["from_first"]).any()
            )
    theirs = drive(PeakMixtures(), right)["mixture"]
    late = rows[(rows["name"] == "L_TA") & (rows["number"] > 20)]
    assert (late["from_other"] > 0).all(), "a leg is never compared with itself"
    pairs = drifted(left, other=theirs)["distance"][2]
    last = pairs[(pairs["name"] == "L_TA") & (pairs["number"] == 40)]["from_other"][0]
    assert np.isclose(late["from_other"][-1], last, rtol=0.2), "the right leg's cycle comes after the left's"


def staged(inputs, stages, speeds=None):
    """The same cycles, of which each has its stage, and the belt's speed."""
    _, time, rows = inputs["closed"]
    kind = np.dtype([*rows.dtype.descr, ("stage", "<U32"), ("speed_m_s", "<f8")])
    made = np.zeros(len(rows), kind)
    for name in rows.dtype.names:
        made[name] = rows[name]
    made["stage"], made["speed_m_s"] = stages, np.nan if speeds is None else speeds
    return {**inputs, "closed": (StreamSpec((), kind, units=("",)), time, made)}


def test_another_stage_has_another_reference_and_is_no_drift():
    stages = ["0.8 m/s"] * 40 + [""] + ["1.2 m/s"] * 49
    inputs = staged(moved(bursts(90), 42), stages)
    assert not len(drifted(inputs)["change"][2]), "what comes with the belt's speed is no drift"
    rows = drifted(staged(moved(moved(bursts(90), 42), 75), stages))["distance"][2]
    limit = rows["limit"][rows["name"] == "TA"]
    assert np.isfinite(limit[20:40]).all() and np.isnan(limit[41:60]).all() and np.isfinite(limit[61:]).all()
    reported = drifted(staged(moved(moved(bursts(90), 42), 75), stages))["change"]
    assert [str(name) for name in reported[2]["subject"]] == ["TA"] and 75 * NS < reported[1][0] <= 86 * NS
    assert len(drifted(moved(bursts(90), 42))["change"][2]), "without stages it is drift"


def test_a_stage_that_comes_ends_an_alarm_and_an_earlier_cycle_that_is_told_again_begins_none():
    stages = ["a"] * 60 + ["b"] * 30
    alarms = drifted(staged(moved(bursts(90), 40), stages))["change"][2]
    assert [str(state) for state in alarms["state"]] == ["on", "over"]
    inputs = staged(bursts(90), stages)
    (spec, time, closed), (wide, when, curves), kept = inputs["closed"], inputs["cycles"], inputs["maxima"]
    again = {
        "closed": (spec, np.insert(time, 70, time[69]), np.insert(closed, 70, closed[55])),
        "cycles": (wide, np.insert(when, 70, when[69]), np.insert(curves, 70, curves[55], axis=0)),
    }
    plain, reported = (drifted({"maxima": kept, **more})["distance"][2] for more in (inputs, again))
    late = plain[plain["number"] > 81]
    np.testing.assert_array_equal(late["limit"], reported[reported["number"] > 81]["limit"])
    assert np.isfinite(late["limit"]).all()


def test_a_belt_at_another_speed_is_another_stage_and_an_uneven_one_is_not():
    inputs = moved(bursts(90), 42)
    slow = np.where(np.arange(90) < 41, 0.8, 1.2)
    assert not len(drifted(staged(inputs, [""] * 90, slow))["change"][2])
    uneven = 1.0 + 0.04 * np.sin(np.arange(90))
    assert len(drifted(staged(inputs, [""] * 90, uneven))["change"][2]) == 1


def test_a_joint_mixture_of_two_limbs_is_refused():
    with pytest.raises(ParameterError, match="channels of one limb"):
        drive(PeakMixtures(joint=(("L_TA", "R_TA"),)), two_legs(4)[2])


def test_a_stage_is_judged_when_a_session_that_begins_with_it_is():
    """Windows are counted from the stage's first cycle on, whatever was left of one before."""
    both = staged(moved(bursts(90), 78), ["a"] * 41 + ["b"] * 49)
    alone = {
        port: (spec, time[keep], rows[keep])
        for port, (spec, time, rows) in both.items()
        for keep in ((rows if port == "maxima" else both["closed"][2])["number"] > 41,)
    }
    found, wanted = (drifted(inputs)["change"] for inputs in (both, alone))
    assert found[1].tolist() == wanted[1].tolist() and len(wanted[1]) == 1
