"""bench/facing.py makes a model that operators.body.facing reads, and that learns."""

from __future__ import annotations

import numpy as np
import pytest

from bench.facing import trained, turned_round
from kinegraph.operators.body.facing import CELLS

pytestmark = pytest.mark.nightly


def test_a_heading_is_learned_from_shapes() -> None:
    """Made-up bodies: what faces the left side lies nearer on the left."""
    random = np.random.default_rng(1)
    angles = random.uniform(0, 2 * np.pi, 400)
    y = np.stack([np.cos(angles), np.sin(angles)], 1)
    x = random.normal(0, 0.1, (400, 2, CELLS, CELLS))
    x[:, 0, :, : CELLS // 2] += y[:, :1, None]
    x[:, 0, : CELLS // 2] += y[:, 1:, None]
    x = x.reshape(400, -1)
    weights = trained(x[:300], y[:300], random)
    assert turned_round(weights, x[300:], y[300:]) < 0.05
    assert turned_round(weights, x[300:], -y[300:]) > 0.95
