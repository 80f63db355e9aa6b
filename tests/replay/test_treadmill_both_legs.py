"""configs/treadmill_both_legs.yaml: both legs on a treadmill with two belts, in stages; contacts come from the belts' forces.

Recording: simulated, 40 s (a real one of two belts and both legs' muscles under fitting terms was not found). The simulator's left leg has
muscles of 0.8 of the right's size, its plates drift by 20 N a minute and show 3 % of each other's load.
Truth: the simulated walk's touch-downs and lift-offs, its ratio of left and right, and scipy's envelope.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.devices.people.treadmill import Treadmill
from kinegraph.devices.people.treadmill.both_legs import plates
from kinegraph.stream.chunk import NS, Array
from tests.replay.replaying import at, emg_envelope, signal

GRAPH = kg.load("treadmill_both_legs")
TREADMILL = GRAPH.nodes["treadmill"]
assert isinstance(TREADMILL, Treadmill)
WALK, SAMPLES = TREADMILL.both(), 40_000
SECONDS = np.arange(SAMPLES) / 1000.0
EMG, FORCE = WALK.read(0, SAMPLES)
KEPT = [
    "feet.touchdown",
    "feet.liftoff",
    "envelope",
    "cycles.closed",
    "statistics",
    "symmetry",
    "footfalls.limbs",
    "stages.stages",
]


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    shown = plates(FORCE, SECONDS, TREADMILL.plate_drift_n_per_min, TREADMILL.cross_talk_pct)
    emg = signal(EMG, 1000.0, GRAPH.specs["treadmill.emg"].channels, ["uV"])
    force = signal(shown, 1000.0, ["Fz_left", "Fz_right"], ["N"])
    return GRAPH.run({"treadmill.emg": emg, "treadmill.force": force}, keep=KEPT)


def true_s(edge: str, foot: str) -> Array:
    index, feet = WALK.contacts(edge, 2000, SAMPLES - 2000)  # the plates are zeroed in the first swings
    return np.asarray(index[np.array(feet) == foot] / 1000.0)


@pytest.mark.parametrize("foot", ["left", "right"])
@pytest.mark.parametrize("edge", ["touchdown", "liftoff"])
def test_contacts_are_those_of_the_walk_although_the_plates_drift(replayed: kg.Results, edge: str, foot: str) -> None:
    rows, truth = replayed[f"feet.{edge}"].data, true_s(edge, foot)
    found = rows["onset"][rows["limb"] == foot] / NS
    assert np.abs(found[:, None] - truth).min(axis=0).max() < 0.02
    assert ((found > truth[0] - 0.1) & (found < truth[-1] + 0.1)).sum() == len(truth)


@pytest.mark.parametrize("foot", ["left", "right"])
def test_a_legs_cycles_reach_from_its_touchdown_to_its_next(replayed: kg.Results, foot: str) -> None:
    rows, truth = replayed["cycles.closed"].data, true_s("touchdown", foot)
    mine = rows[
        (rows["limb"] == foot) & (rows["onset"] > (truth[0] - 0.1) * NS) & (rows["onset"] < (truth[-2] + 0.1) * NS)
    ]
    np.testing.assert_allclose(mine["duration_s"], np.diff(truth)[: len(mine)], atol=0.01)
    assert len(truth) - 1 - len(mine) <= 1


def test_the_envelopes_are_scipys(replayed: kg.Results) -> None:
    live = replayed["envelope"]
    offline = at(live, SECONDS, emg_envelope(EMG, 1000.0))
    np.testing.assert_allclose(live.data[24:-24], offline[24:-24], atol=0.003 * offline.max())


def test_the_left_leg_is_found_weaker_by_as_much_as_it_is(replayed: kg.Results) -> None:
    """0.8 beside 1 is an index of 200 (1 - 0.8) / (1 + 0.8) = 22 %; the interval over the session holds it for every muscle."""
    rows = replayed["symmetry"].data
    for muscle in ("RF", "BF", "TA", "SO"):
        last = rows[(rows["name"] == muscle) & (rows["measure"] == "integrated")][-1]
        assert last["low_pct"] - 2.0 < 200 * 0.2 / 1.8 < last["high_pct"] + 2.0
        assert last["mean_pct"] == pytest.approx(200 * 0.2 / 1.8, abs=4.0)


def test_the_legs_are_half_a_stride_apart(replayed: kg.Results) -> None:
    rows = replayed["footfalls.limbs"].data
    assert rows["phase_pct"][rows["limb"] == "right"].mean() == pytest.approx(50.0, abs=2.0)
    assert rows["duty_pct"].mean() == pytest.approx(TREADMILL.stance_percent, abs=1.0)


def test_stages_change_after_the_time_and_the_cycles_of_the_protocol(replayed: kg.Results) -> None:
    rows = replayed["stages.stages"].data
    assert rows["stage"].tolist() == ["warm-up", "1.2 m/s", "1.5 m/s", ""]
    assert (rows["onset"][1] - rows["onset"][0]) / NS == pytest.approx(8.0, abs=0.01)
    assert rows["speed_m_s"][:3].tolist() == [0.8, 1.2, 1.5]
