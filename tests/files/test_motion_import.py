"""BVH, C3D, ASF/AMC and Kinect tables become recordings; what is wrong in them is named by file and line."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinegraph.devices.formats.asf.reader import read_amc, read_asf
from kinegraph.devices.formats.bvh.reader import read_bvh
from kinegraph.devices.formats.bvh.writer import COUNT, bvh_head, bvh_rows
from kinegraph.devices.formats.c3d.reader import read_c3d
from kinegraph.devices.formats.kinematics import in_turn, place
from kinegraph.devices.formats.table.kinect import ONE, read_kinect
from kinegraph.operators.features.skeleton import SETS, find_joints
from kinegraph.stream.cli import main as cli
from kinegraph.stream.domain.humanoid import BONES, find_bones, usual_body
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording import Recording
from tests.support.command_line import call_command, succeeding
from tests.support.real import needs_data

DATA = Path(os.environ.get("KINEGRAPH_DATA", "/nowhere"))

BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Chest
  {
    OFFSET 0 10 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 1 5 2
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.0083333
0 0 0 0 0 0 0 0 0
1 2 3 10 20 30 40 50 60
1 2 3 90 0 0 0 0 0
"""

ASF = """# a body of three bones
:version 1.10
:units
  mass 1.0
  length 0.5
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name thigh
    direction 0.6 -0.8 0
    length 7
    axis 0 0 20 XYZ
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-60.0 70.0)
  end
  begin
    id 2
    name shank
    direction 0.6 -0.8 0
    length 6
    axis 10 20 30 XYZ
    dof rx
  end
  begin
    id 3
    name toe
    direction 0 0 1
    length 2
    axis 0 0 0 XYZ
  end
:hierarchy
  begin
    root thigh
    thigh shank
    shank toe
  end
"""

AMC = """:FULLY-SPECIFIED
:DEGREES
1
root 1 2 3 0 0 0
thigh 0 0 0
shank 0
2
root 1 2 3 10 20 30
thigh 40 50 60
shank 70
"""


def written(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    return path


def kinegraph(*arguments):
    with succeeding():
        call_command(*arguments)


def test_bvh_against_rotations_of_scipy(tmp_path):
    joints, angles, *_ = read_bvh(written(tmp_path, "walk.bvh", BVH), "cm")
    assert (joints.name, angles.name) == ("walk", "walk.angles")
    assert joints.spec.channels == ("Hips", "Chest", "Chest_end") and joints.spec.rate_hz == 120.0
    assert np.allclose(joints.data[0], [[0, 0, 0], [0, 10, 0], [1, 15, 2]])
    hips = Rotation.from_euler("ZYX", [10, 20, 30], degrees=True)
    chest = hips * Rotation.from_euler("ZXY", [40, 50, 60], degrees=True)
    at = np.array([1.0, 2.0, 3.0]) + hips.apply([0, 10, 0])
    assert np.allclose(joints.data[1], [[1, 2, 3], at, at + chest.apply([1, 5, 2])])
    assert np.allclose(joints.data[2, 1], [-9, 2, 3])
    assert angles.spec.channels[5:7] == ("Hips.Xrotation", "Chest.Zrotation") and angles.spec.units[:4] == (
        "cm",
        "cm",
        "cm",
        "deg",
    )
    assert np.allclose(read_bvh(tmp_path / "walk.bvh", "m", 0.01)[0].data, joints.data / 100)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("HIERARCHY", "HIERARCHIE", "line 1: a BVH file begins with HIERARCHY"),
        ("  JOINT Chest", "  JOINT Hips", "line 6: every joint needs a name of its own, 'Hips'"),
        ("OFFSET 0 10 0", "OFFSET 0 ten 0", "line 8: OFFSET needs 3 numbers, not '0 ten 0'"),
        ("CHANNELS 3 Z", "CHANNELS 4 Z", "line 9: CHANNELS is followed by their number"),
        (
            "CHANNELS 3 Zrotation",
            "CHANNELS 3 Zrotatoin",
            "line 9: 'Zrotatoin' is not a channel; did you mean 'Zrotation'",
        ),
        (BVH[BVH.index("Frames") :], "Frames: 0\nFrame Time: 1\n", "line 17: there is a skeleton, but not one frame"),
        ("CHANNELS 3 Zrotation", "CHANNELS 3 Xrotation", "line 9: a joint has each channel once"),
        ("Frames: 3", "Frames: 4", "line 17: 4 frames are announced, 3 are there"),
        ("Frame Time: 0.0083333", "Frame Time: 0", "line 18: a frame time of 0 s"),
        ("10 20 30 40", "10 20 x 40", "line 20: a frame needs 9 numbers, not '1 2 3 10 20 x"),
        ("90 0 0 0 0 0", "90 0 0 0 0", "line 21: a frame needs 9 numbers"),
        ("}\nMOTION", "MOTION", "line 15: MOTION comes before the hierarchy is closed"),
    ],
)
def test_a_broken_bvh_file_is_named_by_its_line(tmp_path, old, new, message):
    with pytest.raises(RecordingError, match=r"walk\.bvh: " + message):
        read_bvh(written(tmp_path, "walk.bvh", BVH.replace(old, new)))


