"""The grid of poses, cell by cell: the two nearest cells are those of a plain search."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.maps.pose_map.som_kernel import nearest_cells


@pytest.mark.parametrize("seed", range(20))
def test_the_two_nearest_cells_are_those_of_a_plain_search(seed: int) -> None:
    random = np.random.default_rng(seed)
    codes, x = random.normal(size=(3, 12)), random.normal(size=3)
    found, distances, apart = np.full(3, -7), np.full(3, -7.0), np.zeros(12)
    nearest_cells(codes, x, apart, found[:2], distances[:2])
    plain = np.sqrt(((codes - x[:, None]) ** 2).sum(axis=0))
    assert found.tolist() == [*np.argsort(plain)[:2].tolist(), -7], "the last one is not the kernel's"
    np.testing.assert_allclose(distances, [*np.sort(plain)[:2], -7.0])
    np.testing.assert_allclose(apart, plain**2)
