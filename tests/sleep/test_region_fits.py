"""A region that does not hold who lies in bed is reported in the first minutes: by presence, and in the log."""

from __future__ import annotations

import numpy as np
import pytest
from structlog.testing import capture_logs

from kinegraph.operators.bed.frames.regions import REGION, region_spec
from kinegraph.operators.bed.presence import Presence
from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.operator import grid
from tests.sleep.depth_frames import META, blocks_spec, play

FPS, ROWS, COLUMNS = 4.0, 15, 20


def reported(
    rectangle: tuple[int, int, int, int], *, found: bool = True, sits_s: float = 0.0, turns_s: float = 0.0
) -> list[tuple[str, str, float]]:
    """State, why and when (s), with stretches of 8 s: of a bed that somebody of 8 x 4 blocks lies in from 20 s on, and breathes.

    sits_s: for so long they sit on the edge first, a tall body that sways. turns_s: after so long they lie 3 blocks farther down
    """
    second = np.arange(int(80 * FPS)) / FPS
    depth = np.full((len(second), ROWS, COLUMNS), 2000.0)
    depth[second > 20, 3:11, 8:12] -= 180.0
    depth[:, 4:8, 8:12] += 3.0 * np.sin(1.6 * second)[:, None, None] * (second > 20)[:, None, None]
    if sits_s:
        sits = (second > 20) & (second < 20 + sits_s)
        depth[sits, 3:11] = 2000.0
        depth[sits, 3:11, 12:18] -= 700.0 + 10 * np.sin(second[sits])[:, None, None]
    if turns_s:
        depth[second > turns_s] = np.roll(depth[second > turns_s], 3, axis=1)
    depth += np.random.default_rng(3).normal(0, 0.3, depth.shape)
    time = grid(FPS, len(second))
    rows = np.array([(time[2], "a", *(8 * v for v in rectangle), found)], REGION)
    made: Array = play(
        Presence(learn_s=8.0, hold_s=2.0),
        regions=(region_spec(("a",), META), rows["onset"].copy(), rows),
        blocks=(blocks_spec(ROWS, COLUMNS, FPS), time, depth),
    )["out"]
    return [(str(e["state"]), str(e["why"]), (int(e["onset"]) - int(time[0])) / NS) for e in made]


def test_a_region_that_holds_the_sleeper_is_not_complained_of() -> None:
    assert [(state, why) for state, why, _ in reported((2, 6, 10, 8))][:2] == [("out", ""), ("in", "")]
    with capture_logs() as logs:
        assert "region" not in [why for _, why, _ in reported((2, 6, 10, 8))]
    assert not logs


@pytest.mark.parametrize(
    ("rectangle", "message"),
    [((6, 8, 9, 8), "the region holds 62% of who lies there"), ((0, 0, 15, 20), "it is too large")],
)
def test_a_region_that_does_not_hold_them_is_unknown_in_the_first_stretches(
    rectangle: tuple[int, int, int, int], message: str
) -> None:
    with capture_logs() as logs:
        made = reported(rectangle)
    assert ("unknown", "region") in [(state, why) for state, why, _ in made], made
    assert message in logs[0]["event"] and "try regions: [[16, 56, 80, 48]]" in logs[0]["hint"]


def test_a_region_set_by_hand_may_hold_half_of_what_lies_there() -> None:
    """It may be half of a bed, beside somebody else."""
    assert "region" not in [why for _, why, _ in reported((6, 8, 9, 8), found=False)]


@pytest.mark.parametrize("sits_s", [45.0, 20.0])
def test_who_sits_on_the_edge_before_lying_down_is_in_bed_and_the_region_is_not_to_blame(sits_s: float) -> None:
    """Most of who sits is seen beside the region."""
    with capture_logs() as logs:
        assert [(state, why) for state, why, _ in reported((2, 6, 10, 8), sits_s=sits_s)] == [
            ("out", ""), ("in", ""), ("unknown", "unseen"),
        ]  # fmt: skip
    assert not logs


def test_a_region_that_holds_who_turned_over_is_believed_again() -> None:
    made = [(state, why) for state, why, _ in reported((6, 8, 9, 8), turns_s=40.0)]
    assert made[:4] == [("out", ""), ("in", ""), ("unknown", "region"), ("in", "")], made


def test_where_no_bed_was_found_the_region_is_why_nothing_is_known() -> None:
    assert [event[:2] for event in reported((0, 0, 0, 0))] == [("unknown", "region")]
