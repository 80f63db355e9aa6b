"""Which way a body faces: a performer's heading is asked for where the model does not say its own, and only there."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.devices.people.quadruped import marked, topology, walking
from kinegraph.operators.steering.model.adapt import about, adapt
from kinegraph.operators.steering.model.fit import fit_steering
from kinegraph.stream.chunk import Samples

NAMES, AT = tuple(marked()), np.array(list(marked().values()))
STRIDE = np.array([walking(k / 24) for k in range(0, 24, 2)])
REFERENCE, HEADING = ("withers", "croup"), ("croup", "withers")


def rotated(points: Samples, angle: float) -> Samples:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])


def test_the_models_own_heading_is_kept_whatever_the_performer_faces_by() -> None:
    model = fit_steering(STRIDE, topology().faces, marked(), REFERENCE, heading=HEADING)
    marks = STRIDE[:, AT]
    other = adapt(model, marks, marks, heading=("hoof_fl", "withers"))
    assert np.array_equal(other.facing, model.facing)
    assert np.array_equal(adapt(model, marks, marks).facing, model.facing)


def test_a_heading_is_learned_from_the_mesh_where_the_model_has_none() -> None:
    model = fit_steering(STRIDE, topology().faces, marked(), REFERENCE)
    marks = STRIDE[:, AT]
    assert not len(model.facing) and not len(adapt(model, marks, marks).facing)
    pair = [NAMES.index(name) for name in HEADING]
    edge = (marks[:, pair[1]] - marks[:, pair[0]])[:, [0, 2]].mean(axis=0)
    facing = adapt(model, marks, marks, heading=HEADING).facing
    assert facing == pytest.approx([*pair, *(edge / np.linalg.norm(edge))])


@pytest.mark.parametrize("angle", [0.4, -2.0])
def test_what_is_seen_of_markers_does_not_turn_with_the_body(angle: float) -> None:
    model = fit_steering(STRIDE, topology().faces, marked(), REFERENCE, heading=HEADING)
    marks = STRIDE[:, AT]
    seen = about(model, marks, model.facing)
    assert np.allclose(about(model, rotated(marks, angle) + np.array([3.0, 0.0, 1.0]), model.facing), seen)
    nothing = about(model, marks, np.zeros(0))
    assert np.allclose(nothing, marks - marks[:, model.reference].mean(axis=1, keepdims=True))
