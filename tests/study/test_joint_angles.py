"""Anatomical angles: of a body that was posed by other means, and of people who walked."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinegraph.operators.angles.joint_angles import STANDING, JointAngles
from kinegraph.operators.angles.marker_sets import find_places
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import grid
from tests.support.convert_run import DATA
from tests.support.real import needs_data

LEG = (
    "hip_flexion",
    "hip_adduction",
    "hip_rotation",
    "knee_flexion",
    "knee_adduction",
    "knee_rotation",
    "dorsiflexion",
    "ankle_rotation",
)


def turned(flexion: float, adduction: float, rotation: float) -> Rotation:
    """About z, then the new x, then the new y (degrees)."""
    return Rotation.from_euler("ZXY", [flexion, adduction, rotation], degrees=True)


def posed(legs: dict[str, dict[str, float]], pelvis: Rotation) -> dict[str, np.ndarray]:
    """Markers of somebody whose legs are bent so, by plain forward kinematics; x forwards, y up, z to the right (m)."""
    local = {
        "LASI": (0.1, 0.05, -0.12),
        "RASI": (0.1, 0.05, 0.12),
        "LPSI": (-0.1, 0.05, -0.05),
        "RPSI": (-0.1, 0.05, 0.05),
    }
    made = {name: pelvis.apply(place) for name, place in local.items()}
    for side, outer in (("L", -1.0), ("R", 1.0)):
        a = legs[side]
        thigh = pelvis * turned(a["hip_flexion"], outer * a["hip_adduction"], outer * a["hip_rotation"])
        shank = thigh * turned(-a["knee_flexion"], outer * a["knee_adduction"], outer * a["knee_rotation"])
        foot = shank * turned(a["dorsiflexion"], 0.0, outer * a["ankle_rotation"])
        hip = pelvis.apply([0.0, -0.05, outer * 0.09])
        knee = hip + thigh.apply([0.0, -0.42, 0.0])
        ankle = knee + shank.apply([0.0, -0.40, 0.0])
        beside = {
            "KNE": (knee, thigh, 0.05),
            "KNM": (knee, thigh, -0.05),
            "ANK": (ankle, shank, 0.04),
            "ANM": (ankle, shank, -0.04),
        }
        made |= {side + name: at + part.apply([0.0, 0.0, outer * far]) for name, (at, part, far) in beside.items()}
        made |= {
            f"{side}HIP": hip,
            f"{side}HEE": ankle + foot.apply([-0.05, 0, 0]),
            f"{side}TOE": ankle + foot.apply([0.16, 0, 0]),
        }
    return made


def angles(
    frames: list[dict[str, np.ndarray]], axes: dict[str, object] | None = None, **parameters: object
) -> dict[str, np.ndarray]:
    """What the operator gives, by channel."""
    names, data = tuple(frames[0]), np.array([list(frame.values()) for frame in frames])
    operator = JointAngles(**parameters)  # type: ignore[arg-type]
    facts = {"axes": axes or {"up": "y", "forward": "x", "handed": "right"}}
    spec = operator.open({"in": StreamSpec((len(names), 3), rate_hz=100.0, channels=names, units=("m",), meta=facts)})[
        "out"
    ]
    times = grid(100.0, len(data))
    made = operator.process("in", Chunk(times, data.reshape(len(data), -1), int(times[-1])))
    return dict(zip(spec.channels, made.data.T, strict=True))


@pytest.mark.quick
@pytest.mark.parametrize("seed", range(4))
def test_the_angles_that_a_body_was_posed_with_are_found(seed: int) -> None:
    random = np.random.default_rng(seed)
    legs = {
        side: dict(zip(LEG, random.uniform(-25, 60, 8) * [1, 0.3, 0.4, 1, 0.1, 0.2, 0.3, 0.2], strict=True))
        for side in "LR"
    }
    made = angles([posed(legs, Rotation.from_euler("ZXY", [-12.0, 5.0, 20.0], degrees=True))])
    for side in "LR":
        found = [made[f"{side}{joint}"][0] for joint in ("Hip.flexion", "Hip.adduction", "Hip.rotation", "Knee.flexion",
                 "Knee.adduction", "Knee.rotation", "Ankle.flexion", "Ankle.rotation")]  # fmt: skip
        np.testing.assert_allclose(found, list(legs[side].values()), atol=1e-6)
    assert [made[f"Pelvis.{angle}"][0] for angle in ("tilt", "obliquity", "rotation")] == pytest.approx(
        [12.0, 5.0, 20.0]
    )


def test_the_same_body_in_other_axes_has_the_same_angles() -> None:
    legs = {side: dict.fromkeys(LEG, 12.0) for side in "LR"}
    plain = posed(legs, turned(-10.0, 3.0, 5.0))
    z_up = {
        name: np.array([place[2], place[0], place[1]]) for name, place in plain.items()
    }  # x right, y forwards, z up
    one, other = angles([plain]), angles([z_up], {"up": "z", "forward": "y", "handed": "right"})
    for name in one:
        assert one[name][0] == pytest.approx(other[name][0], abs=1e-9), name


def test_no_angle_leaps_where_it_passes_half_a_turn() -> None:
    standing = {side: dict.fromkeys(LEG, 0.0) for side in "LR"}
    made = angles([posed(standing, turned(0.0, 0.0, turn)) for turn in np.arange(0.0, 720.0, 10.0)])
    np.testing.assert_allclose(made["Pelvis.rotation"], np.arange(0.0, 720.0, 10.0), atol=1e-6)


def test_a_missing_marker_costs_only_the_joints_that_need_it() -> None:
    legs = {side: dict.fromkeys(LEG, 10.0) for side in "LR"}
    whole = posed(legs, Rotation.identity())
    made = angles([whole, whole | {"LANK": np.full(3, np.nan)}, whole | {"LTOE": np.zeros(3)}])
    assert np.isfinite(made["LHip.flexion"]).all() and np.isfinite(made["RKnee.flexion"]).all()
    assert np.isfinite(made["LAnkle.flexion"]).tolist() == [True, False, False]


def test_without_an_inner_marker_the_knee_lies_half_its_width_inside() -> None:
    """Somebody who stands straight, with outer markers only: knees are straight within what a nominal axis allows."""
    frame = {name: np.array(place) for name, place in STANDING.items()}
    made = angles([frame], {"up": "z", "forward": "y", "handed": "right"})
    for name in ("LKnee.flexion", "RKnee.flexion", "LHip.flexion", "LKnee.rotation"):
        assert abs(made[name][0]) < 4.0


def test_markers_without_a_pelvis_are_refused_and_names_can_be_given() -> None:
    with pytest.raises(InputError, match="at least a pelvis"):
        angles([{"LKNE": np.zeros(3), "LANK": np.ones(3)}])
    frame = {name.replace("LASI", "front left"): np.array(place) for name, place in STANDING.items()}
    assert "Pelvis.tilt" in angles([frame], markers={"LASI": "front left"})
    with pytest.raises(ParameterError, match="a marker of the input"):
        angles([frame], markers={"LASI": "front lft"})


def test_laboratories_names_are_known() -> None:
    names = ["R.ASIS", "L.ASIS", "V.Sacral", "R.Knee.Lat", "R.Knee.Med", "R.Ankle.Lat", "R.Toe.Tip", "R.Heel"]
    found = find_places(names)
    assert found == {
        "RASI": names[0],
        "LASI": names[1],
        "SACR": names[2],
        "RKNE": names[3],
        "RKNM": names[4],
        "RANK": names[5],
        "RHEE": names[7],
        "RTOE": names[6],
    }
    assert find_places(["left_hip", "right_knee"]) == {"LHIP": "left_hip", "RKNE": "right_knee"}


@needs_data
def test_a_walkers_knee_bends_as_the_angle_between_the_bones() -> None:
    """A recorded walk with the joints' middles in the file: flexion is what three joints span, but for a little."""
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d(str(DATA / "files" / "c3d" / "walking5.c3d"))
    names = file["parameters"]["POINT"]["LABELS"]["value"]
    points = file["data"]["points"][:3].transpose(2, 1, 0)
    kept = [k for k, name in enumerate(names) if not name.endswith(("TH1", "TH2", "TH3", "TB1", "TB2", "TB3"))]
    rows = [dict(zip([names[k] for k in kept], 0.001 * frame[kept], strict=True)) for frame in points]
    made = angles(rows, {"up": "z", "forward": "x", "handed": "right"})
    for side in "LR":
        hip, knee, ankle = (points[:, names.index(side + joint)] for joint in ("HJC", "KJC", "AJC"))
        cosine = (
            ((hip - knee) * (knee - ankle)).sum(1)
            / np.linalg.norm(hip - knee, axis=1)
            / np.linalg.norm(knee - ankle, axis=1)
        )
        straight, flexion = np.degrees(np.arccos(cosine)), made[f"{side}Knee.flexion"]
        seen = np.isfinite(straight) & np.isfinite(flexion) & (straight > 15.0)
        assert seen.sum() > 100
        assert np.abs(straight - flexion)[seen].max() < 6.0
        assert 55 < np.nanmax(flexion) < 85 and 35 < np.nanmax(made[f"{side}Hip.flexion"]) < 60
