"""What a region of the body shows by itself, and the regression from the whole body and from its regions to what markers do not show."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kinegraph.operators.pose.landmarks import NAMES
from kinegraph.operators.pose.limb_kernel import (
    ANKLE_AT,
    ARM,
    ELBOW_AT,
    HAND_AT,
    HEAD_AT,
    HIP_AT,
    HIPS,
    KNEE_AT,
    SHOULDER_AT,
    SIDE,
    THIGH,
    TOE_AT,
    UPPER_CHEST,
    WRIST_AT,
)
from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.skeleton import turn
from kinegraph.stream.kernel import kernel

REGIONS = 5
"""Trunk, left arm, right arm, left leg, right leg."""
LOW, HIGH = -1, -2
"""The middles of hips and shoulders, in the places of landmarks."""


class Corrections(NamedTuple):
    """A regression: for c poses of the training, m landmarks, of which k stand in `shown`.

    chosen    (m,)      the landmarks
    centres   (3 m, c)  the poses, as seen from the body
    scales    (6,)      1 / (2 width^2): of the whole body, of each region
    shown     (k, 3)    a landmark, the one that it is seen from, the bone that it is seen with
    regional  (3 k, c)  the poses as the regions have them
    ends      (6,)      between which columns of `regional` each region lies
    ranks     (6,)      between which columns of the weights
    weights (c, r), basis (r, 135), mean (135,)
    x (3 m,), own (3 k,), near (2, c), few (r,), predicted (135,)  room
    """

    chosen: Times
    centres: Samples
    scales: Samples
    shown: Times
    regional: Samples
    ends: Times
    ranks: Times
    weights: Samples
    basis: Samples
    mean: Samples
    x: Samples
    own: Samples
    near: Samples
    few: Samples
    predicted: Samples


def shown_by_region(chosen: Times) -> tuple[Times, Times]:
    """What the landmarks `chosen` show of each region: `shown` and `ends` of `Corrections`."""
    there = set(chosen.tolist())
    rows = [(HIGH, LOW, HIPS)]
    if {SHOULDER_AT, SHOULDER_AT + 1} <= there:
        rows.append((SHOULDER_AT, SHOULDER_AT + 1, HIPS))
    rows += [(k, HIGH, UPPER_CHEST) for k in range(HEAD_AT, len(NAMES)) if k in there and NAMES[k] in _HEAD]
    ends = [0, 3 * len(rows)]
    for root, start, bone, places in (
        (SHOULDER_AT, HIGH, UPPER_CHEST, (ELBOW_AT, WRIST_AT, HAND_AT)),
        (HIP_AT, LOW, HIPS, (KNEE_AT, ANKLE_AT, TOE_AT)),
    ):
        for side in range(2):
            seen_from = root + side if root + side in there else start
            rows += [(at + side, seen_from, bone) for at in places if at + side in there]
            ends.append(3 * len(rows))
    return np.array(rows, np.int64), np.array(ends, np.int64)


_HEAD = ("head", "neck", "nose", "ear_l", "ear_r")


def numbers_of(region: int) -> list[int]:
    """Which numbers of a prediction (135,) a region says: six for each of its bones; the trunk says where the hips are, too."""
    arm, leg = range(ARM - 1, ARM - 1 + SIDE), range(THIGH, THIGH + SIDE)
    bones = [range(ARM - 1), arm, [b + SIDE for b in arm], leg, [b + SIDE for b in leg]][region]
    return [6 * b + k for b in bones for k in range(6)] + [6 * len(BONES) + k for k in range(3) if region == 0]


@kernel
def regional_of(
    marks: Samples, shown: Times, low: Samples, high: Samples, turns: Samples, size: float, out: Samples, work: Samples
) -> None:
    """Landmarks (m, 3) as each region has them, into `out` (3 k,): from its own root, with its own bone, divided by the body's size.

    `work` (2, 4) is room; `low` and `high` (3,) lie elsewhere.
    """
    for k in range(shown.shape[0]):
        at, root, bone = shown[k, 0], shown[k, 1], shown[k, 2]
        for a in range(3):
            end = marks[at, a] if at >= 0 else high[a]
            start = marks[root, a] if root >= 0 else (low[a] if root == LOW else high[a])
            work[0, a] = (end - start) / size
            work[1, 1 + a] = -turns[bone, 1 + a]
        work[1, 0] = turns[bone, 0]
        turn(work[1], work[0, :3], out[3 * k : 3 * k + 3])


@kernel
def regress(s: Corrections) -> float:
    """predicted = mean + (sum over centres of (whole + own) weights) basis, with the Gaussians of the whole body and of a region by itself.

    From `x` and `own` into `predicted`. Returns the least squared distance of `x` from a centre.
    """
    whole, near = s.near[0], s.near[1]
    add_squares(s.x, s.centres, 0, s.x.shape[0], whole)
    least = math.inf
    for c in range(whole.shape[0]):
        least = min(least, whole[c])
        whole[c] = math.exp(-s.scales[0] * whole[c])
    s.few[:] = 0.0
    for region in range(s.ends.shape[0] - 1):
        add_squares(s.own, s.regional, s.ends[region], s.ends[region + 1], near)
        for c in range(near.shape[0]):
            g = whole[c] + math.exp(-s.scales[1 + region] * near[c])
            for r in range(s.ranks[region], s.ranks[region + 1]):
                s.few[r] += g * s.weights[c, r]
    s.predicted[:] = s.mean
    for r in range(s.few.shape[0]):
        for q in range(s.predicted.shape[0]):
            s.predicted[q] += s.few[r] * s.basis[r, q]
    return least


@kernel
def add_squares(x: Samples, centres: Samples, first: int, last: int, out: Samples) -> None:
    """Squared distances of `x` from all `centres` (k, c) in the rows from `first` to before `last`, into `out` (c,)."""
    out[:] = 0.0
    for k in range(first, last):
        for c in range(out.shape[0]):
            e = x[k] - centres[k, c]
            out[c] += e * e
