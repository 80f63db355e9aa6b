"""A sample of markers to a pose, in one piece of compiled code."""

from __future__ import annotations

import math
from typing import NamedTuple

from kinegraph.operators.pose.limb_kernel import (
    ARM,
    EAR_AT,
    ELBOW_AT,
    FOOT,
    HAND,
    HEAD,
    HEAD_AT,
    HIP_AT,
    HIPS,
    NECK,
    NOSE_AT,
    SHOULDER_AT,
    SIDE,
    THIGH,
    WRIST_AT,
    fit_pose,
    length_of,
    place_from,
)
from kinegraph.operators.pose.marks_kernel import TRUSTS_S, complete_marks, gather, scale_body, stand
from kinegraph.operators.pose.motion_kernel import limit_turns, put_feet, same_signs
from kinegraph.operators.pose.prior_kernel import features_of, geometric_prior, heading, middles, trained_prior
from kinegraph.operators.pose.regions_kernel import Corrections, regional_of, regress
from kinegraph.operators.pose.rotation_kernel import from_axes
from kinegraph.operators.pose.steady_kernel import ease_turns, follow_turns, shows_head, steady_bends, steady_head
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.skeleton import place_joints, turn
from kinegraph.stream.kernel import kernel

STARTED, SIZE, GROUND, FRAMES, CALIBRATED, LAST, OUTSIDE, HELD, LEAPT = range(9)
"""Places in `memory`: whether there is a pose; the body's size; where ankles stand; samples of standing; whether that is done; the newest
stamp in s; how far the sample lies from the poses of the training, in kernel widths; whether a turn was held back; whether nothing
was seen in the sample before."""
STEPS_S = (0.002, 0.1)
"""Periods beyond these are taken for these."""


class Solver(NamedTuple):
    """What the kernel works on; m landmarks, 22 bones.

    columns  (k, 4)  columns of x, y and z of a point, and its landmark   axes, signs (3,)  which of these are x, y and z, and their scale
    present  (m,)    which landmarks the stream has      seen (m,) which of them it shows now
    hinted, surest, trusts, doubts, counts (m,)  as in `gather` and `complete_marks`
    marks, before, total (m, 3)  where landmarks are, where they were, their sum while standing
    from_bone (m, 3), bone_of (m,)  where landmarks are from which joint
    usual, offsets (22, 3)  the skeleton as given and as calibrated; parents (22,)
    turns, turns_before, local, local_before (22, 4)  rotations in the world and relative to parents; joints (22, 3)
    followed (22, 4), speeds (22, 3), bends (4, 4), head (11,)  how bones turn, limbs bend, and how the head is turned (steady_kernel)
    eases (m, 4)  as in `complete_marks`     flags, unsure (22,)  which bones are guessed, and how much, 0 to 1
    learned  the regression; without one there are no centres
    """

    columns: Times
    axes: Times
    signs: Samples
    present: Array
    seen: Array
    hinted: Array
    surest: Samples
    trusts: Samples
    doubts: Samples
    counts: Samples
    marks: Samples
    before: Samples
    total: Samples
    from_bone: Samples
    bone_of: Times
    usual: Samples
    offsets: Samples
    parents: Times
    turns: Samples
    turns_before: Samples
    local: Samples
    local_before: Samples
    joints: Samples
    learned: Corrections
    left: Samples
    memory: Samples
    feet: Samples
    followed: Samples
    speeds: Samples
    bends: Samples
    head: Samples
    eases: Samples
    flags: Samples
    unsure: Samples
    work: Samples


@kernel
def prior(s: Solver) -> None:
    """World rotations and the hips' place: by geometry, corrected by the regression where there is one."""
    geometric_prior(s.marks, s.present, s.memory[SIZE], s.left, s.offsets, s.turns, s.joints, s.work)
    r = s.learned
    if r.centres.shape[1]:
        low, high, size = s.work[4, :3], s.work[5, :3], s.memory[SIZE]
        middles(s.marks, s.present, size, low, high)
        features_of(s.marks, r.chosen, low, s.left, size, r.x)
        regional_of(s.marks, r.shown, low, high, s.turns, size, r.own, s.work)
        s.memory[OUTSIDE] = math.sqrt(2.0 * r.scales[0] * regress(r))
        trained_prior(r.predicted, low, s.left, size, s.turns, s.joints, s.work)


