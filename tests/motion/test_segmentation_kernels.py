"""Kernels of the segmentation one by one, on a few frames: what each says, without all that it is part of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kinegraph.operators.segmentation.kernels.activities import anticipate, open_up
from kinegraph.operators.segmentation.kernels.cycles import advance, last_cycle, sum_up
from kinegraph.operators.segmentation.kernels.distances import insert, mark
from kinegraph.operators.segmentation.kernels.layout import (
    BELIEVED_EVENT,
    COUNT_EVENT,
    RADIUS_EVENT,
    Memory,
    allocate,
)
from kinegraph.operators.segmentation.kernels.provisional import foresee
from kinegraph.operators.segmentation.kernels.symmetry import AT_ONCE, IN_TURN, moves, symmetry

FRAMES = {
    "max_lag": 30, "window": 200, "learn": 2, "quiet": 4, "mass": 6, "settle": 20, "firm": 80, "min_band": 3, "max_band": 3,
    "every": 5, "rest": 5, "transition": 10,
}  # fmt: skip


def memory(x: Any, radius: float | None = 1.0) -> Memory:
    """A segmentation that has seen frames x (n, features), with room for events."""
    made = allocate(x.shape[1], FRAMES, radius, 0.5).with_room(64)
    for i, row in enumerate(x):
        insert(made, row, i)
    return made


def circle(n: int, length: int = 10, size: float = 0.2, right: float = 0.0) -> Any:
    turn = np.arange(n) * 2 * np.pi / length
    return np.stack([size * np.cos(turn) + right, size * np.sin(turn)], 1)


def test_a_path_of_even_distances_lies_as_far_away_as_they_do() -> None:
    length = 6
    cost, begin = np.full((2, length), np.inf), np.full((2, length), -1)
    means = [advance(np.full(length, 0.1), i, length, 0, 0.3, cost, begin) for i in range(12)]
    assert np.isinf(means[:2]).all(), "three frames are the least for six"
    assert np.allclose(means[2:], 0.1)
    assert begin[0, -1] >= 0


def test_sums_give_the_mean_distance_of_the_newest_cycle_to_the_one_before_it() -> None:
    x = np.random.default_rng(1).normal(size=(40, 3))
    s = memory(x)
    s.origin = 2
    s.sums[1] = 0.0
    for i in range(2, 40):
        sum_up(s, i)
    apart = np.sqrt(((x[:, None] - x[None]) ** 2).mean(-1))
    for k in (1, 7, 12):
        newest = np.arange(40 - max(k, 6), 40)
        assert np.isclose(last_cycle(s, 39, k), apart[newest, newest - k].mean())


def test_two_cycles_are_believed_as_soon_as_the_second_is_seen_to_end() -> None:
    x = circle(60, 12, size=2.0)
    s, last = memory(x[:1]), {}
    for t in range(1, 60):
        insert(s, x[t], t)
        s.event_count = 0
        foresee(s, 0, t, True)
        for row in s.events[: s.event_count]:
            last[int(row[0]), int(row[3 if row[0] == COUNT_EVENT else 5])] = t
    believed = [last[BELIEVED_EVENT, k] for k in range(1, 6)]
    assert believed == [last[COUNT_EVENT, k] for k in range(1, 6)]
    assert believed[0] == believed[1] <= 2 * 12 + 3 and believed[2:] == [35, 47, 59]


def test_an_activity_that_opens_is_believed_from_what_its_first_frame_comes_back_to() -> None:
    x = circle(25, 12, size=2.0)
    s = memory(x, radius=0.1)
    assert [mark(s, i, 0) for i in range(25)] == [False] * 12 + [True] * 13
    s.event_count = 0
    open_up(s, 24)
    assert s.opened == s.last == 24
    radius, believed = s.events[: s.event_count].tolist()
    assert radius[0] == RADIUS_EVENT and believed[0] == BELIEVED_EVENT
    assert believed[2:] == [0, 24, 0, 0, 0, 0], "onset and end, the first activity, no repetition"


def test_before_enough_was_seen_what_repeats_is_believed_and_nothing_else_remembered() -> None:
    x = circle(60, 12, size=2.0)
    s, counts = memory(x[:1], radius=None), []
    for t in range(1, 60):
        insert(s, x[t], t)
        s.event_count = 0
        numbers, near = s.numbers.copy(), s.near.copy()
        anticipate(s, t)
        counts += [(t, int(row[3])) for row in s.events[: s.event_count] if row[0] == COUNT_EVENT]
        for name in ("event_count", "believed", "believed_of", "foreseen", "is_grown", "early_radius"):
            numbers[name] = s.numbers[name]
        assert numbers == s.numbers and np.array_equal(near, s.near)
    assert [k for _, k in counts] == [1, 2, 3, 4, 5] and counts[1][0] <= 2 * 12 + 4
    assert s.early_radius > 0.0


def test_whose_half_moves_more_is_the_sum_of_its_squared_steps_less_the_others() -> None:
    x = np.random.default_rng(6).normal(size=(40, 4))
    left, right = [0, 1], [2, 3]
    s = memory(x)
    ring = len(s.times)
    mirrored = np.zeros((ring, 4))
    mirrored[:40] = x[:, [2, 3, 0, 1]]
    s = replace(s, mirrored=mirrored, firsts=np.array([1, 1, 0, 0]))
    steps = np.diff(x, axis=0)[9:29] ** 2
    assert np.isclose(moves(s, 10, 30), steps[:, left].sum() - steps[:, right].sum())


def test_what_is_its_own_mirror_image_has_no_sides_that_take_turns_even_if_its_kind_had() -> None:
    x = np.random.default_rng(7).normal(size=(40, 4))
    s = memory(x)
    mirrored = np.zeros((len(s.times), 4))
    mirrored[:40] = x
    s = replace(s, mirrored=mirrored)
    for leads in (0.0, 2.0):
        s.leads[0] = leads
        assert symmetry(s, 0, 5, 35) == (AT_ONCE, -1)
    mirrored[5:20], mirrored[20:35] = x[20:35], x[5:20]
    assert symmetry(s, 0, 5, 35) == (IN_TURN, 20)


def test_distances_are_over_what_both_frames_have() -> None:
    rng = np.random.default_rng(11)
    x = rng.normal(size=(20, 6))
    x[np.arange(20), rng.integers(0, 6, 20)] = np.nan
    made = memory(x)
    for t in range(1, 20):
        for k in range(1, t + 1):
            apart = x[t] - x[t - k]
            assert made.rows[t, k] == pytest.approx(np.sqrt(np.nanmean(apart**2)))
