"""Rotations of parts: from two columns, and the one that brings points onto others."""

from __future__ import annotations

import numpy as np

from kinegraph.stream.chunk import Samples


def matrix(six: Samples) -> Samples:
    """The rotation matrix (3, 3) nearest to two columns (6,)."""
    a = six[:3] / max(float(np.linalg.norm(six[:3])), 1e-12)
    b = six[3:] - a * (a @ six[3:])
    b = b / max(float(np.linalg.norm(b)), 1e-12)
    return np.stack([a, b, np.cross(a, b)], axis=1)


def rigid(a: Samples, b: Samples) -> tuple[Samples, Samples]:
    """The rotation (3, 3) and translation (3,) that bring the points `a` (n, 3) onto `b` best: b ~ a R^T + t (Gower 1975)."""
    ca, cb = a.mean(axis=0), b.mean(axis=0)
    u, _, vt = np.linalg.svd((a - ca).T @ (b - cb))
    turn = (u * [1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return turn.T, cb - turn.T @ ca