def test_a_bvh_file_saved_again_with_decimal_commas_is_the_same(tmp_path):
    text = BVH.replace("10 20 30 40", "10.5 20.25 30 40")
    points = read_bvh(written(tmp_path, "walk.bvh", text))
    commas = read_bvh(written(tmp_path, "walk.bvh", text.replace(".", ",")))
    assert all(np.array_equal(a.data, b.data) for a, b in zip(points, commas, strict=True))


def test_bvh_cut_anywhere_is_read_or_refused(tmp_path):
    for end in range(0, len(BVH) - 1, 7):
        with pytest.raises(RecordingError, match=r"cut\.bvh"):
            read_bvh(written(tmp_path, "cut.bvh", BVH[:end]))


def test_a_joint_of_a_bvh_file_may_end_several_limbs_and_channels_may_be_in_capitals(tmp_path):
    two = BVH.replace("    End Site", "    End Site\n    {\n      OFFSET 0 0 0\n    }\n    End Site")
    (joints, _) = read_bvh(written(tmp_path, "walk.bvh", two.replace("Xposition", "XPOSITION")))
    assert joints.spec.channels == ("Hips", "Chest", "Chest_end", "Chest_end2")
    assert np.allclose(joints.data[0, 3], [1, 15, 2]) and joints.data[1, 0, 0] == 1.0


