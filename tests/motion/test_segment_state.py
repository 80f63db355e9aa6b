"""The segmentation's reports on its own reliability: counted from 0, reported once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from kinegraph.operators.segmentation.operator import Segment
from kinegraph.operators.segmentation.outputs import ACTIVITY
from kinegraph.operators.segmentation.state import SegmentState
from kinegraph.stream.chunk import Array, StreamSpec


@pytest.fixture
def capture() -> Iterator[list[Any]]:
    with capture_logs() as logs:
        yield logs


@pytest.fixture
def state() -> SegmentState:
    operator = Segment()
    operator.open({"in": StreamSpec((4,), rate_hz=30.0)})
    return operator.state


def activities(*certainty: float) -> Array:
    """Activities of two repetitions that are so certain."""
    made = np.zeros(len(certainty), ACTIVITY)
    made["repeats"], made["repetitions"], made["certainty"] = True, 2, certainty
    return made


def test_a_warning_says_once_that_most_of_what_is_counted_may_be_chance(
    capture: list[dict[str, Any]], state: SegmentState
) -> None:
    state.judge(activities(0.5, 0.0, 0.0))
    assert not capture
    for _ in range(3):
        state.judge(activities(0.0))
    assert len(capture) == 1 and capture[0]["doubtful"] == 3 and capture[0]["of"] == 4


def test_activities_that_do_not_repeat_are_not_judged(capture: list[dict[str, Any]], state: SegmentState) -> None:
    alone = np.zeros(5, ACTIVITY)
    state.judge(alone)
    assert (state.cut, state.judged, state.doubtful, state.sure) == (5, 0, 0, 0) and not capture


def test_half_of_what_repeats_is_not_most_of_it(capture: list[dict[str, Any]], state: SegmentState) -> None:
    state.judge(activities(0.5, 0.6, 0.7, 0.0, 0.0, 0.0))
    assert (state.judged, state.doubtful, state.sure) == (6, 3, 6) and not capture


@pytest.mark.parametrize(
    ("certainty", "warnings"), [((), 0), ((0.5,), 1), ((0.5, 0.5), 1), ((0.5, 0.5, 0.5), 0), ((0.0, 0.5), 1)]
)
def test_little_motion_is_a_warning_where_few_repetitions_are_certain(
    certainty: tuple[float, ...], warnings: int, capture: list[dict[str, Any]], state: SegmentState
) -> None:
    state.judge(activities(*certainty))
    state.say_short()
    assert len(capture) == warnings


def test_one_activity_that_does_not_repeat_is_no_warning_and_two_are(
    capture: list[dict[str, Any]], state: SegmentState
) -> None:
    state.judge(np.zeros(1, ACTIVITY))
    state.say_short()
    assert not capture
    state.judge(np.zeros(1, ACTIVITY))
    state.say_short()
    assert len(capture) == 1
