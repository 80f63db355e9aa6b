"""USB through pyusb as it is, over a simulated bus: addresses, permission, drivers, transfers, the cable, declared reports, discovery."""

from __future__ import annotations

import gc
import threading
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import usb.core
from usb.backend import IBackend

from kinegraph.devices.discovery.usb_devices import find as find_connected
from kinegraph.devices.frames.packet_decoder import PacketDecoder
from kinegraph.devices.mti.simulator import MtiModel
from kinegraph.devices.mti.simulator import SimulatedMti as SimulatedMti
from kinegraph.devices.mti.source import Mti
from kinegraph.devices.people.walking_limb import GRAVITY
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.serve import Server
from kinegraph.devices.transport import usb_bus as bus
from kinegraph.devices.transport.transport import connect
from kinegraph.devices.transport.usb_bus import UsbAddress
from kinegraph.devices.transport.usb_pipe import Pipe
from kinegraph.devices.usb.endpoint import Endpoint
from kinegraph.devices.usb.simulated_bus import BULK, INTERRUPT, SimulatedBus, UsbLine, UsbWiring
from kinegraph.devices.usb.simulated_reports import DUALSENSE, DualSenseBrain, serving
from kinegraph.stream.chunk import NS
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.graph.reading.load import load, load_text
from kinegraph.stream.params import build
from kinegraph.stream.recording import Recording
from tests.support.device_feed import Kept, check, reading, wait_for

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "dualsense.yaml"
WIRING = UsbWiring(0x1209, 0x0001, "Maker", "Thing", "T1", BULK)


@pytest.fixture
def own_bus() -> Iterator[SimulatedBus]:
    """A bus of the test's own; at the end nothing is open on it."""
    made = SimulatedBus()
    yield made
    gc.collect()
    assert not made.handles
    assert made not in bus.simulated


@contextmanager
def plugged(on: SimulatedBus, **changes: object) -> Iterator[UsbLine]:
    line = UsbLine(on, replace(WIRING, **changes))  # type: ignore[arg-type]
    try:
        yield line
    finally:
        line.close()


# addresses -----------------------------------------------------------------------------------------------------------


def test_addresses() -> None:
    assert UsbAddress.parse("usb://2639") == UsbAddress(0x2639)
    assert UsbAddress.parse("usb://054C:0ce6/A1-2") == UsbAddress(0x54C, 0xCE6, "A1-2")
    assert str(UsbAddress(0x54C, 0xCE6, "A1")) == "usb://054c:0ce6/A1"
    for wrong in ("usb://", "usb://26", "usb://2639:3", "usb://2639/", "2639:0003", "usb://gggg"):
        with pytest.raises(DeviceError, match="is not a USB address; write usb://VENDOR"):
            UsbAddress.parse(wrong)


def test_which_of_several(own_bus: SimulatedBus) -> None:
    with plugged(own_bus), plugged(own_bus, serial="T2"), plugged(own_bus, product=2):
        assert bus.find(UsbAddress(0x1209, 2)).product == "Thing"
        assert bus.serial_number(bus.find(UsbAddress(0x1209, 1, "T2"))) == "T2"
        with pytest.raises(
            DeviceError, match="any of 2 devices; write which one: usb://1209:0001/T1, usb://1209:0001/T2"
        ):
            bus.find(UsbAddress(0x1209, 1))
        with pytest.raises(DeviceError, match="is not there; is it plugged in"):
            bus.find(UsbAddress(0x1209, 1, "T3"))
    with pytest.raises(DeviceError, match="is not there"):
        bus.find(UsbAddress(0x1209))


def test_no_libusb(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus, "libusb", lambda: None)
    with pytest.raises(DeviceError, match=r"apt install libusb-1\.0-0"):
        Pipe("usb://1209")


# an open interface ---------------------------------------------------------------------------------------------------


def test_the_simulated_bus_is_pyusbs_own_business(own_bus: SimulatedBus) -> None:
    """pyusb itself, without our code, reads it."""
    assert isinstance(own_bus, IBackend)
    with plugged(own_bus) as line:
        device = usb.core.find(idVendor=0x1209, backend=own_bus)
        assert (device.manufacturer, device.product, device.serial_number) == ("Maker", "Thing", "T1")
        (interface,) = device.get_active_configuration()
        assert [e.bEndpointAddress for e in interface] == [0x81, 0x01]
        with pytest.raises(usb.core.USBTimeoutError):
            device.read(0x81, 64, 10)
        line.write(bytes(range(100)))
        assert device.read(0x81, 640, 100).tobytes() == bytes(range(100))
        assert device.write(0x01, b"hello") == 5 and line.read(0.1) == b"hello"
        line.unplug()
        with pytest.raises(usb.core.USBError) as raised:
            device.read(0x81, 64, 100)
        assert raised.value.errno == 19
        usb.util.dispose_resources(device)


