"""`python -m bench.steering_gradients FOLDER`: a mesh from markers by how its triangles turn and stretch, in frames not trained on.

Of every triangle the rotation's logarithm and the stretch are regressed from the markers, by a Gaussian kernel of its own in which the
markers near it count more; the vertices are those with edges that fit best (least squares), with the markers as soft constraints. Width,
ridge and how near a marker must be are chosen by leaving out every fourth frame of the training in turn. FOLDER and `--mesh` as for
`bench.steering`. Nothing of this is in `operators`: a frame takes a sparse solution and a rotation for every triangle.
"""

from __future__ import annotations

import argparse
import time
from itertools import product
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix, diags, eye, vstack
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from bench.steering import REFERENCE, markers_of, spread_markers
from kinegraph.operators.steering.model.local import fit_local
from kinegraph.stream.chunk import Array, Samples, Times

WIDTHS, RIDGES, REACHES = (1.0, 2.0, 4.0), (1e-3, 1e-2), (0.1, 0.2, 0.4)
FOLDS, MARKED = 4, 100.0
SYMMETRIC = np.triu_indices(3)


def frames_of(v: Samples, faces: Array) -> Samples:
    """Two edges and a normal as long as the root of its length, of each triangle: columns of (faces, 3, 3)."""
    a, b = v[faces[:, 1]] - v[faces[:, 0]], v[faces[:, 2]] - v[faces[:, 0]]
    n = np.cross(a, b)
    long = np.sqrt(np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-18))
    return np.stack([a, b, n / long], -1)


def turns_of(matrices: Samples) -> Samples:
    u, _, w = np.linalg.svd(matrices)
    flip = np.ones(matrices.shape[:-1])
    flip[..., 2] = np.sign(np.linalg.det(u @ w))
    return np.asarray((u * flip[..., None, :]) @ w)


class Surface:
    """How a mesh's triangles are turned and stretched from its first frame, and vertices from that."""

    def __init__(self, rest: Samples, faces: Array, at: Times) -> None:
        self.rest, self.faces, self.at, n = rest, faces, at, len(faces)
        self.diagonal = float(np.linalg.norm(np.ptp(rest, axis=0)))
        frames = frames_of(rest, faces)
        area = np.linalg.norm(np.cross(frames[..., 0], frames[..., 1]), axis=1) / 2
        self.flat = area < 1e-10 * self.diagonal**2
        frames[self.flat] = np.eye(3)
        self.back = np.linalg.inv(frames)
        pairs = [faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]
        self.edges = [rest[p[:, 1]] - rest[p[:, 0]] for p in pairs]
        weight = np.sqrt(np.maximum(area, 1e-12 * self.diagonal**2))
        self.weights = np.concatenate([weight / np.maximum(np.linalg.norm(e, axis=1), 1e-9) for e in self.edges])
        i, one = np.arange(n), np.ones(n)
        shape = (n, len(rest))
        each = [csr_matrix((np.r_[-one, one], (np.r_[i, i], np.r_[p[:, 0], p[:, 1]])), shape) for p in pairs]
        self.operator = diags(self.weights) @ vstack(each).tocsr()
        normal = self.operator.T @ self.operator
        self.marked = MARKED * normal.diagonal().mean()
        mark = csr_matrix((np.ones(len(at)), (np.arange(len(at)), at)), (len(at), len(rest)))
        self.marks = self.marked * mark.T
        self.solver = splu((normal + self.marks @ mark + 1e-11 * self.marked * eye(len(rest))).tocsc())

    def gradients(self, v: Samples) -> Samples:
        made = frames_of(v, self.faces) @ self.back
        made[self.flat] = np.eye(3)
        return made

    def vertices(self, gradients: Samples, marks: Samples) -> Samples:
        """Vertices of triangles with these `gradients` (faces, 3, 3), as nearly as possible, and which are at their `marks` (m, 3)."""
        wanted = np.concatenate([np.einsum("nab,nb->na", gradients, e) for e in self.edges]) * self.weights[:, None]
        return np.asarray(self.solver.solve(self.operator.T @ wanted + self.marks @ marks))


