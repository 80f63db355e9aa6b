"""configs/overground_emg.yaml: cycles of both legs from markers, where no treadmill says when a foot lands.

Recording: a man walks over two force plates, with markers and EMG on both legs (BMClab's Gait.c3d, cut; CC BY 4.0).
Truth: the plates, which the graph does not see: each was stepped on by one foot. A foot lands before its load is visible, so that 0.1 s
between the two are allowed; the graph's contacts come from markers alone.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import at, emg_envelope, signal
from tests.support.real import real_arrays

WALK = real_arrays("files/gait_bmc_cut.npz")
MARKERS = [str(name).replace("ASI", "HIP") for name in WALK["marker_names"]]
MUSCLES = {"LTIB": "LTA", "LGRF": "LMG", "RTIB": "RTA", "RGRF": "RMG"}
PLATES = {"right": "F2Z", "left": "F1Z"}


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    muscles = [MUSCLES[str(name)] for name in WALK["emg_names"]]
    return kg.load("overground_emg").run(
        {
            "lab.emg": signal(1000 * WALK["emg_V"], 1000.0, muscles, ["mV"]),
            "lab.markers": signal(WALK["markers_mm"], 100.0, MARKERS, ["mm"]),
        },
        keep=["feet.touchdown", "feet.liftoff", "envelope", "cycles.closed", "cycles.cycles"],
    )


def loaded_s(foot: str) -> tuple[float, float]:
    """From when to when a foot's plate carries more than 5 N of the 70 that it shows at most."""
    load = -WALK["plates_N"][:, WALK["plate_names"].tolist().index(PLATES[foot])]
    over = np.flatnonzero(load > 5.0)
    return float(over[0] / 1000), float(over[-1] / 1000)


@pytest.mark.parametrize(("edge", "foot"), [("touchdown", "right"), ("touchdown", "left"), ("liftoff", "right")])
def test_a_foot_lands_and_leaves_when_its_plate_says(replayed: kg.Results, edge: str, foot: str) -> None:
    """The left foot leaves its plate 0.13 s before the markers end, which is too late to be seen."""
    rows = replayed[f"feet.{edge}"].data
    found = rows["onset"][rows["limb"] == foot] / NS
    assert np.abs(found - loaded_s(foot)[edge == "liftoff"]).min() < 0.1


def test_the_feet_take_turns_and_a_stride_takes_as_long_on_both_sides(replayed: kg.Results) -> None:
    feet = replayed["feet.touchdown"].data
    assert feet["limb"].tolist() == ["left", "right", "left", "right"]
    strides = [np.diff(feet["onset"][feet["limb"] == foot] / NS)[0] for foot in ("left", "right")]
    assert strides[0] == pytest.approx(strides[1], rel=0.03) and 0.9 < strides[0] < 1.1


def test_the_envelopes_are_the_textbooks(replayed: kg.Results) -> None:
    live = replayed["envelope"]
    offline = at(live, np.arange(len(WALK["emg_V"])) / 1000, emg_envelope(1000.0 * WALK["emg_V"], 1000.0))
    np.testing.assert_allclose(live.data[24:-24], offline[24:-24], atol=0.003 * offline.max())


def test_a_legs_muscles_are_cut_at_its_own_touchdowns(replayed: kg.Results) -> None:
    """The left leg's only cycle begins before the filters have settled, and has no curve."""
    closed = replayed["cycles.closed"].data
    curves = replayed["cycles.cycles"].data
    assert closed["limb"][closed["rejected"] == ""].tolist() == ["right"]
    assert np.isfinite(curves[0][:, 2:]).all() and np.isnan(curves[0][:, :2]).all()
