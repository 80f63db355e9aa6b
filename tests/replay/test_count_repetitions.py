"""configs/count_repetitions.yaml: counts whatever repeats, from one accelerometer; here strides.

Recordings: a phone in the pockets of two people who stand up, walk 3 m, turn, walk back and sit down, several times (GeoTec; CC BY 4.0).
Truth: the annotators' labels say when they walk; scipy's spectrum says how many strides that were. Walks of two or three strides with a
turn between them are the hardest case for a counter, so that a fifth may be missing.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS, Array
from tests.replay.replaying import TURNING, WALKING, pocket_walks, signal, steps_per_s

PEOPLE = pytest.mark.parametrize("person", ["s01", "s04"])


@cache
def counted(person: str) -> kg.Results:
    seconds, imu, _ = pocket_walks(person)
    phone = signal(imu[:, :3], None, ("ax", "ay", "az"), ["m/s2"], time_s=seconds)
    return kg.load("count_repetitions").run({"sensor.imu": phone})


def repetitions(person: str) -> Array:
    rows = counted(person)["segment.primitive"].data
    return rows[rows["repetition"] > 0]


@PEOPLE
def test_strides_are_counted_while_somebody_walks(person: str) -> None:
    seconds, _, labels = pocket_walks(person)
    rows = repetitions(person)
    middle = np.searchsorted(seconds, (rows["onset"] + rows["end"]) / 2 / NS)
    assert np.isin(labels[middle], (WALKING, TURNING)).mean() > 0.9


@PEOPLE
def test_as_many_strides_are_counted_as_the_spectrum_says(person: str) -> None:
    seconds, _, labels = pocket_walks(person)
    walked_s = np.diff(seconds, append=seconds[-1])[labels == WALKING].sum()
    assert len(repetitions(person)) == pytest.approx(steps_per_s(person) / 2 * walked_s, rel=0.2)


@PEOPLE
def test_a_repetition_takes_as_long_as_a_stride(person: str) -> None:
    rows = repetitions(person)
    assert np.median((rows["end"] - rows["onset"]) / NS) == pytest.approx(2 / steps_per_s(person), rel=0.2)


@PEOPLE
def test_an_activitys_last_count_is_how_many_repetitions_it_had(person: str) -> None:
    """Counts are given while somebody is still at it, and corrected: the last one of each activity holds."""
    rows, counts = repetitions(person), counted(person)["segment.count"].data
    last = {int(row["activity"]): int(row["count"]) for row in counts}
    for activity in set(rows["activity"].tolist()):
        assert last[activity] == (rows["activity"] == activity).sum()
