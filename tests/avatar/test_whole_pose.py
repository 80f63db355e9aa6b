"""Whole poses from markers: a walker with known joints, and everything that can be missing or wrong about the markers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.operators.filters.one_euro import OneEuro
from kinegraph.operators.pose.landmarks import BONE_OF, FROM_BONE, NAMES, USUAL
from kinegraph.operators.pose.limb_kernel import two_bones
from kinegraph.operators.pose.operator import WholePose
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.cli import main as cli
from kinegraph.stream.domain.humanoid import BONES, PARENTS, find_bones, to_humanoid, usual_body
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import grid
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.command_line import succeeding

RATE, N = 30.0, 240
TREE = usual_body()
QUALITY = len(BONES)


def walker() -> Samples:
    """Someone who stands for 1.5 s and then walks along z: poses (N, 91)."""
    poses = np.tile(np.concatenate([TREE.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))]), (N, 1))
    time = np.arange(N) / RATE
    phase = np.where(time > 1.5, 2 * np.pi * 0.9 * (time - 1.5), 0.0)
    poses[:, 2] += np.maximum(0.0, time - 1.5) * 1.1

    def bend(bone: str, axis: int, angle: Samples) -> None:
        at = 3 + 4 * BONES.index(bone)
        poses[:, at], poses[:, at + axis] = np.cos(angle / 2), np.sin(angle / 2)

    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        bend(f"{side}UpperArm", 3, np.full(N, -sign * 1.3))
        bend(f"{side}LowerArm", 2, -sign * (0.4 + 0.2 * np.sin(phase)))
        bend(f"{side}UpperLeg", 1, -0.5 * sign * np.sin(phase))
        bend(f"{side}LowerLeg", 1, 0.35 - 0.35 * np.cos(phase))
    return poses


POSES = walker()
JOINTS = joints_of(TREE, POSES)[1]


def marks(names: tuple[str, ...] = USUAL, poses: Samples = POSES) -> Samples:
    turns, joints = joints_of(TREE, poses)
    made = np.empty((len(poses), len(names), 3))
    for i, name in enumerate(names):
        k = NAMES.index(name)
        w, v = turns[:, BONE_OF[k], :1], turns[:, BONE_OF[k], 1:]
        u = 2 * np.cross(v, FROM_BONE[k])
        made[:, i] = joints[:, BONE_OF[k]] + FROM_BONE[k] + w * u + np.cross(v, u)
    return made


def played(x: Samples, names: tuple[str, ...] = USUAL, **parameters: object) -> tuple[Samples, Samples, Samples]:
    operator = WholePose(**parameters)  # type: ignore[arg-type]
    operator.open({"in": StreamSpec((len(names), 3), rate_hz=RATE, channels=names, units=("m",))})
    made = operator.process("in", Chunk(grid(RATE, len(x)), np.ascontiguousarray(x.reshape(len(x), -1)), 0))
    pose, joints, quality = (chunk.data for _, chunk in made)
    return pose, joints, quality


def hold_everywhere(pose: Samples, joints: Samples) -> None:
    """What is true of every pose: finite, unit quaternions, constant bones, no bone faster than 20 rad/s."""
    assert np.isfinite(pose).all() and np.isfinite(joints).all()
    turns = pose[:, 3:].reshape(len(pose), -1, 4)
    assert np.allclose(np.linalg.norm(turns, axis=-1), 1.0, atol=1e-9)
    lengths = np.linalg.norm(joints[40:, 1:] - joints[40:, TREE.parents[1:]], axis=-1)
    assert np.ptp(lengths, axis=0).max() < 1e-9
    world, _ = joints_of(TREE, pose)
    for q in (turns, world):
        angle = 2 * np.arccos(np.minimum(1.0, np.abs((q[1:] * q[:-1]).sum(-1))))
        assert angle[1:].max() < 20.0 / RATE * 1.001


def test_a_doubtful_marker_is_followed_slowly_and_its_bones_are_flagged() -> None:
    """Where a marker is missing its place is guessed: it moves with the trunk. One that is doubtful is better than that."""
    n, k = 120, USUAL.index("wrist_l")
    x = marks(USUAL, np.repeat(POSES[:1], n, axis=0))
    there, gone = x.copy(), x.copy()
    there[60:, k] += [0.0, 0.15, 0.1]
    gone[60:, k] = np.nan
    confidence = np.ones((n, len(USUAL)))
    confidence[60:, k] = 0.1
    hand = BONES.index("LeftHand")
    places, flags = {}, {}
    for way, rows, trust in (("doubtful", there, confidence), ("missing", gone, None), ("sure", there, None)):
        operator = WholePose()
        spec = StreamSpec((len(USUAL), 3), rate_hz=RATE, channels=USUAL, units=("m",))
        sure = {} if trust is None else {"confidence": StreamSpec((len(USUAL),), rate_hz=RATE, channels=USUAL)}
        operator.open({"in": spec, **sure})
        joints, quality = [], []
        for i, time in enumerate(grid(RATE, n).tolist()):
            at = np.array([time])
            if trust is not None:
                operator.process("confidence", Chunk(at, trust[i : i + 1], time))
            made = dict(operator.process("in", Chunk(at, rows[i : i + 1].reshape(1, -1), time)))
            joints.append(made["joints"].data[0, hand])
            quality.append(made["quality"].data[0, hand])
        places[way], flags[way] = np.array(joints), np.array(quality)
    away = {way: np.linalg.norm(place - places["sure"][-1], axis=1) for way, place in places.items()}
    assert away["doubtful"][-1] < 0.03 < 0.1 < away["missing"][-1]
    assert away["doubtful"][61] > away["sure"][61], "slowly"
    assert flags["doubtful"][61:].all() and not flags["doubtful"][:60].any() and not flags["sure"].any()


def followed_by(confidence: Samples) -> Samples:
    """How far (m) the left hand is, in 30 frames, from where it was before its marker went aside by .2 m, of this confidence (30,)."""
    x = marks(USUAL, np.repeat(POSES[:1], 90, axis=0))
    x[60:, USUAL.index("wrist_l")] += [0.0, 0.15, 0.13]
    operator, trust = WholePose(), np.ones(len(USUAL))
    operator.open({
        "in": StreamSpec((len(USUAL), 3), rate_hz=RATE, channels=USUAL, units=("m",)),
        "confidence": StreamSpec((len(USUAL),), rate_hz=RATE, channels=USUAL),
    })  # fmt: skip
    places = []
    for i, time in enumerate(grid(RATE, 90).tolist()):
        trust[USUAL.index("wrist_l")] = confidence[max(0, i - 60)]
        operator.process("confidence", Chunk(np.array([time]), trust[None].copy(), time))
        made = dict(operator.process("in", Chunk(np.array([time]), x[i : i + 1].reshape(1, -1), time)))
        places.append(made["joints"].data[0, BONES.index("LeftHand")])
    return np.linalg.norm(np.array(places[60:]) - places[59], axis=1)


def test_the_surer_a_marker_is_the_sooner_it_is_followed() -> None:
    doubtful, nearly, sure = (followed_by(np.full(30, c)) for c in (0.05, 0.45, 1.0))
    assert nearly[4] > 0.95 * sure[4] and doubtful[4] < 0.7 * sure[4] and doubtful[29] > 0.9 * sure[29]


def test_a_marker_of_which_a_network_is_sure_for_single_frames_is_not_leapt_to() -> None:
    flickers = np.full(30, 0.05)
    flickers[3::4] = 0.9
    assert np.diff(followed_by(flickers))[2:].max() < 0.03


def test_confidence_of_other_points_is_refused() -> None:
    spec = StreamSpec((len(USUAL), 3), rate_hz=RATE, channels=USUAL, units=("m",))
    with pytest.raises(InputError, match="each of the 13 points"):
        WholePose().open({"in": spec, "confidence": StreamSpec((20,), rate_hz=RATE)})


@pytest.mark.parametrize(
    ("names", "max_cm"),
    [
        (USUAL, 1.5),
        ((*USUAL, "toe_l", "toe_r", "neck", "root", "hand_l", "hand_r", "nose"), 1.5),
        (tuple(n for n in USUAL if not n.startswith("hip")), 8.0),
        (tuple(n for n in USUAL if not n.startswith(("elbow", "knee"))), 6.0),
        (("head", "wrist_l", "wrist_r", "ankle_l", "ankle_r"), 15.0),
    ],
    ids=["13", "20", "no hips", "9", "5"],
)
def test_any_markers_give_a_pose_that_fits_them(names: tuple[str, ...], max_cm: float) -> None:
    pose, joints, quality = played(marks(names), names)
    hold_everywhere(pose, joints)
    assert 100 * np.linalg.norm(joints[60:] - JOINTS[60:], axis=-1).mean() < max_cm
    assert not quality[60:, :QUALITY].any()


def test_bone_lengths_are_learned_from_standing_and_left_and_right_are_the_same() -> None:
    small = 0.8 * marks()
    _, joints, quality = played(small)
    assert not quality[:29, QUALITY + 2].any() and quality[31:, QUALITY + 2].all()
    shank = np.linalg.norm(joints[50, BONES.index("LeftFoot")] - joints[50, BONES.index("LeftLowerLeg")])
    assert shank == pytest.approx(0.8 * np.linalg.norm(TREE.offsets[BONES.index("LeftFoot")]), rel=0.01)
    assert 100 * np.linalg.norm(joints[60:] - 0.8 * JOINTS[60:], axis=-1).mean() < 1.5


SCENES = {
    "a hand behind the back": lambda x: x[60:90, [8, 10]].fill(np.nan),
    "half a body": lambda x: x[70:120, :6].fill(np.nan),
    "nobody": lambda x: x[60:80].fill(np.nan),
    "left for right": lambda x: x.__setitem__(slice(80, 84), x[80:84][:, [1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 12]]),
    "left for right for good": lambda x: x.__setitem__(
        slice(80, N), x[80:][:, [1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 12]]
    ),
    "left for right from the start": lambda x: x.__setitem__(
        slice(None), x[:, [1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 12]]
    ),
    "left for right now and then": lambda x: x.__setitem__(
        slice(60, N, 3), x[60::3][:, [1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 12]]
    ),
    "names in disorder": lambda x: x.__setitem__(slice(None), x[:, ::-1]),
    "huge": lambda x: x.__setitem__((slice(60, 80), [6, 8]), 1e30),
    "all in one place": lambda x: x.__setitem__(slice(60, 120), x[60:120, 12:]),
    "10 fps in a stream of 30": lambda x: [x.__setitem__(slice(k, k + 3), x[k]) for k in range(60, N, 3)],
    "a leap": lambda x: x.__setitem__((slice(90, 92), 10), x[90:92, 10] + 1.5),
    "noise": lambda x: x.__iadd__(np.random.default_rng(3).normal(0, 0.03, x.shape)),
    "far away": lambda x: x.__setitem__(slice(100, 240), x[100:240] + 5.0),
    "nothing at first": lambda x: x[:20].fill(np.nan),
}


@pytest.mark.parametrize("scene", SCENES)
def test_whatever_the_markers_do_the_pose_is_one_of_a_body(scene: str) -> None:
    x = marks()
    SCENES[scene](x)
    pose, joints, _ = played(x)
    hold_everywhere(pose[21:], joints[21:])


def test_a_limb_that_is_not_seen_is_flagged_and_comes_back() -> None:
    x = marks()
    x[60:90, [8, 10]] = np.nan  # left elbow and wrist
    _, joints, quality = played(x)
    guessed = quality[:, BONES.index("LeftLowerArm")]
    assert not guessed[40:60].any() and guessed[61:90].all() and not guessed[93:].any()
    assert not quality[:, BONES.index("RightLowerArm")][40:].any()
    hand = BONES.index("LeftHand")
    assert 100 * np.linalg.norm(joints[100:, hand] - JOINTS[100:, hand], axis=-1).max() < 2.0


def test_a_foot_that_stands_does_not_slide_and_nothing_leaps_when_it_is_lifted() -> None:
    x = marks() + np.random.default_rng(5).normal(0, 0.002, (N, 13, 3))
    _, joints, quality = played(x)
    for side in (0, 1):
        ankle = joints[:, BONES.index(("LeftFoot", "RightFoot")[side])]
        stands = quality[:, QUALITY + side].astype(bool)
        steps = np.linalg.norm(np.diff(ankle, axis=0), axis=1)
        slides = np.linalg.norm(np.diff(ankle, axis=0)[:, [0, 2]], axis=1)
        both = stands[1:] & stands[:-1]
        assert both[31:].sum() >= 10 and slides[31:][both[31:]].max() < 0.003
        lifted = ~stands[1:] & stands[:-1]
        true = np.linalg.norm(np.diff(JOINTS[:, BONES.index(("LeftFoot", "RightFoot")[side])], axis=0), axis=1)
        assert (steps - true)[35:][lifted[35:]].max() < 0.02


@pytest.mark.parametrize("seed", range(3))
def test_a_standing_foot_stays_where_it_is_under_a_nearly_straight_noisy_leg(seed: int) -> None:
    """The knee's marker is anywhere around the leg, which turned as fast as it may: 6 % of the steps were slides, of up to 24 cm."""
    n, tree = 900, usual_body()
    poses = np.tile(np.concatenate([tree.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))]), (n, 1))
    x, t = joints_of(tree, poses)[1][:, BONE_OF[[NAMES.index(name) for name in USUAL]]], np.arange(n) / 30.0
    upper = [k for k, name in enumerate(USUAL) if not name.startswith(("knee", "ankle"))]
    knees = [USUAL.index("knee_l"), USUAL.index("knee_r")]
    x[:, upper, 0] += (0.03 * np.sin(1.9 * t))[:, None]
    x[:, upper, 1] -= (0.004 + 0.004 * np.sin(1.3 * t))[:, None]
    x[:, knees, 0] += (0.015 * np.sin(1.9 * t))[:, None]
    x[:, knees, 2] += 0.02
    spec = StreamSpec((len(USUAL), 3), rate_hz=30.0, channels=USUAL, units=("m",))
    euro, pose = OneEuro(cutoff_hz=2.0, beta=1.0), WholePose(calibrate_s=0.0)
    pose.open({"in": euro.open({"in": spec})["out"]})
    noisy = (x + np.random.default_rng(seed).normal(0.0, 0.03, x.shape)).reshape(n, -1)
    smooth = euro.process("in", Chunk(grid(30.0, n), noisy, 0))
    assert smooth is not None
    rows = np.ascontiguousarray(smooth.data.reshape(n, -1))
    facts = {name: chunk.data for name, chunk in pose.process("in", Chunk(smooth.time, rows, 0))}
    stands = facts["quality"][:, len(BONES) : len(BONES) + 2] > 0
    feet = facts["joints"][:, [BONES.index("LeftFoot"), BONES.index("RightFoot")]]
    slides = np.linalg.norm(np.diff(feet, axis=0)[..., [0, 2]], axis=-1)[stands[1:] & stands[:-1]]
    assert len(slides) > n and (slides > 0.003).mean() < 0.01


