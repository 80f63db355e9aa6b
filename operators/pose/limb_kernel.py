"""Limbs of two bones, put where their markers are: the way to a place by the law of cosines, and the turns that bring bones onto it."""

from __future__ import annotations

import math

from kinegraph.operators.pose.rotation_kernel import cross, dot, from_axes, shortest, swing, unit
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.skeleton import multiply, turn
from kinegraph.stream.kernel import kernel

HIPS, SPINE, CHEST, UPPER_CHEST, NECK, HEAD, SHOULDER, ARM, FOREARM, HAND = range(10)
THIGH, SHANK, FOOT, TOES = 14, 15, 16, 17
SIDE = 4
"""Bones of the right side come this much after those of the left one; landmarks come left and right in turn."""
HIP_AT, KNEE_AT, ANKLE_AT, SHOULDER_AT, ELBOW_AT, WRIST_AT = 0, 2, 4, 6, 8, 10
HEAD_AT, NECK_AT, ROOT_AT, TOE_AT, HAND_AT, NOSE_AT, EAR_AT = 12, 13, 14, 15, 17, 19, 20
BENT = 0.35
"""From this bend on (how far the middle joint is from the limb's axis, in halves of its length) a limb shows how it bends: 39 degrees."""


@kernel
def length_of(v: Samples) -> float:
    return math.sqrt(dot(v, v))


@kernel
def two_bones(
    start: Samples,
    end: Samples,
    pole: Samples,
    upper: float,
    lower: float,
    middle: Samples,
    reach: Samples,
    work: Samples,
) -> None:
    """Where the `middle` (3,) joint and the end (`reach`, (3,)) of a limb are that begins at `start` and is to end at `end`.

    Bones have the lengths `upper` and `lower`; the middle joint lies on the side of `pole`. What is out of reach is reached for.
    `work` (2, 4) is room.
    """
    axis, aside = work[0, :3], work[1, :3]
    for a in range(3):
        axis[a] = end[a] - start[a]
        aside[a] = pole[a] - start[a]
    distance = unit(axis)
    nearest = abs(upper - lower) + 1e-4 * (upper + lower)
    far = min(max(distance, nearest), 0.9999 * (upper + lower))
    along = (upper * upper - lower * lower + far * far) / (2.0 * far)
    height = math.sqrt(max(0.0, upper * upper - along * along))
    d = dot(aside, axis)
    for a in range(3):
        aside[a] -= d * axis[a]
    unit(aside)
    for a in range(3):
        middle[a] = start[a] + along * axis[a] + height * aside[a]
        reach[a] = start[a] + far * axis[a]


