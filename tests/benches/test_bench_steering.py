"""The benches of steering: what is chosen by itself is held against baselines that get the same frames and markers."""

from __future__ import annotations

import numpy as np
import pytest

from bench.steering import REFERENCE, nearest_sum
from bench.steering_gradients import Surface, Turned
from bench.steering_meshes import MovingMesh, compared
from kinegraph.devices.people.quadruped import marked, topology, walking

pytestmark = pytest.mark.nightly

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


def test_a_sheet_is_found_again_from_how_its_triangles_turn_and_stretch() -> None:
    x, y = np.meshgrid(np.linspace(0.0, 1.0, 12), np.linspace(0.0, 1.0, 12))
    frames = np.array(
        [np.stack([x, y, 0.2 * np.sin(3 * x + p) * np.cos(2 * y)], -1).reshape(-1, 3) for p in 0.25 * np.arange(24)]
    )
    corners = [12 * r + c for r in range(11) for c in range(11)]
    faces = np.array([t for k in corners for t in ((k, k + 1, k + 12), (k + 1, k + 13, k + 12))])
    at = np.array([0, 11, 132, 143, 66, 77])
    surface = Surface(frames[0], faces, at)
    assert np.abs(surface.vertices(surface.gradients(frames[7]), frames[7][at]) - frames[7]).max() < 1e-6
    model = Turned(surface, frames[::2], [0, 1], 1.0, 1e-3, 0.2)
    off = np.linalg.norm(model(frames[1::2][:, at]) - frames[1::2], axis=-1).mean()
    assert off < 0.1 * np.linalg.norm(frames[0] - frames[1::2], axis=-1).mean()
