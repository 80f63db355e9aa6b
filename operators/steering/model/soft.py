"""Marked vertices as soft constraints: what a mesh is off by at its markers is taken back around them (thesis 9.4.2, equation 9.14)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

WIDTHS, RIDGES = (0.03, 0.05), (0.1, 0.5)
"""How far a marker is felt along the surface, in diagonals of the mesh; how softly the mesh follows it. Frames left out would choose .12,
which brings the mean down further; but vertices between two markers are then off by more than without any pull (docs/lab/steering.md)."""
MOST = 95.0
"""A marker pulls no farther than this percentile of what it was off by in frames left out."""


@dataclass(frozen=True, slots=True)
class MarkerPull:
    """How markers pull: how far it is felt (diagonals), how softly the mesh follows, and from what distance (m) on no stronger."""

    width: float
    ridge: float
    most: float


def felt(apart: Samples, at: Times, pull: MarkerPull) -> Samples:
    """By how much each vertex moves for what each marker is off by, (vertices, m).

    apart  (m, vertices)  how far vertices are from the markers along the surface, in diagonals; inf where they are not joined

    The displacement u of the mesh minimises the sum over markers of |x - x' - u|^2 plus `ridge` times the squared norm of u in the space of
    Gaussians along the surface: 9.14, with smoothness in the place of the shapes' variances.
    """
    near = np.exp(-0.5 * (apart / pull.width) ** 2)
    return np.ascontiguousarray(np.linalg.solve(near[:, at] + pull.ridge * np.eye(len(at)), near).T)


def pulled(off: Samples, apart: Samples, at: Times) -> tuple[MarkerPull | None, Samples]:
    """The pull that brings a mesh nearest to frames that were left out, by what it was `off` (f, vertices, 3) there, and what is left.

    None where no pull brings it nearer.
    """
    best, left = None, off
    long = np.linalg.norm(off[:, at], axis=-1)
    most = float(np.percentile(long, MOST))
    short = off[:, at] * np.minimum(1.0, most / np.maximum(long, 1e-12))[..., None]
    for width, ridge in product(WIDTHS, RIDGES):
        pull = MarkerPull(width, ridge, most)
        rest = off - np.einsum("vm,fma->fva", felt(apart, at, pull), short)
        if mean(rest) < mean(left):
            best, left = pull, rest
    return best, left


def mean(off: Samples) -> float:
    return float(np.linalg.norm(off, axis=-1).mean())


def pulls(residuals: Samples, weights: Samples, most: float, share: float) -> Samples:
    """What moves the mesh, (vertices, 3), where its markers are off by `residuals` (m, 3): the slow reference of `pull_mesh`."""
    long = np.maximum(np.linalg.norm(residuals, axis=-1, keepdims=True), 1e-12)
    return np.asarray(weights @ (share * residuals * np.minimum(1.0, most / long)))


def faded(outside: float) -> float:
    """By what share markers pull `outside` kernel widths from the training: wholly up to one, less beyond."""
    return min(1.0, math.exp(1.0 - outside))


@kernel
def pull_mesh(
    marks: Samples,
    centre: Samples,
    at: Times,
    weights: Samples,
    most: float,
    share: float,
    mesh: Samples,
    room: Samples,
) -> None:
    """Move the vertices of `mesh` (v, 3), which lies about `centre` (3,), by what its markers are off.

    marks    (m, 3)  where the markers are, from the centre   at (m,) their vertices   weights (v, m)   room (m, 3)
    """
    for k in range(at.shape[0]):
        d = 0.0
        for a in range(3):
            room[k, a] = marks[k, a] + centre[a] - mesh[at[k], a]
            d += room[k, a] * room[k, a]
        d = math.sqrt(d)
        scale = share * (most / d if d > most else 1.0)
        for a in range(3):
            room[k, a] *= scale
    for v in range(mesh.shape[0]):
        p = q = r = 0.0
        for k in range(at.shape[0]):
            w = weights[v, k]
            p += w * room[k, 0]
            q += w * room[k, 1]
            r += w * room[k, 2]
        mesh[v, 0] += p
        mesh[v, 1] += q
        mesh[v, 2] += r
