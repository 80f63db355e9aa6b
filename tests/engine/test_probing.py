"""What is missing is named before anything compiles, with the nearest that is there."""

from __future__ import annotations

import socket
import sys
import threading
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest
import serial.tools.list_ports as list_ports
from serial.tools.list_ports_common import ListPortInfo
from structlog.testing import capture_logs

from kinegraph.devices.analog.inputs import AnalogInput
from kinegraph.devices.analog.nidaq import NiDaq
from kinegraph.devices.cameras import kinect
from kinegraph.devices.cameras.kinect import AzureKinect
from kinegraph.devices.lsl import LslInlet
from kinegraph.devices.mqtt.link import Broker
from kinegraph.devices.natnet import NatNet, discovery
from kinegraph.devices.oak import Oak
from kinegraph.devices.osc.inlet import OscArgument, OscInlet, OscStream
from kinegraph.devices.osc.vmc_inlet import Vmc
from kinegraph.devices.qualisys import Qualisys
from kinegraph.devices.transport import ble_radio, transport, usb_bus
from kinegraph.devices.trigno.source import Trigno, TrignoSensor
from kinegraph.stream.chunk import Specs, StreamSpec
from kinegraph.stream.engine import probing
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.source import Feed, Source
from tests.support.command_line import Command, refused

BOARD = "nodes:\n  board: {use: devices.cyton.Cyton, port: /dev/ttyNOTTHERE%s}\n"
UNKNOWN = threading.Event()


@pytest.fixture
def ports(monkeypatch: pytest.MonkeyPatch) -> None:
    built_in, adapter = ListPortInfo("/dev/ttyNOTTHERE0"), ListPortInfo("/dev/ttyNOTTHEIR")
    adapter.vid = 0x0403
    monkeypatch.setattr(list_ports, "comports", lambda: [built_in, adapter])


def test_a_missing_port_is_named_before_anything_compiles(
    kinegraph: Command, ports: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    monkeypatch.setattr("kinegraph.stream.engine.session.warm_up", lambda *_: pytest.fail("it compiles"))
    (tmp_path / "graph.yaml").write_text(BOARD % "")
    output = kinegraph("run", "graph.yaml", "--view", "none")
    refused(output, "source 'board'", "/dev/ttyNOTTHERE does not exist", "'/dev/ttyNOTTHEIR'", "--simulate", code=3)
    assert not (tmp_path / "recordings").exists(), "nothing is recorded of a session that has not begun"


def test_all_that_is_missing_is_named_at_once(ports: None) -> None:
    other = "  second: {use: devices.mti.Mti, port: /dev/ttyGONE}\n"
    with pytest.raises(DeviceError, match=r"'board'.*ttyNOTTHERE.*'second'.*ttyGONE"):
        probing.probe(load_text(BOARD % "" + other))


def test_a_source_that_is_not_required_may_be_missing(ports: None) -> None:
    probing.probe(load_text(BOARD % ", required: false"))


def test_a_stream_that_may_appear_is_named_and_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LslInlet, "missing", lambda _: "no LSL stream")
    with capture_logs() as logs:
        probing.probe(load_text("nodes:\n  eeg: {use: devices.lsl.LslInlet, name: EEG, channels: 1}\n"))
    (reported,) = logs
    assert reported["node"] == "eeg" and "no LSL stream" in reported["error"] and "--simulate" in reported["error"]


BROKER = "{host: 127.0.0.1, port: 1}"
HOME = f"""nodes:
  pause: {{use: devices.mqtt.MqttSwitch, name: pause, broker: {BROKER}}}
  home:
    use: devices.mqtt.MqttOutlet
    from: pause
    broker: {BROKER}
    entities: {{pause: {{of: pause, name: Pause, field: "on"}}}}
"""


def test_a_broker_that_is_away_is_named_once_and_the_session_goes_on() -> None:
    with capture_logs() as logs:
        probing.probe(load_text(HOME))
    (reported,) = logs
    assert reported["node"] == "pause, home", "both need the same one"
    assert "no MQTT broker at 127.0.0.1:1 (Connection refused)" in reported["error"]


def test_a_broker_that_is_there_is_not_missing() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        assert Broker("127.0.0.1", server.getsockname()[1]).missing() == Broker("").missing() == ""


def test_a_bluetooth_device_that_does_not_advertise_is_named_with_those_that_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("bleak")
    from kinegraph.devices.ble.simulated_radio import radio
    from kinegraph.devices.dot.simulator import DotSensor
    from kinegraph.devices.dot.source import MovellaDot

    monkeypatch.setattr(ble_radio, "PROBE_S", 0.05)
    with radio() as air, capture_logs() as logs:
        air.put(DotSensor())
        assert MovellaDot().missing() == ""
        probing.probe(load_text("nodes:\n  belt: {use: devices.heart_rate.HeartRate}\n"))
    (reported,) = logs
    assert reported["node"] == "belt" and "there are Movella DOT (C0:FF:EE:00:00:00)" in reported["error"]
    assert "--simulate" in reported["error"]


def test_bytes_over_bluetooth_are_waited_for_and_those_of_a_port_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("bleak")
    from kinegraph.devices.ble.simulated_radio import radio

    monkeypatch.setattr(ble_radio, "PROBE_S", 0.01)
    with radio(), capture_logs() as logs:
        probing.probe(load_text(BOARD.replace("/dev/ttyNOTTHERE%s", "ble://scale/2a9d")))
    assert "'scale' does not advertise" in logs[0]["error"] and "nothing else does either" in logs[0]["error"]


