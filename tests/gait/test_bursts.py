"""Bursts against a slow count; channels that are one; leads that are swapped; targets; fatigue; what goes out by OSC."""

from __future__ import annotations

import socket
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.osc.outlet import OscOutlet
from kinegraph.devices.osc.protocol import read_osc
from kinegraph.operators.cycles.cycle import CLOSED, CLOSED_UNITS, POINTS, some_cycles
from kinegraph.operators.cycles.statistics.bursts import CycleBursts, spans
from kinegraph.operators.cycles.statistics.cycle_targets import CycleTargets, TargetBand
from kinegraph.operators.cycles.statistics.median_frequency import MedianFrequency
from kinegraph.operators.monitors.channel_watch import ChannelWatch
from kinegraph.operators.monitors.pattern_watch import PatternWatch
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.errors import ParameterError
from tests.support.emg_run import drive, stamps


def cycles_of(curves: np.ndarray, names: tuple[str, ...]) -> dict[str, Any]:
    """Cycles of 1 s each, all accepted."""
    n = len(curves)
    rows = np.zeros(n, CLOSED)
    rows["onset"], rows["number"], rows["duration_s"] = NS + np.arange(n) * NS, np.arange(1, n + 1), 1.0
    rows["end"] = rows["onset"] + NS
    when = rows["end"] + 20_000_000
    spec = StreamSpec((POINTS, len(names)), channels=names, units=("uV",), channel_axis=1)
    return {"closed": (StreamSpec((), CLOSED, units=CLOSED_UNITS), when, rows), "cycles": (spec, when, curves)}


def bump(centre: float, width: float, height: float) -> np.ndarray:
    off = (np.arange(POINTS) - centre + 50) % 100 - 50
    return np.where(np.abs(off) <= width, height, 0.0)


def test_spans_are_those_of_a_slow_search() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        x = np.convolve(rng.random(60), np.ones(5) / 5, "same")
        on, least = 0.55, 3
        found = spans(x, on, 0.45, least, 0)
        slow = np.zeros(60, bool)
        for begin in range(60):
            if all(x[(begin + k) % 60] >= on for k in range(least)):
                for way in (1, -1):
                    at = begin
                    while x[at % 60] >= 0.45 and abs(at - begin) < 60:
                        slow[at % 60] = True
                        at += way
        made = np.zeros(60, bool)
        for a, length in found:
            made[(a + np.arange(length)) % 60] = True
        wraps = x[0] >= 0.45 and x[-1] >= 0.45
        assert np.array_equal(made, slow) or wraps


def test_bursts_are_where_they_are_also_over_the_touch_down() -> None:
    rng = np.random.default_rng(2)
    one = 2 + bump(40, 10, 80.0) + bump(75, 4, 60.0)
    two = 2 + bump(99, 6, 100.0)
    curves = np.stack([one, two], axis=1)[None] + 0.2 * rng.standard_normal((12, POINTS, 2))
    found = drive(CycleBursts(), cycles_of(curves, ("SO", "TA")))
    bursts, session, active = (found[name][2] for name in ("bursts", "session", "active"))
    so = bursts[bursts["name"] == "SO"]
    assert so["on_pct"].tolist() == [30, 71] * 12 and so["off_pct"].tolist() == [51, 80] * 12
    ta = bursts[bursts["name"] == "TA"]
    assert (
        ta["on_pct"].tolist() == [93] * 12
        and ta["off_pct"].tolist() == [6] * 12
        and ta["duration_pct"].tolist() == [13] * 12
    )
    last = session[-2:]
    assert (
        last["per_cycle"].tolist() == [2, 1]
        and np.allclose(last["on_pct"], [30, 93])
        and np.allclose(last["off_pct"], [51, 6])
    )
    assert np.allclose(last["on_sd_pct"], 0, atol=1e-6) and np.array_equal(active[-1][:, 0] == 1, one > 10)


def test_a_cycle_that_is_told_again_is_replaced() -> None:
    given = some_cycles(12, 2, 3)
    _, _, rows = given["closed"]
    bursts = drive(CycleBursts(), given)["session"][2]
    counted = {int(r["number"]) for r in rows if not r["rejected"]} - {2}
    assert bursts[bursts["name"] == "SO"]["cycles"][-1] == len(counted) - 1  # one of them lacks the muscle


def test_two_channels_that_are_one_are_told() -> None:
    rng = np.random.default_rng(3)
    x = 20 * rng.standard_normal((8000, 4))
    x[3000:, 1] = x[3000:, 0]
    x[5000:, 3] = x[5000:, 2] + 2 * rng.standard_normal(3000)
    spec = StreamSpec((4,), rate_hz=1000.0, channels=("TA", "SO", "GM", "BF"), units=("uV",))
    _, time, rows = drive(ChannelWatch(), {"in": (spec, stamps(8000), x)}, 70)["out"]
    alarms = [(str(r["subject"]), str(r["what"]), round(t / NS)) for t, r in zip(time, rows, strict=True)]
    assert alarms == [("TA", "same samples as SO", 5), ("GM", "alike BF", 7)]
    hum = x[:3000] + 300 * np.sin(2 * np.pi * 50 * np.arange(3000) / 1000)[:, None]
    assert not len(drive(ChannelWatch(), {"in": (spec, stamps(3000), hum)}, 70)["out"][2])


