"""Bluetooth LE through bleak as it is, at its backend: belts, sensors, boards and treadmills that come, go, refuse and lose packets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.ble.simulated_radio import radio
from kinegraph.devices.ble.source import BleSource
from kinegraph.devices.dot import protocol as movella_dot
from kinegraph.devices.dot.simulator import DotSensor
from kinegraph.devices.dot.source import MovellaDot
from kinegraph.devices.fitness_treadmill.simulator import FtmsBelt
from kinegraph.devices.fitness_treadmill.source import FtmsTreadmill
from kinegraph.devices.fitness_treadmill.targets import targets_of
from kinegraph.devices.frames.packet_decoder import Framing
from kinegraph.devices.frames.simulator import BinaryModel, notifying
from kinegraph.devices.frames.source import Binary
from kinegraph.devices.ganglion.protocol import UV, impedance_ohm
from kinegraph.devices.ganglion.simulator import GanglionBoard
from kinegraph.devices.ganglion.source import Ganglion
from kinegraph.devices.heart_rate.source import HeartRate
from kinegraph.devices.lines.source import AsciiLines
from kinegraph.devices.polar import protocol as polar_pmd
from kinegraph.devices.polar.simulator import BEAT_S, ECG_FRAME, PolarBelt
from kinegraph.devices.polar.source import Polar
from kinegraph.devices.simulation.fault_injection import FaultInjection
from kinegraph.devices.transport.ble_link import BleLink
from kinegraph.devices.transport.ble_radio import uuid
from kinegraph.devices.transport.transport import connect
from kinegraph.stream.domain.impedance import LoneFeed
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.graph.reading.load import load, load_text
from tests.support.device_feed import Kept, check, reading, wait_for

pytest.importorskip("bleak")


def until(feed: Kept, true: Callable[[], bool]) -> None:
    """Wait for it, or for the source to fail."""
    wait_for(lambda: feed.error is not None or true())
    assert feed.error is None, feed.error


def whole(feed: Kept) -> np.ndarray:
    """The electrocardiogram's sample numbers, of which it tells the last three digits."""
    return np.asarray(feed.data("ecg")[:, 0] % 1000).astype(int)


@pytest.mark.parametrize("compressed", [False, True])
def test_a_polar_belt(compressed: bool) -> None:
    source = Polar(acceleration_hz=200, range_g=4)
    with radio() as air:
        belt = PolarBelt(compressed=compressed)
        air.put(belt)
        with reading(source) as feed:
            until(
                feed, lambda: feed.count("ecg") > 250 and feed.count("acceleration") > 200 and feed.count("beats") > 1
            )
            assert set(belt.running) == {polar_pmd.ECG, polar_pmd.ACC}
        assert not belt.running and not belt.host, "it is stopped, and let go"
    check(source, feed)
    n = feed.count("ecg")
    assert whole(feed).tolist() == (np.arange(n) % 1000).tolist()
    moved = feed.data("acceleration") * 1000
    assert np.allclose(moved, belt.acceleration(np.arange(len(moved))))
    assert np.median(np.diff(feed.time("ecg"))) == pytest.approx(1e9 / 130, rel=1e-3)
    assert np.allclose(feed.data("beats"), BEAT_S, atol=1e-3) and feed.data("rate")[0, 0] == 71
    assert feed.identity["serial" if "serial" in feed.identity else "maker"] == "Polar" and not feed.problems


def test_frames_lost_on_the_air_are_counted() -> None:
    with radio() as air:
        air.put(PolarBelt(), faults=FaultInjection(lose=0.3, seed=5))
        with reading(Polar(heart=False)) as feed:
            until(feed, lambda: feed.count("ecg") > 9 * ECG_FRAME)
    lost, number = feed.lost("ecg"), whole(feed)
    first = int(number[0])
    assert lost and set(lost.values()) <= {k * ECG_FRAME for k in range(1, 9)}
    reported = first + np.cumsum([lost.get(i, 0) + (i > 0) for i in range(len(number))])
    assert (reported % 1000 == number).all()
    assert feed.problems["lost sample"] == sum(lost.values())


def test_a_belt_out_of_reach_is_told_and_found_again() -> None:
    with radio() as air:
        belt = PolarBelt()
        here = air.put(belt)
        with reading(Polar(scan_s=0.3)) as feed:
            until(feed, lambda: feed.count("ecg") > 0)
            here.in_reach = False
            wait_for(lambda: feed.error is not None)
        assert "has disconnected: out of reach, or switched off" in str(feed.error)
        with reading(Polar(scan_s=0.2)) as feed:
            wait_for(lambda: feed.error is not None)
        assert "does not advertise within 0.2 s" in str(feed.error)
        here.in_reach = True
        with reading(Polar()) as feed:
            until(feed, lambda: feed.count("ecg") > 0)
        assert not belt.running