def test_a_bvh_with_positions_in_every_joint_gives_poses(tmp_path):
    moving = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Chest
  {
    OFFSET 0 1 0
    CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 0 1 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
1 2 3 0 0 0 0 5 0 0 0 0
1 2 3 90 0 0 0 5 0 0 0 0
"""
    joints, _, poses = read_bvh(written(tmp_path, "moving.bvh", moving), "m")
    tree = JointTree.of(poses.spec)
    assert np.allclose(joints_of(tree, poses.data)[1], joints.data[:, :2], atol=1e-9)
    assert np.allclose(joints.data[1, 1], [-4, 2, 3])


@needs_data
def test_the_real_bvh_has_bones_of_constant_length_and_all_joints_of_a_pose():
    joints, angles, poses = read_bvh(DATA / "steering" / "cmu_131_01_scaled.bvh", "m")
    tree = JointTree.of(poses.spec)
    numbers = [joints.spec.channels.index(name) for name in tree.joints]
    assert np.allclose(joints_of(tree, poses.data)[1], joints.data[:, numbers], atol=1e-6)
    names = joints.spec.channels
    assert joints.data.shape == (995, 38, 3) and angles.data.shape == (995, 96) and joints.spec.rate_hz == 120.0
    shank = np.linalg.norm(joints.data[:, names.index("LeftAnkle")] - joints.data[:, names.index("LeftKnee")], axis=1)
    assert np.allclose(shank, np.linalg.norm([0.133642, -0.367180, 0.0]), atol=1e-5)
    assert find_joints(names, SETS["e30"], {})["head"] == ("Head_end",)


def test_asf_and_amc_against_rotations_of_scipy(tmp_path):
    skeleton = read_asf(written(tmp_path, "a.asf", ASF))
    ends, angles, pose = read_amc(written(tmp_path, "a_01.amc", AMC), skeleton, 60.0)
    cm = 2.54 / 0.5
    assert ends.spec.channels == ("root", "thigh", "shank", "toe") and ends.spec.units == ("cm",)
    rest = np.cumsum([[1, 2, 3], [4.2, -5.6, 0], [3.6, -4.8, 0], [0, 0, 2]], axis=0) * cm
    assert np.allclose(ends.data[0], rest)
    root = Rotation.from_euler("xyz", [10, 20, 30], degrees=True)
    frame = Rotation.from_euler("z", 20, degrees=True)
    thigh = root * frame * Rotation.from_euler("xyz", [40, 50, 60], degrees=True) * frame.inv()
    frame = Rotation.from_euler("xyz", [10, 20, 30], degrees=True)
    shank = thigh * frame * Rotation.from_euler("x", 70, degrees=True) * frame.inv()
    at = [np.array([1.0, 2.0, 3.0])]
    for turn, bone in ((thigh, [4.2, -5.6, 0]), (shank, [3.6, -4.8, 0]), (shank, [0, 0, 2])):
        at.append(at[-1] + turn.apply(bone))
    assert np.allclose(ends.data[1], np.array(at) * cm)
    assert angles.spec.channels[-1] == "shank.rx" and angles.data[1, -1] == 70.0
    tree = JointTree.of(pose.spec)  # joints stand where bones begin: at the ends of their parents
    joints = joints_of(tree, pose.data)[1]
    assert tree.joints == ("hips", "thigh", "shank", "toe") and np.allclose(joints[:, 2:], ends.data[:, 1:3] / 100.0)
    assert np.allclose(joints[:, :2], ends.data[:, :1] / 100.0)


def test_turns_in_radians_are_what_the_same_turns_are_in_degrees(tmp_path):
    def radians(line):
        return " ".join([line.split()[0], *(str(np.radians(float(word))) for word in line.split()[1:])])

    skeleton = read_asf(written(tmp_path, "a.asf", ASF))
    both = read_amc(written(tmp_path, "a_01.amc", AMC), skeleton)
    axes = {
        line: f"{radians(line[:-4])} XYZ"
        for line in ASF.split("\n")
        if line.strip().startswith("axis ") and line.endswith(" XYZ")
    }
    asf = ASF.replace("angle deg", "angle rad")
    for old, new in axes.items():
        asf = asf.replace(old, new)
    amc = "\n".join(radians(line) if line.startswith(("thigh", "shank")) else line for line in AMC.split("\n"))
    amc = amc.replace("10 20 30", " ".join(str(np.radians(x)) for x in (10, 20, 30)))
    turned = read_asf(written(tmp_path, "r.asf", asf))
    for skeleton_, text in (
        (turned, amc.replace(":DEGREES\n", "")),
        (skeleton, amc.replace(":DEGREES", ":RADIANS")),
        (turned, AMC),
    ):
        for one, other in zip(read_amc(written(tmp_path, "r_01.amc", text), skeleton_), both, strict=True):
            assert np.allclose(one.data, other.data)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("amc", "shank 0\n", "shank 0\nshank 1\n", r"a_01\.amc: line 7: frame 1 speaks of 'shank' for the second time"),
        ("asf", "length 0.5", "length -1", r"a\.asf: line 5: a unit of length of -1"),
        ("asf", "dof rx\n", "dof rw\n", r"a\.asf: line 30: 'rw' is not a degree of freedom"),
        ("asf", "direction 0 0 1", "direction 0 0", r"a\.asf: line 35: 3 numbers are needed here, not '0 0'"),
        (
            "asf",
            "thigh shank",
            "thigh shnak",
            r"a\.asf: line 42: 'shnak' is not a bone that is still free; did you mean 'shank'",
        ),
        ("asf", ":bonedata", ":bones", "no bones, or no hierarchy|no bone"),
        ("amc", "thigh 40 50 60", "thigh 40 50", r"a_01\.amc: line 9: 3 numbers are needed here"),
        ("amc", "thigh 40", "tigh 40", r"a_01\.amc: line 9: a\.asf has no moving bone 'tigh'; did you mean 'thigh'"),
        ("amc", "shank 70\n", "", r"a_01\.amc: line 7: this frame says nothing about 'shank'"),
        ("amc", "\n2\n", "\n4\n", r"a_01\.amc: line 7: frame 4 comes after frame 1"),
    ],
)
def test_broken_asf_and_amc_files_are_named_by_their_line(tmp_path, file, old, new, message):
    texts = {"asf": ASF, "amc": AMC}
    texts[file] = texts[file].replace(old, new)
    with pytest.raises(RecordingError, match=message):
        read_amc(written(tmp_path, "a_01.amc", texts["amc"]), read_asf(written(tmp_path, "a.asf", texts["asf"])))


@needs_data
def test_the_joints_of_a_real_acclaim_recording_follow_from_its_turns():
    z = np.load(DATA / "segmentation" / "cmu86_full" / "86_01.npz")
    names, joints = list(z["joint_names"]), z["joints_cm"].astype(float)
    turns = [Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix() for q in z["quat_wxyz"].astype(float).swapaxes(0, 1)]
    turns[0] = Rotation.from_euler("y", z["heading_rad"][:, None]).as_matrix() @ turns[0]
    at = [names.index(name) for name in ("root", "lhipjoint", "lfemur", "ltibia", "lfoot")]
    world, steps = turns[0], [np.zeros(3)]
    for j, parent in zip(at[1:], at, strict=False):
        world = world @ turns[j]
        steps.append(world[0].T @ (joints[0, j] - joints[0, parent]))
    made = place([-1, 0, 1, 2, 3], steps, [turns[j] for j in at], ends=True)
    assert np.abs(made - joints[:, at]).max() < 1e-3
    thigh = in_turn("z", np.array([[20.0]]))[0]
    degrees = z["amc_deg_120hz"][::4, [list(z["amc_channels"]).index(f"lfemur.{k}") for k in (2, 1, 0)]].astype(float)
    expected = np.einsum("ij,njk,lk->nil", thigh, in_turn("zyx", degrees), thigh)
    assert np.abs(turns[names.index("lfemur")] - expected[: len(joints)]).max() < 1e-5


def c3d_file(path, frames=40, more=()):
    ezc3d = pytest.importorskip("ezc3d")
    rng = np.random.default_rng(1)
    made = ezc3d.c3d()
    made["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    made["parameters"]["POINT"]["LABELS"]["value"] = ("P:LANK", "P:RANK")
    made["parameters"]["POINT"]["UNITS"]["value"] = ("mm",)
    made["parameters"]["ANALOG"]["RATE"]["value"] = [500.0]
    made["parameters"]["ANALOG"]["LABELS"]["value"] = ("emg", "force")
    made["parameters"]["ANALOG"]["UNITS"]["value"] = ("V", "N")
    points = np.ones((4, 2, frames))
    points[:3] = rng.normal(size=(3, 2, frames)).astype(np.float32)
    points[:3, 1, 5] = np.nan
    made["data"]["points"] = points
    made["data"]["analogs"] = rng.normal(size=(1, 2, 5 * frames)).astype(np.float32).astype(float)
    made.add_event([0.0, 0.15], context="Right", label="Foot Strike")
    made.add_event([0.0, 0.05], context="Right", label="Foot Strike")
    made.add_event([0.0, 0.10], context="Left", label="Foot Off")
    for label in more:
        made.add_event([0.0, 0.10], context="Right", label=label)
    made.write(str(path))
    return points, made["data"]["analogs"]


def test_c3d_markers_analogue_channels_and_events(tmp_path):
    points, analogue = c3d_file(tmp_path / "gait.c3d")
    found = {one.name: one for one in read_c3d(tmp_path / "gait.c3d")}
    assert list(found) == ["gait.markers", "gait.analog", "gait.right_foot_strike", "gait.left_foot_off"]
    markers, signals = found["gait.markers"], found["gait.analog"]
    assert markers.spec.channels == ("LANK", "RANK") and markers.spec.units == ("mm",) and markers.spec.rate_hz == 100.0
    assert np.array_equal(markers.data, points[:3].transpose(2, 1, 0), equal_nan=True)
    assert np.isnan(markers.data[5, 1]).all() and np.isfinite(markers.data[5, 0]).all()
    assert signals.spec.rate_hz == 500.0 and signals.spec.units == ("V", "N") and signals.time[5] == markers.time[1]
    np.testing.assert_allclose(signals.data, analogue[0].T, rtol=1e-6)
    strikes = found["gait.right_foot_strike"]
    assert strikes.data["onset"].tolist() == [50_000_000, 150_000_000] and strikes.spec.meta["side"] == "right"


def test_broken_c3d_files_are_refused(tmp_path):
    c3d_file(tmp_path / "gait.c3d")
    whole = (tmp_path / "gait.c3d").read_bytes()
    for size, message in ((0, "C3D file"), (300, "C3D file"), (len(whole) - 900, "announced")):
        (tmp_path / "cut.c3d").write_bytes(whole[:size])
        with pytest.raises(RecordingError, match=rf"cut\.c3d: .*{message}"):
            read_c3d(tmp_path / "cut.c3d")
    with pytest.raises(RecordingError, match="no such file"):
        read_c3d(tmp_path / "none.c3d")


def test_a_c3d_file_whose_parameters_do_not_hold_together_is_refused(tmp_path):
    c3d_file(tmp_path / "gait.c3d")
    whole = (tmp_path / "gait.c3d").read_bytes()
    at = whole.index(b"LABELS") + len(
        b"LABELS"
    )  # then: where the next record begins, the type, the number of dimensions, these
    for byte, value in ((at + 1, 0x80), (at + 2, 9), (at + 3, 60), (at + 4, 255), (at - 8, 90)):
        (tmp_path / "broken.c3d").write_bytes(whole[:byte] + bytes([value]) + whole[byte + 1 :])
        with pytest.raises(
            RecordingError, match=r"broken\.c3d: cannot be read as a C3D file \(its parameters end abruptly"
        ):
            read_c3d(tmp_path / "broken.c3d")


def test_c3d_events_of_names_that_are_written_alike_are_told_apart(tmp_path):
    c3d_file(tmp_path / "gait.c3d", more=("Foot-Strike",))
    names = [one.name for one in read_c3d(tmp_path / "gait.c3d")]
    assert names[2:] == ["gait.right_foot_strike", "gait.left_foot_off", "gait.right_foot_strike_2"]


def test_a_c3d_file_longer_than_its_header_can_say_is_not_cut_in_silence(tmp_path):
    c3d_file(tmp_path / "long.c3d", frames=65_535)
    assert len(read_c3d(tmp_path / "long.c3d")[0].time) == 65_535
    with (tmp_path / "long.c3d").open("ab") as file:
        file.write(np.ones(100 * (2 * 4 + 2 * 5), np.float32).tobytes())
    assert 65_635 <= len(read_c3d(tmp_path / "long.c3d")[0].time) <= 65_643  # 8: what filled up the last block


@needs_data
def test_the_real_c3d_holds_the_published_markers():
    (markers,) = read_c3d(DATA / "steering" / "HDM_dg_06-03_03_120.c3d")
    published = np.load(DATA / "steering" / "hdm05_dg_06-03_03_markers.npz")
    assert np.array_equal(markers.data.astype(np.float32), published["markers"])
    assert find_joints(markers.spec.channels, SETS["e15"], {})["wrist_l"] == ("LWRA", "LWRB")


def test_kinect_tables_with_and_without_a_header(tmp_path):
    rng = np.random.default_rng(2)
    x = rng.normal(size=(9, 20, 3)).round(4)
    t = np.arange(9) * 33_333 + np.array([0, 4, -3, 0, 9, 1, 0, 0, 2])
    state = np.ones((9, 20, 1))
    state[4, 7] = 0.0
    lines = [f"{t[i]} " + " ".join(map(str, np.concatenate([x, state], 2)[i].ravel())) for i in range(9)]
    (plain,) = read_kinect(written(tmp_path, "plain.csv", "\n".join(lines)))
    expected = x.copy()
    expected[4, 7] = np.nan
    assert plain.spec.channels == ONE and plain.spec.rate_hz is None and plain.spec.units == ("m",)
    assert np.array_equal(plain.data, expected, equal_nan=True) and np.array_equal(plain.time, t * 1000)
    header = "t_ms," + ",".join(f"{n}_{a}" for n in ("WristLeft", "Head") for a in "XYZ") + ",WristLeft_TrackingState"
    rows = [f"{t[i] / 1000},{x[i, 0, 0]},{x[i, 0, 1]},{x[i, 0, 2]},0,0,0,{0 if i == 2 else 2}" for i in range(9)]
    (named,) = read_kinect(written(tmp_path, "named.csv", "\n".join([header, *rows])))
    assert named.spec.channels == ("WristLeft", "Head") and np.isnan(named.data[:, 1]).all()
    assert np.isnan(named.data[:, 0]).all(axis=1).tolist() == [i == 2 for i in range(9)]
    assert np.array_equal(named.time, t * 1000)


def test_kinect_tables_with_frame_numbers(tmp_path):
    """As UTKinect's: no time, only numbers, here 60 a second, of which a camera of 30 Hz takes every second one."""
    frames, x = np.array([190, 194, 196, 198, 206]), np.random.default_rng(3).normal(size=(5, 20, 3)).round(4)
    lines = [f"{n}  " + " ".join(map(str, rows.ravel())) for n, rows in zip(frames, x, strict=True)]
    path = written(tmp_path, "joints.txt", "\n".join(lines))
    kinegraph("files", "import", path, "--kinect", "--rate", "60", "-o", tmp_path / "one.mcap")
    with Recording.open(tmp_path / "one.mcap") as recording:
        time, data = recording.read("joints")
        assert recording.streams["joints"].lost == 1 + 3 and recording.streams["joints"].spec.channels == ONE
    assert np.array_equal(data, x) and np.array_equal(time, np.round((frames - 190) * 1e9 / 60))
    header = "Frame," + ",".join(f"{n}_{a}" for n in ("WristLeft", "Head") for a in "xyz")
    named = written(tmp_path, "named.csv", "\n".join([header, "7,1,2,3,4,5,6", "8,1,2,3,4,5,6"]))
    assert read_kinect(named, rate_hz=25.0)[0].time.tolist() == [0, 40_000_000]
    with pytest.raises(
        RecordingError, match=r"joints\.txt: line 1: times 3 apart.* if they are frame numbers, say --rate"
    ):
        read_kinect(path)
    for text, message in (("7.5", "line 3: 7.5 is not a frame number"), ("7", "line 3: the time 0 s is repeated")):
        again = written(tmp_path, "again.csv", "\n".join([header, "7,1,2,3,4,5,6", f"{text},1,2,3,4,5,6"]))
        with pytest.raises(RecordingError, match=message):
            read_kinect(again, rate_hz=25.0)
    with pytest.raises(RecordingError, match="no column of frame numbers"):
        read_kinect(written(tmp_path, "t.csv", header.replace("Frame", "t") + "\n7,1,2,3,4,5,6"), rate_hz=25.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n", "line 1: 3 numbers; without a header"),
        ("1 2 3\n1 2\n", "line 2: 2 numbers, but the first line has 3"),
        ("1 2 3\n1 2 x\n", "line 2: 'x' is not a number"),
        ("t,a_x,a_y,a_z\n0,1,2,3\n", "line 1: x, y and z of at least two joints"),
        ("a_x,a_y,a_z,b_x,b_y,b_z\n0,1,2,3,4,5\n", "line 1: there is no column of times"),
        ("t_ms,a_x,a_y,a_z,b_x,b_y,b_z\n0,1,2,3,4,5,6\n33,1,2,3,4,five,6\n", "line 3: 'five' in column 'b_y'"),
        ("t_ms,a_x,a_y,a_z,b_x,b_y,b_z\n40,1,2,3,4,5,6\n33,1,2,3,4,5,6\n", "line 3: time runs backwards"),
        ("t,a_x,a_y,a_z,b_x,b_y,b_z\n0,1,2,3,4,5,6\n7000,1,2,3,4,5,6\n", "line 2: times 7000 apart"),
    ],
)
def test_broken_kinect_tables_are_named_by_their_line(tmp_path, text, message):
    with pytest.raises(RecordingError, match=r"k\.csv: " + message):
        read_kinect(written(tmp_path, "k.csv", text))