def test_leads_that_are_swapped_in_mid_session_are_told() -> None:
    rng = np.random.default_rng(4)
    shapes = np.stack([5 + bump(c, 8, 80.0) for c in (10, 40, 70)], axis=1)
    curves = shapes[None] * np.exp(0.15 * rng.standard_normal((40, 1, 3))) + rng.standard_normal((40, POINTS, 3))
    curves[25:, :, [0, 1]] = curves[25:, :, [1, 0]]
    given = cycles_of(curves, ("TA", "SO", "GM"))
    _, time, rows = drive(PatternWatch(), given)["out"]
    assert [(str(r["subject"]), str(r["what"])) for r in rows] == [
        ("TA", "its curve is that of SO"),
        ("SO", "its curve is that of TA"),
    ]
    assert all(26 < (t - NS) / NS - 0.02 <= 30 for t in time)


def test_another_stage_has_its_own_size_and_leads_swapped_between_stages_are_told() -> None:
    """At 15 both muscles get 1.6 times as high with the belt's speed; at 40 leads are swapped as the next stage begins."""
    rng = np.random.default_rng(4)
    shapes = np.stack([5 + bump(c, 8, 80.0) for c in (10, 40)], axis=1)
    curves = shapes[None] * np.exp(0.1 * rng.standard_normal((80, 1, 2))) + rng.standard_normal((80, POINTS, 2))
    curves[15:40] *= 1.6
    given = cycles_of(curves, ("TA", "SO"))
    assert {str(r["what"])[:9] for r in drive(PatternWatch(), given)["out"][2]} == {"its curve"}, (
        "reported without stages"
    )
    _, time, rows = given["closed"]
    kind = np.dtype([*rows.dtype.descr, ("stage", "<U32"), ("speed_m_s", "<f8")])
    closed = np.zeros(len(rows), kind)
    for name in rows.dtype.names or ():
        closed[name] = rows[name]
    closed["stage"] = ["slow"] * 15 + ["fast"] * 25 + ["slow again"] * 40
    staged = {**given, "closed": (StreamSpec((), kind, units=("",)), time, closed)}
    assert not len(drive(PatternWatch(), staged)["out"][2])
    staged["cycles"][2][40:] = staged["cycles"][2][40:, :, ::-1]
    alarms = drive(PatternWatch(), staged)["out"][2]
    assert [str(r["what"]) for r in alarms] == ["its curve is that of SO", "its curve is that of TA"]
    staged["cycles"][2][60:, :, 0] *= 2
    sizes = [r for r in drive(PatternWatch(), staged)["out"][2] if "times" in str(r["what"])]
    assert len(sizes) == 1 and "as high as at first" in str(sizes[0]["what"])


def test_targets_tell_below_within_and_above() -> None:
    curves = np.stack([np.full((POINTS, 1), v) for v in (10.0, 50.0, 90.0)])
    target = TargetBand("TA", 40.0, 60.0, 90.0, 10.0)
    found = drive(CycleTargets((target,)), cycles_of(curves, ("TA",)))
    rows = found["targets"][2]
    assert rows["state"].tolist() == ["below", "within", "above"] and rows["hits"].tolist() == [0, 1, 1]
    assert found["values"][2][:, 0].tolist() == [10, 50, 90] and found["values"][0].channels == ("TA mean 90-10 %",)
    with pytest.raises(ParameterError, match="SOL"):
        CycleTargets((TargetBand("SOL", 1.0, 2.0),)).open({k: v[0] for k, v in cycles_of(curves, ("TA",)).items()})


def test_the_median_frequency_falls_as_the_spectrum_does() -> None:
    rng, n, rate = np.random.default_rng(5), 61_000, 1000.0
    t = np.arange(n) / rate
    tone = 100 - 20 * t / 60
    phase = 2 * np.pi * np.cumsum(tone) / rate
    x = np.stack([np.sin(phase) + 0.05 * rng.standard_normal(n), rng.standard_normal(n)], axis=1)
    spec = StreamSpec((2,), rate_hz=rate, channels=("TA", "SO"), units=("uV",))
    closed = cycles_of(np.zeros((59, POINTS, 2)), ("TA", "SO"))["closed"]
    closed = (closed[0], closed[1] - NS, closed[2])
    closed[2]["onset"] -= NS
    closed[2]["end"] -= NS
    rows = drive(MedianFrequency(), {"signal": (spec, stamps(n), x), "closed": closed}, 500)["out"][2]
    ta = rows[rows["name"] == "TA"]
    middle = 100 - 20 * (ta["onset"] / NS + 0.5) / 60
    assert len(ta) == 59 and np.abs(ta["median_hz"] - middle).max() < 1.5
    assert abs(ta["slope_pct_per_min"][-1] + 20.0) < 1.0
    noise = rows[rows["name"] == "SO"]["median_hz"]
    assert abs(noise.mean() - 235) < 6  # half way between 20 and 450 Hz


def test_a_number_goes_out_by_osc() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(20)
        outlet = OscOutlet(port=receiver.getsockname()[1])
        outlet.open({"in": StreamSpec((2,), channels=("TA mean 60-85 %", "SO"), units=("uV",))})
        outlet.begin()
        outlet.process("in", Chunk(np.array([1]), np.array([[55.5, np.nan]]), 1))
        outlet.process("in", Chunk(np.array([2]), np.array([[np.nan, 2.0]]), 2))
        got = [read_osc(receiver.recv(2000))[0] for _ in range(2)]
        outlet.close()
    assert [str(m[0]) for m in got] == ["/kinegraph/TA_mean_60-85__", "/kinegraph/SO"] and [m[1][0] for m in got] == [
        55.5,
        2.0,
    ]
