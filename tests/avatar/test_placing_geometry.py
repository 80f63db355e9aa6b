"""Places of landmarks, by geometry: lines of sight, a bone of known length, what hides what, a body seen from each side."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kinegraph.operators.body.left_right import LIMBS, _legs_exchanged, _upright, exchange_legs, unturned
from kinegraph.operators.body.legs import across, own_legs
from kinegraph.operators.body.placing import FARTHER_M, INSIDE, LENGTHS, TWINS_M, _at_length, _trunk, _without_hidden
from kinegraph.stream.chunk import Samples

CAMERA = np.array([500.0, 480.0, 320.0, 200.0])
RNG = np.random.default_rng(97)
MIRRORED = np.array(
    [
        0,
        4,
        5,
        6,
        1,
        2,
        3,
        8,
        7,
        10,
        9,
        12,
        11,
        14,
        13,
        16,
        15,
        18,
        17,
        20,
        19,
        22,
        21,
        24,
        23,
        26,
        25,
        28,
        27,
        30,
        29,
        32,
        31,
        33,
    ]
)


def at(place: Samples) -> Samples:
    """The pixel at which a place (x, y, z) is seen."""
    return place[:2] / place[2] * CAMERA[:2] + CAMERA[2:]


def seen(places: Samples) -> Samples:
    """Points (34, 8) of places (34, 3) m from the camera, of which every depth was measured, and every landmark is sure."""
    points = np.zeros((34, 8))
    points[:, :2] = [at(place) for place in places]
    points[:, 2], points[:, 3:5] = places[:, 2], 1.0
    points[:, 5:] = places - places[[23, 24]].mean(axis=0)
    return points


def body(turn: float = 0.0) -> Samples:
    """Somebody (34, 3) m who stands 3 m away and faces the camera, turned about the vertical; y is down, the left side at greater x."""
    places = np.zeros((34, 3))
    for k, x, y, z in (
        (11, 0.18, -0.45, 0.0), (13, 0.25, -0.2, 0.0), (15, 0.3, 0.05, -0.03), (23, 0.1, 0.0, 0.0), (25, 0.11, 0.4, 0.0),
        (27, 0.12, 0.8, 0.03), (29, 0.12, 0.85, 0.06), (31, 0.14, 0.87, -0.1),
    ):  # fmt: skip
        places[k], places[k + 1] = (x, y, z), (-x, y, z)
    places[33], places[:11] = (0.0, -0.2, 0.0), (0.0, -0.65, -0.1)
    places[17:23] = places[[15, 16, 15, 16, 15, 16]]
    c, s = math.cos(turn), math.sin(turn)
    return places @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]) + [0.0, 0.0, 3.0]


def test_a_joint_lies_where_the_bone_ends() -> None:
    """Of the two places along its line of sight that are a bone's length from the joint before, the one nearer to the guess."""
    for _ in range(100):
        places = RNG.uniform([-1, -1, 1.5], [1, 1, 3.5], (34, 3))
        points, long = seen(places), float(np.linalg.norm(places[13] - places[11]))
        for guess in (0.5, places[13, 2], 6.0):
            depth, short = _at_length(points, CAMERA, 13, 11, places[11, 2], long, guess)
            line = np.append((points[13, :2] - CAMERA[2:]) / CAMERA[:2], 1.0)
            nearest = line @ places[11] / (line @ line)
            ends = (places[13, 2], 2 * nearest - places[13, 2])
            assert depth == pytest.approx(min(ends, key=lambda d: abs(d - guess))) and short == 0.0
        depth, short = _at_length(points, CAMERA, 13, 11, places[11, 2], 0.01, 2.0)
        gap = float(np.linalg.norm(nearest * line - places[11]))
        if gap > 0.01:
            assert depth == pytest.approx(nearest) and short == pytest.approx(gap / 0.01 - 1.0)