def test_transfers_end_with_a_packet_that_is_not_full(own_bus: SimulatedBus) -> None:
    with plugged(own_bus) as line, connect(line.address) as link:
        assert link.read(0.0) == b""
        line.write(bytes(200))
        line.write(bytes(128))
        line.write(b"abc")
        assert [len(link.read(0.1)) for _ in range(4)] == [200, 128, 3, 0]
        for size in (1, 64, 5000):
            data = np.random.default_rng(size).bytes(size)
            link.write(data)
            assert line.read(0.1) == data
            line.write(data)
            came = b""
            while len(came) < size:
                came += link.read(0.1)
            assert came == data


def test_the_systems_driver_is_detached_and_put_back(own_bus: SimulatedBus) -> None:
    with plugged(own_bus, driver="usbhid") as line:
        with Pipe(line.address):
            assert (own_bus.detached, own_bus.attached) == (1, 0)
        assert own_bus.attached == 1
        with Pipe(line.address), pytest.raises(DeviceError, match="another program or a driver"):
            Pipe(line.address)


def test_permission_is_told_with_the_exact_rule(own_bus: SimulatedBus) -> None:
    with plugged(own_bus, permitted=False):
        for address in ("usb://1209", "usb://1209:0001/T1"):
            with pytest.raises(DeviceError) as raised:
                Pipe(address)
            reported = str(raised.value)
            assert "/etc/udev/rules.d/70-kinegraph.rules" in reported and "udevadm control --reload" in reported
            assert (
                'SUBSYSTEM=="usb", ATTR{idVendor}=="1209", ATTR{idProduct}=="0001", MODE="0660", TAG+="uaccess"'
                in reported
            )


def test_interfaces_and_endpoints_that_are_not_there(own_bus: SimulatedBus) -> None:
    with plugged(own_bus, interface=2, endpoint=3) as line:
        Pipe(line.address, 2, 0x83).close()
        with pytest.raises(
            DeviceError, match=r"no interface 1 to read from; there is interface 2 endpoint 0x83 \(bulk\)"
        ):
            Pipe(line.address, 1)
        with pytest.raises(DeviceError, match="no endpoint 0x81"):
            Pipe(line.address, None, 0x81)


def test_a_stalled_endpoint_goes_on(own_bus: SimulatedBus, monkeypatch: pytest.MonkeyPatch) -> None:
    with plugged(own_bus) as line, Pipe(line.address) as pipe:

        def stall(*_: object) -> int:
            raise usb.core.USBError("Pipe error", -9, 32)

        with monkeypatch.context() as patched:
            patched.setattr(own_bus, "bulk_read", stall)
            assert pipe.read(0.1) == b""
        line.write(b"on")
        assert pipe.read(0.1) == b"on"


# the cable -----------------------------------------------------------------------------------------------------------


def test_unplugged_while_waiting(own_bus: SimulatedBus) -> None:
    with plugged(own_bus) as line, Pipe(line.address) as pipe:
        timer = threading.Timer(0.1, line.unplug)
        timer.start()
        with pytest.raises(DeviceError, match="it is gone"):
            pipe.read(10.0)
        timer.join()
        with pytest.raises(DeviceError, match="it is gone"):
            pipe.write(b"x")


@pytest.mark.nightly
def test_pulled_out_a_hundred_times_in_mid_packet_nothing_leaks(own_bus: SimulatedBus) -> None:
    """An MTi on bulk endpoints: the source raises, lets go of everything and can be opened again."""

    def usage() -> tuple[int, int, int]:
        gc.collect()
        return threading.active_count(), len(list(Path("/proc/self/fd").iterdir())), tracemalloc.get_traced_memory()[0]

    before = (0, 0, 0)
    wiring = UsbWiring(0x2639, 0x0003, "Xsens", "MTi", "S1", BULK, driver="xsens_mt")
    tracemalloc.start()
    try:
        with Server(MtiModel(), UsbLine(own_bus, wiring)) as server:
            for turn in range(100):
                with reading(Mti(server.address)) as feed:
                    wait_for(lambda feed=feed: feed.count("imu") >= 3)
                    server.unplug()
                    wait_for(lambda feed=feed: feed.error is not None)
                assert isinstance(feed.error, DeviceError) and "gone" in str(feed.error)
                server.plug()
                if turn == 20:
                    before = usage()
            after = usage()
    finally:
        tracemalloc.stop()
    assert after[:2] == before[:2] and not own_bus.handles
    assert after[2] - before[2] < 200_000, "bytes kept after 79 more times"


