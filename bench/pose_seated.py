"""`python -m bench.pose_seated FOLDER`: somebody of whom a camera sees only the upper half, through WholePose and Footing with `seated`.

FOLDER is that of bench.pose: motion capture of the CMU database on one skeleton, all sequences. The legs' markers are never seen, with and
without the hips; with noise the markers go through a One Euro filter (2 Hz, beta 1). Errors are of hips, spine, head and arms: places
from the hips, rotations in the world, as the avatar has them before it is turned to the front.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from bench.pose import RATE, filtered, marks_of, sequences
from kinegraph.operators.pose.footing import Footing
from kinegraph.operators.pose.landmarks import NAMES, USUAL
from kinegraph.operators.pose.operator import WholePose
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.operator import grid

HIPS = tuple(name for name in USUAL if name.startswith("hip"))
HANDS_UP = tuple(name for name in USUAL if not name.startswith(("hip", "knee", "ankle")))
UPPER = [b for b, bone in enumerate(BONES) if "Leg" not in bone and "Foot" not in bone and "Toes" not in bone]


def played(names: tuple[str, ...], marks: Samples) -> tuple[Samples, Samples]:
    """Poses of markers (n, m, 3) before and after they are put on a chair."""
    pose, footing = WholePose(calibrate_s=0.0), Footing(seated=True)
    specs = pose.open({"in": StreamSpec((len(names), 3), rate_hz=RATE, channels=names, units=("m",))})
    footing.open(dict(specs))
    made = dict(
        pose.process("in", Chunk(grid(RATE, len(marks)), np.ascontiguousarray(marks.reshape(len(marks), -1)), 0))
    )
    for port in ("joints", "quality"):
        footing.process(port, made[port])
    return made["pose"].data, dict(footing.process("pose", made["pose"]))["out"].data


def errors(tree: JointTree, poses: Samples, truth: Samples) -> tuple[float, float]:
    """Of the upper half: mean distance of its joints (cm), seen from the hips, and mean angle of its bones (deg)."""
    (turns, joints), (true_turns, true_joints) = (joints_of(tree, one) for one in (poses, truth))
    apart = (joints - joints[:, :1])[:, UPPER] - (true_joints - true_joints[:, :1])[:, UPPER]
    cosines = np.abs((turns * true_turns)[:, UPPER].sum(axis=-1)).clip(0.0, 1.0)
    return 100 * float(np.linalg.norm(apart, axis=-1).mean()), float(np.degrees(2 * np.arccos(cosines)).mean())


def fastest(tree: JointTree, poses: Samples) -> float:
    """How fast a bone turns at most (rad/s)."""
    turns = joints_of(tree, poses)[0]
    return 2 * RATE * float(np.arccos(np.abs((turns[1:] * turns[:-1]).sum(axis=-1)).clip(0.0, 1.0)).max())


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.pose_seated", description=__doc__)
    parser.add_argument("folder", type=Path)
    tree, motion = sequences(parser.parse_args().folder)
    print("markers | noise mm | joints cm | bones deg | fastest bone on the chair, rad/s")
    for names in ((*HANDS_UP, *HIPS), HANDS_UP):
        chosen = [NAMES.index(name) for name in names]
        for noise in (0.0, 0.015, 0.03):
            rows, weights = [], []
            for poses in motion.values():
                marks = marks_of(tree, poses)[:, chosen]
                if noise:
                    marks = filtered(marks + np.random.default_rng(30).normal(0.0, noise, marks.shape))
                made, sitting = played(names, marks)
                rows.append((*errors(tree, made, poses), fastest(tree, sitting)))
                weights.append(len(poses))
            cm, deg = np.average(np.array(rows)[:, :2], axis=0, weights=weights)
            print(
                f"{len(names)} | {1000 * noise:.0f} | {cm:.2f} | {deg:.1f} | {max(row[2] for row in rows):.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
