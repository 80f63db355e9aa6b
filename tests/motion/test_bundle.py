"""Bundling against a plain float64 reference (brute force, SVD, mean shift), frame by frame; and the eigenvectors it rests on."""

import numpy as np
import pytest

from kinegraph.operators.features.bundle import Bundle
from kinegraph.operators.features.eigen import symmetric_eigen
from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec
from kinegraph.stream.operator import grid


def by_hand(x, k, ahead, window, variance=0.975):
    """What Bundle says it does, for a whole recording without gaps."""
    made = x.copy()
    for i in range(2, len(x) - ahead):
        way = 8.0 * (x[i + 1] - x[i - 1]) - (x[i + 2] - x[i - 2])
        first = max(0, i + ahead + 1 - window)
        others = np.delete(x[first : i + ahead + 1], i - first, axis=0)
        near = others[np.argsort(((others - x[i]) ** 2).sum(axis=1), kind="stable")[:k]] - x[i]
        if len(near) < 3:
            continue
        if way @ way > 0.0:
            near -= np.outer(near @ way, way) / (way @ way)
        middle = near.mean(axis=0)
        _, sizes, axes = np.linalg.svd(near - middle, full_matrices=False)
        held = np.cumsum(sizes**2)
        kept = min(int(np.searchsorted(held, variance * held[-1])) + 1, len(near) - 1)
        spread = sizes[:kept] / np.sqrt(len(near) - 1)
        points = (near - middle) @ axes[:kept].T / spread
        at = -middle @ axes[:kept].T / spread
        for _ in range(500):
            apart = ((points - at) ** 2).sum(axis=1)
            weights = np.exp((apart.min() - apart) / 2.0 * len(near) ** (2.0 / (kept + 4.0)))
            after = weights @ points / weights.sum()
            moved, at = ((after - at) ** 2).sum(), after
            if moved < 1e-12:
                break
        made[i] = x[i] + middle + (at * spread) @ axes[:kept]
    return made[: len(x) - ahead]


def bundled(operator, x):
    operator.open({"in": StreamSpec((x.shape[1],), rate_hz=30.0)})
    pieces = operator.process("in", Chunk(grid(30.0, len(x)), x, FOREVER))
    return np.concatenate([piece.data for _, piece in pieces]), np.concatenate([piece.time for _, piece in pieces])


def cycles(n, features, noise, seed=5):
    rng = np.random.default_rng(seed)
    phase = 0.21 * np.arange(n)
    clean = np.stack([np.sin(phase + i) + 0.3 * np.cos(2 * phase - i) for i in range(features)], 1)
    return clean, (clean + noise * rng.normal(size=clean.shape)).astype(np.float32).astype(np.float64)


@pytest.mark.parametrize(("features", "ahead"), [(3, 2), (20, 2), (20, 15)])
def test_every_frame_is_what_the_plain_reference_gives(features, ahead):
    _, x = cycles(220, features, 0.1)
    made, times = bundled(Bundle(k=16, window_s=4.0, ahead=ahead), x)
    np.testing.assert_allclose(made, by_hand(x, 16, ahead, 120), atol=2e-5)
    assert np.array_equal(times, grid(30.0, 220)[: 220 - ahead])


def test_where_nothing_moves_there_is_no_way_to_leave_out():
    _, x = cycles(220, 3, 0.1)
    for at in (60, 120, 180):
        x[at : at + 6] = x[at]
    made, _ = bundled(Bundle(k=16, window_s=4.0, ahead=2), x)
    np.testing.assert_allclose(made, by_hand(x, 16, 2, 120), atol=2e-5)


def test_noise_across_the_way_goes():
    clean, x = cycles(900, 4, 0.05)
    made, _ = bundled(Bundle(), x)
    late = slice(300, len(made))
    before, after = (x[: len(made)] - clean[: len(made)])[late], (made - clean[: len(made)])[late]
    assert np.linalg.norm(after) < 0.8 * np.linalg.norm(before)


def test_a_bad_frame_comes_out_as_it_is_and_nobody_gathers_round_it():
    _, x = cycles(200, 5, 0.1)
    x[100, 2] = np.nan
    made, _ = bundled(Bundle(k=16, window_s=4.0), x)
    assert np.isnan(made).sum() == 1 and np.isnan(made[100, 2])
    assert np.array_equal(made[98:103, [0, 1, 3, 4]], x[98:103, [0, 1, 3, 4]])
    assert not np.array_equal(made[97], x[97])


@pytest.mark.parametrize("n", [1, 2, 3, 8, 32])
@pytest.mark.parametrize("kind", ["full", "thin", "zero", "diagonal"])
def test_eigenvectors_agree_with_numpy(n, kind):
    y = np.random.default_rng(n).normal(size=(n, 60 if kind == "full" else 2)) * (0.0 if kind == "zero" else 1.0)
    a = np.diag(np.arange(n) % 3.0) if kind == "diagonal" else y @ y.T
    values, vectors = np.zeros(n), np.zeros((n, n))
    symmetric_eigen(a.copy(), n, values, np.zeros(n), vectors)
    size = max(1.0, np.abs(a).max())
    np.testing.assert_allclose(np.sort(values), np.linalg.eigvalsh(a), atol=1e-12 * n * size)
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(n), atol=1e-12)
    np.testing.assert_allclose(vectors.T * values @ vectors, a, atol=1e-12 * n * size)