def test_a_measurement_that_another_program_left_running_is_begun_again() -> None:
    with radio() as air:
        belt = PolarBelt()
        belt.receive(polar_pmd.CONTROL, polar_pmd.start(polar_pmd.ECG, rate=130, resolution=14))
        air.put(belt)
        with reading(Polar(heart=False)) as feed:
            until(feed, lambda: feed.count("ecg") > 0)


@pytest.mark.parametrize(
    ("status", "message"), [(10, "an MTU of 230 is needed"), (13, "it is being charged"), (77, "error 77")]
)
def test_a_belt_that_refuses_says_why(status: int, message: str) -> None:
    with radio() as air:
        air.put(PolarBelt(refuses=status))
        with reading(Polar()) as feed:
            wait_for(lambda: feed.error is not None)
    assert message in str(feed.error)


def test_packets_too_small_for_a_frame_are_counted_and_never_read_as_others() -> None:
    with radio() as air:
        air.put(PolarBelt(), mtu=185)
        with reading(Polar(acceleration_hz=200, heart=False)) as feed:
            until(feed, lambda: feed.problems["cut frame"] > 3)
    assert feed.identity["mtu"] == 185 and not feed.count("acceleration")


def test_the_belts_clock_set_is_a_restart_and_not_a_jump_of_the_stamps() -> None:
    with radio() as air:
        belt = PolarBelt()
        air.put(belt)
        with reading(Polar(heart=False)) as feed:
            until(feed, lambda: feed.count("ecg") > 2 * ECG_FRAME)
            belt.ahead_ns = 3600 * 10**9
            until(feed, lambda: bool(feed.problems["device restarted"]))
            assert feed.time("ecg")[-1] <= feed.now()


def test_any_belt_by_its_service() -> None:
    with radio() as air:
        air.put(FtmsBelt())
        air.put(PolarBelt())
        with reading(HeartRate()) as feed:
            until(feed, lambda: feed.count("beats") > 2)
    check(HeartRate(), feed)
    assert np.isnan(feed.data("rate")[:, 1]).all() and feed.identity["name"] == "Polar H10 12345678 (C0:FF:EE:00:00:01)"


@pytest.mark.parametrize("mode", movella_dot.MODES)
def test_a_dot_whose_time_runs_over(mode: movella_dot.Mode) -> None:
    source = MovellaDot(mode=mode, rate_hz=120)
    with radio() as air:
        sensor = DotSensor(zero_us=(1 << 32) - 100_000)
        air.put(sensor)
        with reading(source) as feed:
            until(feed, lambda: feed.count("out") > 30)
        assert sensor.running is None
    check(source, feed)
    wanted = np.stack([sensor.values(movella_dot.MODES[mode], i) for i in range(feed.count("out"))])
    assert np.allclose(feed.data("out"), wanted, atol=2e-4)
    assert not feed.lost("out") and not feed.problems


def test_dot_packets_lost_are_known_from_its_time() -> None:
    with radio() as air:
        air.put(DotSensor(), faults=FaultInjection(lose=0.05, seed=3))
        with reading(MovellaDot(rate_hz=120)) as feed:
            until(feed, lambda: feed.count("out") > 200)
    number, lost = (8 * feed.data("out")[:, 0]).astype(int), feed.lost("out")
    assert {i: int(step) - 1 for i, step in enumerate(np.diff(number), 1) if step > 1} == lost and lost


@pytest.mark.parametrize(("firmware", "off"), [(2, 2), (3, 128)])
def test_a_ganglion(firmware: int, off: int) -> None:
    source = Ganglion(acceleration=True)
    with radio() as air:
        board = GanglionBoard(firmware)
        air.put(board)
        with reading(source) as feed:
            until(feed, lambda: feed.count("out") > 450)
        assert not board.running
    check(source, feed)
    counts = feed.data("out") / UV
    assert (np.abs(counts - board.counts(np.arange(len(counts)))) < off).all() and not feed.problems
    assert firmware == 2 or feed.count("acceleration") > 10


def test_a_ganglion_that_sends_differences_is_believed_again_from_the_next_whole_packet() -> None:
    with radio() as air:
        board = GanglionBoard(2)
        air.put(board, faults=FaultInjection(lose=0.01, seed=1))
        with reading(Ganglion()) as feed:
            until(feed, lambda: feed.count("out") > 500 and bool(feed.problems["packet without a reference"]))
            until(feed, lambda: bool(feed.lost("out")))
    lost = feed.lost("out")
    index = np.cumsum([lost.get(i, 0) + (i > 0) for i in range(feed.count("out"))])
    reported = feed.data("timing")["counter"][0]
    counts = feed.data("out") / UV
    assert (np.abs(counts - board.counts(index + int(reported))) < 2).all()