@pytest.mark.parametrize("noise_m", [0.015, 0.03])
def test_feet_stand_by_markers_that_leap_and_are_let_go(noise_m: float) -> None:
    """Filtered noise looks as if the foot went at half a metre a second: nothing was ever held, and feet slid as their markers did."""
    still, goes = 240, 60
    x = np.repeat(marks()[:1], still + goes, axis=0)
    x[still:, :, 2] += 0.05 * np.arange(1, goes + 1)[:, None]
    noisy = x + np.random.default_rng(3).normal(0.0, noise_m, x.shape)
    one = OneEuro(cutoff_hz=2.0, beta=1.0)
    one.open({"in": StreamSpec((39,), rate_hz=30.0)})
    made = one.process("in", Chunk(grid(30.0, len(noisy)), noisy.reshape(len(noisy), -1), 0))
    assert made is not None
    _, joints, quality = played(np.asarray(made.data).reshape(-1, 13, 3))
    for side in (0, 1):
        ankle = joints[:, BONES.index(("LeftFoot", "RightFoot")[side])]
        stands = quality[:, QUALITY + side].astype(bool)
        both = stands[1:] & stands[:-1]
        slides = np.linalg.norm(np.diff(ankle, axis=0)[:, [0, 2]], axis=1)
        assert stands[90:still].mean() > 0.8
        assert np.median(slides[90 : still - 1][both[90 : still - 1]]) < 0.0015
        assert stands[still + 10 :].mean() < 0.1, "who walks away has left"


