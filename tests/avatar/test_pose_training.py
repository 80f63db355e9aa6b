"""`kinegraph motion train pose` on what its importers make of AMC and C3D files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.formats.timing import grid_of
from kinegraph.operators.pose.from_markers import solved
from kinegraph.operators.pose.landmarks import NAMES, USUAL
from kinegraph.operators.pose.learn import learn_pose, lesson_of, lessons_of, scale_of
from kinegraph.operators.pose.regions_kernel import shown_by_region
from kinegraph.stream.chunk import Samples, StreamSpec, grid
from kinegraph.stream.cli import main as cli
from kinegraph.stream.data.model_file import ModelError, read_model, write_model
from kinegraph.stream.domain.humanoid import BONES as HUMANOID
from kinegraph.stream.domain.humanoid import find_bones, to_humanoid
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.avatar.test_whole_pose import POSES, RATE, TREE, N, marks, played
from tests.support.command_line import call_command, succeeding
from tests.support.real import needs_data

DATA = Path(os.environ.get("KINEGRAPH_DATA", "/nowhere"))
SIDES = {"l": 1.0, "r": -1.0}
BONES = {
    "lowerback": ("root", (0, 1, 0), 4), "thorax": ("lowerback", (0, 1, 0), 5), "lowerneck": ("thorax", (0, 1, 0), 3),
    "upperneck": ("lowerneck", (0, 1, 0), 2), "head": ("upperneck", (0, 1, 0), 3),
    **{f"{s}clavicle": ("thorax", (x, 0.2, 0), 3) for s, x in SIDES.items()},
    **{f"{s}humerus": (f"{s}clavicle", (x, 0, 0), 5) for s, x in SIDES.items()},
    **{f"{s}radius": (f"{s}humerus", (x, 0, 0), 5) for s, x in SIDES.items()},
    **{f"{s}hand": (f"{s}radius", (x, 0, 0), 2) for s, x in SIDES.items()},
    **{f"{s}hipjoint": ("root", (x, -0.5, 0), 2) for s, x in SIDES.items()},
    **{f"{s}femur": (f"{s}hipjoint", (0, -1, 0), 8) for s in SIDES},
    **{f"{s}tibia": (f"{s}femur", (0, -1, 0), 8) for s in SIDES},
    **{f"{s}foot": (f"{s}tibia", (0, -0.2, 1), 2) for s in SIDES},
    **{f"{s}toes": (f"{s}foot", (0, 0, 1), 1) for s in SIDES},
}  # fmt: skip
"""A body as Acclaim files of CMU have it: by bone its parent, direction and length (in 0.45 of an inch)."""
STIFF = ("lhipjoint", "rhipjoint")


def acclaim(folder: Path, frames: int = 90) -> list[Path]:
    """Somebody who bends every joint a little, at 30 Hz."""
    bones = "".join(
        f"begin\nname {name}\ndirection {' '.join(map(str, way))}\nlength {long}\naxis 0 0 0 XYZ\n"
        f"{'' if name in STIFF else 'dof rx ry rz'}\nend\n"
        for name, (_, way, long) in BONES.items()
    )
    links = "".join(f"{parent} {name}\n" for name, (parent, _, _) in BONES.items())
    (folder / "9.asf").write_text(
        ":units\nlength 0.45\nangle deg\n:root\norder TX TY TZ RX RY RZ\naxis XYZ\nposition 0 0 0\norientation 0 0 0\n"
        f":bonedata\n{bones}:hierarchy\nbegin\n{links}end\n"
    )
    lines = [":FULLY-SPECIFIED", ":DEGREES"]
    for k in range(frames):
        lines += [str(k + 1), f"root 0 17 {0.2 * k} 0 {k} 0"]
        turns = 20 * np.sin(0.1 * k + np.arange(3 * len(BONES))).reshape(-1, 3)
        lines += [
            f"{name} {' '.join(f'{x:.4f}' for x in turn)}"
            for name, turn in zip(BONES, turns, strict=True)
            if name not in STIFF
        ]
    (folder / "9_01.amc").write_text("\n".join(lines))
    return [folder / "9.asf", folder / "9_01.amc"]


def kinegraph(*arguments: object) -> None:
    with succeeding():
        call_command(*arguments)


def test_acclaim_files_give_poses_to_learn_from(tmp_path: Path) -> None:
    kinegraph("files", "import", *acclaim(tmp_path), "--rate", "9_01=30", "-o", tmp_path / "a.mcap")
    with Recording.open(tmp_path / "a.mcap") as recording:
        tree = JointTree.of(recording.streams["9_01.pose"].spec)
        poses, ends = recording.read("9_01.pose")[1], recording.read("9_01")[1]
    body, made = to_humanoid(tree, poses)
    joints = joints_of(body, made)[1]
    for bone in ("LeftHand", "RightFoot", "LeftLowerLeg"):
        begins = BONES[find_bones(tree.joints)[bone]][0]
        at = ends[:, ["root", *BONES].index(begins)] / 100.0
        assert np.abs(joints[:, list(body.joints).index(bone)] - at).max() < 1e-6
    kinegraph("motion", "train", "pose", tmp_path / "a.mcap", "-o", tmp_path / "pose.npz", "--centres", "50")
    model = read_model(tmp_path / "pose.npz", "pose")
    assert model.header["trained_on"] == ["a: 9_01.pose"] and model.header["landmarks"] == list(USUAL)


def c3d(path: Path, names: tuple[str, ...], *, up: str = "z", labels: tuple[str, ...] = ()) -> Path:
    ezc3d = pytest.importorskip("ezc3d")
    points = marks(names) if up == "y" else marks(names)[..., [0, 2, 1]] * [1.0, -1.0, 1.0]
    made = ezc3d.c3d()
    made["parameters"]["POINT"]["RATE"]["value"] = [RATE]
    made["parameters"]["POINT"]["LABELS"]["value"] = labels or names
    made["parameters"]["POINT"]["UNITS"]["value"] = ("mm",)
    rows = np.ones((4, len(names), N))
    rows[:3] = 1000.0 * points.transpose(2, 1, 0)
    rows[:3, 0, 100:105] = np.nan
    made["data"]["points"] = rows
    made.write(str(path))
    return path


@pytest.mark.parametrize("up", ["z", "y"])
def test_c3d_files_that_show_more_than_the_model_will_see_give_poses_to_learn_from(up: str, tmp_path: Path) -> None:
    file = c3d(tmp_path / "walk.c3d", (*NAMES[:13], "toe_l", "toe_r", "hand_l", "hand_r", "neck", "root"), up=up)
    kinegraph("files", "import", file, "-o", tmp_path / "walk.mcap")
    kinegraph("motion", "train", "pose", tmp_path / "walk.mcap", "-o", tmp_path / "pose.npz", "--centres", "50")
    assert len(read_model(tmp_path / "pose.npz", "pose").header["trained_on"]) == 1
    truth = played(marks((*USUAL, "toe_l", "toe_r")), (*USUAL, "toe_l", "toe_r"), calibrate_s=0.0)[1]
    made = played(marks(), model=tmp_path / "pose.npz", calibrate_s=0.0)[1]
    assert np.linalg.norm(made[60:] - truth[60:], axis=-1).mean() < 0.02


@pytest.mark.parametrize("columns", [[0, 1, 2], [0, 2, 1]], ids=["y", "z"])
def test_poses_of_markers_stand_upright_whichever_axis_points_up(columns: list[int]) -> None:
    names = (*NAMES[:13], "toe_l", "toe_r", "hand_l", "hand_r", "neck", "root")
    marked = marks(names)[..., columns] * ([1.0, 1.0, 1.0] if columns[1] == 1 else [1.0, -1.0, 1.0])
    spec = StreamSpec((len(names), 3), rate_hz=RATE, channels=names, units=("m",))
    poses = solved(spec, grid(RATE, N), marked, np.arange(13))
    assert isinstance(poses, np.ndarray)
    up = 1.0 - 2.0 * (poses[:, 4] ** 2 + poses[:, 6] ** 2)  # y of the hips' own y axis
    assert (up > 0.9).all()


def test_a_c3d_file_that_shows_no_more_than_the_model_will_see_teaches_nothing(tmp_path: Path) -> None:
    kinegraph("files", "import", c3d(tmp_path / "walk.c3d", USUAL), "-o", tmp_path / "walk.mcap")
    with pytest.raises(KinegraphError, match="no markers that show more"):
        cli.call("motion train pose", [str(tmp_path / "walk.mcap"), "-o", str(tmp_path / "pose.npz")])


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[str, str]:
    """What is said of each stream that is left out, and the error."""
    with pytest.raises(KinegraphError) as raised:
        cli.call("motion train pose", [*map(str, arguments)])
    return capsys.readouterr().err, str(raised.value)


def test_positions_of_no_unit_teach_nothing_and_the_cure_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They were taken for metres: a BVH file in cm gave a body of 170 m."""
    names = (*USUAL, "toe_l", "toe_r")
    rows = marks(names).reshape(N, -1)
    spec = StreamSpec((len(names), 3), rate_hz=RATE, channels=names)
    write_recording(
        tmp_path / "a.mcap", [Series("dance", spec, grid_of(RATE, np.arange(N), 0), rows.reshape(N, -1, 3))], {}
    )
    output, why = refused(capsys, tmp_path / "a.mcap", "-o", tmp_path / "pose.npz")
    assert "a: dance: its positions have no unit; import it again with --unit dance=cm" in output
    assert "no stream of poses" in why and not (tmp_path / "pose.npz").exists()


