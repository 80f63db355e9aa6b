"""BrainFlow's own compiled Cyton driver reads our simulated board, and gets the numbers that our source gets.

BrainFlow keeps a shared library in a process of its own here, because its threads and its log are not ours to judge.
"""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.cyton.protocol import uv_per_count
from kinegraph.devices.cyton.simulator import CytonModel
from kinegraph.devices.cyton.source import Cyton
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.serve import Server
from tests.support.device_feed import reading, wait_for

pytest.importorskip("brainflow", reason="BrainFlow is not installed (pip install 'kinegraph[peers]')")

DRIVER = """
import json, sys, time
import numpy as np
from brainflow.board_shim import BoardShim, BrainFlowInputParams
port, kind, wanted = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
BoardShim.disable_board_logger()
given = BrainFlowInputParams()
given.serial_port = port
board = BoardShim(kind, given)
board.prepare_session()
answer = board.config_board("x1060110X")
board.start_stream()
deadline = time.monotonic() + 30
while board.get_board_data_count() < wanted and time.monotonic() < deadline:
    time.sleep(0.05)
board.stop_stream()
data = board.get_board_data()
board.release_session()
print(json.dumps({
    "answer": answer,
    "rate": BoardShim.get_sampling_rate(kind),
    "counter": data[BoardShim.get_package_num_channel(kind)].tolist(),
    "emg": data[BoardShim.get_eeg_channels(kind)].T.tolist(),
    "accel": data[BoardShim.get_accel_channels(kind)].T.tolist(),
}))
"""
CYTON, CYTON_DAISY = 0, 2


def brainflow(port: str, kind: int, wanted: int) -> dict[str, Any]:
    """What BrainFlow reads of a board, in its own units (uV, g)."""
    done = subprocess.run(
        [sys.executable, "-c", DRIVER, port, str(kind), str(wanted)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout.splitlines()[-1])
    return {name: np.array(value) if isinstance(value, list) else value for name, value in found.items()}


@pytest.mark.parametrize("daisy", [False, True])
def test_brainflow_gets_the_same_numbers(daisy: bool) -> None:
    brain = CytonModel(daisy=daisy, seed=11)
    with Server(brain, line_at(name="ttyCYTON")) as server:
        theirs = brainflow(server.address, CYTON_DAISY if daisy else CYTON, 300)
    again = CytonModel(daisy=daisy, seed=11)
    with Server(again, line_at(name="ttyCYTON")) as server, reading(Cyton(server.address, daisy=daisy)) as feed:
        wait_for(lambda: feed.count("emg") >= 400)
    ours = feed.data("emg")
    assert theirs["rate"] == (125 if daisy else 250)
    assert "Success" in theirs["answer"]
    n = len(theirs["emg"])
    assert n >= 300 and not feed.problems
    counter = theirs["counter"].astype(int)
    step = 2 if daisy else 1
    assert (np.diff(counter) % 256 == step).all(), "BrainFlow saw every packet in order"
    # both began with the board's first packet; BrainFlow may have missed some until its thread ran
    first = _first(theirs["emg"][0], ours)
    assert first < 100
    n = min(n, len(ours) - first)
    assert n >= 250
    np.testing.assert_allclose(theirs["emg"][:n], ours[first : first + n], rtol=1e-6, atol=1e-6)
    assert np.abs(ours).max() > 20 * uv_per_count(24)
    if not daisy:  # with a Daisy BrainFlow averages the accelerometer over two packets
        held = theirs["accel"]  # BrainFlow repeats the last value until a new one comes
        fresh = held[1:][(np.diff(held, axis=0) != 0).any(axis=1)]
        accel = feed.data("accel")
        start = _first(fresh[0], accel)
        m = min(len(fresh), len(accel) - start)
        assert m >= 20
        np.testing.assert_allclose(fresh[:m], accel[start : start + m], rtol=1e-6, atol=1e-9)


def _first(row: np.ndarray, table: np.ndarray) -> int:
    """Where a row stands in a table."""
    off = np.abs(table - row).max(axis=1)
    assert off.min() < 1e-3, "the other's first sample is not among ours"
    return int(off.argmin())