@pytest.mark.parametrize("reached", [0.4, 0.9])
def test_two_bones_reach_on_the_side_of_the_pole_in_the_room_that_is_given(reached: float) -> None:
    """Two bones of .3 and .25 m; beyond their length they point where they should end. What lies behind their room is another's."""
    room, middle, end = np.full((4, 4), 7.0), np.empty(3), np.empty(3)
    start, goal = np.array([0.1, 1.0, -0.2]), np.array([0.1, 1.0 - reached, -0.2])
    pole, down = np.array([0.0, 0.3, 1.0]), np.array([0.0, -0.55, 0.0])
    two_bones(start, goal, goal + pole, 0.3, 0.25, middle, end, room[:2])
    assert (room[2:] == 7.0).all()
    assert np.linalg.norm(middle - start) == pytest.approx(0.3) and np.linalg.norm(end - middle) == pytest.approx(0.25)
    assert np.allclose(end, goal if reached < 0.55 else start + down, atol=1e-3)
    assert middle[0] == pytest.approx(0.1) and middle[2] > start[2]


def test_depth_cameras_and_laboratories_have_other_axes() -> None:
    x = marks()
    _, expected, _ = played(x)
    camera, lab = x * [1.0, -1.0, -1.0], x[..., [0, 2, 1]] * [1.0, -1.0, 1.0]
    assert np.allclose(played(camera, up="-y")[1], expected, atol=1e-9)
    assert np.allclose(played(lab, up="z")[1], expected, atol=1e-9)