def test_what_markers_lack_is_said_and_points_can_be_given_for_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    called = {"head": "TOP", "knee_l": "GENOU_G", "hip_l": "HANCHE_G"}
    names = (*USUAL, "toe_l", "toe_r", "neck")
    file = c3d(tmp_path / "walk.c3d", names, labels=tuple(called.get(name, name) for name in names))
    kinegraph("files", "import", file, "-o", tmp_path / "walk.mcap")
    training = (tmp_path / "walk.mcap", "-o", tmp_path / "pose.npz", "--centres", "50")
    output, _ = refused(capsys, *training)
    assert "walk.markers: it shows no hip_l, knee_l, head; --markers says" in output
    given = [word for name, label in called.items() for word in ("--landmark", f"{name}={label}")]
    for wrong, why in (
        ("hip_x=TOP", "no landmark 'hip_x'"),
        ("head=TOPP", "no stream has a point 'TOPP'; did you mean 'TOP'"),
        ("head=", "names no points"),
    ):
        assert why in refused(capsys, *training, "--landmark", wrong)[1]
    kinegraph("motion", "train", "pose", *training, *given)
    assert read_model(tmp_path / "pose.npz", "pose").header["landmarks"] == list(USUAL)


@needs_data
def test_a_real_c3d_file_of_a_person_gives_a_model(tmp_path: Path) -> None:
    pytest.importorskip("ezc3d")
    kinegraph("files", "import", DATA / "steering" / "HDM_dg_06-03_03_120.c3d", "-o", tmp_path / "walk.mcap")
    kinegraph("motion", "train", "pose", tmp_path / "walk.mcap", "-o", tmp_path / "pose.npz", "--centres", "50")
    assert len(read_model(tmp_path / "pose.npz", "pose").header["trained_on"]) == 1


