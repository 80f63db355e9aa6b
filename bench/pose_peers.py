"""`python -m bench.pose_peers FOLDER`: markers to limbs on unseen people, beside kalidokit's solver and plain inverse kinematics.

FOLDER is that of bench.pose. Everybody gets the same 13 landmarks without noise; subjects are left out of our training one after the other.
kalidokit (npm, MIT) solves no shoulders, hands, neck or feet, so only elbows, wrists, knees and ankles count, and the directions of the
eight bones between them; the hips are where they are in truth. It expects BlazePose's landmarks of somebody before a camera: sequences are
turned so that their mean heading faces it, and once more so that every single frame does, which is the best case for it. Its trunk is
damped as in its own example (hips .7, spine .45, chest .25). How its axes and sides lie on our skeleton is not documented: the one of
all 16 ways counts that has the least error in the tested sequences, which flatters it a little.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bench.engines import EngineError
from bench.pose import FOLDS, _constant, marks_of, model_at, played, sequences
from kinegraph.operators.pose.landmarks import NAMES, USUAL
from kinegraph.operators.pose.learn import lessons_of
from kinegraph.operators.pose.operator import WholePose
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.skeleton import JointTree, joints_of

VERSION = "1.1.5"
SOLVER = Path(__file__).parent / "contenders" / "kalidokit.mjs"
SIDES = ("Left", "Right")
ENDS = [f"{s}{b}" for s in SIDES for b in ("LowerArm", "Hand", "LowerLeg", "Foot")]
SOLVED = [f"{s}{b}" for part in ("Arm", "Leg") for s in SIDES for b in (f"Upper{part}", f"Lower{part}")]
DAMPED = {"Hips": 0.7, "Spine": 0.45, "Chest": 0.25}
BLAZE = {"shoulder": 11, "elbow": 13, "wrist": 15, "hip": 23, "knee": 25, "ankle": 27}
"""Landmarks of the left side; those of the right have the next number."""


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.pose_peers", description=__doc__)
    parser.add_argument("folder", type=Path)
    tree, motion = sequences(parser.parse_args().folder)
    truth = [poses for fold in FOLDS for key, poses in motion.items() if key[:2] in fold]
    print("13 landmarks, unseen subjects | joints of limbs, cm | directions of limbs, deg | us a frame, median | p99")
    ours(tree, motion)
    with tempfile.TemporaryDirectory() as folder:
        try:
            library = fetched(Path(folder))
        except EngineError as error:
            print(f"left out: {error}")
            return
        for title, turned in (("mean heading to the camera", _mean_turn), ("every frame to the camera", _turns)):
            solved = [kalidokit(library, Path(folder), tree, poses, turned(tree, poses)) for poses in truth]
            found = min(
                (_row(tree, [(make(*way), us) for make, us in solved], truth) for way in ways()), key=lambda row: row[0]
            )
            _tell(f"kalidokit {VERSION}, {title}", found)


def ways() -> list[tuple[bool, tuple[float, ...]]]:
    """Whether left and right are exchanged, and the signs of a turn's x, y and z."""
    return list(product((False, True), product((1.0, -1.0), repeat=3)))


def ours(tree: JointTree, motion: dict[str, Samples]) -> None:
    """The trained model and the plain geometry, as in bench.pose."""
    chosen = np.array(sorted(NAMES.index(name) for name in USUAL), np.int64)
    made: dict[str, list[tuple[Samples, Samples]]] = {"kinegraph, trained": [], "plain inverse kinematics": []}
    truth = []
    with tempfile.TemporaryDirectory() as folder:
        for unseen in FOLDS:
            lessons = [
                one for key, p in motion.items() if key[:2] not in unseen for one in lessons_of(tree, p, chosen, 0.0)
            ]
            models = (
                model_at(Path(folder) / "pose.npz", tree, lessons, chosen, 500),
                model_at(Path(folder) / "plain.npz", tree, [_constant(one) for one in lessons], chosen, 50),
            )
            for poses in (p for key, p in motion.items() if key[:2] in unseen):
                truth.append(poses)
                for rows, model in zip(made.values(), models, strict=True):
                    took = played(WholePose(model=model, calibrate_s=0.0), USUAL, marks_of(tree, poses)[:, chosen])
                    rows.append(took)
    for name, rows in made.items():
        _tell(name, _row(tree, rows, truth))


def fetched(folder: Path) -> Path:
    """kalidokit's file. Raises EngineError where npm or the package is not to be had."""
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        raise EngineError("kalidokit: needs node and npm")
    done = subprocess.run(
        [npm, "install", "--silent", "--prefix", str(folder), f"kalidokit@{VERSION}"], capture_output=True, text=True
    )
    if done.returncode:
        raise EngineError(f"kalidokit: does not install ({done.stderr.strip().splitlines()[-1:]})")
    return folder / "node_modules" / "kalidokit" / "dist" / "kalidokit.umd.js"


