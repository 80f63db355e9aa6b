"""configs/steer_mesh.yaml: a whole mesh follows six markers, by a model that was trained on the mesh's own motion.

Recording: simulated, three strides of the quadruped that the shipped model was trained on (real meshes in motion may not be kept here).
Truth: the quadruped's own vertices.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.devices.people.quadruped import marked, walking
from tests.replay.replaying import signal

RATE, STRIDE_S = 30.0, 1.2
MESH = np.array([walking(frame / RATE / STRIDE_S % 1.0) for frame in range(108)])
VERTICES = list(marked().values())


@pytest.fixture(scope="module")
def steered() -> np.ndarray:
    graph = kg.load("steer_mesh")
    true_mesh = signal(MESH, RATE, (), ["m"])
    true_mesh.spec = graph.specs["animal.mesh"]
    markers = signal(MESH[:, VERTICES], RATE, marked(), ["m"])
    return graph.run({"animal.mesh": true_mesh, "animal.markers": markers}, keep=["steer.mesh"])["steer.mesh"].data


def test_every_vertex_is_near_its_place(steered: np.ndarray) -> None:
    """Of an animal 2 m long: 2 mm in the mean, and no vertex farther off than 4 cm."""
    away = np.linalg.norm(steered - MESH, axis=2)
    assert away.mean() < 0.004 and away.max() < 0.04


def test_the_vertices_of_the_markers_are_where_the_markers_are(steered: np.ndarray) -> None:
    assert np.linalg.norm(steered - MESH, axis=2)[:, VERTICES].max() < 0.01


def test_the_mesh_moves_by_far_more_than_it_is_off() -> None:
    """A mesh that stood still would be this far off, so that the test above says something."""
    assert np.linalg.norm(MESH - MESH.mean(axis=0), axis=2)[:, VERTICES[:4]].mean() > 0.15
