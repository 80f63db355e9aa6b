"""The table of a running session: how many samples came in a second."""

from __future__ import annotations

from stream.engine.status import _rate


def test_rates_are_those_since_the_table_before_and_the_last_table_keeps_its_own() -> None:
    before = {"emg": {"samples": 100, "at_s": 10.0, "rate_hz": 7.0}}
    table = {"emg": {"samples": 350}, "imu": {"samples": 5}}
    _rate(table, before, 12.00049)
    assert table == {
        "emg": {"samples": 350, "at_s": 12.0, "rate_hz": 124.97},
        "imu": {"samples": 5, "at_s": 12.0, "rate_hz": 0.0},
    }
    _rate(table, before, 12.5, last=True)
    assert [row["rate_hz"] for row in table.values()] == [7.0, 0.0]
    _rate(table, {"emg": {"samples": 350, "at_s": 12.5}}, 12.5)
    assert table["emg"]["rate_hz"] == 0.0, "no time has gone by"
