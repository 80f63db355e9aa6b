"""The noise of a movement signal: its level, its scatter and its threshold from the stillest epochs, and whether they are steady."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.bed.frames.noise import DECILE, EPOCHS, Noise
from kinegraph.operators.bed.sleeper_activity import WHYS, ActivityLimits, SleeperActivity


def learned(levels: list[float], scatter: float = 0.1) -> Noise:
    """Epochs with these medians, and a lowest tenth `scatter` standard deviations below; the second channel learns nothing."""
    noise = Noise.of(2)
    for level in levels:
        noise.learn(0, level + scatter * DECILE * np.linspace(-1.25, 1.25, 101))
    return noise


def test_the_level_is_that_of_the_stillest_quarter_and_the_scatter_of_the_stillest_half() -> None:
    noise = learned([9.0, 5.0, 1.0, 2.0, 8.0, 3.0, 7.0, 4.0])
    assert noise.level_of(0) == pytest.approx(3.0)
    assert noise.scatter_of(0) == pytest.approx(0.1)
    assert noise.threshold(0, sigmas=5.0, min_rise=0.1) == pytest.approx(3.5)
    assert noise.threshold(0, sigmas=1.0, min_rise=0.1) == pytest.approx(3.3)
    assert noise.count.tolist() == [8, 0]


def test_only_the_newest_epochs_count() -> None:
    noise = learned([1.0] * 20 + [5.0] * EPOCHS)
    assert noise.level_of(0) == pytest.approx(5.0)
    noise.clear()
    assert noise.count.tolist() == [0, 0]


@pytest.mark.parametrize(
    ("levels", "scatter", "steady"),
    [
        ([2.0, 2.1, 2.2, 9.0, 9.0, 9.0], 0.1, True),
        ([2.0, 2.1, 2.2, 9.0, 9.0], 0.1, False),  # too few epochs
        ([2.0, 2.4, 2.7, 9.0, 9.0, 9.0], 0.1, False),  # .7 apart, of a level of 2.4
        ([2.0, 2.1, 2.2, 9.0, 9.0, 9.0], 0.6, False),  # each scatters
    ],
)
def test_epochs_are_steady_among_and_within_themselves(levels: list[float], scatter: float, steady: bool) -> None:
    assert learned(levels, scatter).steady(0, most=0.2, epochs=6) == steady


def test_a_reason_that_is_not_known_counts_as_none() -> None:
    sleepers = SleeperActivity.unknown(["left", "right"], ActivityLimits(5.0, 0.1, 0.5, 0.5, 2.0, 0), 10**9)
    for why, number in (("region", 5), ("nothing of ours", 0), ("", 0)):
        sleepers.move("right", "out", why)
        assert sleepers.why.tolist() == [0, number]
    assert len(WHYS) == 7
