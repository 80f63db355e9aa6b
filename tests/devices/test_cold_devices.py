"""Nothing compiles once a session with a device runs: not with an empty cache either, as no kernel meets anything for the first time."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.nightly

HERE = Path(__file__).parent
OWN = {
    "belt": "devices.polar.Polar, device: Polar H10, acceleration_hz: 50",
    "mocap": "devices.natnet.NatNet, bodies: [Shank]",
    "imu": "devices.mti.Mti, port: /dev/none",
    "board": "devices.cyton.Cyton, port: /dev/none",
    "leg": "devices.shimmer.Shimmer, port: /dev/none, sensors: [emg]",
    "lines": "devices.lines.AsciiLines, port: /dev/none, columns: [t, emg], time: t, rate_hz: 200",
}


def test_no_kernel_is_met_for_the_first_time_while_a_device_is_read(tmp_path: Path) -> None:
    pytest.importorskip("bleak")
    graphs = []
    for name, text in OWN.items():
        path = tmp_path / f"{name}.yaml"
        path.write_text(f"nodes:\n  {name}: {{use: {text}}}\n")
        graphs.append(str(path))
    command = [sys.executable, "-m", "tests.cold_devices", *graphs]
    done = subprocess.run(command, capture_output=True, text=True, cwd=HERE.parents[1], check=False)
    met = json.loads(done.stdout.splitlines()[-1])
    assert met == {graph: [] for graph in graphs}, done.stderr