def test_the_command_makes_one_recording_of_all_kinds(tmp_path):
    written(tmp_path, "walk.bvh", BVH)
    written(tmp_path, "a.asf", ASF)
    written(tmp_path, "a_01.amc", AMC)
    written(tmp_path, "k.csv", "t_ms,a_x,a_y,a_z,b_x,b_y,b_z\n0,1,2,3,4,5,6\n33,1,2,3,4,5,6\n")
    files = [tmp_path / name for name in ("walk.bvh", "a.asf", "a_01.amc", "k.csv")]
    kinegraph(
        "files", "import", *files, "--kinect", "--unit", "walk=m", "--meta", "k:person=S1", "-o", tmp_path / "all.mcap"
    )
    with Recording.open(tmp_path / "all.mcap") as recording:
        specs = {name: stream.spec for name, stream in recording.streams.items()}
    assert list(specs) == ["walk", "walk.angles", "walk.pose", "a_01", "a_01.angles", "a_01.pose", "k"]
    assert specs["walk"].units == ("m",) and specs["a_01"].rate_hz == 120.0 and specs["k"].meta == {"person": "S1"}
    with pytest.raises(RecordingError, match="read with its skeleton"):
        cli.call("files import", [str(files[2]), "-o", str(tmp_path / "other.mcap")])
    with pytest.raises(RecordingError, match="does not move"):
        cli.call("files import", [str(files[1]), "-o", str(tmp_path / "other.mcap")])


