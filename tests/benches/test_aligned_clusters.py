"""Aligned cluster analysis of the benches: its kernel is the one of dynamic time alignment, and it finds what was put together."""

from __future__ import annotations

import numpy as np
import pytest

from bench.aligned_clusters import align_back, aligned_clusters
from kinegraph.stream.chunk import Samples

pytestmark = pytest.mark.nightly


def alignment(k: Samples) -> float:
    """The dynamic time alignment kernel by its recursion, from the frame kernel (n, m) of two segments."""
    n, m = k.shape
    best = np.full((n, m), -np.inf)
    for i in range(n):
        for j in range(m):
            ways = [2.0 * k[0, 0]] if i == j == 0 else []
            ways += [best[i - 1, j] + k[i, j]] if i else []
            ways += [best[i, j - 1] + k[i, j]] if j else []
            ways += [best[i - 1, j - 1] + 2.0 * k[i, j]] if i and j else []
            best[i, j] = max(ways)
    return float(best[-1, -1] / (n + m))


def test_the_kernel_is_that_of_the_recursion() -> None:
    k = np.abs(np.random.default_rng(0).normal(size=(30, 30)))
    out = np.zeros(11)
    align_back(k, 20, 10, 21, 28, np.zeros((2, 11)), out)
    for n in range(1, 11):
        assert abs(out[n] - alignment(k[20 - n : 20, 21:28][::-1, ::-1])) < 1e-12


def test_movements_put_together_are_found_at_their_cuts() -> None:
    """Three movements of 10 to 14 frames, four times each: every cut within two frames, every movement a cluster of its own."""
    rng = np.random.default_rng(3)
    parts, cuts, kinds = list[Samples](), [0], list[int]()
    for kind in rng.permutation(np.repeat(np.arange(3), 4)).tolist():
        t = np.linspace(0.0, np.pi, int(rng.integers(10, 15)))
        part = 0.05 * rng.normal(size=(len(t), 3))
        part[:, kind] += 3.0 * np.sin(t)
        parts.append(part)
        cuts.append(cuts[-1] + len(t))
        kinds.append(kind)
    found = aligned_clusters(np.concatenate(parts), 3, 6, 18)
    assert (np.abs(found.starts - np.array(cuts)[:-1, None]).min(axis=1) <= 2).all()
    middle = [
        int(np.searchsorted(cuts, (a + b) / 2, side="right")) - 1 for a, b in zip(found.starts, found.ends, strict=True)
    ]
    pairs = {(kinds[m], int(c)) for m, c in zip(middle, found.cluster, strict=True)}
    assert len(pairs) == 3
