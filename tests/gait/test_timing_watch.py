"""Contacts and leads that the muscles' own timing speaks against: later than at first, the other leg's, another muscle's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph.operators.cycles.cycle import POINTS
from kinegraph.operators.monitors.reference_patterns import muscle_called, side_called, textbook_pattern
from kinegraph.operators.monitors.timing_watch import TimingWatch, lags_pct
from kinegraph.stream.chunk import Array, StreamSpec
from kinegraph.stream.errors import ParameterError
from tests.gait.test_bursts import cycles_of
from tests.support.emg_run import drive

NAMES = ("TA", "SO", "VM", "BF")


def walked(n: int = 60, seed: int = 3, names: tuple[str, ...] = NAMES) -> Array:
    """Cycles (n, 100, m): each muscle where the textbook has it, its size and place differing from cycle to cycle (0.5 %), noise."""
    rng = np.random.default_rng(seed)
    shapes = np.stack([4 + 60 * textbook_pattern(name) ** 2 for name in names], axis=1)
    curves = shapes[None] * np.exp(0.2 * rng.standard_normal((n, 1, len(names))))
    return moved(curves, 0.5 * rng.standard_normal(n)) + 4 * rng.standard_normal((n, POINTS, len(names)))


def moved(curves: Array, later_pct: Any) -> Array:
    """Each cycle's curves later by a part of a point, around the cycle."""
    wave = np.fft.fftfreq(POINTS)[None, :, None] * np.asarray(later_pct, float).reshape(-1, 1, 1)
    return np.asarray(np.fft.ifft(np.fft.fft(curves, axis=1) * np.exp(-2j * np.pi * wave), axis=1).real)


def reported(curves: Array, names: tuple[str, ...] = NAMES, **of: Any) -> list[tuple[int, str, str, str]]:
    """The cycle at which each alarm came, about whom, on or over, what."""
    given = cycles_of(curves, names)
    at = {stamp: k for k, stamp in enumerate(given["cycles"][1].tolist())}
    _, time, rows = drive(TimingWatch(**of), given)["out"]
    return [
        (at[t], str(r["subject"]), str(r["state"]), str(r["what"])) for t, r in zip(time.tolist(), rows, strict=True)
    ]


def test_contacts_that_come_twenty_milliseconds_late_are_told_and_told_to_be_over() -> None:
    curves = walked(80)
    curves[25:50] = moved(curves[25:50], -1.9)
    (on, who, state, what), (over, _, ended, _) = reported(curves)
    assert (who, state, ended) == ("contacts", "on", "over") and 25 < on < 35 and 50 < over < 60
    assert what.startswith("contacts 1.") and what.endswith("% of the cycle later than at first")
    assert "earlier than at first" in reported(moved(curves, np.where(np.arange(80) < 25, 0.0, 3.8)))[0][3]


def test_a_long_steady_walk_and_one_muscle_that_works_later_are_no_fault_of_the_contacts() -> None:
    for seed in range(4):
        assert reported(walked(600, seed)) == []
    tired = walked(60)
    tired[25:, :, 1] = moved(tired[25:, :, 1:2], 4.0)[:, :, 0]
    assert reported(tired) == []


def test_an_uneven_walker_needs_more_than_a_steady_one() -> None:
    rng = np.random.default_rng(8)
    uneven = moved(walked(400), 2.5 * rng.standard_normal(400))
    assert reported(uneven) == []
    uneven[200:] = moved(uneven[200:], -7.0)
    assert reported(uneven)[0][0] > 200


def test_another_stage_has_another_timing_of_its_own() -> None:
    curves = walked(80)
    curves[30:] = moved(curves[30:], -3.0)
    given = cycles_of(curves, NAMES)
    _, time, rows = given["closed"]
    kind = np.dtype([*rows.dtype.descr, ("stage", "<U32"), ("speed_m_s", "<f8")])
    closed = np.zeros(len(rows), kind)
    for name in rows.dtype.names or ():
        closed[name] = rows[name]
    closed["stage"] = ["slow"] * 30 + ["fast"] * 50
    assert reported(curves), "reported without stages"
    assert not len(
        drive(TimingWatch(), {**given, "closed": (StreamSpec((), kind, units=("",)), time, closed)})["out"][2]
    )