def test_streams_of_motion_files_get_the_names_that_a_graph_wants(tmp_path):
    written(tmp_path, "walk.bvh", BVH)
    c3d_file(tmp_path / "gait.c3d")
    written(tmp_path, "a.csv", "t,x\n0,1\n0.1,2\n0.2,3\n")
    chosen = (
        "--stream",
        "mocap.joints=walk",
        "--stream",
        "lab.markers=gait.markers",
        "--stream",
        "board.x=x",
        "--time",
        "board.x=t",
    )
    reported = ("--unit", "mocap.joints=cm", "--scale", "walk=2", "--meta", "lab.markers:who=S1", "--unit", "board.x=V")
    files = [tmp_path / name for name in ("a.csv", "walk.bvh", "gait.c3d")]
    kinegraph("files", "import", *files, *chosen, *reported, "-o", tmp_path / "all.mcap")
    with Recording.open(tmp_path / "all.mcap") as recording:
        specs = {name: stream.spec for name, stream in recording.streams.items()}
    assert set(specs) == {"mocap.joints", "lab.markers", "board.x"}
    assert specs["mocap.joints"].units == ("cm",) and specs["lab.markers"].meta == {"who": "S1"}
    assert specs["board.x"].units == ("V",)


def test_bones_are_named_where_the_joints_of_a_file_do_not_show_them(tmp_path):
    body = usual_body()
    odd = {"LeftUpperArm": "Bone_17", "Hips": "Bone_1"}
    tree = JointTree(tuple(odd.get(bone, bone) for bone in BONES), body.parents, body.offsets)
    poses = np.tile(np.concatenate([body.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))]), (3, 1))
    head, at = bvh_head(tree, 30.0)
    written(tmp_path, "odd.bvh", f"{head[:at]}{3:{COUNT}d}{head[at + COUNT :]}{bvh_rows(tree, poses)}")
    files = ("files", "import", tmp_path / "odd.bvh", "--unit", "cm", "-o", tmp_path / "odd.mcap")
    kinegraph(*files, "--bones", "LeftUpperArm=Bone_17", "--bones", "Hips=Bone_1")
    with Recording.open(tmp_path / "odd.mcap") as recording:
        spec = recording.streams["odd.pose"].spec
    found = find_bones(JointTree.of(spec).joints)
    assert found["LeftUpperArm"] == "LeftUpperArm" and found["Hips"] == "Hips" and "LeftUpperArm.w" in spec.channels
    for words, message in (
        (("LeftUpperArm=Bone_71", "Hips=Bone_1"), "a joint one of"),
        (("LeftArm=Bone_17",), "a bone is one of"),
        (("Hips=Bone_1",), "has no LeftUpperArm"),
    ):
        with pytest.raises(RecordingError, match=message):
            call_command(*files, *(part for word in words for part in ("--bones", word)), "--overwrite")