@pytest.mark.parametrize("share", [0.5, 0.9, 1.1, 2.0])
@pytest.mark.parametrize("joint", [11, 12, 15, 16, 27, 28])
def test_of_twins_in_the_image_the_one_that_is_taken_for_the_farther_is_hidden(joint: int, share: float) -> None:
    """As far apart in the image as `share` of TWINS_M where they are; the other one is seen better."""
    twin = joint + 1 if joint % 2 else joint - 1
    places = np.stack([np.arange(34) * 0.5 - 8.0, np.zeros(34), np.full(34, 2.5)], axis=1)
    places[joint] = places[twin] + [share * TWINS_M, 0.0, 0.0]
    points = seen(places)
    points[joint, 7], points[joint, 3] = points[twin, 7] + 2 * FARTHER_M, 0.4
    lost = [k for k in range(34) if math.isnan(_without_hidden(points, CAMERA)[k, 2])]
    assert lost == ([joint] if share < 1 else [])
    for column, value in ((7, points[twin, 7] + FARTHER_M / 2), (3, 1.5), (2, points[twin, 2] + 2 * FARTHER_M)):
        other = points.copy()
        other[joint, column] = value
        assert np.isfinite(_without_hidden(other, CAMERA)[:, 2]).all(), (
            "not farther, seen better, or measured farther away"
        )


@pytest.mark.parametrize(("elbow", "fist"), [(13, 15), (14, 16), (25, 28), (26, 27)])
@pytest.mark.parametrize("share", [0.5, 0.9, 1.1])
def test_a_joint_behind_a_fist_or_an_ankle_has_no_depth_of_its_own(elbow: int, fist: int, share: float) -> None:
    places = np.stack([np.arange(34) * 0.5 - 8.0, np.zeros(34), np.full(34, 2.5)], axis=1)
    places[elbow] = places[fist] + [0.0, share * TWINS_M * CAMERA[0] / CAMERA[1], 0.0]
    points = seen(places)
    points[elbow, 7] = points[fist, 7] + 2 * FARTHER_M
    lost = [k for k in range(34) if math.isnan(_without_hidden(points, CAMERA)[k, 2])]
    assert lost == ([elbow] if share < 1 else [])


def test_the_trunk_is_where_its_shoulders_and_hips_say() -> None:
    points = seen(body())
    points[:, 2] -= INSIDE
    assert _trunk(points) == pytest.approx(3.0)
    points[[11, 12, 23], 2] = math.nan
    points[25, 2] += 0.3
    assert _trunk(points) == pytest.approx(3.0), "by the median of all, where less than two of the four were measured"
    points[:, 2] = math.nan
    assert math.isnan(_trunk(points))


@pytest.mark.parametrize("lean", [0.0, 30.0, 60.0, 85.0, 120.0])
def test_a_trunk_is_upright_by_the_cosine_of_how_far_it_leans(lean: float) -> None:
    places = body() - [0.0, 0.0, 3.0]
    c, s = math.cos(math.radians(lean)), math.sin(math.radians(lean))
    leaning = places @ np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]]) + [0.0, 0.0, 3.0]
    assert _upright(seen(leaning)) == pytest.approx(max(c, 0.0), abs=1e-6)


def test_legs_that_are_the_other_way_round_than_the_hips_are_exchanged() -> None:
    before = np.full((34, 2), math.nan)
    places = body()
    places[25:33, 0] *= 3.0
    right = seen(places)
    assert not _legs_exchanged(right, MIRRORED, before)
    wrong = right.copy()
    wrong[25:33] = right[MIRRORED[25:33]]
    assert _legs_exchanged(wrong, MIRRORED, before)
    exchange_legs(wrong)
    assert (wrong == right).all()
    for pair in ((25, 26), (27, 28)):
        crossed = right.copy()
        crossed[list(pair)] = right[list(pair[::-1])]
        assert not _legs_exchanged(crossed, MIRRORED, before), "knees and ankles that disagree say nothing"
    assert not _legs_exchanged(seen(body(math.pi / 2)), MIRRORED, before), "from the side legs are not wide apart"