def test_what_shows_no_body_is_refused() -> None:
    with pytest.raises(InputError, match="at least 5 points of a body"):
        played(np.zeros((3, 4, 3)), ("head", "tail", "wing", "beak"))
    with pytest.raises(ParameterError, match="landmarks"):
        played(marks(), landmarks={"tail": ("head",)})


BONES_BY_WHERE_THEY_END = {
    "LeftUpperArm": "LeftArm",
    "LeftLowerArm": "LeftForeArm",
    "LeftUpperLeg": "LeftUpLeg",
    "LeftLowerLeg": "LeftLeg",
}
BONES_BY_WHERE_THEY_BEGIN = {
    "LeftShoulder": "LeftCollar",
    "LeftUpperArm": "LeftShoulder",
    "LeftLowerArm": "LeftElbow",
    "LeftHand": "LeftWrist",
    "LeftUpperLeg": "LeftHip",
    "LeftLowerLeg": "LeftKnee",
    "LeftFoot": "LeftAnkle",
}


@pytest.mark.parametrize("names", [BONES_BY_WHERE_THEY_END, BONES_BY_WHERE_THEY_BEGIN])
def test_other_skeletons_become_humanoid(names: dict[str, str]) -> None:
    names = names | {k.replace("Left", "Right"): v.replace("Left", "Right") for k, v in names.items()}
    other = JointTree(tuple(names.get(b, b) for b in BONES), TREE.parents, TREE.offsets)
    found = find_bones(other.joints)
    assert set(found) == set(PARENTS) and all(found[bone] == name for bone, name in names.items())
    tree, poses = to_humanoid(other, POSES)
    assert np.allclose(joints_of(tree, poses)[1], JOINTS, atol=1e-9)


