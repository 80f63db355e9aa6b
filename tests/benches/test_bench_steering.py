"""The benches of steering: what is chosen by itself is held against baselines that get the same frames and markers."""

from __future__ import annotations

import numpy as np
import pytest

from bench.steering import REFERENCE, nearest_sum
from bench.steering_meshes import MovingMesh, compared
from devices.simulators.quadruped import marked, topology, walking

STRIDE = np.array([walking(k / 48) for k in range(48)])


@pytest.mark.parametrize("every", [2, 4])
def test_what_is_chosen_is_better_than_skinning_principal_components_and_the_nearest_frame(every: int) -> None:
    way, off = compared(MovingMesh(STRIDE, topology().faces, marked(), REFERENCE, (every,)), every)
    chosen, *baselines = off.values()
    assert f"chosen ({way})" in off and len(baselines) == 3 and all(chosen < 0.5 * one for one in baselines)


def test_the_nearest_sum_of_frames_is_nearer_than_any_one_of_them() -> None:
    train, truth = STRIDE[::4].reshape(12, -1), STRIDE[1::4]
    made = nearest_sum(train, truth)
    off = np.linalg.norm(made - truth, axis=(1, 2))
    assert (off <= np.linalg.norm(train[:, None] - truth.reshape(1, 12, -1), axis=-1).min(axis=0)).all()
    assert np.allclose(nearest_sum(train, STRIDE[::4]), STRIDE[::4])
