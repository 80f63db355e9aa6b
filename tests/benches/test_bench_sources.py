"""The bench of live devices runs, and measures what it says: ages from the packet itself, and what is lost."""

from __future__ import annotations

import pytest

from bench import sources

pytestmark = pytest.mark.nightly


def test_a_cyton_is_measured_from_its_packets() -> None:
    section = sources.board(1, 0.5, every=2)
    ours = next(row for row in section.rows if "kinegraph" in row[0])
    assert float(ours[2]) > 0 and int(ours[-2]) > 100 and ours[-1] == "0", section.notes


def test_a_device_is_measured_by_its_stamps() -> None:
    found = sources.one("NatNet, 120 Hz", 0.5)
    assert found["samples"] > 100 and found["lost"] == 0 and min(found["ages"]) > 0
