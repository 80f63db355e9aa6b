"""A person's markers from depth and images: rendered people, degraded scenes, and the network where it is there."""

from __future__ import annotations

from typing import Any
from unittest import mock

import numpy as np
import pytest

from kinegraph.devices.people import rendered_performer
from kinegraph.devices.people.rendered_performer import RenderedPerformer
from kinegraph.operators.body.background import Background
from kinegraph.operators.body.left_right import unturned
from kinegraph.operators.body.names import OTHER_SIDE
from kinegraph.operators.body.persons import Persons
from kinegraph.stream.chunk import Chunk
from tests.avatar.body_runs import CAMERA, DEPTH, HEIGHT, RATE, WIDTH, feed, standing, with_block


def room(n: int = 60) -> np.ndarray:
    performer = RenderedPerformer(WIDTH, HEIGHT)
    return np.stack([performer.frame(k, 0.0) for k in range(n)])


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


def test_who_leaps_aside_in_two_parts_stays_one_person() -> None:
    """The trunk is half a metre from where it was, the legs are not, and at the belt nothing is measured. The trunk was somebody else."""
    frames = np.zeros((10, HEIGHT, WIDTH), np.uint16)
    frames[:5, 4 : HEIGHT // 2, 12:20] = 2000
    frames[5:, 4 : HEIGHT // 2 - 1, 24:32] = 2000
    frames[:, HEIGHT // 2 : HEIGHT - 2, 14:24] = 2000
    persons = Persons()
    persons.open({"in": DEPTH})
    labels = np.concatenate([chunk.data for chunk in feed(persons, "in", frames)["labels"]])
    assert ((labels > 0) == (frames > 0)).all() and labels.max() == 1


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