def kalidokit(
    library: Path, folder: Path, tree: JointTree, poses: Samples, facing: Rotation
) -> tuple[Callable[..., Samples], Samples]:
    """A function that gives its poses on our skeleton, by how axes and sides lie; and how long each frame took (us)."""
    marks = marks_of(tree, poses) - poses[:, None, :3]
    seen = np.stack([facing.apply(marks[:, k]) for k in range(len(NAMES))], axis=1)
    world, image = np.zeros((len(poses), 33, 3)), np.zeros((len(poses), 33, 2))
    for joint, number in BLAZE.items():
        for side, name in enumerate((f"{joint}_l", f"{joint}_r")):
            world[:, number + side] = seen[:, NAMES.index(name)] * [1.0, -1.0, -1.0]
    world -= world[:, 23:25].mean(axis=1, keepdims=True)
    world[:, 17:23] = world[:, 15:21:1][:, [0, 1, 0, 1, 0, 1]]
    image[:] = 0.5 + 0.4 * world[:, :, :2]
    given, made = folder / "given.bin", folder / "made.bin"
    rows = np.hstack([world.reshape(len(poses), -1), image.reshape(len(poses), -1)])
    given.write_bytes(np.concatenate([[float(len(poses))], rows.ravel()]).tobytes())
    subprocess.run(["node", str(SOLVER), str(library), str(given), str(made)], check=True)
    table = np.frombuffer(made.read_bytes()).reshape(len(poses), 31)
    return (lambda swapped, signs: _posed(tree, poses, table, facing, swapped, np.array(signs))), table[:, 30]


def _posed(tree: JointTree, poses: Samples, table: Samples, facing: Rotation, swapped: bool, signs: Samples) -> Samples:
    """Poses of Euler angles in a row of the solver's."""
    made = np.zeros((len(poses), tree.width))
    made[:, :3], made[:, 3::4] = poses[:, :3], 1.0
    other = {"Left": "Right", "Right": "Left"}
    columns = {"Hips": 0, "Spine": 1, "Chest": 1, **{bone: 2 + k for k, bone in enumerate(SOLVED)}}
    for bone, k in columns.items():
        side = next((s for s in SIDES if swapped and bone.startswith(s)), "")
        goal = tree.joints.index(other[side] + bone[len(side) :] if side else bone)
        turn = Rotation.from_euler("XYZ", DAMPED.get(bone, 1.0) * table[:, 3 * k : 3 * k + 3])
        x, y, z, w = (turn.as_quat() * [*signs, 1.0]).T
        if bone == "Hips":
            x, y, z, w = (facing.inv() * Rotation.from_quat(np.stack([x, y, z, w], axis=1))).as_quat().T
        made[:, 3 + 4 * goal : 7 + 4 * goal] = np.stack([w, x, y, z], axis=1)
    return made


def _turns(tree: JointTree, poses: Samples) -> Rotation:
    """The turn about the vertical that has every frame face z."""
    marks = marks_of(tree, poses)
    ends = [[NAMES.index(f"{joint}_{side}") for joint in ("shoulder", "hip")] for side in "lr"]
    left = marks[:, ends[0]].sum(axis=1) - marks[:, ends[1]].sum(axis=1)
    return Rotation.from_rotvec(np.outer(np.arctan2(left[:, 2], left[:, 0]), [0.0, 1.0, 0.0]))


def _mean_turn(tree: JointTree, poses: Samples) -> Rotation:
    """The turn about the vertical that has the frames face z in the mean."""
    angles = _turns(tree, poses).as_rotvec()[:, 1]
    mean = np.angle(np.exp(1j * angles).mean())
    return Rotation.from_rotvec(np.outer(np.full(len(poses), mean), [0.0, 1.0, 0.0]))


def _row(tree: JointTree, made: Sequence[tuple[Samples, Samples]], truth: Sequence[Samples]) -> tuple[float, ...]:
    """Mean distance (cm) and angle (deg), median and p99 of a frame's time (us), over all frames."""
    ends = [tree.joints.index(bone) for bone in ENDS]
    starts = [int(tree.parents[j]) for j in ends]
    off, angle = [], []
    for (poses, _), true in zip(made, truth, strict=True):
        (a, b) = (joints_of(tree, p)[1] for p in (poses, true))
        off.append(np.linalg.norm(a[:, ends] - b[:, ends], axis=-1))
        u, v = (p[:, ends] - p[:, starts] for p in (a, b))
        cosine = (u * v).sum(-1) / (np.linalg.norm(u, axis=-1) * np.linalg.norm(v, axis=-1))
        angle.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    took = np.concatenate([us for _, us in made])
    return (
        100.0 * float(np.concatenate(off).mean()), float(np.concatenate(angle).mean()),
        float(np.median(took)), float(np.quantile(took, 0.99)),
    )  # fmt: skip


def _tell(name: str, row: Sequence[float]) -> None:
    print(f"{name} | {row[0]:.2f} | {row[1]:.1f} | {row[2]:.0f} | {row[3]:.0f}", flush=True)


if __name__ == "__main__":
    main()
