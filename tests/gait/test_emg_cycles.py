"""Gait cycles and their numbers: against a plain computation on the real treadmill recording, and on made-up walks with known faults."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import butter, sosfiltfilt

from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.operators.cycles.statistics.ensemble import CycleEnsemble
from kinegraph.operators.cycles.statistics.operator import CycleStatistics
from kinegraph.stream.chunk import FOREVER, NS, Chunk, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import grid
from tests.gait import naive_emg
from tests.support.emg_run import contacts, drive, enveloped, stamps, treadmill

CLOSE = {"rtol": 0, "atol": 1e-9}


@pytest.fixture(scope="module")
def session():
    """The real recording through envelope, cycles, statistics, ensemble."""
    streams = treadmill()
    envelope = enveloped(streams["emg"])
    inputs = {"signal": envelope, "touchdown": streams["touchdown"], "liftoff": streams["liftoff"]}
    cycles = drive(Cycles(), inputs, 12)
    both = {"closed": cycles["closed"], "cycles": cycles["cycles"]}
    return {
        "streams": streams,
        "envelope": envelope,
        **cycles,
        "statistics": drive(CycleStatistics(), both)["out"],
        **drive(CycleEnsemble(), both),
        "touch": streams["touchdown"][2]["onset"] / 1e9,
        "lift": streams["liftoff"][2]["onset"] / 1e9,
    }


def plain_cycles(session):
    x = naive_emg.zero_phase_envelope(session["streams"]["emg"][2], 1000.0)
    time = (session["streams"]["emg"][1][0] + np.round(np.arange(len(x)) * 25e6 / 3)) / 1e9  # stamps are whole ns
    return naive_emg.cycles(time, x, session["touch"])


def test_curves_agree_with_the_plain_computation_from_the_raw_recording_on(session):
    np.testing.assert_allclose(session["cycles"][2], plain_cycles(session), **CLOSE)
    time = session["envelope"][1] / 1e9
    plain = naive_emg.cycles(time, session["envelope"][2], session["touch"])
    np.testing.assert_allclose(session["cycles"][2], plain, **CLOSE)


def test_peaks_lie_within_one_percent_of_zero_phase_filtering(session):
    """sosfiltfilt of the whole recording at 1000 Hz, 65 peaks."""
    _, time, x = session["streams"]["emg"]
    high, low = butter(2, 20, "highpass", fs=1000, output="sos"), butter(4, 20, fs=1000, output="sos")
    reference = sosfiltfilt(low, np.abs(sosfiltfilt(high, x, axis=0)), axis=0)
    theirs = naive_emg.cycles(time / 1e9, reference, session["touch"]).argmax(axis=1).ravel()
    ours = session["statistics"][2]["peak_pct"]
    apart = np.abs(ours - theirs)
    assert len(ours) == 65
    assert np.minimum(apart, 100 - apart).max() <= 1


def test_the_events_of_the_real_recording(session):
    closed = session["closed"][2]
    assert closed["rejected"].tolist() == [""] * 5
    assert closed["number"].tolist() == [1, 2, 3, 4, 5]
    np.testing.assert_allclose(closed["duration_s"], np.diff(session["touch"]), **CLOSE)
    np.testing.assert_allclose(
        closed["stance_pct"], (session["lift"] - session["touch"])[:5] / np.diff(session["touch"]) * 100, **CLOSE
    )
    assert (session["closed"][1] - closed["end"] < 25_000_000).all()
    assert session["cycles"][0].meta["side"] == "right"


def test_statistics_agree_with_the_plain_computation(session):
    plain = naive_emg.statistics(session["cycles"][2], session["touch"], session["lift"])
    rows = session["statistics"][2].reshape(5, 13)
    assert rows[0]["name"].tolist() == list(session["streams"]["emg"][0].channels)
    for name, expected in plain.items():
        np.testing.assert_allclose(rows[name], expected, **CLOSE, err_msg=name)
    spec = session["statistics"][0]
    assert spec.unit_of("integrated") == "uV s"
    assert spec.meta["normalisation"] == "none"
    whole = CubicHermiteSpline(
        time := session["envelope"][1] / 1e9, x := session["envelope"][2], np.gradient(x, time, axis=0)
    )
    exact = [whole.integrate(a, b) for a, b in pairwise(session["touch"])]
    np.testing.assert_allclose(rows["integrated"], exact, rtol=0.03)


def test_maxima_agree_and_reach_the_edges(session):
    rows, curves = session["maxima"][2], session["cycles"][2]
    for k in range(5):
        for muscle in range(13):
            mine = rows[(rows["number"] == k + 1) & (rows["muscle"] == muscle)]
            inside = [p for p in mine["position_pct"] if 0 < p < 99]
            assert inside == naive_emg.local_maxima(curves[k, :, muscle])
            assert np.array_equal(mine["height"], curves[k, mine["position_pct"].astype(int), muscle])


def test_panorama_joins_neighbours(session):
    views, curves = session["panorama"][2], session["cycles"][2]
    assert views.shape == (4, 200, 13)
    assert np.isnan(views[0, :50]).all()
    for k in range(4):
        assert np.array_equal(views[k, 50:150], curves[k])
        assert np.array_equal(views[k, 150:], curves[k + 1, :50])
    assert np.array_equal(views[3, :50], curves[2, 50:])


def test_ensemble_agrees_with_the_plain_computation(session):
    curves = session["cycles"][2]
    np.testing.assert_allclose(session["mean"][2][-1], curves.mean(axis=0), **CLOSE)
    np.testing.assert_allclose(session["sd"][2][-1], curves.std(axis=0, ddof=1), **CLOSE)
    rows = session["muscles"][2].reshape(5, 13)
    np.testing.assert_allclose(rows[-1]["cv_pct"], naive_emg.variation(curves), **CLOSE)
    deviation, mad = naive_emg.deviations(curves)
    np.testing.assert_allclose(rows[-1]["deviation"], deviation, **CLOSE)
    np.testing.assert_allclose(rows[-1]["mad"], mad, **CLOSE)
    assert np.isnan(rows["variance_ratio"]).all(), "five cycles are too few for a variance ratio"
    assert set(rows["verdict"].ravel()) == {""}
    last = session["session"][2][-1]
    assert (last["accepted"], last["rejected"]) == (5, 0)
    np.testing.assert_allclose(last["cadence"], 60 / np.diff(session["touch"]).mean(), **CLOSE)


def test_any_cutting_gives_the_same_bits(session):
    streams = session["streams"]
    inputs = {"signal": session["envelope"], "touchdown": streams["touchdown"], "liftoff": streams["liftoff"]}
    for size in (1, 7, 1000):
        again = drive(Cycles(), inputs, size)
        for name in Cycles.outputs:
            assert again[name][1].tobytes() == session[name][1].tobytes()
            assert again[name][2].tobytes() == session[name][2].tobytes()


def walk(cycles=14, rate=100.0, noise=0.1, seed=0):
    """A made-up envelope of two muscles, the first repeatable and the second noise; touch-downs about every second from 1 s on."""
    rng = np.random.default_rng(seed)
    touch = 1 + np.concatenate([[0], np.cumsum(1 + 0.05 * rng.random(cycles))])
    time = stamps(int((touch[-1] + 1) * rate), rate)
    phase = np.interp(time / 1e9, touch, np.arange(len(touch)))
    data = np.stack(
        [1 + np.sin(2 * np.pi * phase) + noise * rng.standard_normal(len(time)), rng.random(len(time))], axis=1
    )
    return StreamSpec((2,), rate_hz=rate, channels=("TA", "SO"), units=("uV",), settling_s=0.5), time, data, touch


def closed_of(spec, time, data, touch, operator=None, **gaps):
    return drive(
        operator or Cycles(), {"signal": (spec, time, data, *gaps.values()), "touchdown": contacts(touch)}, 17
    )["closed"][2]


def test_a_flat_baseline_has_no_maxima_by_rounding():
    """One burst in each cycle of 1.07 s, at 0.7 elsewhere to the last bit."""
    spec, touch = StreamSpec((1,), rate_hz=100.0, channels=("TA",), units=("%",)), 1 + 1.07 * np.arange(9)
    time = stamps(1100, 100.0)
    data = np.full((1100, 1), 0.7)
    for onset in touch:
        data[(time / 1e9 > onset + 0.3) & (time / 1e9 < onset + 0.5)] = 1.7
    out = drive(Cycles(), {"signal": (spec, time, data), "touchdown": contacts(touch)}, 12)
    assert set(out["maxima"][2]["position_pct"].tolist()) <= set(range(25, 50))


def test_reasons_for_rejection():
    spec, time, data, touch = walk()
    assert set(closed_of(spec, time, data, touch)["rejected"]) == {""}
    twice = np.sort([*touch, touch[3] + 0.2])
    assert closed_of(spec, time, data, twice)["rejected"].tolist()[2:6] == ["", "too short", "", ""]
    assert closed_of(spec, time, data, np.delete(touch, 8))["rejected"].tolist()[6:9] == ["", "irregular", ""]
    assert "too long" in closed_of(spec, time, data, np.delete(touch, [5, 6, 7, 8]))["rejected"]
    early = np.array([0.3, *touch])
    assert closed_of(spec, time, data, early)["rejected"].tolist()[:2] == ["settling", ""]
    assert closed_of(spec, time, data, [-0.5, *early])["rejected"][0] == "incomplete"
    late = closed_of(spec.derive(settling_s=0.0), time, data, [-0.5, 0.3, *touch])["rejected"].tolist()
    assert late[:3] == ["incomplete", "", ""]


def test_gaps_reject_the_cycle_and_those_not_settled_after():
    spec, time, data, touch = walk()
    hole = (time > (touch[5] + 0.7) * 1e9) & (time < (touch[5] + 0.9) * 1e9)
    first = int(hole.argmax())
    found = closed_of(spec, time[~hole], data[~hole], touch, gaps={first: int(hole.sum())})
    assert found["rejected"].tolist()[4:9] == ["", "gap", "settling", "", ""]
    hole = (time > (touch[5] + 0.7) * 1e9) & (time < (touch[5] + 0.73) * 1e9)
    assert set(closed_of(spec, time[~hole], data[~hole], touch)["rejected"]) == {""}


def test_a_contact_stream_that_lost_something_rejects_the_open_cycle():
    spec, time, data, touch = walk()
    found = drive(Cycles(), {"signal": (spec, time, data), "touchdown": (*contacts(np.delete(touch, 4)), {4: 1})}, 17)
    assert found["closed"][2]["rejected"].tolist()[2:5] == ["", "gap", ""]


def test_missing_values_spoil_their_muscle_or_the_cycle():
    spec, time, data, touch = walk()
    data[(time > (touch[4] + 0.2) * 1e9) & (time < (touch[4] + 0.3) * 1e9), 1] = np.nan
    inputs = {"signal": (spec, time, data), "touchdown": contacts(touch)}
    found = drive(Cycles(), inputs, 17)
    assert set(found["closed"][2]["rejected"]) == {""}
    assert np.isnan(found["cycles"][2][4, :, 1]).all()
    assert np.isfinite(found["cycles"][2][:, :, 0]).all()
    assert drive(Cycles(missing="cycle"), inputs, 17)["closed"][2]["rejected"].tolist()[3:6] == ["", "missing", ""]
    both = {"closed": found["closed"], "cycles": found["cycles"]}
    statistics = drive(CycleStatistics(), both)["out"][2]
    assert np.isnan(statistics[(statistics["number"] == 5) & (statistics["muscle"] == 1)]["peak_pct"]).all()
    rows = drive(CycleEnsemble(), both)["muscles"][2]
    assert rows[-2:]["cycles"].tolist() == [14, 13]


def test_contacts_told_late_give_the_same_cycles():
    spec, time, data, touch = walk()
    prompt = drive(Cycles(), {"signal": (spec, time, data), "touchdown": contacts(touch)}, 17)
    late = drive(Cycles(), {"signal": (spec, time, data), "touchdown": contacts(touch, late=0.4)}, 17)
    assert prompt["cycles"][2].tobytes() == late["cycles"][2].tobytes()
    assert (late["cycles"][1] > prompt["cycles"][1]).all()
    slow = drive(Cycles(late_s=0.2), {"signal": (spec, time, data), "touchdown": contacts(touch, late=0.4)}, 17)
    assert set(slow["closed"][2]["rejected"]) == {"incomplete"}


def test_variance_ratio_from_ten_cycles_on_and_its_verdict():
    spec, time, data, touch = walk()
    found = drive(Cycles(), {"signal": (spec, time, data), "touchdown": contacts(touch)}, 17)
    rows = drive(CycleEnsemble(), {"closed": found["closed"], "cycles": found["cycles"]})["muscles"][2].reshape(14, 2)
    assert np.isnan(rows["variance_ratio"][:9]).all()
    for k in range(9, 14):
        np.testing.assert_allclose(
            rows["variance_ratio"][k], naive_emg.variance_ratio(found["cycles"][2][: k + 1]), **CLOSE
        )
    assert rows["verdict"][-1].tolist() == ["repeatable", "not repeatable"]


def test_co_contraction_of_normalised_channels_only():
    spec, time, data, touch = walk()
    found = drive(Cycles(), {"signal": (spec, time, data), "touchdown": contacts(touch)}, 17)
    both = {"closed": found["closed"], "cycles": found["cycles"]}
    with pytest.raises(InputError, match="not normalised in amplitude"):
        drive(CycleEnsemble(pairs=(("TA", "SO"),)), both)
    named = found["cycles"][0].derive(meta={"normalisation": "mvc"}, units=("% MVC",))
    both["cycles"] = (named, *found["cycles"][1:])
    rows = drive(CycleEnsemble(pairs=(("TA", "SO"),)), both)["pairs"][2]
    plain = [naive_emg.co_contraction(c[:, 0], c[:, 1]) for c in found["cycles"][2]]
    np.testing.assert_allclose(rows["co_contraction_pct"], plain, **CLOSE)
    np.testing.assert_allclose(rows["mean_pct"][-1], np.mean(plain), **CLOSE)
    with pytest.raises(ParameterError, match="did you mean 'SO'"):
        drive(CycleEnsemble(pairs=(("TA", "SOL"),)), both)


def test_what_cannot_be_is_said():
    spec, time, data, touch = walk()
    with pytest.raises(InputError, match="contact events"):
        drive(Cycles(), {"signal": (spec, time, data), "touchdown": (spec, time, data)})
    with pytest.raises(InputError, match="regular rate"):
        drive(Cycles(), {"signal": (StreamSpec((2,)), time, data), "touchdown": contacts(touch)})
    with pytest.raises(ParameterError, match="shortest_s"):
        drive(Cycles(shortest_s=4.0), {"signal": (spec, time, data), "touchdown": contacts(touch)})
    with pytest.raises(InputError, match=r"operators\.cycles\.cycles\.Cycles"):
        CycleStatistics().open({"closed": contacts([1])[0], "cycles": spec})


@pytest.mark.parametrize("order", [("signal", "touchdown", "liftoff"), ("liftoff", "signal", "touchdown")])
def test_a_lift_off_told_with_the_closing_touch_down_counts_whatever_the_order_of_ports(order):
    spec, time, data, touch = walk()
    touches = contacts(touch, late=0.03)
    lift = touch[:-1] + 0.6 * np.diff(touch)
    late = (touches[0], touches[1][1:], np.round(lift * 1e9).astype(np.int64).view(touches[2].dtype))
    inputs = {"signal": (spec, time, data), "touchdown": touches, "liftoff": late}
    for size in (1, 17, None):
        found = drive(Cycles(), {port: inputs[port] for port in order}, size)["closed"][2]
        np.testing.assert_allclose(found["stance_pct"], 60.0, atol=0.01)


def test_the_first_cycles_are_judged_once_there_is_a_median_and_taken_back():
    spec, time, data, touch = walk()
    rows = closed_of(spec, time, data, np.delete(touch, 2))  # the second cycle is two
    assert rows["number"].tolist()[:7] == [1, 2, 3, 4, 5, 2, 6]
    assert rows["rejected"].tolist()[:7] == ["", "", "", "", "", "irregular", ""]
    assert rows[5]["onset"] == rows[1]["onset"] and rows[5]["end"] == rows[1]["end"]
    fifth = closed_of(spec, time, data, np.delete(touch, 5))
    assert fifth["rejected"].tolist()[:6] == ["", "", "", "", "irregular", ""]


@pytest.mark.parametrize(
    ("lifts", "reason"),
    [([0.08], "stance"), ([0.95], "stance"), ([0.2, 0.65], "order"), ([0.6, 0.62], ""), ([0.6], ""), ([], "")],
)
def test_impossible_stance_and_order_of_contacts_are_rejected(lifts, reason):
    spec, time, data, touch = walk()
    off = [a + share * (b - a) for k, (a, b) in enumerate(pairwise(touch)) for share in (lifts if k == 7 else [0.62])]
    inputs = {"signal": (spec, time, data), "touchdown": contacts(touch), "liftoff": contacts(off)}
    assert drive(Cycles(), inputs, 17)["closed"][2]["rejected"].tolist()[6:9] == ["", reason, ""]


def test_the_declared_delay_covers_the_samples_that_a_cycle_waits_for():
    spec, time, data, touch = walk(rate=120.0)
    operator = Cycles().unopened()
    operator.open({"signal": spec, "touchdown": contacts(touch)[0]})
    found = drive(Cycles(), {"signal": (spec, time, data), "touchdown": contacts(touch)}, 1)["closed"]
    waited = (found[1] - found[2]["end"]).max() / 1e9
    assert 1 / 120 < waited <= operator.delay_s


def test_a_cycle_that_is_taken_back_leaves_every_number_as_if_it_had_never_counted(session):
    """The real recording's third cycle is taken back with the last, and comes again without its first muscle."""
    row, (curves, closed) = session["closed"][2][2:3].copy(), (session["cycles"], session["closed"])
    gone, back = row.copy(), row.copy()
    gone["rejected"] = "irregular"
    half = curves[2][2:3].copy()
    half[:, :, 0] = np.nan

    def touches(*rows):
        return (closed[0], np.append(closed[1], [closed[1][-1]] * len(rows)), np.concatenate([closed[2], *rows]))

    left = np.delete(curves[2], 2, axis=0)
    for events, samples in (
        (touches(gone), curves),
        (touches(gone, back), (curves[0], np.append(curves[1], curves[1][-1]), np.concatenate([curves[2], half]))),
    ):
        both = {"closed": events, "cycles": samples}
        found, statistics = drive(CycleEnsemble(), both), drive(CycleStatistics(), both)["out"][2]
        again = len(samples[1]) == 6
        used = [left[:, :, m] if m == 0 or not again else curves[2][:, :, m] for m in range(13)]
        np.testing.assert_allclose(found["mean"][2][-1], np.stack([u.mean(axis=0) for u in used], 1), **CLOSE)
        np.testing.assert_allclose(found["sd"][2][-1], np.stack([u.std(axis=0, ddof=1) for u in used], 1), **CLOSE)
        assert found["muscles"][2][-13:]["cycles"].tolist() == [4, *[5 if again else 4] * 12]
        last = found["session"][2][-1]
        assert (last["accepted"], last["rejected"]) == ((5, 0) if again else (4, 1))
        durations = [c["duration_s"] for c in closed[2] if again or c["number"] != 3]
        np.testing.assert_allclose(last["cadence"], 60 / np.mean(durations), **CLOSE)
        assert len(statistics) == 13 * (6 if again else 5)