def test_a_pose_is_learned_as_it_is_and_in_a_mirror() -> None:
    chosen, sides = np.arange(len(USUAL)), [NAMES.index(other_side(name)) for name in USUAL]
    one, other = lessons_of(TREE, POSES, chosen)
    assert np.array_equal(one.features, lesson_of(TREE, POSES, chosen).features)
    flipped = one.features.reshape(N, -1, 3)[:, sides] * [-1.0, 1.0, 1.0]
    assert np.abs(flipped.reshape(N, -1) - other.features).max() < 1e-9
    assert np.abs(other.targets[:, -3:] - one.targets[:, -3:] * [-1.0, 1.0, 1.0]).max() < 1e-9
    arm = slice(*shown_by_region(chosen)[1][1:3])
    other_arm = slice(*shown_by_region(chosen)[1][2:4])
    assert (
        np.abs(
            one.regional[:, arm].reshape(N, -1, 3) * [-1.0, 1.0, 1.0] - other.regional[:, other_arm].reshape(N, -1, 3)
        ).max()
        < 1e-9
    )


def other_side(name: str) -> str:
    return name.replace("_l", "_?").replace("_r", "_l").replace("_?", "_r")


@pytest.mark.parametrize(
    "few", [("head", "hip_l", "hip_r", "wrist_l", "ankle_l"), ("head", "neck", "nose", "wrist_l", "wrist_r"), NAMES]
)
def test_every_subset_of_the_landmarks_can_be_learned_from_and_played(few: tuple[str, ...], tmp_path: Path) -> None:
    chosen = np.array(sorted(NAMES.index(name) for name in few))
    learned = learn_pose(lessons_of(TREE, POSES, chosen), chosen, 50)
    names = tuple(NAMES[k] for k in chosen)
    path = tmp_path / "pose.npz"
    write_model(path, "pose", {"landmarks": list(names)}, {**learned, "landmarks": chosen, "offsets": TREE.offsets})
    poses = played(marks(names), names, model=path, calibrate_s=0.0)[0]
    assert np.isfinite(poses).all()


