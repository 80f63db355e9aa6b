"""Pulses of a channel: they begin where a straight line between two samples passes the threshold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.operators.contacts.commands.compare_clocks import read_pulses
from kinegraph.stream.chunk import StreamSpec, grid
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.recording.series import Series, write_recording

LEVEL = np.array([0.0, 0.0, 1.0, 4.0, 4.0, 1.0, 0.0, 0.5, 2.0, 3.0, 0.0, 0.0, 4.0])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    spec = StreamSpec((2,), rate_hz=10.0, channels=("EMG", "TTL"), units=("V",))
    data = np.stack([np.ones(len(LEVEL)), LEVEL], axis=1)
    write_recording(tmp_path / "r.mcap", [Series("box", spec, grid(10.0, len(LEVEL)), data)], {})
    return tmp_path / "r.mcap"


@pytest.mark.parametrize(
    ("threshold", "places"),
    [
        (None, [2 + 1 / 3, 8.0, 11.5]),
        (2.0, [2 + 1 / 3, 8.0, 11.5]),
        (3.0, [2 + 2 / 3, 9.0, 11.75]),
        (0.5, [1.5, 7.0, 11.125]),
        (4.0, [3.0, 12.0]),
        (4.5, []),
    ],
)
def test_a_pulse_begins_where_the_line_between_samples_passes(
    path: Path, threshold: float | None, places: list[float]
) -> None:
    found = read_pulses(path, "box:TTL", threshold)
    start = grid(10.0, 1)[0] / 1e9
    assert found == pytest.approx(start + np.array(places) / 10.0, abs=1e-9)


@pytest.mark.parametrize("name", ["box", "box:TTX"])
def test_a_channel_that_is_not_there_is_told_with_one_that_is(path: Path, name: str) -> None:
    with pytest.raises(KinegraphError, match="name a channel of box, as in box:EMG"):
        read_pulses(path, name, None)