def test_a_treadmill_is_read_and_nothing_is_written() -> None:
    with radio() as air:
        belt = FtmsBelt(speed_kmh=5.4)
        air.put(belt)
        with reading(FtmsTreadmill()) as feed:
            until(feed, lambda: feed.count("out") > 2)
    check(FtmsTreadmill(), feed)
    assert np.allclose(feed.data("out")[:, 0], 1.5) and belt.heard == [] and belt.speed_kmh == 5.4


def test_a_treadmill_is_set_within_its_limits_and_stopped_at_the_end() -> None:
    source = FtmsTreadmill(device="Treadmill 7", control=True, max_kmh=6.0)
    with radio() as air:
        belt = FtmsBelt()
        air.put(belt)
        with reading(source) as feed:
            until(feed, lambda: feed.count("out") > 0)
            targets_of("Treadmill 7").set(2, 5.04)
            targets_of("Treadmill 7").set(3, 2.0)
            until(feed, lambda: belt.incline == 2.0)
            assert belt.speed_kmh == 5.0, "in the treadmill's own steps"
            targets_of("Treadmill 7").set(2, 15.0)
            until(feed, lambda: belt.speed_kmh == 6.0)
        assert belt.speed_kmh == 0.0 and belt.heard[-1] == b"\x08\x01"
    assert feed.problems["setting beyond the limits"] == 1


def test_who_is_there_is_told_where_nobody_fits() -> None:
    with radio() as air:
        air.put(DotSensor())
        with reading(HeartRate(scan_s=0.1)) as feed:
            wait_for(lambda: feed.error is not None)
    assert "there are Movella DOT (C0:FF:EE:00:00:00)" in str(feed.error)


def test_a_device_without_the_characteristic_is_told() -> None:
    with radio() as air:
        air.put(DotSensor("Polar H10 fake"))
        with reading(Polar()) as feed:
            wait_for(lambda: feed.error is not None)
    assert "has no characteristic" in str(feed.error)


def test_answers_do_not_hide_what_came_before_them() -> None:
    feed = Kept()
    with radio() as air:
        air.put(PolarBelt())
        with BleLink(feed, "Polar") as link:
            link.subscribe(polar_pmd.CONTROL)
            link.subscribe("2a37")
            link.write(polar_pmd.CONTROL, b"\x01\x02")
            link.write(polar_pmd.CONTROL, b"\x01\x00")
            assert link.answer(polar_pmd.CONTROL, b"\xf0\x01\x00", 2.0)[:3] == b"\xf0\x01\x00"
            assert b"\xf0\x01\x02" in [note.data[:3] for note in link.fetch(0.1)]
            with pytest.raises(DeviceError, match="does not answer"):
                link.answer(polar_pmd.CONTROL, b"\xee", 0.2)


@pytest.mark.parametrize("text", ["2a3", "xyz", "2a37-"])
def test_what_is_no_uuid_is_refused(text: str) -> None:
    with pytest.raises(DeviceError, match="is not a Bluetooth UUID"):
        uuid(text)


def test_a_ganglions_impedances_are_asked_for_before_a_session_and_it_is_told_to_stop() -> None:
    with radio() as air:
        board = GanglionBoard(ohm=(9000, 120_000, 7000, 15_000, 11_000))
        air.put(board)
        rows = [(each.channel, each.pole, each.ohm) for each in Ganglion().impedances(LoneFeed())]
        assert rows[:4] == [("ch1", "+", 9e3), ("ch1", "-", 11e3), ("ch2", "+", 120e3), ("ch2", "-", 11e3)]
        assert len(rows) == 8 and not board.measuring
        with reading(Ganglion()) as feed:
            until(feed, lambda: feed.count("out") > 50)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"\xc9" + b"9000Z\n", (1, 9000.0)), (b"\xcd" + b"0", (5, 0.0)), (b"\xce" + b"5", None), (b"\xc8" + b"5", None),
        (b"\xc9", None), (b"", None), (b"\xc9Z5", None),
    ],
)  # fmt: skip
def test_what_a_ganglion_says_of_an_impedance(data: bytes, expected: tuple[int, float] | None) -> None:
    assert impedance_ohm(data) == expected


@pytest.mark.parametrize("source", [Polar(acceleration_hz=50), HeartRate(), MovellaDot(), Ganglion(), FtmsTreadmill()])
def test_every_one_runs_without_hardware(source: BleSource) -> None:
    device = source.simulated()
    assert device is not None
    with device as there, reading(there) as feed:
        until(feed, lambda: feed.count(source.outputs[0]) > 2)