@kernel
def begin(s: Solver, found: int) -> bool:
    """Begin with the first sample that shows the hips or the shoulders, and half of what the stream has: what it does not show hangs."""
    wanted = 0
    for k in range(s.present.shape[0]):
        wanted += s.present[k]
    hips = s.seen[HIP_AT] and s.seen[HIP_AT + 1]
    shoulders = s.seen[SHOULDER_AT] and s.seen[SHOULDER_AT + 1]
    if found < wanted and not ((hips or shoulders) and 2 * found >= wanted):
        return False
    heading(s.marks, s.seen, s.left)
    middles(s.marks, s.seen, s.memory[SIZE], s.joints[HIPS], s.work[0, :3])
    s.work[1, 0], s.work[1, 1], s.work[1, 2] = 0.0, 1.0, 0.0
    from_axes(s.left, s.work[1, :3], s.work[2])
    for b in range(1, s.turns.shape[0]):
        turn(s.work[2], s.offsets[b], s.joints[b])
        for a in range(3):
            s.joints[b, a] += s.joints[s.parents[b], a]
    for k in range(s.marks.shape[0]):
        turn(s.work[2], s.from_bone[k], s.before[k])
        for a in range(3):
            s.before[k, a] += s.joints[s.bone_of[k], a]
    for side in range(2):
        arm = ARM + SIDE * side
        s.before[ELBOW_AT + side] = s.joints[arm]
        s.before[ELBOW_AT + side, 1] -= length_of(s.offsets[arm + 1])
        s.before[WRIST_AT + side] = s.before[ELBOW_AT + side]
        s.before[WRIST_AT + side, 1] -= length_of(s.offsets[arm + 2])
    for k in range(s.marks.shape[0]):
        if s.seen[k]:
            s.before[k] = s.marks[k]
    s.memory[STARTED] = 1.0
    return True


@kernel
def believe(row: Samples, sure: Samples, dt: float, frames: int, s: Solver) -> bool:
    """The landmarks of a sample into `marks`, with guesses for those that are not seen; returns whether there is anything to go by."""
    found = gather(row, sure, s.columns, s.axes, s.signs, s.marks, s.seen, s.hinted, s.surest, s.counts)
    if s.memory[STARTED] == 0.0 and not begin(s, found):
        return False
    found, followed = complete_marks(
        s.marks, s.before, s.seen, s.hinted, s.present, s.surest, s.trusts, s.doubts, s.eases, dt, s.work[0, :3]
    )  # fmt: skip
    s.memory[LEAPT] = 0.0 if followed else 1.0
    s.before[:] = s.marks
    if s.memory[CALIBRATED] == 0.0 and frames and found:
        s.memory[FRAMES] = stand(s.marks, s.seen, s.present, s.total, s.memory[FRAMES])
        if s.memory[FRAMES] >= frames:
            s.total[:] /= s.memory[FRAMES]
            s.memory[SIZE] = scale_body(s.total, s.present, s.usual, s.offsets)
            s.memory[CALIBRATED] = 1.0
    return found > 0


@kernel
def flag(s: Solver, dt: float) -> None:
    """Which bones are guessed, into `flags` (22,): those of which a marker that the stream has was not seen; and how unsure they are."""
    for k in range(s.counts.shape[0]):
        s.counts[k] = 1.0 if s.present[k] and not s.seen[k] else 0.0
    s.flags[:] = 0.0
    worst_of_limbs(s.counts, s.flags)
    for k in range(s.counts.shape[0]):
        if s.present[k] and (s.seen[k] or s.hinted[k]):
            s.counts[k] = 1.0 - s.trusts[k]
    for b in range(s.unsure.shape[0]):
        s.unsure[b] = max(0.0, s.unsure[b] - dt / TRUSTS_S)
    worst_of_limbs(s.counts, s.unsure)


@kernel
def worst_of_limbs(marks: Samples, bones: Samples) -> None:
    """For each bone, into `bones` (22,), the largest of the numbers of its limb's `marks` (m,), where that is larger."""
    for side in range(2):
        for a in range(3):
            worst = marks[SHOULDER_AT + 2 * a + side]
            for bone in range(ARM - 1 if a == 0 else ARM, HAND + 1 if a == 2 else HAND):
                bones[bone + SIDE * side] = max(bones[bone + SIDE * side], worst)
            worst = marks[HIP_AT + 2 * a + side]
            for bone in range(THIGH, FOOT + 2 if a == 2 else FOOT):
                bones[bone + SIDE * side] = max(bones[bone + SIDE * side], worst)
            if a == 0:
                bones[HIPS] = max(bones[HIPS], worst)
        for bone in range(HIPS + 1, NECK):
            bones[bone] = max(bones[bone], marks[SHOULDER_AT + side])
    for bone in range(NECK, HEAD + 1):
        bones[bone] = max(bones[bone], marks[HEAD_AT])


