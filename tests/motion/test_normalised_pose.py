"""Poses of any marker set, wherever the body stands and whichever way it faces."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.features.normalised_pose import NormalisedPose
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import grid

NAMES = ("T5", "S1L", "S1R", "poll", "hoof")
SPEC = StreamSpec((5, 3), rate_hz=100.0, channels=NAMES, units=("mm",))
SET = {"withers": ("T5",), "sacrum": ("S1L", "S1R"), "tail": ("T18",), "hoof": ("hoof",)}
HORSE = NormalisedPose("withers", "sacrum", SET)


def run(operator: NormalisedPose, x: Samples, spec: StreamSpec = SPEC) -> tuple[StreamSpec, Samples]:
    operator = operator.unopened()
    out = operator.open({"in": spec})["out"]
    time = grid(100.0, len(x))
    made = operator.process("in", Chunk(time, x, int(time[-1])))
    assert made is not None
    return out, made.data


def horses(n: int) -> Samples:
    rng = np.random.default_rng(5)
    body = np.array([[0, 1600, 0], [-600, 1500, 80], [-600, 1500, -80], [700, 1900, 10], [100, 0, 150]], float)
    return body + rng.normal(0.0, 30.0, (n, 5, 3))


def turned(x: Samples, angle: float, shift: tuple[float, float, float]) -> Samples:
    c, s = np.cos(angle), np.sin(angle)
    made: Samples = x @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + np.array(shift)
    return made


def slowly(x: Samples) -> Samples:
    """The same by rotation matrices, a frame at a time; y up."""
    made = []
    for t5, left, right, _, hoof in x:
        sacrum = (left + right) / 2
        ahead = (sacrum - t5) * (1, 0, 1)
        ahead /= np.linalg.norm(ahead)
        basis = np.stack([ahead, (0, 1, 0), np.cross(ahead, (0, 1, 0))])
        made.append([*(basis @ (p - t5) for p in (t5, sacrum)), np.full(3, np.nan), basis @ (hoof - t5)])
    return np.array(made).reshape(len(x), -1)


def test_it_agrees_with_rotation_matrices() -> None:
    x = turned(horses(50), 0.7, (3000.0, 20.0, -500.0))
    _, out = run(HORSE, x)
    np.testing.assert_allclose(out, slowly(x), atol=1e-9)
    sacrum = out[:, 3:6]
    assert (sacrum[:, 0] > 0).all() and np.abs(sacrum[:, 2]).max() < 1e-9


@pytest.mark.parametrize("angle", [0.3, 2.0, -2.9])
def test_where_it_stands_and_which_way_it_faces_does_not_count(angle: float) -> None:
    x = horses(50)
    np.testing.assert_allclose(run(HORSE, turned(x, angle, (900.0, -5.0, 70.0)))[1], run(HORSE, x)[1], atol=1e-9)


@pytest.mark.parametrize(("up", "order", "signs"), [("z", (2, 0, 1), 1), ("x", (1, 2, 0), 1), ("-y", (0, 1, 2), -1)])
def test_any_axis_may_point_up(up: str, order: tuple[int, ...], signs: int) -> None:
    x = horses(20)
    seen = x[..., list(order)] * ((signs, signs, 1) if signs < 0 else (1, 1, 1))
    operator = NormalisedPose("withers", "sacrum", SET, up)  # type: ignore[arg-type]
    np.testing.assert_allclose(run(operator, seen)[1], run(HORSE, x)[1], atol=1e-9)


def test_a_marker_that_the_input_lacks_is_said() -> None:
    spec, out = run(HORSE, horses(3))
    assert spec.meta["missing"] == ["tail.x", "tail.y", "tail.z"]
    assert np.isnan(out[:, 6:9]).all() and np.isfinite(np.delete(out, [6, 7, 8], 1)).all()
    assert spec.channels[:4] == ("withers.x", "withers.y", "withers.z", "sacrum.x") and spec.units == ("mm",)


def test_hidden_markers_stay_hidden() -> None:
    x = horses(4)
    x[1, 4] = np.nan
    x[2, 0, 1] = np.inf
    x[3, 2] = np.nan
    out = run(HORSE, x)[1]
    assert np.isnan(out[1, 9:]).all() and np.isfinite(out[1, :6]).all()
    assert np.isnan(out[2]).all() and np.isnan(out[3]).all() and np.isfinite(out[0, :6]).all()


def test_the_heading_holds_while_it_cannot_be_seen() -> None:
    x = horses(3)
    x[1:, 1:3] = x[1:, :1] + (0.0, -600.0, 1.0)
    out = run(HORSE, x)[1]
    away = run(HORSE, x[1:])[1]
    assert np.isfinite(out[:, :6]).all() and np.isnan(away[:, 3]).all()
    first = (x[0, 1] + x[0, 2]) / 2 - x[0, 0]
    expected = (x[1, 4] - x[1, 0])[[0, 2]] @ first[[0, 2]] / np.hypot(first[0], first[2])
    assert out[1, 9] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("operator", "parameter", "message"),
    [
        (NormalisedPose("tail", "sacrum", SET), "origin", "the input has no T18"),
        (NormalisedPose("withers", "sacrun", SET), "ahead", "sacrum"),
        (NormalisedPose("withers", "withers", SET), "ahead", "another marker"),
        (NormalisedPose("withers", "sacrum", {**SET, "hock": ()}), "markers", "at least one marker"),
    ],
)
def test_what_cannot_be_is_said_at_open(operator: NormalisedPose, parameter: str, message: str) -> None:
    with pytest.raises(ParameterError, match=message) as raised:
        operator.open({"in": SPEC})
    assert raised.value.parameter == parameter
