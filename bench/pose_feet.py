"""`python -m bench.pose_feet FOLDER`: whether feet that stand slide, and leap when they are lifted; of whole poses by geometry.

FOLDER is that of bench.pose: motion capture of the CMU database on one skeleton, all sequences, 13 markers, with noise on every coordinate
that a One Euro filter (2 Hz, beta 1) has seen. A foot truly stands while its ankle goes less than .3 cm a frame level, less than 3 cm
above its lowest places.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.pose import RATE, filtered, marks_of, sequences
from kinegraph.operators.pose.landmarks import NAMES, USUAL
from kinegraph.operators.pose.operator import WholePose
from kinegraph.stream.chunk import Array, Chunk, Samples, StreamSpec
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.operator import grid

NOISES_M = (0.0, 0.005, 0.015, 0.03)
STILL_M, LOW_M = 0.003, 0.03
CHOSEN = [NAMES.index(name) for name in USUAL]
FEET = [BONES.index(f"{side}Foot") for side in ("Left", "Right")]


class FootSteps(NamedTuple):
    """Of all frames of feet: how far the ankle goes level from frame to frame (m); how much farther it goes than the true one (m); whether
    the pose says that it stands, and is just released; whether it truly stands."""

    slides: Samples
    leaps: Samples
    stands: Array
    released: Array
    truly: Array


def foot_steps(joints: Samples, stands: Samples, true: Samples) -> FootSteps:
    """Of joints (n, 22, 3), whether each foot stands (n, 2), and the true joints."""
    step, true_step = (np.diff(one[:, FEET], axis=0) for one in (joints, true))
    slides, true_slides = (np.linalg.norm(one[..., [0, 2]], axis=-1) for one in (step, true_step))
    leaps = np.linalg.norm(step, axis=-1) - np.linalg.norm(true_step, axis=-1)
    heights = true[:, FEET, 1]
    truly = (true_slides < STILL_M) & (heights[1:] < np.percentile(heights, 2, axis=0) + LOW_M)
    on: Array = stands > 0
    return FootSteps(slides, leaps, on[1:] & on[:-1], ~on[1:] & on[:-1], truly)


def played(marks: Samples) -> tuple[Samples, Samples]:
    """Joints of the poses of markers (n, 13, 3), and whether each foot stands."""
    operator = WholePose(calibrate_s=0.0)
    operator.open({"in": StreamSpec((len(CHOSEN), 3), rate_hz=RATE, channels=USUAL, units=("m",))})
    chunk = Chunk(grid(RATE, len(marks)), np.ascontiguousarray(marks.reshape(len(marks), -1)), 0)
    made = {name: part.data for name, part in operator.process("in", chunk)}
    return made["joints"], made["quality"][:, len(BONES) : len(BONES) + 2]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.pose_feet", description=__doc__)
    parser.add_argument("folder", type=Path)
    tree, motion = sequences(parser.parse_args().folder)
    print(
        "noise mm | reported as standing, % of truly | slides then, cm: mean, max | released | leaps then, cm: max | "
        "slides where truly, cm: mean, p95"
    )
    for noise in NOISES_M:
        of: list[FootSteps] = []
        for poses in motion.values():
            marks = marks_of(tree, poses)[:, CHOSEN]
            if noise:
                marks = filtered(marks + np.random.default_rng(30).normal(0.0, noise, marks.shape))
            of.append(foot_steps(*played(marks), joints_of(tree, poses)[1]))
        print(f"{1000 * noise:.0f} | {described(FootSteps(*map(np.concatenate, zip(*of, strict=True))))}")


def described(feet: FootSteps) -> str:
    """A row of the table."""
    then, where, leaps = (
        100 * one for one in (feet.slides[feet.stands], feet.slides[feet.truly], feet.leaps[feet.released])
    )
    slides = f"{then.mean():.4f}, {then.max():.2f}" if len(then) else "-"
    most = f"{leaps.max():.1f}" if len(leaps) else "-"
    return (
        f"{100 * feet.stands[feet.truly].mean():.0f} | {slides} | {len(leaps)} | {most} | {where.mean():.2f}, "
        f"{np.percentile(where, 95):.2f}"
    )


if __name__ == "__main__":
    main()
