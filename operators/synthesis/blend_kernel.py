"""One pose of synthesised motion: two recorded ones placed on the floor and blended, and feet that stand where they stood."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.skeleton import multiply, place_joints, turn
from kinegraph.stream.kernel import kernel

REACH = 0.999
"""A leg is stretched to at most this share of its length."""
RELEASE = 0.75
"""What is left, a frame later, of how far a foot was moved, once it stands no more."""
RISE = 0.6
"""What is left, a frame later, of how far the body was lowered for the feet's sake, once it need not be."""


@kernel
def placed(pose: Samples, place: Samples, out: Samples) -> None:
    """A pose (3 + 4 j,) turned about y and shifted by `place` (3,): turn (rad), x, z (m)."""
    cos, sin = math.cos(place[0]), math.sin(place[0])
    x, z = pose[0] * cos + pose[2] * sin + place[1], pose[2] * cos - pose[0] * sin + place[2]
    c, s = math.cos(place[0] / 2.0), math.sin(place[0] / 2.0)
    w, a, b, d = pose[3], pose[4], pose[5], pose[6]
    out[:] = pose
    out[0], out[2] = x, z
    out[3], out[4], out[5], out[6] = c * w - s * b, c * a + s * d, c * b + s * w, c * d - s * a


@kernel
def blended(p: Samples, q: Samples, share: float, out: Samples) -> None:
    """`p` and `q` (3 + 4 j,) mixed, `share` of `q`: root by line, rotations along the great circle (slerp)."""
    for a in range(3):
        out[a] = (1.0 - share) * p[a] + share * q[a]
    for j in range(3, p.shape[0], 4):
        dot = p[j] * q[j] + p[j + 1] * q[j + 1] + p[j + 2] * q[j + 2] + p[j + 3] * q[j + 3]
        sign = -1.0 if dot < 0.0 else 1.0
        angle = math.acos(min(1.0, abs(dot)))
        size = math.sin(angle)
        u, v = (
            (math.sin((1.0 - share) * angle) / size, math.sin(share * angle) / size)
            if size > 1e-6
            else (1.0 - share, share)
        )
        norm = 0.0
        for a in range(4):
            out[j + a] = u * p[j + a] + sign * v * q[j + a]
            norm += out[j + a] ** 2
        for a in range(4):
            out[j + a] /= math.sqrt(norm)


@kernel
def between(a: Samples, b: Samples, out: Samples) -> None:
    """The shortest rotation (4,) that turns the direction of `a` (3,) into that of `b` (3,)."""
    norm = math.sqrt((a[0] ** 2 + a[1] ** 2 + a[2] ** 2) * (b[0] ** 2 + b[1] ** 2 + b[2] ** 2))
    out[0] = norm + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    out[1], out[2], out[3] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    size = math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2 + out[3] ** 2)
    if size < 1e-9 * max(norm, 1e-12):
        out[:], out[0] = 0.0, 1.0
    else:
        for k in range(4):
            out[k] /= size


@kernel
def turn_joint(pose: Samples, turns: Samples, parents: Times, j: int, by: Samples, work: Samples) -> None:
    """Turn joint `j` and what it carries by the rotation `by` (4,) of the world: its own entry in `pose`, and `turns[j]`."""
    multiply(by, turns[j], work[0])
    turns[j] = work[0]
    relative(pose, turns, parents, j, work)


@kernel
def relative(pose: Samples, turns: Samples, parents: Times, j: int, work: Samples) -> None:
    """The rotation of joint `j` relative to its parent, from those in the world, into `pose`."""
    work[1] = turns[parents[j]]
    for a in range(1, 4):
        work[1, a] = -work[1, a]
    multiply(work[1], turns[j], work[2])
    pose[3 + 4 * j : 7 + 4 * j] = work[2]


@kernel
def lengths(offsets: Samples, leg: Times) -> tuple[float, float]:
    """Of the thigh and the shank; `leg` (4,) are the joints hip, knee, ankle and toes."""
    upper = math.sqrt((offsets[leg[1]] ** 2).sum())
    return upper, math.sqrt((offsets[leg[2]] ** 2).sum())


