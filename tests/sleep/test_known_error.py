"""The time asleep is given with the error that scorers of movement are known to have."""

from __future__ import annotations

import pytest

from kinegraph.devices.reports.night.numbers import PUBLISHED, asleep_range


@pytest.mark.parametrize("asleep", [200.0, 300.0, 420.0])
def test_the_range_holds_every_truth_that_a_published_scorer_would_have_scored_so(asleep: float) -> None:
    low, high = asleep_range({"tib": 500.0, "unknown": 20.0, "tst": asleep}) or (0.0, 0.0)
    assert 0 <= low <= high <= 480
    for sensitivity, specificity in PUBLISHED:
        for truth in range(0, 481, 5):
            scored = sensitivity * truth + (1 - specificity) * (480 - truth)
            assert abs(scored - asleep) > 0.5 or low - 5 <= truth <= high + 5


def test_a_night_that_was_not_scored_has_no_range() -> None:
    assert asleep_range({"tib": 400.0, "unknown": 400.0, "tst": 0.0}) is None
