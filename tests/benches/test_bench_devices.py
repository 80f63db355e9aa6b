"""The bench of serial devices runs, and measures what it says."""

from __future__ import annotations

from bench.devices import bytes_to_samples, read_latency


def test_decoders_are_measured_on_all_of_their_packets() -> None:
    section = bytes_to_samples(0.5, 1)
    assert [row[0].partition(",")[0] for row in section.rows] == ["Cyton", "WT901", "lines of 3 columns"]
    assert all(float(cell) > 0 for row in section.rows for cell in row[1:])
    assert section.goals[0].limit == 200


def test_reads_are_measured_in_turn() -> None:
    section = read_latency(1, 10)
    assert len(section.rows) == 2 and float(section.rows[0][1]) == 1.0
