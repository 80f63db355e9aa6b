"""A loose plug: a device is opened when its port is there, and as soon as it is there; back-off is for what opens and then fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinegraph.devices.discovery import serial_ports
from kinegraph.devices.lines.indexed_simulator import Indexed
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.fault_injection import FaultInjection
from kinegraph.devices.simulation.serve import Server
from kinegraph.devices.transport.transport import connect, present
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording


def test_what_is_not_there_is_not_opened_and_what_comes_back_is_opened_at_once(tmp_path: Path) -> None:
    wrong = FaultInjection(unplug_every_s=2.0, unplug_s=1.0)
    with Indexed(rate_hz=200).serving(wrong) as port:
        graph = load_text(
            f"nodes: {{lines: {{use: devices.lines.AsciiLines, port: {port}, columns: [i, t, n], time: t, rate_hz: 200}}}}"
        )
        outcome = Session(graph, tmp_path / "s", duration_s=11.5).run()
    assert outcome.error is None
    with Recording.open(tmp_path / "s") as recording:
        kinds = [(entry["kind"], str(entry.get("error", ""))) for entry in recording.log]
    failed = [error for kind, error in kinds if kind == "source failed"]
    assert failed and not [error for error in failed[1:] if "does not exist" in error], failed  # it may start unplugged
    reopened = sum(kind == "source reopened" for kind, _ in kinds)
    assert len(failed) - 1 <= reopened <= len(failed)


def test_ports_are_shown_by_the_name_that_lasts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two adapters change places: the name of each leads to it still."""
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    monkeypatch.setattr(serial_ports, "BY_ID", by_id)
    ports = [tmp_path / "ttyUSB0", tmp_path / "ttyUSB1"]
    for port in ports:
        port.touch()
    assert serial_ports.lasting_name(str(ports[0])) == str(ports[0]), "there is no name that lasts"
    for order in (ports, ports[::-1]):
        for name, port in zip(("usb-FTDI_A-if00-port0", "usb-FTDI_B-if00-port0"), order, strict=True):
            (by_id / name).unlink(missing_ok=True)
            (by_id / name).symlink_to(port)
            assert serial_ports.lasting_name(str(port)) == str(by_id / name)


@pytest.mark.parametrize(("address", "there"), [("/nowhere/ttyUSB0", False), ("COM3", None), ("tcp://a:1", None)])
def test_only_what_has_a_path_can_be_looked_for(address: str, there: bool | None) -> None:
    assert present(address) is there


def test_a_device_of_which_every_line_was_bad_is_no_success(tmp_path: Path) -> None:
    """Even where the session ended before the source's deadline."""
    with Indexed(rate_hz=200, trailing=",x").serving() as port:
        graph = load_text(f"nodes: {{lines: {{use: devices.lines.AsciiLines, port: {port}, columns: [i, t, n]}}}}")
        outcome = Session(graph, tmp_path / "s", duration_s=2).run()
    assert outcome.error is None and outcome.exit_code == 3


def test_two_sessions_on_one_device(tmp_path: Path) -> None:
    """The first goes on as if nothing had happened; the second says what to do, and goes on once the first has ended."""
    device = Server(Indexed(rate_hz=200.0).brain(), line_at("", Indexed.port_name))
    try:
        with connect(device.address, 9600) as first:
            with pytest.raises(DeviceError, match="another program has it open; close that one first"):
                connect(device.address, 9600)
            assert first.read(2.0), "it still gives"
        connect(device.address, 9600).close()
    finally:
        device.close()
