"""configs/gait_angles.yaml: the joint angles of somebody who walks, cycle by cycle.

Recording: a man walks through a laboratory, with markers on pelvis and both legs (BMClab's Gait.c3d, cut; CC BY 4.0).
Truth: what plain geometry says of the same markers (hips by Bell 1990, the angle that three joints span), and what textbooks say of a walk.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from tests.replay.replaying import signal
from tests.support.real import real_arrays

WALK = real_arrays("files/gait_bmc_pelvis_and_legs.npz")
NAMES = [str(name) for name in WALK["marker_names"]]
POINTS = WALK["markers_mm"]


def place(name: str) -> np.ndarray:
    return POINTS[:, NAMES.index(name)]


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    return kg.load("gait_angles").run(
        {"lab.markers": signal(POINTS, 100.0, NAMES, ["mm"])}, keep=["angles", "cycles.closed", "cycles.cycles"]
    )


def test_a_knee_bends_as_hip_knee_and_ankle_span(replayed: kg.Results) -> None:
    angles = replayed["angles"]
    wide = np.linalg.norm(place("RASI") - place("LASI"), axis=1)[:, None]
    across = (place("RASI") - place("LASI")) / wide
    front = (place("RASI") + place("LASI")) / 2
    forward = front - place("VSAC")
    forward -= (forward * across).sum(1, keepdims=True) * across
    forward /= np.linalg.norm(forward, axis=1)[:, None]
    up = np.cross(across, forward)
    for side, outer in (("L", -1.0), ("R", 1.0)):
        hip = front + wide * (-0.19 * forward - 0.30 * up + outer * 0.36 * across)
        thigh, shank = hip - place(f"{side}KNE"), place(f"{side}KNE") - place(f"{side}ANK")
        cosine = (thigh * shank).sum(1) / np.linalg.norm(thigh, axis=1) / np.linalg.norm(shank, axis=1)
        spanned = np.degrees(np.arccos(cosine))
        found = angles.data[:, angles.spec.channels.index(f"{side}Knee.flexion")]
        bent = spanned > 25.0
        assert bent.sum() > 30 and np.abs(found - spanned)[bent].mean() < 5.0
        assert 50.0 < found.max() < 75.0


def test_hips_and_ankles_move_as_in_any_walk(replayed: kg.Results) -> None:
    angles = dict(zip(replayed["angles"].spec.channels, replayed["angles"].data.T, strict=True))
    for side in "LR":
        assert 25.0 < np.ptp(angles[f"{side}Hip.flexion"]) < 60.0
        assert 15.0 < np.ptp(angles[f"{side}Ankle.flexion"]) < 55.0
    assert np.ptp(angles["Pelvis.obliquity"]) < 20.0


def test_a_cycle_holds_the_angles_of_its_own_leg(replayed: kg.Results) -> None:
    closed, curves = replayed["cycles.closed"].data, replayed["cycles.cycles"]
    assert len(closed) == 2 and set(closed["limb"]) == {"left", "right"}
    for row, curve in zip(closed, curves.data, strict=True):
        mine = [k for k, name in enumerate(curves.spec.channels) if name.startswith(row["limb"][0].upper())]
        knee = curve[:, curves.spec.channels.index(f"{row['limb'][0].upper()}Knee.flexion")]
        assert (
            np.isfinite(curve[:, mine]).all() and 60 < knee.argmax() < 85
        )  # percent: the knee bends most in the swing
