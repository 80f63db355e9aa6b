"""The package `pyshimmer` reads our simulated device over a pseudo-terminal, and gets the numbers that our decoder gets.

It is not a dependency of anything here (GPL). KINEGRAPH_PYSHIMMER may name a Python that has it, where this one has not.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.shimmer import protocol as protocol
from kinegraph.devices.shimmer import units as units
from kinegraph.devices.shimmer.simulator import ShimmerModel
from kinegraph.devices.shimmer.source import Shimmer
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.serve import Server
from tests.support.device_feed import reading, wait_for

PYTHON = os.environ.get("KINEGRAPH_PYSHIMMER", sys.executable)
if sys.executable == PYTHON and find_spec("pyshimmer") is None:
    pytest.skip("the pyshimmer package is not installed (pip install pyshimmer)", allow_module_level=True)

PACKAGE = """
import json, sys, threading
from serial import Serial
from pyshimmer import ShimmerBluetooth, DEFAULT_BAUDRATE
from pyshimmer.dev.channels import ESensorGroup
groups = {"acceleration": ESensorGroup.ACCEL_LN, "wide_acceleration": ESensorGroup.ACCEL_WR,
          "angular_velocity": ESensorGroup.GYRO, "exg1": ESensorGroup.EXG1_24BIT, "exg2": ESensorGroup.EXG2_24BIT}
wanted, rate, n = sys.argv[2].split(","), float(sys.argv[3]), int(sys.argv[4])
rows, enough = [], threading.Event()
def take(packet):
    rows.append([packet[c] for c in packet.channels])
    if len(rows) >= n:
        enough.set()
with ShimmerBluetooth(Serial(sys.argv[1], DEFAULT_BAUDRATE)) as device:
    kind, version = device.get_firmware_version()
    device.set_sensors([groups[g] for g in wanted])
    device.set_sampling_rate(rate)
    for chip in (0, 1):
        device.set_exg_register(chip, 0, bytes.fromhex(sys.argv[5 + chip]))
    true_rate, _, channels = device.get_inquiry()
    gains = [device.get_exg_register(chip).get_ch_gain(c) for chip in (0, 1) for c in (0, 1)]
    known = device.get_all_calibration()
    calibration = [known.get_offset_bias(i) + known.get_sensitivity(i) + known.get_ali_mat(i) for i in (0, 1, 3)]
    battery, name = device.get_battery_state(in_percent=False), device.get_device_name()
    device.add_stream_callback(take)
    device.start_streaming()
    assert enough.wait(30)
    during = device.get_battery_state(in_percent=False)
    device.stop_streaming()
print(json.dumps({"version": [version.major, version.minor, version.rel], "kind": kind.name, "rate": true_rate,
                  "channels": [c.name for c in channels], "gains": gains, "calibration": calibration, "name": name,
                  "battery": [battery, during], "rows": rows[:n]}))
"""


@pytest.mark.parametrize(
    ("sensors", "groups"),
    [
        (("acceleration", "angular_velocity"), "acceleration,angular_velocity"),
        (("wide_acceleration", "emg"), "wide_acceleration,exg1"),
        (("acceleration", "angular_velocity", "ecg"), "acceleration,angular_velocity,exg1,exg2"),
    ],
)
def test_the_package_gets_the_same_numbers(sensors: tuple[str, ...], groups: str) -> None:
    purpose = "ecg" if "ecg" in sensors else "emg"
    registers = [r.hex() for r in units.registers(purpose, 512)]
    brain = ShimmerModel(seed=7)
    wide = brain.chips.wide_rate(512)  # the package does not set how often the sensors themselves measure
    brain.receive(bytes([protocol.WIDE_RATE, wide, protocol.GYRO_RATE, units.gyro_divider(512)]))
    with Server(brain, line_at("", "rfcommSHIM")) as server:
        where = str(Path(server.address).resolve())
        done = subprocess.run(
            [PYTHON, "-W", "ignore", "-c", PACKAGE, where, groups, "512", "200", *registers],
            capture_output=True,
            text=True,
            timeout=90,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        source = Shimmer(server.address, sensors, 512, wide_range_g=2)  # type: ignore[arg-type]
        with reading(source) as feed:
            wait_for(lambda: feed.error is not None or feed.count("timing") >= 200)
    theirs = json.loads(done.stdout.splitlines()[-1])
    assert feed.error is None and theirs["rate"] == 512 and theirs["kind"] == "LogAndStream"
    assert feed.identity["firmware"] == "LogAndStream " + ".".join(map(str, theirs["version"]))
    assert feed.identity["name"] == theirs["name"]
    assert feed.identity["battery_v"] == pytest.approx(theirs["battery"][0], abs=0.006) == theirs["battery"][1]
    rows = np.array(theirs["rows"], float)
    assert np.array_equal(np.round(feed.data("timing")["device"][:200] * 32768 / 1e9), rows[:, 0]), "device time"
    if "motion" in source.outputs:
        assert np.allclose(feed.data("motion")[:200], motion(theirs, source, rows), rtol=1e-9, atol=1e-9)
    if "exg" in source.outputs:
        names = {"emg": ("1_CH1", "1_CH2"), "ecg": ("1_CH1", "1_CH2", "2_CH2")}[purpose]
        columns = [theirs["channels"].index(f"EXG_ADS1292R_{name}_24BIT") + 1 for name in names]
        gains = [theirs["gains"][2 * int(name[0]) + int(name[-1]) - 3] for name in names]
        uv = rows[:, columns] * (2.42 / np.array(gains) / (2**23 - 1) * 1e6)
        assert np.allclose(feed.data("exg")[:200], uv, rtol=1e-12)


def motion(theirs: dict[str, list[list[int]]], source: Shimmer, rows: np.ndarray) -> np.ndarray:
    """Their counts by their calibration, in our units."""
    parts = []
    for sensor in source.motion:
        chip, place, unit = {
            "acceleration": ("ACCEL_LN", 0, 1.0),
            "angular_velocity": ("GYRO_MPU9150", 1, np.pi / 180 * 100),
            "wide_acceleration": ("ACCEL_LSM303DLHC", 2, 1.0),
        }[sensor]
        numbers = np.array(theirs["calibration"][place], float)
        first = theirs["channels"].index(f"{chip}_X") + 1  # type: ignore[arg-type]
        scaled = (rows[:, first : first + 3] - numbers[:3]) / numbers[3:6] * unit
        parts.append(scaled @ np.linalg.inv(numbers[6:].reshape(3, 3) / 100).T)
    return np.hstack(parts)


def test_every_channel_is_laid_out_as_the_package_has_it() -> None:
    program = """
import json
from pyshimmer.bluetooth.bt_const import BtChannelsByIndex as by
from pyshimmer.dev.channels import ChDataTypeAssignment as kinds
print(json.dumps({i: [kinds[c].size, kinds[c].big_endian, kinds[c].signed] for i, c in by.items() if kinds[c]}))
"""
    done = subprocess.run([PYTHON, "-W", "ignore", "-c", program], capture_output=True, text=True, timeout=60)
    theirs = json.loads(done.stdout)
    for number, channel in protocol.CHANNELS.items():
        size, big, signed = theirs[str(number)]
        assert (channel.size, channel.signed) == (size, signed) and (channel.big == big or size == 1)