def test_bones_of_files_without_poses_are_refused(tmp_path):
    file = written(tmp_path, "walk.bvh", BVH)
    with pytest.raises(RecordingError, match="no poses in these files"):
        call_command("files", "import", file, "--bones", "Hips=Hips", "-o", tmp_path / "walk.mcap")


@pytest.mark.parametrize(
    ("expected", "message"),
    [
        (
            ("--stream", "mocap.joints=wlak"),
            "--stream mocap.joints=wlak: there is no such stream in these files; did you mean 'walk'",
        ),
        (("--unit", "wlak=cm"), "--unit wlak=...: no such stream is made; did you mean 'walk'"),
        (("--meta", "wlak:who=S1"), "--meta wlak=...: no such stream is made"),
        (("--rate", "walk=60"), r"--rate walk=...: walk\.bvh says this itself"),
        (("--rate", "60"), "--rate: files of motion say this themselves"),
        (("--time", "t"), "--time: files of motion say this themselves"),
    ],
)
def test_what_is_said_of_motion_files_in_vain_is_refused(tmp_path, expected, message):
    with pytest.raises(RecordingError, match=message):
        cli.call(
            "files import", [str(written(tmp_path, "walk.bvh", BVH)), *expected, "-o", str(tmp_path / "walk.mcap")]
        )
