"""What a pose is before its limbs are brought onto the markers: by geometry alone, or by a kernel regression that was trained."""

from __future__ import annotations

import math

from kinegraph.operators.pose.limb_kernel import (
    ANKLE_AT,
    ARM,
    CHEST,
    ELBOW_AT,
    FOOT,
    HEAD,
    HEAD_AT,
    HIP_AT,
    HIPS,
    KNEE_AT,
    NECK,
    NECK_AT,
    ROOT_AT,
    SHANK,
    SHOULDER,
    SHOULDER_AT,
    SIDE,
    SPINE,
    THIGH,
    TOES,
    UPPER_CHEST,
    WRIST_AT,
)
from kinegraph.operators.pose.rotation_kernel import cross, dot, from_axes, from_six, part_way, swing, unit
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.skeleton import multiply, turn
from kinegraph.stream.kernel import kernel

UPRIGHT = 0.35
"""How far the pelvis stays upright as the trunk bends: its up is this share of straight up and the rest of the trunk's direction."""
BENT = 0.35
"""From this sine of its bend on, a limb's own plane says how its bones are turned about themselves."""


@kernel
def middles(marks: Samples, known: Array, size: float, low: Samples, high: Samples) -> None:
    """The middle of the hips into `low` (3,) and of the shoulders into `high` (3,), from what is known; `size` is the body's (1: usual)."""
    has_low = has_high = True
    if known[HIP_AT] and known[HIP_AT + 1]:
        low[:] = 0.5 * (marks[HIP_AT] + marks[HIP_AT + 1])
    elif known[ROOT_AT]:
        low[:] = marks[ROOT_AT]
    else:
        has_low = False
    if known[SHOULDER_AT] and known[SHOULDER_AT + 1]:
        high[:] = 0.5 * (marks[SHOULDER_AT] + marks[SHOULDER_AT + 1])
    elif known[NECK_AT]:
        high[:] = marks[NECK_AT]
    elif known[HEAD_AT] and has_low:
        high[:] = low + 0.62 * (marks[HEAD_AT] - low)
    elif known[HEAD_AT]:
        high[:] = marks[HEAD_AT]
        high[1] -= 0.33 * size
    else:
        has_high = False
    if has_high and not has_low:
        low[:] = high
        low[1] -= 0.49 * size
        if known[ANKLE_AT] and known[ANKLE_AT + 1]:
            low[:] = 0.37 * high + 0.63 * 0.5 * (marks[ANKLE_AT] + marks[ANKLE_AT + 1])
            low[1] = high[1] - 0.37 * (high[1] - 0.5 * (marks[ANKLE_AT, 1] + marks[ANKLE_AT + 1, 1]))
    elif has_low and not has_high:
        high[:] = low
        high[1] += 0.49 * size


@kernel
def heading(marks: Samples, known: Array, left: Samples) -> None:
    """The level direction to the body's left into `left` (3,), which holds the one before: kept where the markers do not show it."""
    for pair in (HIP_AT, SHOULDER_AT, KNEE_AT, ANKLE_AT, ELBOW_AT, WRIST_AT):
        if known[pair] and known[pair + 1]:
            x = marks[pair, 0] - marks[pair + 1, 0]
            z = marks[pair, 2] - marks[pair + 1, 2]
            flat = math.sqrt(x * x + z * z)
            whole = math.sqrt(flat * flat + (marks[pair, 1] - marks[pair + 1, 1]) ** 2)
            if flat > 0.2 * whole and flat > 0.02:
                left[0], left[1], left[2] = x / flat, 0.0, z / flat
                return


@kernel
def geometric_prior(
    marks: Samples,
    known: Array,
    size: float,
    left: Samples,
    offsets: Samples,
    turns: Samples,
    joints: Samples,
    work: Samples,
) -> None:
    """World rotations (22, 4) into `turns` by the geometry of the markers alone, and the hips' place into `joints`.

    left  (3,) the level direction to the body's left   work  (8, 4) room
    """
    low, high, up, across = work[4, :3], work[5, :3], work[6, :3], work[7, :3]
    middles(marks, known, size, low, high)
    joints[HIPS] = low
    up[:] = high - low
    unit(up)
    for b in range(2):
        at = SHOULDER_AT if b else HIP_AT
        across[:] = left
        if known[at] and known[at + 1]:
            across[:] = marks[at] - marks[at + 1]
        work[3, :3] = up
        if not b:
            work[3, :3] *= 1.0 - UPRIGHT
            work[3, 1] += UPRIGHT
        from_axes(across, work[3, :3], turns[UPPER_CHEST if b else HIPS])
    part_way(turns[HIPS], turns[UPPER_CHEST], 0.4, turns[SPINE])
    part_way(turns[HIPS], turns[UPPER_CHEST], 0.8, turns[CHEST])
    turns[NECK] = turns[UPPER_CHEST]
    turns[HEAD] = turns[UPPER_CHEST]
    for side in range(2):
        turns[SHOULDER + SIDE * side] = turns[UPPER_CHEST]
        _arm(side, marks, known, high, turns, work)
        _leg(side, marks, known, offsets, turns, joints, work)


@kernel
def _plane(upper: Samples, lower: Samples, usual: Samples, sign: float, work: Samples) -> None:
    """The normal of a limb's plane into `work` (3,): upper x lower times `sign`, the more `usual` the straighter the limb."""
    cross(upper, lower, work)
    bend = math.sqrt(dot(work, work))
    share = min(1.0, bend / BENT)
    share = share * share * (3.0 - 2.0 * share)
    for a in range(3):
        work[a] = sign * share * work[a] / max(bend, 1e-9) + (1.0 - share) * usual[a]


