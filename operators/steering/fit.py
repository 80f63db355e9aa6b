"""From a moving mesh and the vertices that markers stand for: the part model, or the mesh straight from markers (thesis 9.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from operators.steering.parts import blend_weights, edges_of, near_rigid_parts, nearest_of
from operators.steering.regression import Learned, learn
from stream.chunk import Array, Samples, Times

REACH = 0.024
"""How far parts blend into one another, in diagonals of the mesh."""
FITS = 5


@dataclass(frozen=True, slots=True)
class Part:
    """A near-rigid part: its vertices, their weights, mean shape about its centre (n, 3), modes (k, 3 n), size; and its regression.

    features  which of all features it goes by
    """

    vertices: Times
    weights: Samples
    mean: Samples
    modes: Samples
    size: float
    features: Times
    learned: Learned


@dataclass(frozen=True, slots=True)
class Steering:
    """What has been learned of a mesh: markers (names and vertices), those that its place goes by, and its parts.

    usual, spread  (m, 3)  where the markers were in the mean, from the references' mean, and by what standard deviation they moved
    """

    markers: tuple[str, ...]
    vertices: Times
    reference: Times
    parts: tuple[Part, ...]
    usual: Samples
    spread: Samples

    def features(self, marks: Samples) -> tuple[Samples, Samples]:
        """Markers (f, m, 3) as seen from the references' mean: (f, 3 m); and that mean (f, 1, 3)."""
        centre = marks[:, self.reference].mean(axis=1, keepdims=True)
        return (marks - centre).reshape(len(marks), -1), centre

    def __call__(self, marks: Samples, count: int) -> Samples:
        """The mesh (f, count, 3) for markers (f, m, 3): the slow reference of the operator's kernel."""
        x, centre = self.features(marks)
        made = np.zeros((len(marks), count, 3))
        for part in self.parts:
            y = part.learned(x[:, part.features])
            for f in range(len(marks)):
                shape = part.mean + (y[f, 9:] * np.sqrt(len(part.vertices)) @ part.modes).reshape(-1, 3)
                made[f, part.vertices] += part.weights[:, None] * (shape @ matrix(y[f, :6]).T + y[f, 6:9])
        return made + centre


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


def fit_steering(
    frames: Samples,
    faces: Array,
    markers: Mapping[str, int],
    reference: Sequence[str],
    limbs: Sequence[str] = (),
    count: int = 14,
    modes: int = 4,
) -> Steering:
    """Learn how a mesh's `frames` (f, vertices, 3) follow from the vertices that `markers` names.

    reference  the markers whose mean is where the mesh is
    limbs      markers that alone drive the parts nearest to them, so that limbs can move as they never did together; the other parts,
               and all where none are named, go by all markers
    """
    names, at = tuple(markers), np.array(list(markers.values()), np.int64)
    edges = edges_of(faces)
    part = near_rigid_parts(frames, edges, count)
    diagonal = float(np.linalg.norm(np.ptp(frames[0], axis=0)))
    parts, weights = blend_weights(part, edges, frames[0], REACH * diagonal)
    body = np.array([names.index(name) for name in reference], np.int64)
    centre = frames[:, at][:, body].mean(axis=1, keepdims=True)
    seen = frames[:, at] - centre
    x = seen.reshape(len(seen), -1)
    nearest = nearest_of(at, edges, frames[0])
    made = []
    for k in range(int(part.max()) + 1):
        owner = names[int(np.bincount(nearest[part == k]).argmax())]
        own = 3 * names.index(owner) + np.arange(3)
        features = own if owner in limbs else np.arange(x.shape[1])
        share = (weights * (parts == k)).sum(axis=1)
        vertices = np.flatnonzero(share > 0.0)
        made.append(_part((frames - centre)[:, vertices], vertices, share[vertices], modes, x, features))
    return Steering(names, at, body, tuple(made), seen.mean(axis=0), seen.std(axis=0))


def _part(points: Samples, vertices: Times, weights: Samples, modes: int, x: Samples, features: Times) -> Part:
    """Mean shape, modes and regression of a part whose vertices are at `points` (f, n, 3)."""
    mean = points[0]
    for _ in range(FITS):
        fits = [rigid(frame, mean) for frame in points]
        mean = np.mean([frame @ turn.T + move for frame, (turn, move) in zip(points, fits, strict=True)], axis=0)
    centre = mean.mean(axis=0)
    mean = mean - centre
    poses = [rigid(mean, frame) for frame in points]
    shapes = np.array([(frame - move) @ turn for frame, (turn, move) in zip(points, poses, strict=True)]) - mean
    _, _, directions = np.linalg.svd(shapes.reshape(len(points), -1), full_matrices=False)
    basis = directions[:modes]
    size = float(np.sqrt((mean**2).sum(1).mean()))
    turns = np.array([turn[:, :2].T.ravel() for turn, _ in poses])
    moves = np.array([move for _, move in poses])
    coefficients = shapes.reshape(len(points), -1) @ basis.T / np.sqrt(len(vertices))
    learned = learn(x[:, features], np.hstack([turns * size, moves, coefficients]))
    return Part(vertices, weights, mean, basis, size, features, learned)
