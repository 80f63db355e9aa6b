"""Straight to the vertices, region by region: each goes by the markers nearest to it (thesis 9.3.3, without parts)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from operators.steering.fit import KEPT, USUAL, PoseRegression, Steering, untrained
from operators.steering.part import Part
from operators.steering.parts import along_surface, edges_of, seams_of
from operators.steering.regression import learn
from stream.chunk import Array, Samples

REGION = 0.12
"""How far a marker's region blends into others along the surface, in diagonals of the mesh (standard deviation)."""
LEAST = 0.05
"""A region that has a smaller share in a vertex leaves it to the others."""
NEAREST = (3, 4, 5, 6, 8)


def fit_local(
    frames: Samples,
    faces: Array,
    markers: Mapping[str, int],
    reference: Sequence[str],
    heading: Sequence[str] = (),
    how: PoseRegression = USUAL,
    earlier: Samples | None = None,
) -> Steering:
    """A model of one part for each marker, never turned, which goes by the nearest markers along the surface; how many is found by
    leaving frames out, for each part by itself.

    One regression for the whole mesh weighs whole training frames; regions of their own can do what they never did together.
    """
    bare, points, x = untrained(frames, markers, reference, heading, how, earlier)
    at, rest = bare.vertices, frames[0]
    apart = along_surface(at, np.concatenate([edges_of(faces), seams_of(frames)]), rest)
    straight = np.linalg.norm(rest[None] - rest[at][:, None], axis=-1)
    apart = np.where(np.isfinite(apart), apart, straight) / np.linalg.norm(np.ptp(rest, axis=0))
    near = np.exp(-0.5 * (apart**2 - apart.min(axis=0) ** 2) / REGION**2)
    near /= near.sum(axis=0)
    near = np.where(near < LEAST, 0.0, near)
    near /= near.sum(axis=0)
    parts = []
    for marker, share in enumerate(near):
        if (share > 0.0).any():
            order = np.argsort(apart[marker, at], kind="stable")
            features = {n: np.unique(np.concatenate([bare.own(bare.markers[k]) for k in order[:n]])) for n in NEAREST}
            vertices = np.flatnonzero(share)
            parts.append(_region(points[:, vertices], replace(EMPTY, vertices=vertices, weights=share[vertices]), x, [
                one for one in (*features.values(), np.arange(x.shape[1])) if len(one)
            ]))  # fmt: skip
    return replace(bare, parts=tuple(parts))


EMPTY = Part(
    np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 0)), 1.0, np.zeros(0, np.int64),
    learn(np.zeros((1, 1)), np.zeros((1, 1))),
)  # fmt: skip


def _region(points: Samples, part: Part, x: Samples, choices: Sequence[Array]) -> Part:
    """A region whose vertices are at `points` (f, n, 3), by that choice of features which predicts frames left out best."""
    mean = points.mean(axis=0)
    off = (points - mean).reshape(len(points), -1)
    _, size, directions = np.linalg.svd(off, full_matrices=False)
    left = np.sqrt(np.append(np.cumsum(size[::-1] ** 2)[::-1], 0.0) / points[..., 0].size)
    basis = directions[: int(np.argmax(left <= KEPT * max(float(np.linalg.norm(np.ptp(mean, axis=0))), 1e-9)))]
    still = np.tile([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], (len(points), 1))
    y = np.hstack([still, off @ basis.T / np.sqrt(len(mean))])
    found = [(learn(x[:, one], y), one) for one in choices]
    learned, features = min(found, key=lambda one: one[0].error)
    return replace(part, mean=mean, modes=basis, features=features, learned=learned)