def test_without_a_radio_the_reason_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    import bleak

    async def nothing(*_: object, **__: object) -> None:
        raise bleak.exc.BleakDBusError("org.freedesktop.DBus.Error.ServiceUnknown", ["org.bluez was not provided"])

    monkeypatch.setattr(bleak.BleakScanner, "find_device_by_filter", nothing)
    with reading(replace(HeartRate(), scan_s=0.1)) as feed:
        wait_for(lambda: feed.error is not None)
    assert "does the system's Bluetooth service run?" in str(feed.error)


def test_a_treadmill_obeys_a_graph(tmp_path: Path) -> None:
    graph = load_text(
        "nodes:\n"
        "  belt: {use: devices.fitness_treadmill.FtmsTreadmill, device: Treadmill 7, control: true, max_kmh: 8}\n"
        "  wish: {use: stream.manual.Value, initial: 1.5, unit: m/s}\n"
        "  set: {use: devices.fitness_treadmill.control.TreadmillControl, device: Treadmill 7, from: {speed: wish}}\n"
    )
    with radio() as air:
        belt = FtmsBelt()
        air.put(belt)
        Session(graph, tmp_path / "session", duration_s=2.0).run()
    assert b"\x02\x1c\x02" in belt.heard, "5.4 km/h"
    assert belt.speed_kmh == 0.0


WIT = Path(__file__).resolve().parents[2] / "configs" / "witmotion_ble.yaml"
CAPTURED = bytes.fromhex("556135ff59ff0a08") + bytes(12)
"""A packet of a WT901BLE67, as far as it is published."""


def wit() -> Binary:
    part = load(WIT).nodes["imu"].part
    assert isinstance(part, Binary)
    return part


def test_witmotion_packets_are_declared_and_a_capture_read() -> None:
    (layout,) = wit().layouts()
    assert layout.size == 20
    values = layout.values(layout.table(CAPTURED))[0]
    assert values[:3] == pytest.approx((-0.0991, -0.0815, 1.0049), abs=5e-5)


@pytest.mark.parametrize("framing", ["none", "packet"])
def test_any_device_that_notifies_is_declared_as_serial_frames_are(framing: Framing) -> None:
    source = replace(wit(), framing=framing)
    model = BinaryModel(source)
    with notifying(source, model), reading(source) as feed:
        until(feed, lambda: feed.count("motion") > 60)
    check(source, feed)
    assert model.heard == bytes.fromhex("FFAA6988B5FFAA030800") and not feed.problems
    source.layouts()


def test_lines_over_bluetooth_are_lines() -> None:
    """A UART over Bluetooth LE (Nordic's, and many others): whatever reads a serial port reads it."""

    class Uart:
        name, advertised = "Uart", ()
        services = {"6e400001-b5a3-f393-e0a9-e50e24dcca9e": {"6e400003-b5a3-f393-e0a9-e50e24dcca9e": ["notify"]}}
        sent = 0

        def connected(self, yes: bool) -> None: ...

        def hold(self, characteristic: str) -> bytes:
            return b""

        def receive(self, characteristic: str, data: bytes) -> list[tuple[str, bytes]]:
            return []

        def say(self, seconds: float) -> list[tuple[str, bytes]]:
            first, self.sent = self.sent, int(seconds * 50)
            text = "".join(f"{i * 20},{i}\r\n" for i in range(first, self.sent)).encode()
            return [("6e400003-b5a3-f393-e0a9-e50e24dcca9e", text[a : a + 7]) for a in range(0, len(text), 7)]

    source = AsciiLines(
        port="ble://Uart/6e400003-b5a3-f393-e0a9-e50e24dcca9e",
        columns=("ms", "emg"),
        time="ms",
        time_unit="ms",
        rate_hz=50,
    )
    with radio() as air:
        air.put(Uart())
        with reading(source) as feed:
            until(feed, lambda: feed.count("out") > 40)
    assert np.diff(feed.data("out")[:, 0]).tolist() == [1] * (feed.count("out") - 1)


@pytest.mark.parametrize("address", ["ble://", "ble://X", "ble://X/2a37/2a38/2a39", "ble://X/2a3"])
def test_an_address_that_is_none(address: str) -> None:
    with pytest.raises(DeviceError):
        connect(address)


def test_nothing_can_be_written_where_no_characteristic_was_named() -> None:
    with radio() as air:
        air.put(PolarBelt())
        with connect("ble://Polar/2a37") as link, pytest.raises(DeviceError, match="names no characteristic"):
            link.write(b"x")