@kernel
def reach_down(joints: Samples, offsets: Samples, legs: Times, moved: Samples, stands: Array, lowered: float) -> float:
    """How far the body must be lowered (m) for both feet to be where they are to be; `lowered` so far."""
    need = 0.0
    for side in range(2):
        if not stands[side]:
            continue
        upper, shank = lengths(offsets, legs[side])
        hip, ankle = joints[legs[side, 0]], joints[legs[side, 2]]
        x, z = hip[0] - ankle[0] - moved[side, 0], hip[2] - ankle[2] - moved[side, 2]
        room = (REACH * (upper + shank)) ** 2 - x * x - z * z
        height = hip[1] - ankle[1] - moved[side, 1]
        need = max(need, height - math.sqrt(max(room, 0.0)))
    return max(need, RISE * lowered)


@kernel
def bend_leg(
    pose: Samples, turns: Samples, joints: Samples, parents: Times, offsets: Samples, leg: Times, goal: Samples, work: Samples
) -> None:  # fmt: skip
    """Bring the ankle of `leg` (4,) to `goal` (3,), in the plane in which the knee bends now; the foot stays as it is turned."""
    hip, knee, ankle = leg[0], leg[1], leg[2]
    upper, shank = lengths(offsets, leg)
    far = math.sqrt(((goal - joints[hip]) ** 2).sum())
    far = min(max(far, abs(upper - shank) + 1e-6), REACH * (upper + shank))
    now = math.sqrt(((joints[ankle] - joints[hip]) ** 2).sum())
    axis, a, b, q = work[3, :3], work[4, :3], work[5, :3], work[6]
    a[:], b[:] = joints[hip] - joints[knee], joints[ankle] - joints[knee]
    axis[0], axis[1], axis[2] = b[1] * a[2] - b[2] * a[1], b[2] * a[0] - b[0] * a[2], b[0] * a[1] - b[1] * a[0]
    size = math.sqrt((axis**2).sum())
    if size < 1e-4 * upper * shank:
        b[:] = 0.0
        b[0] = 1.0
        turn(turns[hip], b, axis)
        size = 1.0
    change = opening(upper, shank, far) - opening(upper, shank, now)
    half = -0.5 * change
    q[0] = math.cos(half)
    for k in range(3):
        q[1 + k] = math.sin(half) * axis[k] / size
    turn_joint(pose, turns, parents, knee, q, work)
    b[:] = joints[ankle] - joints[knee]
    turn(q, b, a)
    a += joints[knee] - joints[hip]
    b[:] = goal - joints[hip]
    between(a, b, q)
    work[7] = turns[ankle]
    turn_joint(pose, turns, parents, hip, q, work)
    multiply(q, turns[knee], work[8])
    turns[knee] = work[8]
    turns[ankle] = work[7]
    relative(pose, turns, parents, ankle, work)


@kernel
def opening(upper: float, shank: float, far: float) -> float:
    """The angle at the knee (rad) at which hip and ankle are `far` apart."""
    return math.acos(min(1.0, max(-1.0, (upper**2 + shank**2 - far**2) / (2.0 * upper * shank))))


@kernel
def hold_feet(
    pose: Samples, stands: Array, parents: Times, offsets: Samples, legs: Times, stood: Array, spot: Samples, moved: Samples,
    lowered: Samples, turns: Samples, joints: Samples, work: Samples,
) -> None:  # fmt: skip
    """Keep the toes of feet that stand where they were when they began to, by bending the legs of `pose`; and let go smoothly.

    stands (2,)  which feet stand now     stood (2,), spot (2, 3)  which did, and where their toes are held
    moved (2, 3)  how far each foot is moved     lowered (1,)  how far the body is     legs (2, 4)  joints
    """
    place_joints(pose, parents, offsets, turns, joints)
    for side in range(2):
        toes = joints[legs[side, 3]]
        if stands[side] and not stood[side]:
            spot[side] = toes + RELEASE * moved[side]
        if stands[side]:
            moved[side] = spot[side] - toes
        else:
            moved[side] *= RELEASE
        stood[side] = stands[side]
    lowered[0] = reach_down(joints, offsets, legs, moved, stood, lowered[0])
    pose[1] -= lowered[0]
    joints[:, 1] -= lowered[0]
    for side in range(2):
        work[9, :3] = joints[legs[side, 2]] + moved[side]
        work[9, 1] += lowered[0]
        bend_leg(pose, turns, joints, parents, offsets, legs[side], work[9, :3], work)


def room_for(joints: int) -> tuple[Samples, Samples, Samples]:
    """`turns`, `joints` and `work` for `hold_feet`."""
    return np.zeros((joints, 4)), np.zeros((joints, 3)), np.zeros((10, 4))
