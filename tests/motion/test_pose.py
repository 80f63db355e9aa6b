"""Poses against the recordings' own, and against bodies that stand, turn and lie elsewhere."""

import os
from pathlib import Path

import numpy as np
import pytest

from kinegraph.operators.features.pose import Pose
from kinegraph.operators.features.skeleton import SETS, partner
from kinegraph.operators.inputs.lengths import metres
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.data.rows import taking
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import grid
from tests.support.real import needs_data

DATA = Path(os.environ.get("KINEGRAPH_DATA", "/nowhere"))
KINECT = (
    "hip_center",
    "head",
    *(f"{joint}_{side}" for joint in ("hip", "knee", "ankle", "wrist", "elbow") for side in "lr"),
)


def poses(data, names, unit="m", **parameters):
    operator = Pose(**parameters)
    specs = {"in": StreamSpec(data.shape[1:], rate_hz=30.0, channels=names, units=(unit,))}
    spec, take = operator.open(specs)["out"], taking(operator, specs)
    return spec, operator.process("in", take("in", Chunk(grid(30.0, len(data)), data, 0))).data


def body(frames=40, seed=3):
    """A body of Kinect joints in metres: left of the hips is +x, up is +y, front is +z."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(frames, len(KINECT), 3))
    x[:, KINECT.index("hip_center")] = 0.0
    x[:, KINECT.index("hip_l")], x[:, KINECT.index("hip_r")] = (0.1, 0.0, 0.0), (-0.1, 0.0, 0.0)
    return x


@needs_data
@pytest.mark.parametrize("trial", ["86_01", "86_09"])
def test_the_published_five_points_come_from_the_joints(trial):
    z = np.load(DATA / "segmentation" / "cmu86_full" / f"{trial}.npz")
    names = tuple(map(str, z["joint_names"]))
    turned = z["joints_cm"].astype(float)
    angle = z["heading_rad"].astype(float)
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    world = turned.copy()
    world[..., 0] = c * turned[..., 0] + s * turned[..., 2]
    world[..., 2] = -s * turned[..., 0] + c * turned[..., 2]
    world += z["root_cm"][:, None]
    spec, made = poses(world, names, "cm")
    expected = z["e15_cm"].reshape(-1, 5, 3)
    assert spec.channels[::3] == tuple(f"{joint}.x" for joint in SETS["e15"])
    assert np.abs(made.reshape(-1, 5, 3) - expected).max() < 1e-3


@needs_data
def test_a_kinect_skeleton_gives_the_same_set():
    z = np.load(DATA / "segmentation" / "msrc12" / "P1_1_2_p21.npz")
    spec, made = poses(z["joints_m"], tuple(map(str, z["joint_names"])))
    assert spec.shape == (15,) and spec.units == ("cm",)
    pose = made[np.isfinite(made).all(axis=1) & z["tracked"]].reshape(-1, 5, 3)
    ankle_l, ankle_r, head, wrist_l, wrist_r = np.median(pose, axis=0)
    assert head[1] > 40 and ankle_l[1] < -50 and ankle_r[1] < -50
    assert ankle_l[0] > 5 > -5 > ankle_r[0] and wrist_l[0] > 10 > -10 > wrist_r[0]


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_where_a_body_stands_and_looks_does_not_matter(up):
    x = body()
    _, plain = poses(x, KINECT)
    assert np.allclose(plain.reshape(-1, 5, 3)[:, 2], 100.0 * x[:, KINECT.index("head")])
    angle = np.linspace(0.0, 9.0, len(x))
    turn = np.stack(
        [np.cos(angle), np.zeros(len(x)), np.sin(angle), -np.sin(angle), np.zeros(len(x)), np.cos(angle)], 1
    )
    turn = np.insert(turn.reshape(-1, 2, 3), 1, [0.0, 1.0, 0.0], axis=1)
    moved = np.einsum("nij,npj->npi", turn, x) + np.cumsum(np.ones((len(x), 1, 3)), axis=0)
    axis, sign = "xyz".index(up[-1]), -1.0 if up[0] == "-" else 1.0
    lying = np.empty_like(moved)
    lying[..., axis] = sign * moved[..., 1]
    lying[..., (axis + 1) % 3] = moved[..., 2]
    lying[..., (axis + 2) % 3] = sign * moved[..., 0]
    _, made = poses(1000.0 * lying, KINECT, "mm", up=up)
    assert np.allclose(made, plain, atol=1e-9)


def test_a_bigger_body_has_the_same_pose_once_its_size_is_known():
    x = body()
    for k, joint in enumerate(("hip", "knee", "ankle")):
        for side, at in (("l", 0.1), ("r", -0.1)):
            x[:, KINECT.index(f"{joint}_{side}")] = (at, -0.4 * k, 0.0)
    _, small = poses(x, KINECT, body_cm=80.0)
    _, tall = poses(1.3 * x, KINECT, body_cm=80.0)
    assert np.allclose(small, tall) and np.allclose(small, poses(x, KINECT)[1])


@pytest.mark.parametrize(("unit", "metre"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("", 1.0)])
def test_positions_in_any_unit_become_metres(unit, metre):
    assert metres(unit) == pytest.approx(metre)


def test_a_bodys_size_is_that_of_its_first_two_seconds():
    x = body(frames=120)
    for k, joint in enumerate(("hip", "knee", "ankle")):
        for side, at in (("l", 0.1), ("r", -0.1)):
            x[:, KINECT.index(f"{joint}_{side}")] = (at, -0.4 * k, 0.0)
    other = x.copy()
    other[61:] *= 2.0  # from after two seconds on somebody else's
    _, alone = poses(x, KINECT, body_cm=90.0)
    _, both = poses(other, KINECT, body_cm=90.0)
    assert np.allclose(both[61:], 2.0 * alone[61:]) and np.allclose(both[:61], alone[:61], equal_nan=True)


def test_the_last_heading_holds_while_one_hip_is_above_the_other():
    x = body(3)
    x[1:, KINECT.index("hip_l")], x[1:, KINECT.index("hip_r")] = (0.001, 0.1, 0.01), (0.0, -0.1, 0.0)
    _, made = poses(x, KINECT)
    assert np.allclose(made[1].reshape(5, 3)[2], 100.0 * x[1, KINECT.index("head")])


def test_bad_points_are_bad_and_a_bad_hip_spoils_the_pose():
    x = body(2)
    x[0, KINECT.index("wrist_l"), 1] = np.inf
    x[1, KINECT.index("hip_l")] = np.nan
    _, made = poses(x, KINECT)
    assert np.isnan(made[0].reshape(5, 3)).all(axis=1).tolist() == [False, False, False, True, False]
    assert np.isnan(made[1]).all()


def test_markers_make_up_joints_and_what_is_missing_is_named():
    names = (
        "A:LWRA",
        "A:LWRB",
        "A:RWRI",
        "A:LANK",
        "A:RANK",
        "A:LFHD",
        "A:RFHD",
        "A:LBHD",
        "A:RBHD",
        "A:LFWT",
        "A:RFWT",
        "A:LBWT",
        "A:RBWT",
    )
    x = np.random.default_rng(0).normal(size=(5, 13, 3))
    _, made = poses(x, names, "mm", heading=False)
    middle = x[:, names.index("A:LWRA")] + x[:, names.index("A:LWRB")]
    root = x[:, 9:13].mean(axis=1)
    assert np.allclose(made.reshape(-1, 5, 3)[:, 3], 0.1 * (middle / 2 - root))
    with pytest.raises(ParameterError, match="'wrist_r'"):
        poses(x[:, :-1], (*names[:2], *names[3:]), "mm", heading=False)
    with pytest.raises(ParameterError, match="did you mean 'A:RWRI'"):
        poses(x, names, "mm", joints={"wrist_r": ("A:RWR",)})
    with pytest.raises(InputError, match="m, cm or mm"):
        poses(x, names, "inch")


@pytest.mark.parametrize(
    ("left", "right"),
    [("LANK", "RANK"), ("Daniel:LFHD", "Daniel:RFHD"), ("hip_l", "hip_r"), ("LeftUpLeg", "RightUpLeg"), ("WristLeft", "WristRight"),
     ("lfoot", "rfoot"), ("ankle_l.x", "ankle_r.x"), ("ankle_l.x[-10]", "ankle_r.x[-10]")],
)  # fmt: skip
def test_partners_on_the_other_side(left, right):
    names = [left, right, "head", "lowerback"]
    assert partner(left, names) == right and partner(right, names) == left
    assert partner("head", names) is None and partner("lowerback", names) is None