def test_a_model_is_trained_by_the_command_and_corrects_what_markers_do_not_show(tmp_path: Path) -> None:
    twisted = POSES.copy()  # the hands are turned by half a radian, which no marker shows
    for side in ("Left", "Right"):
        at = 3 + 4 * BONES.index(f"{side}Hand")
        twisted[:, at], twisted[:, at + 1] = np.cos(0.25), np.sin(0.25)
    spec = TREE.spec(RATE)
    series = [Series("walk", spec, grid(RATE, N), twisted)]
    write_recording(tmp_path / "walk.mcap", series, {})
    with succeeding():
        cli.call(
            "motion train pose", [str(tmp_path / "walk.mcap"), "-o", str(tmp_path / "pose.npz"), "--centres", "50"]
        )
    hand = 3 + 4 * BONES.index("LeftHand")
    with_model, _, quality = played(marks(), model=tmp_path / "pose.npz", calibrate_s=0.0)
    assert np.abs(played(marks(), calibrate_s=0.0)[0][60:, hand : hand + 4] - twisted[60:, hand : hand + 4]).max() > 0.2
    assert np.abs(with_model[60:, hand : hand + 4] - twisted[60:, hand : hand + 4]).max() < 0.1
    assert quality[60:, QUALITY + 3].max() < 1.0
    few = tuple(n for n in USUAL if n != "head")
    with pytest.raises(ParameterError, match="has no head"):
        played(marks(few), few, model=tmp_path / "pose.npz")


def test_the_shipped_avatar_follows_the_performer(tmp_path: Path) -> None:
    quick = ("--set", "performer.realtime=false", "--set", "performer.duration_s=12", "--set", "vmc.port=9")
    with succeeding():
        cli.call("run", ["avatar_markers", "-o", str(tmp_path / "run"), "--view", "lines", *quick])
    with Recording.open(tmp_path / "run") as recording:
        true, made = (recording.read(name)[1] for name in ("performer.pose", "body.pose"))
        hidden = np.isnan(recording.read("performer.markers")[1]).any(axis=(1, 2))
    assert len(made) == 360 and np.isfinite(made).all() and hidden.sum() > 10
    apart = np.linalg.norm(joints_of(TREE, true)[1] - joints_of(TREE, made)[1], axis=-1)
    assert np.median(apart[60:][~hidden[60:]]) < 0.03 and apart[60:][~hidden[60:]].mean() < 0.06