def test_the_other_legs_contacts_are_told_from_the_start_and_from_any_moment_on() -> None:
    half = np.roll(walked(20), POINTS // 2, axis=1)
    assert reported(half) == [(3, "contacts", "on", "muscles work half a cycle off")]
    assert reported(half, textbook=False) == [] and reported(half, ("A", "B", "C", "D")) == []
    later = walked(60)
    later[30:] = np.roll(later[30:], POINTS // 2, axis=1)
    assert (
        (30, "muscles work half a cycle off")
        < next((at, what) for at, _, _, what in reported(later) if "half" in what)
        < (38, "z")
    )


def test_leads_that_are_swapped_from_the_start_are_told_and_the_other_legs_channels_are_not_judged() -> None:
    swapped = walked(20)[:, :, [1, 0, 2, 3]]
    assert [(at, who, what) for at, who, _, what in reported(swapped)] == [
        (3, "TA", "its curve is rather that of SO"),
        (3, "SO", "its curve is rather that of TA"),
    ]
    legs = ("RTA", "RSO", "LTA", "LSO")
    both = np.concatenate([walked(20), np.roll(walked(20), POINTS // 2, axis=1)], axis=2)[:, :, [0, 1, 4, 5]]
    assert reported(both, legs) == [], "cycles of the right leg; the left one works half a cycle later"


@pytest.mark.parametrize(
    ("channel", "muscle", "side"),
    [
        ("TA", "TA", ""), ("L_TA", "TA", "left"), ("RMG", "GM", "right"), ("RF", "RF", ""), ("LG", "GL", ""), ("Soleus R", "SO", "right"),
        ("left tibialis anterior", "TA", "left"), ("EMG1", "", ""), ("", "", ""),
        ("R TIBIALIS ANTERIOR: EMG 1 (IM) [V]", "TA", "right"), ("LT TIB.ANT.,uV", "TA", "left"), ("RT MED. GASTRO", "GM", "right"),
        ("RT GLUT. MAX.", "MA", "right"), ("LT BICEPS FEM.", "BF", "left"), ("RectFem_L", "RF", "left"), ("Semitend", "ST", ""),
        ("GAST LAT", "GL", ""), ("L_VMO", "VM", "left"), ("VastusLateralis", "VL", ""), ("Peroneus", "", ""), ("L_Med_Ham", "ST", "left"),
        ("LATISSIMUS", "", ""), ("L_EMG1", "", "left"), ("EMG 3: Soleus", "", ""),
    ],
)  # fmt: skip
def test_muscles_are_known_by_name(channel: str, muscle: str, side: str) -> None:
    assert (muscle_called(channel), side_called(channel)) == (muscle, side)


def test_a_channel_whose_name_says_nothing_is_named_by_hand_and_the_others_are_told_to_the_report() -> None:
    names = ("EMG1", "EMG2", "EMG3", "EMG4")
    swapped = walked(20)[:, :, [1, 0, 2, 3]]
    assert reported(swapped, names) == []
    by_hand = dict(zip(names, NAMES, strict=True))
    assert [who for _, who, *_ in reported(swapped, names, muscles=by_hand)] == ["EMG1", "EMG2"]
    given = cycles_of(swapped, names)
    specs = {port: each[0] for port, each in given.items()}
    assert TimingWatch(muscles={"EMG1": "TA"}).open(specs)["out"].meta["unnamed"] == ["EMG2", "EMG3", "EMG4"]
    assert TimingWatch(first=7, latest=4).open(specs)["out"].meta["needs_cycles"] == 11
    for wrong, message in (({"EMG9": "TA"}, "did you mean"), ({"EMG1": "jaw"}, "textbook has")):
        with pytest.raises(ParameterError, match=message):
            TimingWatch(muscles=wrong).open(specs)


def test_a_lag_is_found_to_a_part_of_a_point() -> None:
    curves = walked(1, 5)[0]
    for later in (-6.3, -0.4, 0.0, 1.25, 7.7):
        assert np.abs(lags_pct(moved(curves[None], [later])[0], curves) - later).max() < 0.1
