"""configs/dot_steps.yaml: every step of somebody who wears a Movella DOT, and the statistics of the latest ones.

Recording: no recording of the sensor may be kept. A phone in a walker's pocket (GeoTec; CC BY 4.0) stands in for it, at the sensor's rate.
Truth: the step frequency by scipy's spectrum, and the annotators' labels.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import WALKING, evenly, pocket_walks, signal, steps_per_s

RATE = 120.0
CHANNELS = ("ax", "ay", "az", "gx", "gy", "gz")
UNITS = ("m/s2",) * 3 + ("deg/s",) * 3


@pytest.mark.parametrize("person", ["s01", "s04"])
def test_its_steps_and_their_cadence_are_those_of_the_spectrum(person: str) -> None:
    walks, imu, labels = pocket_walks(person)
    _, phone = evenly(walks, imu, RATE)
    phone = np.hstack([phone[:, :3], np.degrees(phone[:, 3:6])])
    kept = ("walk.steps.steps", "walk.statistics.statistics")
    made = kg.load("dot_steps").run({"dot": signal(phone, RATE, CHANNELS, UNITS)}, keep=kept)
    steps, statistics = (made[name].data for name in kept)
    walked_s = np.diff(walks, append=walks[-1])[labels == WALKING].sum()
    at = np.searchsorted(walks, steps["end"] / NS).clip(max=len(labels) - 1)
    assert (labels[at] == WALKING).sum() == pytest.approx(steps_per_s(person) * walked_s, rel=0.1)
    assert np.median(statistics["cadence"]) == pytest.approx(60 * steps_per_s(person), rel=0.15)
