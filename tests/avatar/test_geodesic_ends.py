"""Ends of limbs that something nearer cuts off, noise beside a body, and where the hips are on the way from head to foot."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from kinegraph.operators.body import extrema
from kinegraph.operators.body.extrema import Extrema, hips_between
from kinegraph.operators.body.geodesic_kernel import extrema_of, middle_of, place_between, walk_back
from kinegraph.operators.body.names import MARKERS
from kinegraph.stream.chunk import Array, Chunk, Samples, StreamSpec
from kinegraph.stream.operator import grid

CAMERA = (60.0, 60.0, 23.5, 29.5)
APART_M = 0.1
ENDS = 4


def figure() -> Array:
    """Somebody who stands 2 m away with the feet apart, and holds an arm before the neck: depth (60, 48) in mm."""
    depth = np.zeros((60, 48), np.uint16)
    depth[3:12, 20:28] = 2000
    depth[12:34, 16:32] = 2000
    depth[34:58, 15:21] = depth[34:58, 27:33] = 2000
    depth[10:16, 14:34] = 1800
    depth[12:30, 32:36] = (1800 + 11 * np.arange(18))[:, None]
    return depth


def surface(depth: Array) -> Samples:
    points = np.full((*depth.shape, 3), np.nan)
    z = depth / 1000.0
    y, x = np.nonzero(depth)
    points[y, x] = np.stack([(x - CAMERA[2]) / CAMERA[0] * z[y, x], (y - CAMERA[3]) / CAMERA[1] * z[y, x], z[y, x]], 1)
    return points


def searched(points: Samples) -> tuple[list[tuple[int, int]], Array, Array]:
    """Rows and columns of the ends; the distances, the ways back."""
    pixels, middle = points.shape[0] * points.shape[1], np.empty(3)
    distance, parent, found = np.empty(pixels), np.empty(pixels, np.int64), np.empty(ENDS, np.int64)
    count = extrema_of(points, middle_of(points, middle), APART_M, distance, parent, found, 0.2)
    return [divmod(int(k), points.shape[1]) for k in found[:count]], distance, parent


def test_a_head_that_an_arm_cuts_off_is_an_end() -> None:
    ends, _, _ = searched(surface(figure()))
    assert any(row < 6 for row, _ in ends), "nothing above the arm is found"


@pytest.mark.parametrize(("pixels", "noise"), [(6, True), (11, True), (12, False)])
def test_a_few_pixels_beside_the_body_are_none(pixels: int, noise: bool) -> None:
    depth, beside = figure(), np.zeros((60, 48), bool)
    beside[20:23, 38:42] = (np.arange(12) < pixels).reshape(3, 4)
    depth[beside] = 2000
    points = surface(depth)
    ends, distance, _ = searched(points)
    assert not noise or all(column < 37 for _, column in ends)
    assert np.isnan(points[beside]).all() == noise and np.isinf(distance.reshape(60, 48)[beside]).all() == noise


def test_a_way_back_does_not_lead_over_a_leap() -> None:
    points = np.zeros((1, 6, 3))
    points[0, :, 0] = (0.0, 0.05, 0.10, 0.40, 0.45, 0.50)
    parent, out = np.array([-1, 0, 1, 2, 3, 4]), np.empty(3)
    assert walk_back(points, parent, 5, 0.08, APART_M, out) and out[0] == 0.40
    assert not walk_back(points, parent, 5, 0.15, APART_M, out)


@pytest.mark.parametrize(("share", "place"), [(0.0, 0.0), (0.3, 0.3), (0.5, 0.5), (1.0, 1.0)])
def test_a_share_of_the_way_between_two_ends(share: float, place: float) -> None:
    """Pixels in a row; both ways lead to a pixel that lies aside, by the same one."""
    points = np.zeros((1, 12, 3))
    points[0, :11, 0], points[0, 11] = np.linspace(0.0, 1.0, 11), (0.4, 0.3, 0.0)
    parent = np.array([1, 2, 3, 4, 11, 4, 5, 6, 7, 8, 9, -1])
    out = np.empty(3)
    assert place_between(points, parent, 0, 10, share, out) == pytest.approx(1.0)
    assert out[0] == pytest.approx(place)


def test_ends_whose_ways_do_not_meet_have_nothing_between() -> None:
    assert place_between(np.zeros((1, 4, 3)), np.array([1, -1, 3, -1]), 0, 2, 0.5, np.empty(3)) == 0.0


def test_who_sits_back_on_bent_legs_has_the_hips_at_the_seat() -> None:
    """Head and trunk lean forward over feet that stand in front: the seat is the corner between them, the middle is not."""
    corner = np.array([(0.3, -0.6, 2.0), (-0.3, 0.0, 2.0), (0.25, 0.1, 2.0), (0.0, 0.7, 2.0)])
    way = np.concatenate([np.linspace(a, b, 41) for a, b in pairwise(corner)])
    points, parent = np.ascontiguousarray(way)[None], np.arange(-1, len(way) - 1)
    middle = np.array([0.1, 0.05, 2.0])
    hips = hips_between(1.0, points, parent, [len(way) - 1, -1, -1, 0, -1], middle)
    assert np.linalg.norm(hips[:2] - [-0.3, 0.0]) < 0.35 < np.linalg.norm(middle[:2] - [-0.3, 0.0])
    np.testing.assert_array_equal(hips_between(1.0, points, parent, [-1, -1, -1, 0, -1], middle), middle)


def found_in(depth: Array) -> Samples:
    """The markers (3, 20, 3) of three frames that show `depth` (60, 48)."""
    meta = {"camera": dict(zip(("fx", "fy", "cx", "cy"), CAMERA, strict=True))}
    extrema = Extrema()
    extrema.open({"in": StreamSpec((60, 48), np.dtype(np.uint16), rate_hz=30.0, units=("mm",), meta=meta)})
    times = grid(30.0, 3)
    return dict(extrema.process("in", Chunk(times, np.repeat(depth[None], 3, 0), int(times[-1]))))["out"].data


def test_depth_alone_sees_a_head_above_an_arm() -> None:
    heads = found_in(figure())[:, MARKERS.index("head")]
    assert np.isfinite(heads).all(), "the head is not seen"
    assert (heads[:, 1] < -0.6).all(), "the arm is taken for the head"


def test_hips_are_missing_where_nothing_of_the_body_is_seen() -> None:
    """The hips are put on the way from head to feet: of who bends over they came out between the legs, 70 cm off."""
    hips, depth = [MARKERS.index(f"{side}_hip") for side in ("left", "right")], figure()
    assert np.isfinite(found_in(depth)[:, hips]).all()
    depth[24:40, 14:34] = 0
    assert np.isnan(found_in(depth)[:, hips]).all()


def test_every_kernel_is_compiled_before_the_camera_opens(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[str] = []
    for name in ("area_around", "extrema_of", "place_between", "surface_at", "walk_back"):
        kernel = getattr(extrema, name)
        monkeypatch.setattr(
            extrema, name, lambda *given, name=name, kernel=kernel: called.append(name) or kernel(*given)
        )
    for case in Extrema.warm_up_cases():
        operator = case.operator.unopened()
        operator.open({port: spec for port, (spec, _, _) in case.inputs.items()})
        for port, (_, time, data) in case.inputs.items():
            operator.process(port, Chunk(time, data, int(time[-1])))
    assert set(called) == {"area_around", "extrema_of", "place_between", "surface_at", "walk_back"}
