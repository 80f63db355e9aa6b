"""The `bitalino` package reads our simulated device, and gets the numbers that our decoder gets.

It is not a dependency of anything here (GPL; its own needs a Bluetooth library that it does not use on a serial port or over TCP).
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.bitalino.simulator import BitalinoModel
from kinegraph.devices.bitalino.source import Bitalino, BitalinoChannel
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.serve import Server
from tests.support.device_feed import reading, wait_for

pytest.importorskip("bitalino", reason="the bitalino package is not installed (pip install --no-deps bitalino)")

PACKAGE = """
import json, sys
from bitalino import BITalino
device = BITalino(sys.argv[1], timeout=5)
version = device.version()
state = device.state()
device.start(int(sys.argv[2]), [int(c) for c in sys.argv[3]])
rows = device.read(int(sys.argv[4])).tolist()
device.stop()
print(json.dumps({"version": version, "state": state, "rows": rows}))
"""


@pytest.mark.parametrize(
    ("inputs", "rate_hz"), [("0", 100), ("02", 1000), ("0123", 1000), ("12345", 100), ("012345", 1000)]
)
@pytest.mark.parametrize("tcp", [False, True])
def test_the_package_gets_the_same_numbers(inputs: str, rate_hz: int, tcp: bool) -> None:
    brain = BitalinoModel(seed=7)
    with Server(brain, line_at("tcp://127.0.0.1:0" if tcp else "", "rfcommSIM")) as server:
        where = server.address.removeprefix("tcp://") if tcp else str(Path(server.address).resolve())
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", PACKAGE, where, str(rate_hz), inputs, "60"],
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        channels = tuple(BitalinoChannel(f"A{int(c) + 1}") for c in inputs)  # type: ignore[arg-type]
        with reading(Bitalino(server.address, channels, rate_hz)) as feed:  # type: ignore[arg-type]
            wait_for(lambda: feed.error is not None or feed.count("analog") >= 60)
    theirs = json.loads(done.stdout.splitlines()[-1])
    rows = np.array(theirs["rows"])
    assert theirs["version"] == "BITalino_v5.2" and feed.error is None
    assert np.array_equal(rows[:, 0], np.arange(60) % 16), "sequence"
    assert np.array_equal(rows[:, 1:5], [brain.digital(i) for i in range(60)])
    assert theirs["state"]["battery"] / 1024 * 6.6 == pytest.approx(feed.identity["battery_v"], abs=0.01)
    full = np.array([1024, 1024, 1024, 1024, 64, 64][: len(inputs)])
    assert np.array_equal(feed.data("analog")[:60], rows[:, 5:] / full * 3.3)
    assert np.array_equal(feed.data("digital")[:60], rows[:, 1:5])