@kernel
def smooth_step(x: float) -> float:
    x = min(max(x, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)


@kernel
def towards_straight(start: Samples, end: Samples, pole: Samples, upper: float, lower: float, out: Samples) -> None:
    """Where a limb of two bones is to end, `out` (3,), that ends at `end` by its markers: as near as its middle joint's bend lets it.

    By the law of cosines an error of 5 mm in the length of a straight leg moves its knee by 5 cm. How far the middle joint's own
    marker lies from the axis shows the bend of a straight limb much better; of one that is bent, the distance of its ends does.
    """
    axis, aside = out, 0.0
    for a in range(3):
        axis[a] = end[a] - start[a]
    far = unit(axis)
    along = 0.0
    for a in range(3):
        along += axis[a] * (pole[a] - start[a])
    for a in range(3):
        aside += (pole[a] - start[a] - along * axis[a]) ** 2
    aside = math.sqrt(aside)
    half = 0.5 * (upper + lower)
    share = smooth_step(aside / (BENT * half))
    if share < 1.0 and far > 0.5 * half:
        reached = min(far, upper + lower)
        straight = (upper * upper - lower * lower + reached * reached) / (2.0 * reached)
        bend = share * math.sqrt(max(upper * upper - straight * straight, 0.0)) + (1.0 - share) * aside
        far = math.sqrt(max(upper * upper - bend * bend, 0.0)) + math.sqrt(max(lower * lower - bend * bend, 0.0))
    for a in range(3):
        out[a] = start[a] + far * axis[a]


@kernel
def place_from(bone: int, parent: int, offsets: Samples, turns: Samples, joints: Samples) -> None:
    """Where the joint `bone` is: at its offset from its parent's."""
    turn(turns[parent], offsets[bone], joints[bone])
    for a in range(3):
        joints[bone, a] += joints[parent, a]


@kernel
def point_bone(
    bone: int, child: int, to: Samples, offsets: Samples, turns: Samples, joints: Samples, work: Samples
) -> None:
    """Turn `bone` the shortest way so that `child` lies in the direction of `to`, and place `child`. `work` (3, 4)."""
    for a in range(3):
        work[2, a] = to[a] - joints[bone, a]
    swing(turns[bone], offsets[child], work[2, :3], work)
    place_from(child, bone, offsets, turns, joints)


@kernel
def fit_limb(
    first: int,
    middle_at: int,
    end_at: int,
    marks: Samples,
    known: Array,
    offsets: Samples,
    turns: Samples,
    joints: Samples,
    work: Samples,
    exactly: bool,
) -> None:
    """Bring a limb of two bones from `first`, a placed joint, onto its markers: those of the middle and of the end, where known.

    The middle joint's marker, or else the turns as they are, say on which side it lies, and of a limb that is nearly straight how far,
    unless its end is to be reached `exactly`. `work` (6, 4).
    """
    middle, end = first + 1, first + 2
    place_from(middle, first, offsets, turns, joints)
    if known[end_at]:
        pole = marks[middle_at] if known[middle_at] else joints[middle]
        upper, lower = length_of(offsets[middle]), length_of(offsets[end])
        work[5, :3] = marks[end_at]
        if known[middle_at] and not exactly:
            towards_straight(joints[first], marks[end_at], pole, upper, lower, work[5, :3])
        two_bones(joints[first], work[5, :3], pole, upper, lower, work[3, :3], work[4, :3], work)
        point_bone(first, middle, work[3, :3], offsets, turns, joints, work)
        point_bone(middle, end, work[4, :3], offsets, turns, joints, work)
    elif known[middle_at]:
        point_bone(first, middle, marks[middle_at], offsets, turns, joints, work)
        place_from(end, middle, offsets, turns, joints)
    else:
        place_from(end, middle, offsets, turns, joints)


@kernel
def fit_trunk(marks: Samples, known: Array, offsets: Samples, turns: Samples, joints: Samples, work: Samples) -> None:
    """Bring pelvis, spine and shoulders onto the hips' and shoulders' markers. The hips' joint is placed where no marker says it is."""
    left, right = THIGH, THIGH + SIDE
    if known[HIP_AT] and known[HIP_AT + 1]:
        work[3, :3] = offsets[left] - offsets[right]
        work[4, :3] = marks[HIP_AT] - marks[HIP_AT + 1]
        swing(turns[HIPS], work[3, :3], work[4, :3], work)
        work[3, :3] = 0.5 * (offsets[left] + offsets[right])
        turn(turns[HIPS], work[3, :3], work[4, :3])
        joints[HIPS] = 0.5 * (marks[HIP_AT] + marks[HIP_AT + 1]) - work[4, :3]
    if known[SHOULDER_AT] and known[SHOULDER_AT + 1]:
        _bend_spine(marks, offsets, turns, joints, work)
    for bone in range(SPINE, NECK + 1):
        place_from(bone, bone - 1, offsets, turns, joints)
    for side in range(2):
        bone = SHOULDER + SIDE * side
        place_from(bone, UPPER_CHEST, offsets, turns, joints)
        if known[SHOULDER_AT + side]:
            point_bone(bone, bone + 1, marks[SHOULDER_AT + side], offsets, turns, joints, work)
        else:
            place_from(bone + 1, bone, offsets, turns, joints)


@kernel
def _bend_spine(marks: Samples, offsets: Samples, turns: Samples, joints: Samples, work: Samples) -> None:
    """Turn spine, chest and shoulders so that the shoulders' line lies as their markers' does, and its middle in their direction."""
    for bone in range(SPINE, UPPER_CHEST + 1):
        place_from(bone, bone - 1, offsets, turns, joints)
    for side in range(2):
        bone = SHOULDER + SIDE * side
        place_from(bone, UPPER_CHEST, offsets, turns, joints)
        place_from(bone + 1, bone, offsets, turns, joints)
    work[3, :3] = 0.5 * (joints[ARM] + joints[ARM + SIDE]) - joints[SPINE]
    work[4, :3] = 0.5 * (marks[SHOULDER_AT] + marks[SHOULDER_AT + 1]) - joints[SPINE]
    shortest(work[3, :3], work[4, :3], work[5])
    work[3, :3] = joints[ARM] - joints[ARM + SIDE]
    turn(work[5], work[3, :3], work[3, :3])
    work[4, :3] = marks[SHOULDER_AT] - marks[SHOULDER_AT + 1]
    shortest(work[3, :3], work[4, :3], work[2])
    for bone in range(SPINE, UPPER_CHEST + 1):
        multiply(work[5], turns[bone], turns[bone])
    multiply(work[2], turns[UPPER_CHEST], turns[UPPER_CHEST])
    for side in range(2):
        bone = SHOULDER + SIDE * side
        multiply(work[5], turns[bone], turns[bone])
        multiply(work[2], turns[bone], turns[bone])
    work[2, 0] += 1.0
    n = math.sqrt(work[2, 0] ** 2 + work[2, 1] ** 2 + work[2, 2] ** 2 + work[2, 3] ** 2)
    for a in range(4):
        work[2, a] /= n
    multiply(work[2], turns[CHEST], turns[CHEST])


@kernel
def fit_head(
    marks: Samples, known: Array, from_bone: Samples, offsets: Samples, turns: Samples, joints: Samples, work: Samples
) -> None:
    """Bring neck and head onto the head's marker; the head looks where the nose is from the ears, which may be hidden by turns."""
    if known[HEAD_AT]:
        turn(turns[NECK], offsets[HEAD], work[3, :3])
        turn(turns[HEAD], from_bone[HEAD_AT], work[4, :3])
        work[3, :3] += work[4, :3]
        work[4, :3] = marks[HEAD_AT] - joints[NECK]
        shortest(work[3, :3], work[4, :3], work[5])
        multiply(work[5], turns[NECK], turns[NECK])
        multiply(work[5], turns[HEAD], turns[HEAD])
    if known[NOSE_AT] and known[EAR_AT] and known[EAR_AT + 1]:
        work[3, :3] = marks[EAR_AT] - marks[EAR_AT + 1]
        work[4, :3] = marks[NOSE_AT] - 0.5 * (marks[EAR_AT] + marks[EAR_AT + 1])
        cross(work[4, :3], work[3, :3], work[5, :3])
        cross(work[5, :3], work[4, :3], work[3, :3])
        from_axes(work[3, :3], work[5, :3], turns[HEAD])
    place_from(HEAD, NECK, offsets, turns, joints)


@kernel
def fit_pose(
    marks: Samples,
    known: Array,
    from_bone: Samples,
    parents: Times,
    offsets: Samples,
    turns: Samples,
    joints: Samples,
    work: Samples,
) -> None:
    """Bring a pose's world rotations `turns` (22, 4) onto the markers that are known, and place its `joints` (22, 3).

    marks  (22, 3) m, where landmarks are; known (22,) which of them   work  (6, 4) room
    """
    fit_trunk(marks, known, offsets, turns, joints, work)
    fit_head(marks, known, from_bone, offsets, turns, joints, work)
    for side in range(2):
        fit_limb(ARM + SIDE * side, ELBOW_AT + side, WRIST_AT + side, marks, known, offsets, turns, joints, work, False)
        hand = HAND + SIDE * side
        if known[HAND_AT + side]:
            work[3, :3] = marks[HAND_AT + side] - joints[hand]
            swing(turns[hand], from_bone[HAND_AT + side], work[3, :3], work)
        thigh, foot = THIGH + SIDE * side, FOOT + SIDE * side
        place_from(thigh, HIPS, offsets, turns, joints)
        fit_limb(thigh, KNEE_AT + side, ANKLE_AT + side, marks, known, offsets, turns, joints, work, False)
        if known[TOE_AT + side]:
            point_bone(foot, foot + 1, marks[TOE_AT + side], offsets, turns, joints, work)
        else:
            place_from(foot + 1, foot, offsets, turns, joints)
