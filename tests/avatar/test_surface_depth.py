"""How deep the surface before a place is: from eight points on, and without what lies much nearer."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.body.geodesic_kernel import surface_at


@pytest.mark.parametrize(("known", "deep"), [(7, False), (8, True), (24, True)])
def test_a_surface_is_the_median_of_at_least_eight_points(known: int, deep: bool) -> None:
    points = np.full((5, 6, 3), np.nan)
    flat = points.reshape(-1, 3)
    flat[:known] = [(0.01 * (k % 3), 0.0, 2.0 + 0.01 * k) for k in range(known)]
    flat[24:28] = (0.0, 0.0, 1.2)  # an arm, far before it
    flat[28:] = (0.5, 0.0, 2.0)  # beside it
    found = surface_at(points, np.array([0.0, 0.0, 2.0]), 0.1)
    assert found == pytest.approx(2.0 + 0.005 * (known - 1)) if deep else np.isnan(found)
