"""`python -m bench.pose FOLDER`: markers to whole poses on unseen people, beside the methods that it could be instead.

FOLDER holds cmu_mocap_30hz.npz and human_male.npz: motion capture of the CMU database as rotations on one skeleton. Subjects are left out
of the training one after the other. Every method gets the same landmarks: 13 (head, shoulders, elbows, wrists, hips, knees, ankles), 9 of
these (no elbows, no knees), and the 13 with 30 mm of noise on every coordinate, then a One Euro filter (2 Hz, beta 1).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from bench.avatar import SEEN, lag_of
from kinegraph.operators.filters.one_euro import OneEuro
from kinegraph.operators.pose.landmarks import BONE_OF, FROM_BONE, NAMES, USUAL
from kinegraph.operators.pose.learn import Lesson, learn_pose, lessons_of
from kinegraph.operators.pose.operator import WholePose
from kinegraph.operators.pose.solve_kernel import place_marks
from kinegraph.stream.chunk import Array, Chunk, Samples, StreamSpec
from kinegraph.stream.data.model_file import write_model
from kinegraph.stream.domain.humanoid import to_humanoid
from kinegraph.stream.domain.skeleton import JointTree, joints_of, local_poses
from kinegraph.stream.operator import grid

NINE = tuple(name for name in USUAL if not name.startswith(("elbow", "knee")))
FOLDS = (("13", "14"), ("03",), ("02",), ("01",))
RATE = 30.0
Row: TypeAlias = tuple[float, float, float, float, int]
LEFT_M = 0.015
"""What the filter leaves of the noise, of somebody who stands still (deviation): the training for noisy markers has so much of it."""


def sequences(folder: Path) -> tuple[JointTree, dict[str, Samples]]:
    """The skeleton of the body, in T-pose, and the poses of every sequence, by subject and number."""
    body, motion = np.load(folder / "human_male.npz"), np.load(folder / "cmu_mocap_30hz.npz")
    parents, heads = body["parents"], body["head"].astype(float)
    order = [int(np.flatnonzero(parents < 0)[0])]
    for j in order:
        order += np.flatnonzero(parents == j).tolist()
    place = {j: i for i, j in enumerate(order)}
    offsets = np.array([heads[j] - (heads[parents[j]] if parents[j] >= 0 else 0.0) for j in order])
    names = tuple(str(body["joint_names"][j]) for j in order)
    tree = JointTree(names, np.array([place.get(int(parents[j]), -1) for j in order]), offsets)
    made, humanoid = {}, tree
    for key in (name for name in motion.files if name.startswith("rot_")):
        turns = motion[key].astype(float)[:, order][..., [3, 0, 1, 2]]
        turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
        root = motion[key.replace("rot_", "root_")].astype(float)
        humanoid, made[key[4:]] = to_humanoid(tree, local_poses(tree, root, turns))
    return humanoid, made


def marks_of(tree: JointTree, poses: Samples) -> Samples:
    """Where all landmarks are in poses, (n, m, 3)."""
    turns, joints = joints_of(tree, poses)
    marks = np.zeros((len(poses), len(NAMES), 3))
    for i in range(len(poses)):
        place_marks(FROM_BONE, BONE_OF, turns[i], joints[i], np.ones(len(NAMES), np.bool_), marks[i])
    return marks


def played(operator: WholePose, names: Sequence[str], marks: Samples) -> tuple[Samples, Samples]:
    """The operator's poses of landmarks (n, m, 3), and how long each frame took (us), one frame a chunk."""
    spec = StreamSpec((len(names), 3), rate_hz=RATE, channels=tuple(names), units=("m",))
    operator.open({"in": spec})
    times, rows = grid(RATE, len(marks)), marks.reshape(len(marks), -1)
    made, took = [], np.empty(len(rows))
    for i in range(len(rows)):
        began = time.perf_counter()
        made.append(operator.process("in", Chunk(times[i : i + 1], rows[i : i + 1], int(times[i])))[0][1].data)
        took[i] = time.perf_counter() - began
    return np.concatenate(made), 1e6 * took


def filtered(marks: Samples) -> Samples:
    """Landmarks (n, m, 3) through the filter that a live graph has."""
    operator = OneEuro(cutoff_hz=2.0, beta=1.0)
    operator.open({"in": StreamSpec((marks.shape[1] * 3,), rate_hz=RATE)})
    made = operator.process("in", Chunk(grid(RATE, len(marks)), marks.reshape(len(marks), -1), 0))
    assert made is not None
    return np.asarray(made.data.reshape(marks.shape))