@kernel
def _arm(side: int, marks: Samples, known: Array, high: Samples, turns: Samples, work: Samples) -> None:
    """Upper arm, lower arm and hand of a side: along their markers, turned about themselves by the elbow's plane."""
    arm, sign = ARM + SIDE * side, 1.0 - 2.0 * side
    upper, lower, normal = work[0, :3], work[1, :3], work[2, :3]
    start = marks[SHOULDER_AT + side] if known[SHOULDER_AT + side] else high
    if known[ELBOW_AT + side]:
        upper[:] = marks[ELBOW_AT + side] - start
    elif known[WRIST_AT + side]:
        upper[:] = marks[WRIST_AT + side] - start
    else:
        upper[0], upper[1], upper[2] = 0.0, -1.0, 0.0
    lower[:] = upper
    if known[ELBOW_AT + side] and known[WRIST_AT + side]:
        lower[:] = marks[WRIST_AT + side] - marks[ELBOW_AT + side]
    unit(upper)
    unit(lower)
    turns[arm] = turns[UPPER_CHEST]
    work[3, 0], work[3, 1], work[3, 2] = sign, 0.0, 0.0
    swing(turns[arm], work[3, :3], upper, work[6:8])
    work[3, 0], work[3, 1] = 0.0, 1.0
    turn(turns[arm], work[3, :3], work[3, :3])
    _plane(upper, lower, work[3, :3], -sign, normal)
    for a in range(3):
        upper[a] *= sign
        lower[a] *= sign
    from_axes(upper, normal, turns[arm])
    from_axes(lower, normal, turns[arm + 1])
    turns[arm + 2] = turns[arm + 1]


@kernel
def _leg(
    side: int, marks: Samples, known: Array, offsets: Samples, turns: Samples, joints: Samples, work: Samples
) -> None:
    """Thigh, shank and foot of a side: along their markers, turned about themselves by the knee's plane; the foot is half level."""
    thigh = THIGH + SIDE * side
    upper, lower, normal = work[0, :3], work[1, :3], work[2, :3]
    turn(turns[HIPS], offsets[thigh], work[3, :3])
    work[3, :3] += joints[HIPS]
    if known[HIP_AT + side]:
        work[3, :3] = marks[HIP_AT + side]
    if known[KNEE_AT + side]:
        upper[:] = marks[KNEE_AT + side] - work[3, :3]
    elif known[ANKLE_AT + side]:
        upper[:] = marks[ANKLE_AT + side] - work[3, :3]
    else:
        upper[0], upper[1], upper[2] = 0.0, -1.0, 0.0
    lower[:] = upper
    if known[KNEE_AT + side] and known[ANKLE_AT + side]:
        lower[:] = marks[ANKLE_AT + side] - marks[KNEE_AT + side]
    unit(upper)
    unit(lower)
    turns[thigh] = turns[HIPS]
    work[3, 0], work[3, 1], work[3, 2] = 0.0, -1.0, 0.0
    swing(turns[thigh], work[3, :3], upper, work[6:8])
    work[3, 0], work[3, 1] = 1.0, 0.0
    turn(turns[thigh], work[3, :3], work[3, :3])
    _plane(upper, lower, work[3, :3], 1.0, normal)
    for bone in range(2):
        along = lower if bone else upper
        d = dot(normal, along)
        for a in range(3):
            work[3, a] = normal[a] - d * along[a]
            work[6, a] = -along[a]
        from_axes(work[3, :3], work[6, :3], turns[thigh + bone])
    work[6, 0], work[6, 1], work[6, 2] = 0.0, 1.0, 0.0
    work[3, :3] = normal
    work[3, 1] = 0.0
    from_axes(work[3, :3], work[6, :3], work[7])
    part_way(turns[SHANK + SIDE * side], work[7], 0.5, turns[FOOT + SIDE * side])
    turns[TOES + SIDE * side] = turns[FOOT + SIDE * side]


@kernel
def features_of(marks: Samples, chosen: Times, low: Samples, left: Samples, size: float, out: Samples) -> None:
    """Landmarks `chosen` (m,) as seen from the body: from `low` (3,), x to its left, y up, divided by its size, into `out` (3 m,)."""
    for k in range(chosen.shape[0]):
        x = marks[chosen[k], 0] - low[0]
        y = marks[chosen[k], 1] - low[1]
        z = marks[chosen[k], 2] - low[2]
        out[3 * k] = (x * left[0] + z * left[2]) / size
        out[3 * k + 1] = y / size
        out[3 * k + 2] = (z * left[0] - x * left[2]) / size


@kernel
def trained_prior(
    predicted: Samples, low: Samples, left: Samples, size: float, turns: Samples, joints: Samples, work: Samples
) -> None:
    """Correct world rotations `turns` (22, 4) and the hips' place by what a regression says of them (22 * 6 + 3,).

    It says how each bone is turned relative to the geometric prior, and where the hips are as seen from the body.
    """
    n = turns.shape[0]
    for b in range(n):
        from_six(predicted[6 * b : 6 * b + 6], work[1])
        multiply(turns[b], work[1], turns[b])
    work[0, 0], work[0, 1], work[0, 2] = 0.0, 1.0, 0.0
    from_axes(left, work[0, :3], work[1])
    for a in range(3):
        work[2, a] = size * predicted[6 * n + a]
    turn(work[1], work[2, :3], joints[HIPS])
    for a in range(3):
        joints[HIPS, a] += low[a]