def test_limbs_do_together_what_they_were_never_seen_to_do_together(tmp_path: Path) -> None:
    """The wrists turn as the elbows bend, one arm at a time in the training, both at once live."""
    chosen, tree = np.arange(len(USUAL)), TREE
    arms = [[HUMANOID.index(f"{side}{bone}") for bone in ("LowerArm", "Hand")] for side in ("Left", "Right")]

    def bent(left: Samples, right: Samples) -> Samples:
        poses = np.tile(np.concatenate([tree.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(HUMANOID))]), (len(left), 1))
        turns = poses[:, 3:].reshape(len(left), -1, 4)
        for (lower, hand), angle, sign in zip(arms, (left, right), (1.0, -1.0), strict=True):
            turns[:, lower, 0], turns[:, lower, 2] = np.cos(angle / 2), -sign * np.sin(angle / 2)
            turns[:, hand, 0], turns[:, hand, 1] = np.cos(angle / 2), np.sin(angle / 2)
        return poses

    angle, still = np.linspace(0.0, 1.5, 90), np.zeros(90)
    lessons = [one for poses in (bent(angle, still), bent(still, angle)) for one in lessons_of(tree, poses, chosen)]
    path = tmp_path / "pose.npz"
    write_model(path, "pose", {}, {**learn_pose(lessons, chosen, 100), "landmarks": chosen, "offsets": tree.offsets})
    both = bent(angle, angle)
    made = played(marks(poses=both), model=path, calibrate_s=0.0, feet=False)[0][:, 3:].reshape(90, -1, 4)
    for _, hand in arms:
        off = np.degrees(
            2 * np.arccos(np.minimum(1.0, np.abs((made[:, hand] * both[:, 3:].reshape(90, -1, 4)[:, hand]).sum(-1))))
        )
        assert off.mean() < 15.0, off.mean()


def test_a_model_of_an_earlier_kinegraph_is_refused(tmp_path: Path) -> None:
    write_model(tmp_path / "pose.npz", "pose", {}, {"landmarks": np.arange(13), "centres": np.zeros((4, 39))})
    with pytest.raises(ModelError, match="made by an earlier kinegraph"):
        played(marks(), model=tmp_path / "pose.npz")


def test_a_training_for_noisy_markers_turns_less_with_them(tmp_path: Path) -> None:
    chosen, noise = np.arange(len(USUAL)), np.random.default_rng(5).normal(0.0, 0.03, (N, len(USUAL), 3))
    off = []
    for noise_m in (0.0, 0.03):
        path = tmp_path / f"{noise_m}.npz"
        learned = learn_pose(lessons_of(TREE, POSES, chosen, noise_m), chosen, 60)
        write_model(path, "pose", {}, {**learned, "landmarks": chosen, "offsets": TREE.offsets})
        made = played(marks() + noise, model=path, calibrate_s=0.0)[0]
        dot = np.abs((made[:, 3:].reshape(N, -1, 4) * POSES[:, 3:].reshape(N, -1, 4)).sum(-1))
        off.append(np.arccos(np.minimum(1.0, dot)).mean())
    assert off[1] < off[0]


@pytest.mark.parametrize("seed", range(4))
def test_a_region_that_never_moves_has_no_width(seed: int) -> None:
    """What rounding makes of squared distances was its width once, so that the least movement later was out of all it had learned."""
    still = np.repeat(np.random.default_rng(seed).normal(0.3, 1.0, (1, 9)), 50, axis=0)
    moved = np.random.default_rng(seed + 10).normal(size=still.shape)
    assert scale_of(still + 1e-8 * moved, 1.0) == 0.0
    assert 1e3 < scale_of(still + 1e-3 * moved, 1.0) < 1e6
