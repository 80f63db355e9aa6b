"""Point clouds of motion over a window, and how far two are from each other after the best placement on the floor (Kovar 2002)."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

SIDES = ("RightUpperLeg", "LeftUpperLeg")
"""The heading is square to the line between these."""


@kernel
def placement(p: Samples, q: Samples, out: Samples) -> None:
    """The turn and shift that bring the points `q` (n, 3) nearest to `p` (n, 3), into `out` (4,): turn (rad), x, z, rms distance.

    Closed form of Kovar, Gleicher and Pighin 2002, section 3.1, with equal weights; the turn is about y.
    """
    n = p.shape[0]
    px, pz, qx, qz = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        px += p[i, 0]
        pz += p[i, 2]
        qx += q[i, 0]
        qz += q[i, 2]
    px, pz, qx, qz = px / n, pz / n, qx / n, qz / n
    cross, along = 0.0, 0.0
    for i in range(n):
        a, b, c, d = p[i, 0] - px, p[i, 2] - pz, q[i, 0] - qx, q[i, 2] - qz
        cross += a * d - c * b
        along += a * c + b * d
    turn = math.atan2(cross, along)
    cos, sin = math.cos(turn), math.sin(turn)
    out[0], out[1], out[2] = turn, px - (qx * cos + qz * sin), pz - (qz * cos - qx * sin)
    total = 0.0
    for i in range(n):
        x = q[i, 0] * cos + q[i, 2] * sin + out[1] - p[i, 0]
        z = q[i, 2] * cos - q[i, 0] * sin + out[2] - p[i, 2]
        total += x * x + z * z + (q[i, 1] - p[i, 1]) ** 2
    out[3] = math.sqrt(total / n)


@kernel
def window_features(joints: Samples, at: Times, offsets: Times, left: int, right: int, out: Samples) -> None:
    """Clouds of `joints` (n, j, 3) at frames `at` (m,) and `offsets` (o,) beside them, into `out` (m, o j 3).

    Seen from the root's place on the floor at the frame itself, turned to the front by the line from joint `right` to joint `left`.
    """
    count = joints.shape[1]
    for r in range(at.shape[0]):
        i = at[r]
        a, b = joints[i, left, 0] - joints[i, right, 0], joints[i, left, 2] - joints[i, right, 2]
        size = math.sqrt(a * a + b * b)
        cos, sin = (a / size, b / size) if size > 0.0 else (1.0, 0.0)
        x, z = joints[i, 0, 0], joints[i, 0, 2]
        k = 0
        for o in range(offsets.shape[0]):
            for j in range(count):
                dx, dz = joints[i + offsets[o], j, 0] - x, joints[i + offsets[o], j, 2] - z
                out[r, k] = dx * cos + dz * sin
                out[r, k + 1] = joints[i + offsets[o], j, 1]
                out[r, k + 2] = dz * cos - dx * sin
                k += 3


def cloud_distance(joints: Samples, leave: int, enter: int, half: int) -> Samples:
    """Turn, x, z and rms distance (4,) of the windows of `half` frames on either side of two frames of `joints` (n, j, 3)."""
    out = np.empty(4)
    first, then = (np.ascontiguousarray(joints[at - half : at + half + 1]).reshape(-1, 3) for at in (leave, enter))
    placement(first, then, out)
    return out
