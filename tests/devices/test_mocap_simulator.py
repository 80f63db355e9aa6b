"""Simulated markers on the Lab Streaming Layer: an inlet gets the walk, foot by foot."""

from __future__ import annotations

import numpy as np

from kinegraph.devices.lsl import LslInlet
from kinegraph.devices.lsl.mocap_simulator import LABELS, Mocap
from kinegraph.devices.simulation.catalogue import named
from kinegraph.stream.chunk import NS
from tests.support.device_feed import check, reading, wait_for


def test_an_inlet_gets_the_walk() -> None:
    sender = Mocap("walking markers", source_id="walking markers", rate_hz=200.0, seed=3)
    source = LslInlet("walking markers", channels=LABELS, rate_hz=200.0, unit="mm", type="MoCap")
    with sender.serving(), reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("out") >= 600, 60.0)
    assert feed.error is None and not feed.problems
    check(source, feed)
    data = feed.data("out").reshape(-1, 8, 3)
    number = np.round((feed.time("out") - feed._offset) / NS * 200).astype(np.int64)
    wanted = sender.values(sender.signal(), int(number[0]), int(number[-1]) + 1)[number - number[0]]
    np.testing.assert_allclose(data.reshape(len(data), -1), wanted.astype(np.float32))
    ankles = data[:, [2, 6]] - data[:, [0, 4]]
    assert np.ptp(ankles[:, :, 1], axis=0).min() > 300, "both feet swing"
    assert np.abs(data[:, :, :2]).max() < 1000 and (data[:, :, 2] >= 0).all(), "it stays on the treadmill"


def test_it_can_be_started_by_name() -> None:
    assert named()["mocap"] is Mocap
