"""Markers as seen from one place of a body: from where those near it lie, and how they are turned."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

ROUNDS = 3
"""How often the usual places of markers are taken again, in the frames that follow from them."""


@dataclass(frozen=True, slots=True)
class MarkerFrame:
    """A frame that moves with markers: the rigid motion that brings their usual places nearest to them, in the sum of weighted squares.

    weights  (m,)    what each marker counts for the motion; their sum is 1
    usual    (m, 3)  where markers usually are, about their weighted mean
    shares   (m,)    by what each marker's place counts among the numbers that tell the pose
    """

    weights: Samples
    usual: Samples
    shares: Samples

    @staticmethod
    def of(seen: Samples, weights: Samples, shares: Samples) -> MarkerFrame:
        """The frame of markers `seen` (f, m, 3) in a training."""
        weights = weights / weights.sum()
        frame = MarkerFrame(weights, seen[0] - weights @ seen[0], shares)
        for _ in range(ROUNDS):
            turns, middles = frame.motions(seen)
            usual = ((seen - middles[:, None]) @ turns).mean(axis=0)
            frame = MarkerFrame(weights, usual - weights @ usual, shares)
        return frame

    def motions(self, seen: Samples) -> tuple[Samples, Samples]:
        """How the frame is turned (f, 3, 3), and where it is (f, 3), for markers (f, m, 3)."""
        middles = np.einsum("m,fma->fa", self.weights, seen)
        cross = np.einsum("m,fma,mb->fab", self.weights, seen - middles[:, None], self.usual)
        u, _, vt = np.linalg.svd(cross)
        u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
        return u @ vt, middles

    def __call__(self, seen: Samples) -> tuple[Samples, Samples, Samples]:
        """The frame's motions, and markers as seen from it, by their shares: (f, 3 m)."""
        turns, middles = self.motions(seen)
        features = ((seen - middles[:, None]) @ turns) * self.shares[:, None]
        return turns, middles, features.reshape(len(seen), -1)


@kernel
def see_from(
    marks: Samples, weights: Samples, usual: Samples, shares: Samples, pose: Samples, features: Samples, room: Samples
) -> None:
    """Writes a sample's markers (m, 3) as a `MarkerFrame` sees them into `features` (3 m,); turn columns and place into `pose` (9,).

    The turn is Horn's quaternion (1987): the eigenvector of the largest eigenvalue of a matrix (4, 4), by Jacobi's rotations. `room`
    is (11, 4).
    """
    m = marks.shape[0]
    cross, n, v = room[:3], room[3:7], room[7:11]
    cross[:] = 0.0
    for a in range(3):
        pose[6 + a] = 0.0
        for k in range(m):
            pose[6 + a] += weights[k] * marks[k, a]
    for k in range(m):
        for a in range(3):
            for b in range(3):
                cross[a, b] += weights[k] * usual[k, a] * (marks[k, b] - pose[6 + b])
    _horn(cross, n)
    _largest(n, v)
    best = 0
    for k in range(1, 4):
        if n[k, k] > n[best, best]:
            best = k
    w, x, y, z = v[0, best], v[1, best], v[2, best], v[3, best]
    turn = cross  # no longer needed
    turn[0, 0], turn[0, 1], turn[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    turn[1, 0], turn[1, 1], turn[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    turn[2, 0], turn[2, 1], turn[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    for a in range(3):
        pose[a], pose[3 + a] = turn[a, 0], turn[a, 1]
    for k in range(m):
        for b in range(3):
            s = 0.0
            for a in range(3):
                s += (marks[k, a] - pose[6 + a]) * turn[a, b]
            features[3 * k + b] = shares[k] * s


@kernel
def _horn(cross: Samples, n: Samples) -> None:
    """Horn's symmetric matrix (4, 4) of a cross-covariance (3, 3), usual places by those seen."""
    xx, xy, xz = cross[0, 0], cross[0, 1], cross[0, 2]
    yx, yy, yz = cross[1, 0], cross[1, 1], cross[1, 2]
    zx, zy, zz = cross[2, 0], cross[2, 1], cross[2, 2]
    n[0, 0], n[1, 1] = xx + yy + zz, xx - yy - zz
    n[2, 2], n[3, 3] = yy - xx - zz, zz - xx - yy
    n[0, 1], n[0, 2], n[0, 3] = yz - zy, zx - xz, xy - yx
    n[1, 2], n[1, 3], n[2, 3] = xy + yx, zx + xz, yz + zy
    for i in range(4):
        for j in range(i):
            n[i, j] = n[j, i]


@kernel
def _largest(n: Samples, v: Samples) -> None:
    """Eigenvectors of a symmetric matrix `n` (4, 4) into the columns of `v`; its eigenvalues stay on the diagonal of `n`."""
    v[:] = 0.0
    size = 0.0
    for i in range(4):
        v[i, i] = 1.0
        for j in range(4):
            size += n[i, j] * n[i, j]
    for _ in range(12):
        rest = 0.0
        for p in range(3):
            for q in range(p + 1, 4):
                rest += n[p, q] * n[p, q]
                if n[p, q] == 0.0:
                    continue
                theta = (n[q, q] - n[p, p]) / (2.0 * n[p, q])
                t = (1.0 if theta >= 0.0 else -1.0) / (abs(theta) + math.sqrt(theta * theta + 1.0))
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(4):
                    a, b = n[k, p], n[k, q]
                    n[k, p], n[k, q] = c * a - s * b, s * a + c * b
                for k in range(4):
                    a, b = n[p, k], n[q, k]
                    n[p, k], n[q, k] = c * a - s * b, s * a + c * b
                for k in range(4):
                    a, b = v[k, p], v[k, q]
                    v[k, p], v[k, q] = c * a - s * b, s * a + c * b
        if rest <= 1e-28 * size:
            break