@kernel
def move(s: Solver, dt: float, first: bool, feet: bool, turn_rad_s: float, rest_rad_s: float) -> None:
    """The pose that fits the landmarks, as far as one period lets the bones turn."""
    heading(s.marks, s.present, s.left)
    steady_bends(s.marks, s.present, s.left, dt, s.bends, s.work)
    prior(s)
    fit_pose(s.marks, s.present, s.from_bone, s.parents, s.offsets, s.turns, s.joints, s.work)
    standing = s.memory[FRAMES] if s.memory[CALIBRATED] == 0.0 else 0.0
    whole = s.present[NOSE_AT] and s.present[EAR_AT] and s.present[EAR_AT + 1]
    shown = not whole or shows_head(s.marks, s.seen, standing, s.head)
    steady_head(s.turns, dt, shown, standing, s.head, s.work)
    if first:
        s.followed[:] = s.turns
    if rest_rad_s > 0.0:
        follow_turns(s.unsure, dt, rest_rad_s, s.followed, s.speeds, s.turns, s.work)
    elif first or s.memory[LEAPT] > 0.0:
        s.speeds[:] = 0.0
    else:
        ease_turns(s.turns_before, dt, s.speeds, s.turns, s.work)
    for b in range(1, s.turns.shape[0]):
        place_from(b, s.parents[b], s.offsets, s.turns, s.joints)
    if feet:
        put_feet(s.marks, s.present, dt, s.memory, s.feet, s.offsets, s.turns, s.joints, s.work)
    most = 1e9 if first else turn_rad_s * dt
    held = limit_turns(s.turns_before, s.local_before, s.parents, most, s.turns, s.local, s.work)
    s.memory[HELD] = 1.0 if held else 0.0


@kernel
def solve(
    rows: Samples, sure: Samples, time: Times, s: Solver, frames: int, feet: bool, turn_rad_s: float, rest_rad_s: float,
    poses: Samples, joints: Samples, quality: Samples,
) -> None:  # fmt: skip
    """Poses (n, 3 + 4 * 22), joints (n, 22, 3) and what is known of them (n, 22 + 4) of the samples `rows` (n, width), of
    which each point is to be trusted as `sure` (n, points) says, from 0 to 1."""
    for i in range(rows.shape[0]):
        now = time[i] * 1e-9
        dt = min(max(now - s.memory[LAST], STEPS_S[0]), STEPS_S[1])
        first = s.memory[STARTED] == 0.0
        s.memory[LAST] = now
        moved = believe(rows[i], sure[i], dt, frames, s)
        flag(s, dt)
        if moved:
            s.memory[OUTSIDE] = 0.0
            move(s, dt, first, feet, turn_rad_s, rest_rad_s)
            if not first:
                same_signs(s.local_before, s.local)
            s.turns_before[:] = s.turns
            s.local_before[:] = s.local
        pose = poses[i]
        pose[:3] = s.joints[0]
        for b in range(s.local.shape[0]):
            for a in range(4):
                pose[3 + 4 * b + a] = s.local_before[b, a]
            quality[i, b] = s.flags[b] if s.memory[STARTED] else 1.0
        place_joints(pose, s.parents, s.offsets, s.turns, joints[i])
        n = s.local.shape[0]
        quality[i, n] = s.feet[0, 0]
        quality[i, n + 1] = s.feet[1, 0]
        quality[i, n + 2] = s.memory[CALIBRATED]
        quality[i, n + 3] = s.memory[OUTSIDE]


@kernel
def place_marks(
    from_bone: Samples, bone_of: Times, turns: Samples, joints: Samples, present: Array, marks: Samples
) -> None:
    """Where a pose has its landmarks, into `marks` (m, 3)."""
    for k in range(marks.shape[0]):
        if present[k]:
            b = bone_of[k]
            turn(turns[b], from_bone[k], marks[k])
            for a in range(3):
                marks[k, a] += joints[b, a]
