"""Made-up motion of someone who walks, runs and jumps: one take, with a way from each to the others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinegraph.operators.maps.motion_graph.takes import TOES
from kinegraph.operators.synthesis.blend_kernel import blended, placed
from kinegraph.stream.chunk import Samples, grid
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.motion_made import RATE, TREE, bend, bent, walking

RUN_CYCLE, JUMP_CYCLE = 22, 40
"""Frames of a stride, and from one jump to the next."""
BETWEEN = 8
"""Frames in which one motion goes over into another."""


def running(cycles: int, turn_rad: float = 0.0) -> Samples:
    """Strides of a run at some 3 m/s, each turned by `turn_rad`, both feet in the air twice in each."""
    n = cycles * RUN_CYCLE
    phase = 2 * np.pi * np.arange(n) / RUN_CYCLE
    poses = bent(n)
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        swing = sign * np.sin(phase)
        lift = np.clip(sign * np.cos(phase), 0.0, None) ** 2
        bend(poses, f"{side}UpperLeg", 1, -0.6 * swing - 0.6 * lift)
        bend(poses, f"{side}LowerLeg", 1, 0.25 + 1.4 * lift)
        bend(poses, f"{side}Foot", 1, -0.1 + 0.35 * swing - 0.45 * lift)
        bend(poses, f"{side}UpperArm", 3, np.full(n, -sign * 1.3))
        bend(poses, f"{side}LowerArm", 2, -sign * (1.4 + 0.3 * np.sin(phase)))
    bend(poses, "Spine", 1, np.full(n, 0.15))
    bend(poses, "Hips", 2, turn_rad * np.arange(n) / RUN_CYCLE)
    poses[:, 0] = poses[:, 2] = 0.0
    toes = joints_of(TREE, poses)[1][:, TOES]
    lower = toes[:, :, 1].argmin(axis=1)
    move = np.array([toes[i, lower[i]] - toes[i + 1, lower[i]] for i in range(n - 1)])
    poses[1:, [0, 2]] += np.cumsum(move[:, [0, 2]], axis=0)
    poses[:, 1] -= toes[:, :, 1].min(axis=1) - 0.02 - 0.08 * np.sin(phase) ** 2
    return poses


def jumping(cycles: int) -> Samples:
    """Jumps on the spot, arms up, from one standing pose back to it."""
    n = cycles * JUMP_CYCLE
    phase = 2 * np.pi * np.arange(n) / JUMP_CYCLE
    poses = bent(n)
    crouch = 0.7 * np.sin(phase) ** 2
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        bend(poses, f"{side}UpperLeg", 1, -crouch)
        bend(poses, f"{side}LowerLeg", 1, 2.0 * crouch)
        bend(poses, f"{side}Foot", 1, -crouch)
        bend(poses, f"{side}UpperArm", 3, -sign * (1.3 - 0.9 * (1 - np.cos(phase))))
    toes = joints_of(TREE, poses)[1][:, TOES]
    poses[:, 1] -= toes[:, :, 1].min(axis=1) - 0.02 - 0.35 * np.clip(-np.cos(phase), 0.0, None) ** 2
    return poses


def joined(parts: Sequence[Samples]) -> Samples:
    """One part after the other, each placed where the one before ends and facing as it does, with some frames between."""
    made = [parts[0]]
    for part in parts[1:]:
        last, before = made[-1][-1], made[-1][-2]
        turn = _heading(last) - _heading(part[0])
        first = np.empty_like(last)
        placed(part[0], np.array([turn, 0.0, 0.0]), first)
        speed = 0.5 * (last - before)[[0, 2]] + 0.5 * _turned((part[1] - part[0])[[0, 2]], turn)
        shift = last[[0, 2]] + (BETWEEN + 1) * speed - first[[0, 2]]
        whole = np.empty_like(part)
        for i, pose in enumerate(part):
            placed(pose, np.array([turn, *shift]), whole[i])
        between = np.empty((BETWEEN, len(last)))
        for i in range(BETWEEN):
            blended(last, whole[0], (i + 1) / (BETWEEN + 1), between[i])
        made += [between, whole]
    return np.concatenate(made)


def _heading(pose: Samples) -> float:
    w, x, y, z = pose[3:7]
    return float(np.arctan2(2.0 * (w * y + x * z), 1.0 - 2.0 * (x * x + y * y)))


def _turned(x: Samples, turn: float) -> Samples:
    return np.array([x[0] * np.cos(turn) + x[1] * np.sin(turn), x[1] * np.cos(turn) - x[0] * np.sin(turn)])


CURVE = np.radians(30.0)


def athlete() -> tuple[Samples, list[tuple[str, float, float]]]:
    """Poses (n, 91) at 30 Hz of someone who walks, runs and jumps, straight on and to the left; and what is done from when to when (s)."""
    parts = {
        "walk": [walking(7, sway=0.1), walking(6, CURVE, sway=0.1)],
        "run": [running(8), running(7, CURVE), running(4)],
        "jump": [jumping(6)],
    }
    order = ["walk", "walk", "run", "run", "run", "jump", "walk", "run", "walk", "jump", "run"]
    again = {"walk": [walking(4), walking(3)], "run": [running(4), running(3)], "jump": [jumping(3)]}
    chosen, names = list[Samples](), list[str]()
    for name in order:
        chosen.append((parts[name] or again[name]).pop(0))
        names.append(name)
    begins = np.cumsum([0, *(len(part) + BETWEEN for part in chosen)]) / RATE
    when = [
        (name, begin, begin + (len(part) - 1) / RATE)
        for name, begin, part in zip(names, begins.tolist(), chosen, strict=False)
    ]
    return joined(chosen), when


def record_athlete(path: Path) -> list[tuple[str, float, float]]:
    """A recording of the athlete's poses; what is done from when to when (s)."""
    poses, when = athlete()
    write_recording(path, [Series("athlete.pose", TREE.spec(RATE), grid(RATE, len(poses), 0), poses)], {}, chunk_s=0.5)
    return when