def striding(turn: float) -> Samples:
    """Somebody (34, 3) m in mid-stride, the left leg ahead."""
    places = body()
    for side, ahead in ((0, -1.0), (1, 1.0)):
        places[25 + side] += [0.0, 0.0, 0.12 * ahead]
        places[[27 + side, 29 + side, 31 + side]] += [0.0, 0.0, 0.3 * ahead]
    c, s = math.cos(turn), math.sin(turn)
    return (places - [0.0, 0.0, 3.0]) @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]) + [0.0, 0.0, 3.0]


def with_own_legs(points: Samples) -> tuple[Samples, Samples]:
    """Places and pixels of points (34, 8) on the surface of a body."""
    points[:, 2] -= INSIDE
    pixels, places = points[:, :2].copy(), np.empty((34, 3))
    own_legs(points, CAMERA, LENGTHS.copy(), np.zeros(len(LENGTHS)), pixels, places, np.empty((34, 2)))
    return places, pixels


@pytest.mark.parametrize("degrees", [30, 60, 120, 150, 225, 240, 300])
def test_legs_of_somebody_striding_at_an_angle_are_their_own_hips(degrees: int) -> None:
    """The network has followed each leg through to the other hip: in the image nothing is wrong, knees are on each other's side."""
    places = striding(math.radians(degrees))
    right = seen(places)
    wrong = right.copy()
    exchange_legs(wrong)
    for given in (right, wrong):
        found, pixels = with_own_legs(given.copy())
        assert across(found, 23, 25) > 0.15
        assert np.abs(found - places).max() < 0.03
        assert (pixels == right[:, :2]).all(), "the next frame is held against what was taken to be the image"


def test_ankles_that_are_crossed_stay_crossed() -> None:
    places = body(math.radians(30))
    for k in (27, 29, 31):
        places[[k, k + 1]] = places[[k + 1, k]]
    found, _ = with_own_legs(seen(places))
    assert across(found, 23, 27) < -0.15 and across(found, 23, 25) > 0.15


@pytest.mark.parametrize(("crossed_m", "exchanged"), [(0.03, False), (0.07, True)])
def test_knees_are_on_each_other_s_side_only_where_they_are_so_clearly(crossed_m: float, exchanged: bool) -> None:
    places = body()
    for k in range(25, 33):
        places[k, 0] = (-crossed_m if k % 2 else crossed_m) / 2
    places[27:33, 0] *= 2.0
    points = seen(places)
    _, pixels = with_own_legs(points.copy())
    assert (pixels[25, 0] == points[26, 0]) == exchanged


def test_a_body_that_turns_round_is_read_as_it_is_and_as_it_is_given() -> None:
    """Left and right as they are, in every frame of a turn, where shape and network agree; exchanged ones are put right within a second."""
    turns = np.linspace(0.0, 2 * math.pi, 90)
    for exchanged in (False, True):
        memory, before, readings = np.zeros(4), np.full((34, 2), math.nan), list[int]()
        out = np.empty((34, 8))
        for k, turn in enumerate([0.0] * 30 + turns.tolist()):
            places = body(turn)
            right = seen(places)
            given = right[MIRRORED] if exchanged and k < 100 else right
            chest = places[[11, 12]].mean(axis=0) - places[[23, 24]].mean(axis=0)
            across = places[11] - places[12]
            faces = np.cross(across, chest)[[0, 2]]
            facing = faces / np.linalg.norm(faces)
            readings.append(unturned(given, facing, MIRRORED, memory, before, out))
            if k >= 30:
                assert np.allclose(out[:, :3], right[:, :3]), (exchanged, k)
        assert set(readings[30:100]) <= ({1, 2} if exchanged else {0})
        assert np.hypot(memory[0], memory[1]) > 0.8 and set(LIMBS.tolist()) < set(range(34))