def errors(tree: JointTree, poses: Samples, truth: Samples) -> tuple[float, float]:
    """Mean distance of the joints (cm) and angle of the bones (deg)."""
    (turns, joints), (true_turns, true_joints) = joints_of(tree, poses), joints_of(tree, truth)
    angle = 2.0 * np.arccos(np.minimum(1.0, np.abs((turns * true_turns).sum(-1))))
    return 100.0 * float(np.linalg.norm(joints - true_joints, axis=-1).mean()), float(np.degrees(angle).mean())


def model_at(path: Path, tree: JointTree, lessons: Sequence[Lesson], chosen: Array, centres: int) -> Path:
    """A model as the command makes it."""
    learned = learn_pose(lessons, chosen, centres)
    header = {"landmarks": [NAMES[k] for k in chosen]}
    write_model(path, "pose", header, {**learned, "landmarks": chosen, "offsets": tree.offsets})
    return path


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.pose", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--centres", type=int, default=500)
    given = parser.parse_args()
    tree, motion = sequences(given.folder)
    print("unseen subjects | markers | method | joints cm | bones deg | us a frame | lag ms")
    totals: dict[tuple[str, str], list[Row]] = {}
    for unseen in FOLDS:
        for names, noise_m in ((USUAL, 0.0), (NINE, 0.0), (USUAL, 0.03)):
            what = f"{len(names)}{' noisy' if noise_m else ''}"
            for method, row in measured(tree, motion, unseen, names, noise_m, given.centres).items():
                print(f"{'+'.join(unseen)} | {what} | {method} | {described(row)}", flush=True)
                totals.setdefault((what, method), []).append(row)
    for (what, method), rows in totals.items():
        print(f"all | {what} | {method} | {described(_mean(rows))}")


def described(row: Row) -> str:
    return f"{row[0]:.3f} | {row[1]:.2f} | {row[2]:.0f} | {row[3]:.0f}"


def measured(
    tree: JointTree,
    motion: dict[str, Samples],
    unseen: Sequence[str],
    names: Sequence[str],
    noise_m: float,
    centres: int,
) -> dict[str, Row]:
    """Joint error (cm), bone error (deg), us a frame, lag (ms) and frames of every method."""
    chosen = np.array(sorted(NAMES.index(name) for name in names), np.int64)
    known = [poses for key, poses in motion.items() if key[:2] not in unseen]
    lessons = [one for poses in known for one in lessons_of(tree, poses, chosen, LEFT_M if noise_m else 0.0)]
    found: dict[str, list[Row]] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = model_at(Path(folder) / "pose.npz", tree, lessons, chosen, centres)
        body = model_at(Path(folder) / "body.npz", tree, [_constant(one) for one in lessons], chosen, 50)
        for key, poses in motion.items():
            if key[:2] not in unseen:
                continue
            marks = marks_of(tree, poses)[:, chosen]
            if noise_m:
                marks = filtered(marks + np.random.default_rng(30).normal(0.0, noise_m, marks.shape))
            for method, model in (("geometry, mean turns", body), ("kernel ridge, limbs", path)):
                operator = WholePose(model=model, calibrate_s=0.0)
                made, took = played(replace(operator), [NAMES[k] for k in chosen], marks)
                us = float(np.median(took))
                found.setdefault(method, []).append(
                    (*errors(tree, made, poses), us, lag_ms(tree, made, poses), len(poses))
                )
    return {method: _mean(rows) for method, rows in found.items()}


def _constant(lesson: Lesson) -> Lesson:
    """Targets without any dependence on the features: what remains is their mean, the plain geometry's usual turns."""
    return Lesson(
        lesson.features, lesson.regional, np.broadcast_to(lesson.targets.mean(axis=0), lesson.targets.shape).copy()
    )


def lag_ms(tree: JointTree, poses: Samples, truth: Samples) -> float:
    """By how much hands and feet of `poses` trail those of `truth`."""
    places = [joints_of(tree, one)[1][:, SEEN].reshape(len(one), -1) for one in (truth, poses)]
    return 1e3 * lag_of(places[0], places[1], RATE)


def _mean(rows: Sequence[Row]) -> Row:
    weight = np.array([row[4] for row in rows], float)
    cm, deg, us, lag = (float(np.average([row[k] for row in rows], weights=weight)) for k in range(4))
    return cm, deg, us, lag, int(weight.sum())


if __name__ == "__main__":
    main()
