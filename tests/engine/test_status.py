"""The table of a running session: how many samples come in a second."""

from __future__ import annotations

import pytest

from kinegraph.stream.chunk import FOREVER, NEVER, NS
from kinegraph.stream.engine.status import Rates


def test_a_rate_is_over_the_last_ten_seconds_of_sample_time() -> None:
    rates = Rates()
    found = [rates.of("emg", 1000 * min(s, 30) + 500 * max(s - 30, 0), s * NS) for s in range(1, 60)]
    assert found[0] == 0.0, "nothing is known of one moment"
    assert found[1:30] == [1000.0] * 29
    assert found[34] == pytest.approx(750.0)
    assert found[40:] == [500.0] * 19


def test_a_device_that_lost_nothing_has_its_rate_in_whatever_bursts_its_samples_are_read() -> None:
    rates, came = Rates(), [0, 100, 3100, 3200, 3300, 9000, 9001]
    assert [rates.of("emg", n, n * NS // 1000) for n in came][2:] == [1000.0] * 5


def test_the_end_of_a_stream_keeps_its_rate() -> None:
    rates = Rates()
    assert [rates.of("emg", n, until) for n, until in ((0, NEVER), (10, NS), (20, 2 * NS), (20, FOREVER))] == [
        0,
        0,
        10.0,
        10.0,
    ]


def test_streams_have_rates_of_their_own() -> None:
    rates = Rates()
    for s in (1, 2):
        last = rates.of("emg", 1000 * s, s * NS), rates.of("imu", 100 * s, s * NS)
    assert last == (1000.0, 100.0)
