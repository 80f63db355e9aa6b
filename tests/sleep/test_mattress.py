"""The plane of a mattress is found however the camera is tilted."""

from __future__ import annotations

import numpy as np
import pytest

from operators.depth.mattress import mattress


@pytest.mark.parametrize(("down", "right"), [(0.0, 0.0), (4e-6, 0.0), (0.0, 6e-6), (-3e-6, 5e-6), (2e-6, -7e-6)])
def test_the_plane_is_that_of_the_mattress_whoever_lies_on_it(down: float, right: float) -> None:
    rows, columns = np.mgrid[:12, :9]
    true = 1 / (1 / 2000.0 + down * rows + right * columns)
    seen = true.copy()
    seen[3:8, 3:6] -= 180.0
    seen[0, 0] = np.nan
    assert np.abs(mattress(seen, 15.0) - true).max() < 1.0
