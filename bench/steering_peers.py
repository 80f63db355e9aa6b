"""What `bench.steering` is held against: other ways from markers to a mesh. All is chosen by leaving training frames out, one by one.

x are markers (f, d), y shapes (f, 3 v), both around the mesh's reference; every peer is a function (x, y, query) -> shapes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import nnls

from kinegraph.operators.steering.model.regression import squares
from kinegraph.operators.steering.model.turns import matrix, rigid
from kinegraph.stream.chunk import Samples, Times

Peer = Callable[[Samples, Samples, Samples], Samples]
RIDGES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1)
BONES = 4
"""A vertex follows at most so many parts."""


def ridge(x: Samples, y: Samples, query: Samples, share: float) -> Samples:
    """Linear ridge regression; the ridge is `share` of the mean variance. In the dual form, for few frames."""
    mx, my = x.mean(axis=0), y.mean(axis=0)
    gram = (x - mx) @ (x - mx).T
    inner = np.linalg.solve(gram + share * np.trace(gram) / len(x) * np.eye(len(x)), y - my)
    return np.asarray((query - mx) @ (x - mx).T @ inner + my)


def by_leaving_out(peers: Iterable[Peer], x: Samples, y: Samples) -> Peer:
    """The peer that predicts training frames best from the others."""
    best, least = None, np.inf
    for peer in peers:
        try:
            off = [peer(np.delete(x, i, 0), np.delete(y, i, 0), x[i : i + 1])[0] - y[i] for i in range(len(x))]
        except np.linalg.LinAlgError:
            continue
        if (error := float((np.array(off) ** 2).mean())) < least:
            best, least = peer, error
    assert best is not None
    return best


def components(y: Samples, most: int) -> tuple[Samples, Samples, Samples]:
    """Mean (q,), scores (f, k) and directions (k, q) of the principal components."""
    mean = y.mean(axis=0)
    u, size, directions = np.linalg.svd(y - mean, full_matrices=False)
    k = min(most, int((size > 1e-9 * size[0]).sum()))
    return mean, u[:, :k] * size[:k], directions[:k]


def global_pca(x: Samples, y: Samples) -> Peer:
    """Principal components of the whole mesh by ridge regression; their number and the ridge are chosen."""

    def peer(k: int, share: float) -> Peer:
        def made(a: Samples, b: Samples, query: Samples) -> Samples:
            mean, scores, directions = components(b, k)
            return np.asarray(ridge(a, scores, query, share) @ directions + mean)

        return made

    return by_leaving_out((peer(k, share) for k in (2, 3, 4, 6, 8, 10) for share in RIDGES), x, y)


def _canonical(left: Samples, right: Samples, seen: Samples, k: int, share: float) -> tuple[Samples, Samples]:
    """Canonical variates of two Gram matrices (f, f), centred: those of the frames (f, k) and of `seen` (n, f) by the first one.

    Regularised as by Hardoon 2004: the directions of largest correlation under a ridge in both spaces.
    """
    n = len(left)
    a = left @ left + share * np.trace(left) * left + 1e-9 * np.trace(left) ** 2 / n * np.eye(n)
    b = right @ right + share * np.trace(right) * right + 1e-9 * np.trace(right) ** 2 / n * np.eye(n)
    cross = left @ right
    found = eigh(cross @ np.linalg.solve(b, cross.T), a, subset_by_index=[n - min(k, n - 1), n - 1])[1]
    return left @ found, seen @ found


def canonical(x: Samples, y: Samples, *, kernel: bool) -> Peer:
    """Canonical correlation analysis of markers and shapes, then the shapes by least squares on the variates; linear or Gaussian."""

    def peer(k: int, share: float, width: float) -> Peer:
        def made(a: Samples, b: Samples, query: Samples) -> Samples:
            n, my = len(a), b.mean(axis=0)
            centring = np.eye(n) - 1 / n
            if width:
                apart = squares(a, a)
                scale = 1 / (2 * width**2 * float(np.median(apart[np.triu_indices(n, 1)])))
                gram, seen = np.exp(-scale * apart), np.exp(-scale * squares(query, a))
            else:
                gram, seen = a @ a.T, query @ a.T
            seen = (seen - gram.mean(axis=0)) @ centring
            variates, asked = _canonical(centring @ gram @ centring, (b - my) @ (b - my).T, seen, k, share)
            weights = np.linalg.lstsq(variates, b - my, rcond=1e-9)[0]
            return np.asarray(asked @ weights + my)

        return made

    widths = (0.7, 1.0, 1.4, 2.0, 2.8, 4.0) if kernel else (0.0,)
    return by_leaving_out((peer(k, s, w) for k in (2, 4, 6, 8) for s in RIDGES for w in widths), x, y)


def skinning(x: Samples, y: Samples, part: Times) -> Peer:
    """Linear blend skinning: a rigid motion for each part by ridge regression, fitted weights of at most four parts a vertex.

    It is fitted once, to the training frames `x` and `y`; what it is called with has to be these.
    """

    count = int(part.max()) + 1

    def motions_of(shapes: Samples, rest: Samples) -> Samples:
        """(f, k, 9): two columns of each part's rotation, and where its middle is."""
        motions = np.empty((len(shapes), count, 9))
        for f, shape in enumerate(shapes):
            for k in range(count):
                turn, _ = rigid(rest[part == k], shape[part == k])
                motions[f, k] = *turn[:, 0], *turn[:, 1], *shape[part == k].mean(axis=0)
        return motions

    def linear(share: float) -> Peer:
        return lambda a, b, query: ridge(a, b, query, share)

    shapes = y.reshape(len(y), -1, 3)
    rest = shapes.mean(axis=0)
    middles = np.array([rest[part == k].mean(axis=0) for k in range(count)])
    motions = motions_of(shapes, rest)
    weights = _weights(shapes, rest, middles, motions)
    flat = motions.reshape(len(y), -1)
    chosen = by_leaving_out((linear(share) for share in RIDGES), x, flat)

    def made(_a: Samples, _b: Samples, query: Samples) -> Samples:
        asked = chosen(x, flat, query).reshape(len(query), count, 9)
        return np.array([np.einsum("vk,kvc->vc", weights, _moved(rest, middles, one)).ravel() for one in asked])

    return made


def _moved(rest: Samples, middles: Samples, motion: Samples) -> Samples:
    """`rest` (v, 3) under each part's motion (k, 9), which turns it about its middle (k, 3): (k, v, 3)."""
    return np.array(
        [(rest - middle) @ matrix(one[:6]).T + one[6:] for middle, one in zip(middles, motion, strict=True)]
    )


def _weights(shapes: Samples, rest: Samples, middles: Samples, motions: Samples) -> Samples:
    """For each vertex the weights (v, k), not negative, sum 1, of the four parts that fit it best (Kavan 2010's least squares)."""
    moved = np.array([_moved(rest, middles, motion) for motion in motions])  # (f, k, v, 3)
    alone = ((moved - shapes[:, None]) ** 2).sum(axis=(0, 3))  # (k, v)
    near = np.argsort(alone, axis=0)[:BONES].T
    weights = np.zeros((len(rest), motions.shape[1]))
    strong = 10.0 * float(np.ptp(rest, axis=0).max())
    for v in range(len(rest)):
        columns = moved[:, near[v], v].transpose(0, 2, 1).reshape(-1, BONES)
        found, _ = nnls(np.vstack([columns, strong * np.ones(BONES)]), np.append(shapes[:, v].ravel(), strong))
        weights[v, near[v]] = found / max(found.sum(), 1e-9)
    return weights