def test_a_session_goes_on_when_the_cable_is_put_in_again(tmp_path: Path) -> None:
    graph = load_text(
        "nodes: {mti: {use: devices.mti.Mti, port: usb://2639}, smooth: {use: operators.filters.iir.Lowpass, from: mti, cutoff_hz: 5}}\n"
        "record: [smooth]",
    )
    with SimulatedMti().on_usb(FaultInjection(unplug_every_s=3.0, unplug_s=0.6)):
        Session(graph, tmp_path / "session", duration_s=8.0).run()
    with Recording.open(tmp_path / "session") as recording:
        lost = [chunk.lost for chunk in recording.chunks("mti.imu") if chunk.lost]
        stamp, data = recording.read("mti.imu")
        seen, _ = recording.read("smooth")
    assert len(lost) >= 1 and -1 in lost
    assert (np.diff(stamp) > 0).all() and np.diff(stamp).max() > 0.5 * NS
    assert len(seen) == len(stamp) == len(data) > 100


def test_transfers_that_pile_up_while_packets_gather_are_all_taken(own_bus: SimulatedBus) -> None:
    """The sensor sends faster than reads begin: nothing may be left behind."""
    wiring = UsbWiring(0x2639, 0x0003, "Xsens", "MTi", "S1", BULK)
    source = Mti("usb://2639", rate_hz=2000, high_rate=True, gather_s=0.05)
    with Server(MtiModel(), UsbLine(own_bus, wiring)), reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("imu") >= 8000, 60)
    assert feed.error is None and feed.lost("imu") == {}
    behind = feed.data("timing")["arrival"] - feed.time("timing")
    assert np.median(behind[len(behind) // 2 :]) < 0.5e9


# the MTi on USB ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("given", [{}, {"rate_hz": 2000, "high_rate": True}])
def test_an_mti_on_usb_gives_what_it_gives_on_a_serial_line(given: dict[str, object]) -> None:
    with SimulatedMti(seed=4).on_usb() as address:
        source = build(Mti, {"port": "usb://2639", **given})
        with reading(source) as feed:
            wait_for(lambda: feed.error is not None or feed.count("imu") >= 200, 60)
        assert address == "usb://2639:0003/SIM03700001"
    assert feed.error is None and not feed.problems and feed.lost("imu") == {}
    check(source, feed)
    brain = MtiModel(seed=4)
    brain._outputs = list(source.wanted)
    brain._configure()
    made = brain.limb.measure(np.arange(feed.count("imu")))
    np.testing.assert_allclose(
        feed.data("imu"), np.hstack([made["acceleration"], made["angular_velocity"]]), rtol=1e-6, atol=1e-6
    )


def test_losses_on_usb_are_found_by_counter() -> None:
    with (
        SimulatedMti().on_usb(FaultInjection(lose=0.05, corrupt=0.02, seed=5)) as address,
        reading(Mti(address)) as feed,
    ):
        wait_for(lambda: feed.error is not None or feed.count("imu") >= 300, 60)
    assert feed.error is None
    number = feed.data("timing")["counter"]
    assert sum(feed.lost("imu").values()) == number[-1] - number[0] + 1 - len(number) > 5


# declared reports ----------------------------------------------------------------------------------------------------


def dualsense(**changes: object) -> Endpoint:
    part = load(CONFIG).nodes["controller"].part
    assert isinstance(part, Endpoint)
    return replace(part, **changes)


def read(source: Endpoint, faults: FaultInjection = GOOD, n: int = 300) -> Kept:
    with serving(source, faults) as address:
        there = replace(source, port=address)
        with reading(there) as feed:
            wait_for(lambda: feed.error is not None or feed.count("imu") >= n, 60)
    if feed.chunks:
        check(there, feed)
    return feed


def truth(feed: Kept) -> np.ndarray:
    """The controller's movement at the reports that came, known by the device's time."""
    number = np.round(feed.data("timing")["device"] * 250 / NS).astype(int)
    made = DualSenseBrain().limb.measure(np.arange(number[-1] + 1))
    return np.hstack([np.rad2deg(made["angular_velocity"]), made["acceleration"] / GRAVITY])[number]


def test_a_report_as_the_driver_of_the_system_reads_it() -> None:
    """Offsets of hid-playstation: id 0, counter 7, gyroscope 16, accelerometer 22, time in thirds of us 28."""
    report = bytearray(64)
    report[0], report[7] = 0x01, 0xFE
    report[16:28] = np.array([16, -16, 32767, 8192, -8192, 4096], "<i2").tobytes()
    report[28:32] = (3_000_000).to_bytes(4, "little")
    source = dualsense()
    (layout,) = source.layouts()
    assert layout.size == 32
    found = PacketDecoder([layout]).feed(bytes(report))
    table = layout.table(bytes(found.frames[0]))
    assert layout.counters(table).tolist() == [0xFE] and layout.times_ns(table).tolist() == [NS]
    assert layout.values(table).tolist() == [[1.0, -1.0, 2047.9375, 1.0, -1.0, 0.5]]


def test_what_the_controller_measures_arrives() -> None:
    feed = read(dualsense())
    assert feed.error is None and not feed.problems and feed.lost("imu") == {}
    off = np.abs(feed.data("imu") - truth(feed)).max(axis=0)
    assert (off <= [0.0313] * 3 + [0.0000611] * 3).all(), "half a count"
    assert np.median(np.diff(feed.time("imu"))) == pytest.approx(4e6, rel=0.01)


def test_lost_and_repeated_reports_are_counted() -> None:
    feed = read(dualsense(), FaultInjection(lose=0.05, duplicate=0.05, seed=3), 600)
    assert feed.error is None
    device = feed.data("timing")["device"]
    assert np.abs(feed.data("imu") - truth(feed)).max() < 0.05
    missing = round((device[-1] - device[0]) * 250 / NS) + 1 - len(device)
    assert sum(feed.lost("imu").values()) == missing == feed.problems["lost frame"] > 10
    assert feed.problems["repeated frame or wrong time"] > 10


def test_a_controller_that_starts_again_and_one_that_is_unplugged() -> None:
    feed = read(dualsense(), FaultInjection(reset_every_s=1.2), 600)
    assert feed.error is None and feed.problems["device restarted"] >= 1 and -1 in feed.lost("imu").values()
    feed = read(dualsense(), FaultInjection(unplug_every_s=1.0), 10**9)
    assert isinstance(feed.error, DeviceError) and "it is gone" in str(feed.error)
    assert feed.problems["bytes that are no frame"] <= 63, "half a report"


def test_other_reports_and_wrong_ones_are_passed_over(own_bus: SimulatedBus) -> None:
    line = UsbLine(own_bus, DUALSENSE)
    try:
        with reading(dualsense()) as feed:
            brain, n = DualSenseBrain(), 0
            while feed.count("imu") < 50:
                (report,) = brain.reports(n, n + 1)
                for sent in (b"\x31" + report[1:], report[:20], report):
                    line.write(sent)
                n += 1
                threading.Event().wait(0.004)
    finally:
        line.close()
    assert feed.error is None and feed.lost("imu") == {}
    assert feed.problems["bytes that are no frame"] >= 50 * 84 and set(feed.problems) == {"bytes that are no frame"}


def test_nothing_that_was_declared_comes(own_bus: SimulatedBus, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinegraph.devices.frames.declaration_check.FIRST_FRAME_S", 0.2)
    line = UsbLine(own_bus, DUALSENSE)
    try:
        with reading(dualsense()) as feed:
            while feed.error is None:
                line.write(b"\x31" + bytes(63))
                threading.Event().wait(0.02)
    finally:
        line.close()
    assert isinstance(feed.error, DeviceError) and "expected 01" in str(feed.error) and "31 00" in str(feed.error)


def test_any_declaration_has_a_simulated_device() -> None:
    given = {
        "port": "usb://1209:abcd",
        "endpoint": 0x82,
        "interface": 1,
        "frames": [
            {
                "name": "imu",
                "sync": "07",
                "rate_hz": 200.0,
                "checksum": "crc8",
                "fields": [{"type": "u16", "role": "counter"}, {"name": "x", "type": "f32", "unit": "g"}],
            }
        ],
    }
    source = build(Endpoint, given)
    with source.simulated() as there, reading(there) as feed:
        wait_for(lambda: feed.error is not None or feed.count("imu") >= 100)
    assert feed.error is None and not feed.problems
    for wrong, reported in (
        ({"port": "/dev/ttyUSB0"}, "port is"),
        ({"endpoint": 1}, "endpoint is 1"),
        ({"frames": []}, "frames"),
    ):
        with pytest.raises(ParameterError, match=reported):
            build(Endpoint, {**given, **wrong}).specs()


# discovery -----------------------------------------------------------------------------------------------------------


def test_known_devices_are_listed_with_their_yaml(own_bus: SimulatedBus) -> None:
    with (
        plugged(own_bus),
        plugged(own_bus, vendor=0x2639, product=3),
        plugged(own_bus, vendor=0x54C, product=0xCE6, permitted=False),
    ):
        found = {one.address: one for one in find_connected()}
    assert set(found) == {"usb://2639:0003/T1", "usb://054c:0ce6"}
    mti, pad = found["usb://2639:0003/T1"], found["usb://054c:0ce6"]
    assert mti.what == "Xsens/Movella MTi (Thing, serial number T1)" and not mti.note
    assert mti.yaml == "use: devices.mti.Mti\nport: usb://2639:0003/T1"
    assert pad.what == "Sony DualSense controller" and 'ATTR{idVendor}=="054c"' in pad.note


def test_report_endpoints_are_interrupt_ones() -> None:
    assert DUALSENSE.transfer == INTERRUPT and (DUALSENSE.interface, DUALSENSE.endpoint) == (3, 4)
