"""Points of the network, moved to the middle of the heat around them: also where that lies at the picture's edge."""

from __future__ import annotations

import numpy as np
import pytest

from operators.body.crop import refine

SIDE = 64


@pytest.mark.parametrize("edge", [0, SIDE - 1])
def test_heat_at_the_edge_counts_like_any_other(edge: int) -> None:
    heat = np.full((SIDE, SIDE, 2), -50.0, np.float32)
    heat[edge, 30, 0] = heat[30, edge, 1] = 5.0
    near = abs(edge - 2) * 256.0 / SIDE
    points = np.zeros((2, 5))
    points[:, :2] = (30 * 4.0, near), (near, 30 * 4.0)
    refine(heat, points)
    assert points[0, :2] == pytest.approx((30 * 4.0, edge * 4.0), abs=1e-6)
    assert points[1, :2] == pytest.approx((edge * 4.0, 30 * 4.0), abs=1e-6)
