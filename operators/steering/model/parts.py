"""A moving mesh in near-rigid parts: clustered PCA, one piece each, with weights that blend where they meet (thesis 9.3.5, 9.4.3)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from kinegraph.operators.steering.model.turns import rigid
from kinegraph.stream.chunk import Array, Samples, Times

ROUNDS = 20
FITS = 3
"""How often the mean shape of a part is made of frames turned onto it."""
DIMENSION = 3
"""Vertices of a rigid part move as an affine image of their places at rest: their trajectories span three dimensions."""


def edges_of(faces: Array) -> Times:
    """The edges (m, 2) of triangles, each once."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    return np.unique(np.sort(pairs, axis=1), axis=0)


def seams_of(frames: Samples) -> Times:
    """Edges (m, 2) between vertices that lie at one place in all `frames` (f, vertices, 3).

    Where texture or shading breaks, many programs write a vertex twice, and the triangles on either side are not joined.
    """
    moved = np.ascontiguousarray(frames.transpose(1, 0, 2), np.float32).reshape(frames.shape[1], -1)
    order = np.lexsort(moved[:, :: max(1, moved.shape[1] // 64)].T)
    same = (moved[order[1:]] == moved[order[:-1]]).all(axis=1)
    return np.sort(np.stack([order[:-1][same], order[1:][same]], axis=1), axis=1).astype(np.int64)


def near_rigid_parts(frames: Samples, edges: Times, count: int) -> Times:
    """The part (vertices,) of each vertex of a mesh's `frames` (f, vertices, 3), numbered from 0; at most `count` of them.

    Each vertex goes to the part with the affine subspace nearest to its trajectory; the subspaces are fitted to their vertices in turn.
    What is not joined to most of its part goes to the neighbouring ones.
    """
    moved = np.ascontiguousarray(frames.transpose(1, 0, 2)).reshape(frames.shape[1], -1)
    at = [int(((moved - moved.mean(axis=0)) ** 2).sum(1).argmax())]
    nearest = ((moved - moved[at[0]]) ** 2).sum(1)
    while len(at) < min(count, len(moved)):
        at.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, ((moved - moved[at[-1]]) ** 2).sum(1))
    part: Times = np.stack([((moved - moved[a]) ** 2).sum(1) for a in at]).argmin(axis=0).astype(np.int64)
    for _ in range(ROUNDS):
        before = part
        part = np.stack([_residuals(moved, moved[part == k]) for k in range(len(at))]).argmin(axis=0).astype(np.int64)
        if (part == before).all():
            break
    return in_one_piece(part, edges)


def fewest_parts(
    frames: Samples,
    edges: Times,
    most: int,
    goal: float,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[int, float]:
    """How few near-rigid parts, `most` at most, leave no more than `goal`, and what they leave; see `rigid_error`.

    Found by halving: more parts are taken to leave less, which holds but for a few parts.
    """
    few, many, left = 1, most, rigid_error(frames, near_rigid_parts(frames, edges, most))
    tries = most.bit_length()
    for k in range(tries):
        if few >= many or left > goal:
            break
        progress(k + 1, tries + 1)
        middle = (few + many) // 2
        if (off := rigid_error(frames, near_rigid_parts(frames, edges, middle))) <= goal:
            many, left = middle, off
        else:
            few = middle + 1
    return many, left


def rigid_error(frames: Samples, part: Times) -> float:
    """How far vertices are from where they would be if each part (vertices,) only turned and shifted, in the mean; percent of the diagonal
    of the first of `frames` (f, vertices, 3)."""
    total = 0.0
    for k in range(int(part.max()) + 1):
        points = frames[:, part == k]
        mean = points[0]
        for _ in range(FITS):
            mean = np.mean([frame @ turn.T + move for frame, (turn, move) in _onto(points, mean)], axis=0)
        total += sum(
            float(np.linalg.norm(frame @ turn.T + move - mean, axis=1).sum())
            for frame, (turn, move) in _onto(points, mean)
        )
    diagonal = float(np.linalg.norm(np.ptp(frames[0], axis=0)))
    return float(100.0 * total / (frames.shape[0] * frames.shape[1] * diagonal))


def _onto(points: Samples, mean: Samples) -> Iterator[tuple[Samples, tuple[Samples, Samples]]]:
    return ((frame, rigid(frame, mean)) for frame in points)


def _residuals(moved: Samples, members: Samples) -> Samples:
    """How far (squared) trajectories lie from the affine subspace of a part's."""
    if len(members) <= DIMENSION:
        return np.full(len(moved), np.inf)
    centre = members.mean(axis=0)
    _, axes = np.linalg.eigh((members - centre).T @ (members - centre))
    rest = moved - centre
    return np.asarray((rest**2).sum(1) - ((rest @ axes[:, -DIMENSION:]) ** 2).sum(1))


def in_one_piece(part: Times, edges: Times) -> Times:
    """Parts of which each is joined: smaller pieces take the part that most of their neighbours have. Numbered from 0."""
    part, n = part.copy(), len(part)
    for _ in range(n):
        same = edges[part[edges[:, 0]] == part[edges[:, 1]]]
        _, piece = connected_components(_graph(same, np.ones(len(same)), n), directed=False)
        sizes = np.bincount(piece)
        largest = {int(k): int(np.bincount(piece[part == k]).argmax()) for k in np.unique(part)}
        loose = piece != np.array([largest[int(k)] for k in part])
        border = edges[(part[edges[:, 0]] != part[edges[:, 1]])]
        border = np.concatenate([border, border[:, ::-1]])
        border = border[loose[border[:, 0]] & ~loose[border[:, 1]]]
        if not len(border):
            break
        smallest = piece[border[sizes[piece[border[:, 0]]].argmin(), 0]]
        joined = border[piece[border[:, 0]] == smallest, 1]
        part[piece == smallest] = np.bincount(part[joined]).argmax()
    return np.unique(part, return_inverse=True)[1].astype(np.int64)


def blend_weights(part: Times, edges: Times, rest: Samples, reach: float) -> tuple[Times, Samples]:
    """For each vertex its part and the nearest other one (vertices, 2), and their weights (vertices, 2), which add up to 1.

    At a border both weigh half; from a geodesic distance of `reach` on, the own part alone.
    """
    length = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    graph = _graph(edges, np.maximum(length, 1e-12), len(part))
    parts, weights = np.stack([part, part], 1), np.zeros((len(part), 2))
    weights[:, 0] = 1.0
    crossing = edges[part[edges[:, 0]] != part[edges[:, 1]]]
    for k in np.unique(part):
        outside = np.unique(np.concatenate([crossing[part[crossing[:, a]] != k, a] for a in (0, 1)]))
        near = np.unique(np.concatenate([crossing[part[crossing[:, a]] == k, 1 - a] for a in (0, 1)]))
        sources = np.intersect1d(outside, near)
        if not len(sources):
            continue
        distance, _, source = dijkstra(
            graph, directed=False, indices=sources, min_only=True, limit=reach, return_predecessors=True
        )
        mine = (part == k) & np.isfinite(distance) & (distance < reach)
        parts[mine, 1] = part[source[mine]]
        weights[mine, 1] = 0.5 * (1.0 - distance[mine] / reach)
        weights[mine, 0] = 1.0 - weights[mine, 1]
    return parts, weights


def along_surface(vertices: Times, edges: Times, rest: Samples) -> Samples:
    """How far the mesh's vertices are from some `vertices` (m,) along the surface, (m, vertices); inf where they are not joined."""
    length = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    graph = _graph(edges, np.maximum(length, 1e-12), len(rest))
    return np.asarray(dijkstra(graph, directed=False, indices=vertices))


def nearest_of(vertices: Times, edges: Times, rest: Samples) -> Times:
    """For each vertex of the mesh, which of some `vertices` is nearest to it along the surface (numbers into `vertices`).

    What is not joined to any of them goes by the straight distance.
    """
    along = along_surface(vertices, edges, rest)
    straight = np.linalg.norm(rest[None] - rest[vertices][:, None], axis=-1)
    return np.asarray(np.where(np.isfinite(along), along, 1e6 + straight).argmin(axis=0), np.int64)


def _graph(edges: Times, weights: Samples, n: int) -> Any:
    return csr_matrix((weights, (edges[:, 0], edges[:, 1])), shape=(n, n))
