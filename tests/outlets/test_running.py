"""Running statistics against numpy on all the data at once."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.devices.reports.session.contents.running import Choice, Running

pytestmark = pytest.mark.quick


def test_mean_and_deviation_leave_nan_out_element_by_element() -> None:
    rng = np.random.default_rng(1)
    data = rng.standard_normal((50, 4, 3)) * 5 + 100
    data[rng.random(data.shape) < 0.2] = np.nan
    data[:, 0, 0] = np.nan
    data[1:, 0, 1] = np.nan
    data[0, 0, 1] = 7.0
    running = Running.of((4, 3))
    for row in data:
        running.add(row)
    centre, spread = running.centre(), running.spread()
    assert np.isnan(centre[0, 0]) and centre[0, 1] == 7.0 and np.isnan(spread[0, :2]).all()
    np.testing.assert_allclose(centre[1:], np.nanmean(data[:, 1:], 0), rtol=1e-13)
    np.testing.assert_allclose(spread[1:], np.nanstd(data[:, 1:], 0, ddof=1), rtol=1e-11)


def test_places_on_a_circle() -> None:
    running = Running.of((3,), turn=100.0)
    for near in (98.0, 99.0, 0.0, 1.0, 2.0):
        running.add(np.array([near, 50 + (near + 50) % 100 - 50, np.nan]))
    assert abs((running.centre()[0] + 50) % 100 - 50) < 1e-9 and abs(running.centre()[1] - 50) < 1e-9
    assert abs(running.spread()[0] - np.std([98, 99, 100, 101, 102])) < 0.01
    assert np.isnan(running.centre()[2]) and np.isnan(running.spread()[2])


def test_a_choice_is_even_and_does_not_grow() -> None:
    choice = Choice.of(200, (1,))
    for i in range(10_000):
        choice.add(np.array([i]))
        kept = choice.chosen()[:, 0]
        assert len(kept) <= 200 and kept[0] == 0 and (np.diff(kept) == choice.step).all()
        assert len(kept) >= min(i + 1, 100) and i - kept[-1] < choice.step