@pytest.mark.parametrize("bounce_ms", [[30], [20, 50]])
def test_a_contact_that_bounces_does_not_shorten_the_next_cycle(bounce_ms: list[int]) -> None:
    spec = StreamSpec((1,), rate_hz=1000.0, units=("uV",))
    contact = StreamSpec((), np.dtype([("onset", "<i8")]), units=("ns",))
    touch = np.arange(1, 6) * NS
    bounces = [touch + ms * 10**6 for ms in bounce_ms]
    outcome = {}
    for name, touches, lifts in (
        ("clean", touch, touch + 600 * 10**6),
        (
            "bouncing",
            np.sort(np.concatenate([touch, *bounces])),
            np.sort(np.concatenate([touch + 15 * 10**6, touch + 600 * 10**6])),
        ),
    ):
        operator = Cycles()
        operator.open({"signal": spec, "touchdown": contact, "liftoff": contact})
        closed = []
        time = grid(1000.0, 9000)
        for port, when, data in (
            ("touchdown", touches, touches.view(contact.dtype)),
            ("liftoff", lifts, lifts.view(contact.dtype)),
            ("signal", time, np.random.default_rng(0).normal(size=(9000, 1))),
        ):
            for output, chunk in operator.process(port, Chunk(when, data, FOREVER)) or []:
                closed += chunk.data[["onset", "end", "stance_pct", "rejected"]].tolist() if output == "closed" else []
        outcome[name] = closed
    assert len(outcome["clean"]) == 4 and outcome["bouncing"] == outcome["clean"]


def test_muscles_that_events_could_not_tell_apart_are_refused() -> None:
    """Events have room for 16 characters of a name: two longer ones that begin alike would be one muscle in every report."""
    names = ("Tibialis anterior left", "Tibialis anterior right")
    signal = StreamSpec((2,), rate_hz=100.0, channels=names, units=("uV",))
    touchdown = StreamSpec((), np.dtype([("onset", "<i8")]), units=("ns",))
    with pytest.raises(InputError, match="differ in their first 16 characters"):
        Cycles().open({"signal": signal, "touchdown": touchdown})
