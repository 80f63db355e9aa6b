"""Straight to the vertices, region by region: each goes by the markers near it, as seen from there (thesis 9.3.3, without parts)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from kinegraph.operators.steering.model.fit import KEPT, Steering, untrained
from kinegraph.operators.steering.model.marker_frame import MarkerFrame
from kinegraph.operators.steering.model.part import Part
from kinegraph.operators.steering.model.parts import along_surface, edges_of, seams_of
from kinegraph.operators.steering.model.regression import learn
from kinegraph.stream.chunk import Array, Samples, Times

REGIONS = 26
"""How many regions, or as many as there are markers."""
REGION = 0.06
"""How far a region blends into others along the surface, in diagonals of the mesh (standard deviation)."""
LEAST = 0.05
"""A region that has a smaller share in a vertex leaves it to the others."""
STEADY, AFAR = 0.1, 1e-3
"""How far along the surface markers count for how a region is turned, and what those farther off count beside them."""
SEEN, BESIDE = (0.15, 0.3), 0.05
"""How far along the surface markers count for how a region is bent, which is chosen; and what those farther off count."""
MODES = 10
"""Shape modes of a region, at most."""


def fit_local(
    frames: Samples, faces: Array, markers: Mapping[str, int], reference: Sequence[str], heading: Sequence[str] = ()
) -> Steering:
    """A model of one part for each of `REGIONS`, in the place of the markers near it, and turned with them. How it is bent goes by all
    markers as seen from there, by how near they are along the surface.

    One regression for the whole mesh weighs whole training frames; regions of their own can do what they never did together, and one that
    bends as it did is known again wherever the body has turned it.
    """
    bare, points, x = untrained(frames, markers, reference, heading)
    edges, rest = np.concatenate([edges_of(faces), seams_of(frames)]), frames[0]
    diagonal = float(np.linalg.norm(np.ptp(rest, axis=0)))
    middles = spread_on(bare.vertices, edges, rest, REGIONS)
    apart = _apart(middles, edges, rest) / diagonal
    near = np.exp(-0.5 * (apart**2 - apart.min(axis=0) ** 2) / REGION**2)
    near /= near.sum(axis=0)
    near = np.where(near < LEAST, 0.0, near)
    near /= near.sum(axis=0)
    seen = x.reshape(len(x), -1, 3)
    parts = []
    for far, share in zip(apart[:, bare.vertices], near, strict=True):
        if len(vertices := np.flatnonzero(share)):
            weights = np.exp(-0.5 * (far / STEADY) ** 2) + AFAR
            shares = [np.exp(-0.5 * (far / width) ** 2) + BESIDE for width in SEEN]
            found = [_region(points[:, vertices], vertices, share[vertices], seen, (weights, one)) for one in shares]
            parts.append(min(found, key=lambda part: part.learned.error))
    return replace(bare, parts=tuple(parts))


def spread_on(first: Times, edges: Times, rest: Samples, count: int) -> Times:
    """Vertices: the `first`, and those farthest from all before along the surface, until there are `count`; of `rest` (v, 3)."""
    found = list(first)
    nearest = _apart(np.asarray(found), edges, rest).min(axis=0)
    while len(found) < min(count, len(rest)):
        found.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, _apart(np.array(found[-1:]), edges, rest)[0])
    return np.asarray(found, np.int64)


def _apart(vertices: Times, edges: Times, rest: Samples) -> Samples:
    """How far the mesh's vertices are from some (m, vertices): along the surface, or straight where they are not joined."""
    apart = along_surface(vertices, edges, rest)
    return np.where(np.isfinite(apart), apart, np.linalg.norm(rest[None] - rest[vertices][:, None], axis=-1))


def _region(points: Samples, vertices: Times, weights: Samples, seen: Samples, counts: tuple[Samples, Samples]) -> Part:
    """Fits a region with vertices at `points` (f, n, 3) to markers `seen` (f, m, 3), weighted by `counts` for its turn and its bend."""
    frame = MarkerFrame.of(seen, *counts)
    turns, middles, features = frame(seen)
    local = (points - middles[:, None]) @ turns
    mean = local.mean(axis=0)
    off = (local - mean).reshape(len(local), -1)
    _, size, directions = np.linalg.svd(off, full_matrices=False)
    left = np.sqrt(np.append(np.cumsum(size[::-1] ** 2)[::-1], 0.0) / local[..., 0].size)
    enough = int(np.argmax(left <= KEPT * max(float(np.linalg.norm(np.ptp(mean, axis=0))), 1e-9)))
    basis = directions[: min(enough, MODES)]
    still = np.tile([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], (len(local), 1))
    learned = learn(features, np.hstack([still, off @ basis.T / np.sqrt(len(mean))]))
    return Part(vertices, weights, mean, basis, 1.0, np.arange(features.shape[1]), learned, frame=frame)
