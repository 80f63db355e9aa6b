"""configs/treadmill_emg.yaml: every gait cycle's muscle activity, as the cycle ends.

Recording: 13 muscles of the right leg and the foot's contacts, six strides on a treadmill (Santuz; MIT).
Truth: the envelope by scipy's zero-phase filters, and each cycle cut out of it by numpy between two touch-downs of the file.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import at, emg_envelope, events, signal
from tests.support.real import real_arrays

pytestmark = pytest.mark.quick

WALK = real_arrays("emg/emg_santuz_tw12.npz")
MUSCLES = [str(name) for name in WALK["names"]]
DOWN, UP = WALK["touchdown_s"], WALK["liftoff_s"]


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    return kg.load("treadmill_emg").run(
        {
            "treadmill.emg": signal(WALK["emg_uV"], 1000.0, MUSCLES, ["uV"], time_s=WALK["t_s"]),
            "treadmill.touchdown": events(DOWN, side="right"),
            "treadmill.liftoff": events(UP, side="right"),
        }
    )


@pytest.fixture(scope="module")
def cycles() -> np.ndarray:
    """The file's five whole strides by numpy and scipy, each at 0..99 %: (5, 100, 13) µV."""
    envelope = emg_envelope(WALK["emg_uV"].astype(float), 1000.0)
    places = [a + (b - a) * np.arange(100) / 100 for a, b in pairwise(DOWN)]
    curves = [[np.interp(place, WALK["t_s"], muscle) for muscle in envelope.T] for place in places]
    return np.array(curves).swapaxes(1, 2)


def test_the_envelope_is_the_textbooks(replayed: kg.Results) -> None:
    live = replayed["envelope"]
    offline = at(live, WALK["t_s"], emg_envelope(WALK["emg_uV"].astype(float), 1000.0))
    inside = slice(24, -24)  # the first and last 0.2 s depend on what a filter assumes beyond the ends
    assert live.spec.channels == tuple(MUSCLES)
    np.testing.assert_allclose(live.data[inside], offline[inside], atol=0.002 * offline.max())


def test_a_cycle_reaches_from_one_touchdown_to_the_next(replayed: kg.Results) -> None:
    closed = replayed["cycles.closed"].data
    assert (closed["rejected"] == "").all()
    np.testing.assert_allclose(closed["onset"] / NS, DOWN[:-1], atol=1e-9)
    np.testing.assert_allclose(closed["duration_s"], np.diff(DOWN), atol=1e-6)
    np.testing.assert_allclose(closed["stance_pct"], 100 * (UP[:5] - DOWN[:-1]) / np.diff(DOWN), atol=1e-6)


def test_every_cycles_curve_is_the_envelope_over_a_hundred_places(replayed: kg.Results, cycles: np.ndarray) -> None:
    np.testing.assert_allclose(replayed["cycles.cycles"].data, cycles, atol=0.01 * cycles.max())


def test_the_statistics_are_those_of_the_curves(replayed: kg.Results, cycles: np.ndarray) -> None:
    rows = replayed["statistics"].data.reshape(5, 13)
    np.testing.assert_allclose(rows["peak"], cycles.max(axis=1), rtol=0.02)
    np.testing.assert_allclose(rows["mean"], cycles.mean(axis=1), rtol=0.005)
    assert (np.abs(rows["peak_pct"] - cycles.argmax(axis=1)) <= 1).mean() > 0.95  # two peaks may be equally high


def test_the_mean_cycle_and_its_spread_are_numpys(replayed: kg.Results, cycles: np.ndarray) -> None:
    np.testing.assert_allclose(replayed["ensemble.mean"].data[-1], cycles.mean(axis=0), atol=0.005 * cycles.max())
    np.testing.assert_allclose(replayed["ensemble.sd"].data[-1], cycles.std(axis=0, ddof=1), atol=0.01 * cycles.max())


def test_good_electrodes_raise_no_alarm(replayed: kg.Results) -> None:
    assert set(replayed["quality"].data["session_flag"]) == {"good"}
    assert not len(replayed["electrodes"]) and not len(replayed["contacts"])