def test_a_bluetooth_device_ends_the_session_where_its_library_is_not_installed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "bleak", None)
    with pytest.raises(DeviceError, match=r"source 'belt'.*pip install 'kinegraph\[ble\]'"):
        probing.probe(load_text("nodes:\n  belt: {use: devices.heart_rate.HeartRate}\n"))


def test_a_simulated_device_is_not_looked_for(ports: None) -> None:
    graph = load_text(BOARD % "")
    graph.session["simulated_sources"] = ["board"]
    probing.probe(graph)


@dataclass(frozen=True, slots=True)
class Slow(Source):
    """Its library does not come back."""

    def specs(self) -> Specs:
        return {"out": StreamSpec((1,), rate_hz=10.0)}

    def missing(self) -> str:
        UNKNOWN.wait(30)
        return "never seen"

    def read(self, feed: Feed) -> None:
        raise NotImplementedError


def test_a_library_that_does_not_answer_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probing, "PROBE_S", 0.01)
    UNKNOWN.clear()
    graph = load_text(f"nodes:\n  slow: {{use: {Slow.__module__}.Slow}}\n")
    try:
        probing.probe(graph)
    finally:
        UNKNOWN.set()


def test_a_port_that_is_there_is_not_missing(ports: None) -> None:
    assert transport.missing("/dev/null") == transport.missing("tcp://localhost:1") == ""


def test_a_usb_device_is_named_with_its_sibling(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(usb_bus, "connected", lambda: [SimpleNamespace(idVendor=0x2639, idProduct=0x0017)])
    reported = transport.missing("usb://2639:0003")
    assert "usb://2639:0003 is not there" in reported and "there is usb://2639:0017" in reported


def test_a_camera_that_is_not_among_those_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = [SimpleNamespace(deviceId="14442C10", name="1.2")]
    monkeypatch.setattr("kinegraph.devices.oak.source.library", lambda: None)
    monkeypatch.setattr("kinegraph.devices.oak.source.all_cameras", lambda _: seen)
    assert "connected: 14442C10" in Oak(device="14442C11").missing()
    assert Oak().missing() == Oak(device="1.2").missing() == Oak(device="192.168.1.5").missing() == ""


def test_a_server_that_does_not_answer_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        sensors = (TrignoSensor(1),)
        assert Trigno(port=f"tcp://127.0.0.1:{port}", sensors=sensors).missing() == ""
        assert Qualisys(port=port, markers=("head",)).missing() == ""
    for source in (
        Trigno(port=f"tcp://127.0.0.1:{port}", sensors=sensors),
        Qualisys(port=port, markers=("head",)),
    ):
        assert f"tcp://127.0.0.1:{port} cannot be reached: Connection refused" in source.missing()


def test_a_port_where_another_program_listens_is_named() -> None:
    stream = OscStream("knee", "/knee", (OscArgument("angle"),))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        for source in (OscInlet((stream,), port=port), Vmc(port=port)):
            assert "another program listens there" in source.missing()
    for source in (OscInlet((stream,), port=port), Vmc(port=port)):
        assert source.missing() == ""


def test_a_natnet_server_that_does_not_answer_is_named_with_one_that_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(discovery, "AT", [])
    monkeypatch.setattr(discovery, "ANSWER_S", 0.01)
    assert "no NatNet server answers at 127.0.0.1:1; does Motive stream" in discovery.missing("127.0.0.1", 1)
    monkeypatch.setattr(discovery, "answering", lambda *_: ({("127.0.0.9", 1510): None}, {}))
    assert "there is 127.0.0.9:1510" in NatNet("127.0.0.1", bodies=("racket",)).missing()
    assert NatNet("127.0.0.9", bodies=("racket",)).missing() == ""


def test_a_kinect_that_is_not_connected_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kinect, "library", lambda: SimpleNamespace(connected_device_count=lambda: 1))
    assert AzureKinect().missing() == ""
    assert "no Azure Kinect of number 1 is connected; there are 1" in AzureKinect(device="1").missing()


def test_a_library_that_is_not_installed_is_named_before_anything_compiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(DeviceError, match=r"pip install 'kinegraph\[ni\]'"):
        NiDaq(inputs=(AnalogInput("ai0"),)).missing()


def test_a_stream_that_nobody_sends_is_named_with_the_nearest(monkeypatch: pytest.MonkeyPatch) -> None:
    info = SimpleNamespace(
        name=lambda: "OpenBCI_EMG", type=lambda: "EMG", source_id=lambda: "x", hostname=lambda: "lab"
    )
    lsl = SimpleNamespace(ContinuousResolver=lambda: SimpleNamespace(results=lambda: [info]))
    monkeypatch.setattr("kinegraph.devices.lsl.inlet.library", lambda _: lsl)
    monkeypatch.setattr("kinegraph.devices.lsl.find.PROBE_S", 0.0)
    reported = LslInlet(name="OpenBCI_EEG", channels=1).missing()
    assert "no LSL stream with name 'OpenBCI_EEG'" in reported and "did you mean 'OpenBCI_EMG'?" in reported
    assert LslInlet(name="OpenBCI_EMG", channels=1).missing() == ""
