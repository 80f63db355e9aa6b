"""What is known of each device's clock is in the recording, and `info` tells how far two devices may be apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinegraph.devices.clocks.device_clock import STEADY, DeviceClock
from kinegraph.devices.lines.indexed_simulator import Indexed
from kinegraph.devices.simulation.fault_injection import FaultInjection
from kinegraph.stream.chunk import NS
from kinegraph.stream.cli.commands.info import clocks, facts
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.support.command_line import Command


def test_info_tells_of_the_clocks_of_two_devices_one_of_which_is_set(tmp_path: Path, kinegraph: Command) -> None:
    wrong = FaultInjection(jump_every_s=2.0, jump_s=3600.0)
    with Indexed(rate_hz=200).serving() as one, Indexed(rate_hz=100).serving(wrong) as other:
        nodes = "".join(
            f"  {name}: {{use: devices.lines.AsciiLines, port: {port}, columns: [i, t, n], time: t, time_bits: 0, rate_hz: {hz}}}\n"
            for name, port, hz in (("left", one, 200), ("right", other, 100))
        )
        outcome = Session(load_text(f"nodes:\n{nodes}"), tmp_path / "s", duration_s=7).run()
    assert outcome.error is None
    with Recording.open(tmp_path / "s") as recording:
        known, reported = clocks(recording), facts(recording)["clocks"]
        jumps = [entry for entry in recording.log if entry["kind"] == "device clock jumped"]
        lasted = max(stream.duration_s for stream in recording.streams.values())
    assert known == reported and set(known) == {"left", "right"}
    assert all(clock["settling"] and clock["uncertainty_s"] > 0 for clock in known.values())
    assert known["left"]["jumps"] == 0 < known["right"]["jumps"]
    assert jumps and all(entry["node"] == "right" and abs(entry["jump_s"] - 3600) < 60 for entry in jumps)
    assert lasted < 600, "not 3600"
    _, shown, _ = kinegraph("info", str(tmp_path / "s"))
    assert "left and right agree within" in shown and "still settling" in shown and "clock right: within" in shown


def test_while_the_drift_is_unknown_the_uncertainty_covers_it() -> None:
    """A resonator of 800 ppm: until its drift is known, stamps fall behind, by no more than is stated."""
    clock = DeviceClock()
    for i in range(50 * STEADY - 1):
        true, device = i * NS // 50, round(i * NS / 50 * (1 - 800e-6))
        clock.see(device, true)
        error = abs(int(clock.stamps(np.array([device]))[0]) - true) / NS
        assert error <= clock.state.uncertainty_s + 1e-3 and (clock.state.settling or i > 50 * (STEADY - 1))