class Turned:
    """The regression, of `frames` (f, vertices, 3); markers count by how near they are in the first frame."""

    def __init__(
        self, surface: Surface, frames: Samples, refs: list[int], width: float, ridge: float, reach: float
    ) -> None:
        self.surface, self.refs = surface, refs
        gradients = [surface.gradients(v) for v in frames]
        turns = np.array([turns_of(g) for g in gradients])
        self.usual = turns_of(turns.mean(axis=0))
        logs = [Rotation.from_matrix(np.swapaxes(self.usual, 1, 2) @ t).as_rotvec() for t in turns]
        stretch = np.swapaxes(turns, 2, 3) @ np.array(gradients)
        known = np.concatenate([np.array(logs), stretch[..., SYMMETRIC[0], SYMMETRIC[1]]], axis=-1)
        self.mean = known.mean(axis=0)
        self.off = known - self.mean
        places = surface.rest[surface.at]
        middles = surface.rest[surface.faces].mean(axis=1)
        self.nearest = np.linalg.norm(middles[:, None] - places, axis=-1).argmin(axis=1)
        apart = np.linalg.norm(places[:, None] - places, axis=-1) / surface.diagonal
        self.share = np.repeat(np.exp(-0.5 * apart / reach), 3, axis=1)
        self.x, self.width, self.ridge = self.features(frames[:, surface.at]), width, ridge
        alike = [self.kernel(self.x * s, self.x * s, s) for s in self.share]
        self.solved = [np.asarray(np.linalg.inv(k + ridge * np.eye(len(k)))) for k in alike]

    def features(self, marks: Samples) -> Samples:
        return np.asarray((marks - marks[:, self.refs].mean(axis=1, keepdims=True)).reshape(len(marks), -1))

    def kernel(self, a: Samples, b: Samples, share: Samples) -> Samples:
        own = self.x * share
        median = np.median(((own[:, None] - own) ** 2).sum(-1)[np.triu_indices(len(own), 1)])
        return np.asarray(np.exp(-((a[:, None] - b) ** 2).sum(-1) / (2 * self.width**2 * median)))

    def __call__(self, marks: Samples) -> Samples:
        x = self.features(marks)
        weights = np.array(
            [self.kernel(x * s, self.x * s, s) @ k for s, k in zip(self.share, self.solved, strict=True)]
        )
        made = []
        for j, seen in enumerate(marks):
            result = self.mean + np.einsum("nf,fnc->nc", weights[self.nearest, j], self.off)
            stretch = np.empty((len(result), 3, 3))
            stretch[:, SYMMETRIC[0], SYMMETRIC[1]] = stretch[:, SYMMETRIC[1], SYMMETRIC[0]] = result[:, 3:]
            turns = self.usual @ Rotation.from_rotvec(result[:, :3]).as_matrix()
            made.append(self.surface.vertices(turns @ stretch, seen))
        return np.array(made)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.steering_gradients", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--mesh", choices=("horse-gallop", "samba"), default="horse-gallop")
    parser.add_argument("--every", type=int, help="which frames train: every second, third, ...")
    given = parser.parse_args()
    held, horse = np.load(given.folder / f"{given.mesh}.npz"), given.mesh == "horse-gallop"
    frames, faces = held["vertices"].astype(float), held["faces"].astype(np.int64)
    trained = np.arange(len(frames)) % (given.every or (2 if horse else 4)) == 0
    train, test = frames[trained], frames[~trained]
    markers = markers_of(train[0]) if horse else spread_markers(train[0], faces)
    at = np.array(list(markers.values()))
    names = [*REFERENCE] if horse else list(markers)
    refs = [list(markers).index(name) for name in names]
    surface = Surface(train[0], faces, at)

    def off(made: Samples, truth: Samples) -> Samples:
        return np.asarray(100.0 * np.linalg.norm(made - truth, axis=-1) / surface.diagonal)

    found = {}
    for choice in product(WIDTHS, RIDGES, REACHES):
        errors = []
        for fold in range(FOLDS):
            out = np.arange(len(train)) % FOLDS == fold
            errors.append(off(Turned(surface, train[~out], refs, *choice)(train[out][:, at]), train[out]).mean(axis=1))
        found[choice] = float(np.concatenate(errors).mean())
    best = min(found, key=lambda one: found[one])
    print(f"width {best[0]:g}, ridge {best[1]:g}, reach {best[2]:g}: {found[best]:.3f} % in frames left out")
    model = Turned(surface, train, refs, *best)
    begun = time.perf_counter()
    made = model(test[:, at])
    took = (time.perf_counter() - begun) / len(test)
    local = fit_local(train, faces, markers, names)(test[:, at], frames.shape[1])
    for name, what in (("turned and stretched", made), ("local", local), ("mean of both", (made + local) / 2)):
        error = off(what, test)
        print(f"{name} | {error.mean():.3f} | {np.percentile(error, 95):.2f} | {error.max():.2f}", flush=True)
    print(f"{1000 * took:.1f} ms a frame")


if __name__ == "__main__":
    main()
