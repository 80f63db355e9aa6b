"""OAK cameras: the adapter on made-up messages, the source on depthai itself with a camera that is simulated, errors and discovery."""

from __future__ import annotations

import gc
import re
import sys
import threading
import time
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.oak import Oak
from kinegraph.devices.oak.adapter import Frames, ImuPackets, Message
from kinegraph.devices.oak.camera import CameraLink, _depth, lit, opened
from kinegraph.devices.oak.discovery import described
from kinegraph.devices.oak.library import NOT_FOUND, all_cameras, library, not_opened, ns
from kinegraph.devices.oak.simulator import BOOTED_S, HEAD, MAX_BEHIND, RunningScene, SimulatedCamera, SimulatedOak
from kinegraph.devices.oak.simulator import OakSimulator as Simulated
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import DeviceError, GraphError, ParameterError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.support.device_feed import Kept, check, reading, wait_for

needs_depthai = [
    pytest.mark.skipif(find_spec("depthai") is None, reason="depthai is not installed (pip install 'kinegraph[oak]')"),
    pytest.mark.timeout(120, method="thread"),  # whatever depthai may do, the tests end
    pytest.mark.xdist_group("depthai"),
]
SPEC = StreamSpec((4, 6), np.dtype(np.uint16), 30.0, units=("mm",))
NOW = 1_700_000_000 * NS


# the adapter, without depthai ----------------------------------------------------------------------------------------


def message(number: int, value: int = 0, *, host: int | None = None, stride: int = 16, rows: int = 4) -> Message:
    """A frame of 4 x 6 in rows of `stride` bytes; pixel i is 100 + i + value."""
    pixels = np.full((rows, stride), 0xEE, np.uint8)
    pixels[:4, :12] = (100 + value + np.arange(24, dtype=np.uint16)).reshape(4, 6).view(np.uint8)[:rows]
    return Message(number, number * 33_000_000, number * 33_000_000 if host is None else host, 6, pixels)


def test_a_frame_is_copied_once_and_without_its_padding() -> None:
    frames, sent = Frames(SPEC, NOW), message(5)
    taken = frames.take(sent, NOW + 5 * 33_000_000 + 1000)
    assert taken.chunk and not taken.problems
    assert np.array_equal(taken.chunk.data, (100 + np.arange(24)).reshape(1, 4, 6))
    assert taken.chunk.time.tolist() == [NOW + 165_000_000] and taken.chunk.until == NOW + 165_000_000
    sent.rows[:] = 0
    assert taken.chunk.data[0, 0, 0] == 100 and taken.chunk.data.flags.carray

    big = StreamSpec((480, 640), np.dtype(np.uint16), 30.0)
    rows = np.random.default_rng(0).integers(0, 256, (480, 1280), np.uint8)
    frames = Frames(big, NOW)
    frames.take(Message(0, 0, 0, 640, rows), NOW)
    tracemalloc.start()
    frames.take(Message(1, 1, 1, 640, rows), NOW)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1.9 * rows.nbytes, "a second copy was made"


def test_what_is_missing_is_known_from_the_numbers() -> None:
    frames = Frames(SPEC, NOW)
    lost: list[Any] = []
    problems: list[str] = []
    for i, number in enumerate([7, 8, 8, 11, 12, 3, 4]):
        taken = frames.take(message(number, i, host=i * 33_000_000), NOW + i * 33_000_000 + 1000)
        lost.append(taken.chunk.lost if taken.chunk else None)
        problems += taken.problems
    assert lost == [0, 0, None, 2, 0, -1, 0] and problems == ["repeated frame", "counter reset"]
    frames.interrupted()
    taken = frames.take(message(9, 9, host=9 * 33_000_000), NOW + 9 * 33_000_000)
    assert taken.chunk and taken.chunk.lost == -1


@pytest.mark.parametrize(
    "bad", [message(1, rows=0), message(1)._replace(width=9), message(1)._replace(rows=np.empty((0, 0), np.uint8))]
)
def test_a_broken_frame_is_lost_not_an_exception(bad: Message) -> None:
    frames = Frames(SPEC, NOW)
    frames.take(message(0), NOW)
    assert frames.take(bad, NOW + 33_000_000).problems == ["broken frame"]
    taken = frames.take(message(2, 5), NOW + 66_000_000)
    assert taken.chunk and taken.chunk.lost == 1


def test_another_size_is_told_with_what_to_write() -> None:
    with pytest.raises(DeviceError, match=r"frames of 6 x 5.*says 6 x 4; write width: 6 and height: 5"):
        Frames(SPEC, NOW).take(message(0, rows=5), NOW)


def test_stamps_never_run_backwards_and_are_never_absurd() -> None:
    frames = Frames(SPEC, NOW, latency_ns=2_000_000)
    hosts = [0, 33_000_000, 20_000_000, 10**15, -(10**15), 99_000_000]
    stamps, problems = [], []
    for i, host in enumerate(hosts):
        taken = frames.take(message(i, i, host=host), NOW + i * 33_000_000 + 1000)
        assert taken.chunk
        stamps.append(int(taken.chunk.time[0]) - NOW)
        problems += taken.problems
    assert stamps[:2] == [-2_000_000, 31_000_000] and (np.diff(stamps) > 0).all()
    assert stamps[3] == 3 * 33_000_000 + 1000 - 2_000_000 and problems == ["wrong time"] * 2


def test_a_frozen_picture_and_one_without_depth_are_counted() -> None:
    frames = Frames(SPEC, NOW)
    rows = [frames.take(message(i, value), NOW + i * 33_000_000).problems for i, value in enumerate([1, 1, 2])]
    blind = message(3)._replace(rows=np.zeros((4, 16), np.uint8))
    assert [*rows, frames.take(blind, NOW + 99_000_000).problems] == [[], ["frozen frame"], [], ["frame without depth"]]


def test_inertial_packets() -> None:
    from datetime import timedelta

    def packet(k: int) -> Any:
        at = timedelta(milliseconds=10 * k)
        a = SimpleNamespace(x=k, y=k + 0.5, z=9.8, getTimestamp=lambda: at, getTimestampDevice=lambda: at)
        return SimpleNamespace(acceleroMeter=a, gyroscope=SimpleNamespace(x=0.1, y=0.2, z=0.3))

    motion = ImuPackets(100.0, NOW)
    chunks = motion.take([packet(k) for k in (0, 1, 2, 5, 6)], NOW + 60_000_000)
    assert [(len(c), c.lost) for c in chunks] == [(3, 0), (2, 2)]
    assert chunks[1].data[0].tolist() == [5, 5.5, 9.8, 0.1, 0.2, 0.3]
    assert chunks[1].time.tolist() == [NOW + 50_000_000, NOW + 60_000_000]
    motion.interrupted()
    assert [c.lost for c in motion.take([packet(9), packet(10)], NOW + 10**8)] == [-1]


# what can be known without a camera ----------------------------------------------------------------------------------


def test_a_simulated_camera_on_a_busy_computer_slows_its_clock_and_loses_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [100.0]
    monkeypatch.setattr("kinegraph.devices.oak.simulator.time.monotonic", lambda: now[0])
    camera = SimulatedCamera(Simulated(width=16, height=16, fps=30.0), GOOD)
    camera.began = now[0]
    scene, numbers = RunningScene(None, camera, CameraLink()), list[int]()
    for late_s in (0.1, 0.03, 5.0, 0.03, 0.03, 2.0, 0.03):
        now[0] += late_s
        due = scene._due(camera.caught_up(scene._said))
        assert len(due) <= MAX_BEHIND + 2
        numbers += [HEAD.unpack_from(packet)[0] for packet in due]
    assert numbers == list(range(len(numbers))) and len(numbers) > 15


def test_specs_and_outputs_hang_on_the_parameters() -> None:
    assert Oak().outputs == ("depth", "timing") == tuple(Oak().specs())
    specs = Oak(imu_hz=200.0, depth="tof", height=480, preset="mid_range", fps=20.0).specs()
    assert specs["depth"].shape == (480, 640) and specs["depth"].rate_hz == 20.0 and specs["imu"].rate_hz == 200.0
    assert Oak(imu_hz=200.0).outputs == ("depth", "imu", "timing")
    with pytest.raises(ParameterError, match="preset is 'mid_range'; it must be one of default"):
        Oak(preset="mid_range").specs()


def test_without_the_library_it_is_said_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "depthai", None)
    with pytest.raises(DeviceError, match=r"pip install 'kinegraph\[oak\]'"), reading(Oak()) as feed:
        wait_for(lambda: feed.error is not None)
        assert feed.error
        raise feed.error


def fake(*cameras: SimpleNamespace) -> Any:
    """depthai, as far as it lists cameras."""
    xlink = SimpleNamespace(getAllConnectedDevices=lambda state, skip: list(cameras))
    errors = SimpleNamespace(X_LINK_INSUFFICIENT_PERMISSIONS="denied", X_LINK_SUCCESS="fine")
    return SimpleNamespace(
        XLinkConnection=xlink, XLinkError_t=errors, XLinkDeviceState=SimpleNamespace(X_LINK_ANY_STATE=0)
    )


def camera(**differing: Any) -> SimpleNamespace:
    named = {
        name: SimpleNamespace(name=f"X_LINK_{value}")
        for name, value in (("platform", "MYRIAD_X"), ("protocol", "USB_VSC"), ("state", "UNBOOTED"))
    }
    return SimpleNamespace(**{"deviceId": "14442C10D13EABCE00", "name": "1.2", "status": "fine", **named, **differing})


def test_errors_say_what_to_do() -> None:
    assert str(not_opened(fake(), "", RuntimeError("x"))) == NOT_FOUND
    denied = str(not_opened(fake(camera(status="denied")), "", RuntimeError("x")))
    assert "permission denied" in denied and 'ATTR{idVendor}=="03e7"' in denied and "udevadm" in denied
    elsewhere = str(not_opened(fake(camera()), "192.168.1.40", RuntimeError("x")))
    assert "no OAK camera '192.168.1.40'" in elsewhere and "14442C10D13EABCE00" in elsewhere
    taken = str(not_opened(fake(camera()), "14442C10D13EABCE00", RuntimeError("X_LINK_DEVICE_ALREADY_IN_USE")))
    assert "X_LINK_DEVICE_ALREADY_IN_USE" in taken and "another program" in taken


@pytest.mark.parametrize("device", ["", "14442C10D13EABCE01"])
def test_depthai_is_not_asked_for_a_camera_that_is_not_there(device: str) -> None:
    """It would look for ten seconds, and a session that ended meanwhile with it, by std::terminate."""
    dai = fake(*([camera()] if device else []))  # without `Device`: asking for it is an AttributeError
    with pytest.raises(DeviceError, match="no OAK camera"), opened(dai, Oak(device=device), CameraLink()):
        pass


def test_cameras_are_listed_with_the_yaml_to_use_them() -> None:
    found = described(fake(), camera())
    assert (found.kind, found.address, found.note) == ("oak", "14442C10D13EABCE00", "")
    assert found.what == "Luxonis OAK (MYRIAD_X, USB 1.2, unbooted)"
    graph = load_text("nodes:\n  camera:\n" + "\n".join(f"    {line}" for line in found.yaml.splitlines()))
    assert graph.nodes["camera"].part == Oak(device="14442C10D13EABCE00")
    assert "udevadm" in described(fake(), camera(status="denied")).note
    network = camera(
        protocol=SimpleNamespace(name="X_LINK_TCP_IP"), name="10.0.0.7", state=SimpleNamespace(name="X_LINK_BOOTED")
    )
    assert (
        "network 10.0.0.7" in described(fake(), network).what and "another program" in described(fake(), network).note
    )


class Lights:
    """A device of depthai, as far as it has lights."""

    def __init__(self, projector: bool, flood: bool) -> None:
        self.has, self.set = (projector, flood), [0.0, 0.0]

    def setIrLaserDotProjectorIntensity(self, intensity: float) -> bool:
        self.set[0] = intensity
        return self.has[0]

    def setIrFloodLightIntensity(self, intensity: float) -> bool:
        self.set[1] = intensity
        return self.has[1]


def test_projector_and_flood_light_are_set_as_asked_for_and_missing_ones_are_named() -> None:
    pro, plain = Lights(True, True), Lights(False, False)
    assert lit(pro, 0.8, 0.0) == [] and pro.set == [0.8, 0.0]
    assert lit(pro, 0.5, 0.25) == [] and pro.set == [0.5, 0.25]
    assert lit(plain, 0.0, 0.0) == [] and lit(plain, 0.8, 0.2) == ["dot projector", "flood light"]


@pytest.mark.parametrize("intensity", [-0.1, 1.1])
def test_an_intensity_is_a_share(intensity: float) -> None:
    with pytest.raises(GraphError, match="projector"):
        load_text(f"nodes:\n  camera: {{use: devices.oak.Oak, projector: {intensity}}}\n")


# depthai itself, with a camera that is simulated ---------------------------------------------------------------------

SMALL = Oak(width=160, height=100)


@contextmanager
def plugged_in(
    of: Oak = SMALL, faults: FaultInjection = GOOD, **more: Any
) -> Iterator[tuple[SimulatedOak, SimulatedCamera]]:
    device = Simulated(width=of.width, height=of.height, fps=of.fps, imu_hz=of.imu_hz, **more)
    with device.plugged_in(faults) as simulated:
        yield SimulatedOak.of(of, simulated), simulated


def shown(feed: Kept, simulated: SimulatedCamera) -> None:
    """Every frame is, bit by bit, what the camera saw at the time that its own clock gives."""
    fps = simulated.of.fps
    for frame, event in zip(feed.data("depth"), feed.data("timing"), strict=True):
        index = round((int(event["device"]) / NS - BOOTED_S) * fps)
        assert np.array_equal(frame, simulated.sleeper.frame(index, index / fps)), event


class TestWithDepthai:
    pytestmark = needs_depthai

    def test_frames_come_through_bit_by_bit(self) -> None:
        with plugged_in(replace(SMALL, imu_hz=100.0)) as (source, simulated):
            with reading(source) as feed:
                wait_for(lambda: feed.count("depth") >= 20 and feed.count("imu") >= 50)
            check(source, feed)
            shown(feed, simulated)
        assert feed.error is None
        timing = feed.data("timing")
        step = np.diff(timing["stamp"]) - np.diff(timing["counter"]) * NS / 30
        assert abs(step).max() < 3000, "stamps keep the camera's pace to the microsecond"
        assert (timing["arrival"] > timing["stamp"]).all() and np.array_equal(feed.time("timing"), feed.time("depth"))
        assert feed.data("imu")[:, 2].mean() == pytest.approx(9.81, abs=0.02)

    def test_lost_and_repeated_frames_are_counted(self) -> None:
        with plugged_in(faults=FaultInjection(lose=0.2, duplicate=0.2, seed=1)) as (source, simulated):
            with reading(source) as feed:
                wait_for(lambda: feed.count("depth") >= 60)
            shown(feed, simulated)
        timing, lost = feed.data("timing"), feed.lost("depth")
        gaps = np.diff(timing["counter"]) - 1
        assert {i + 1: int(n) for i, n in enumerate(gaps) if n} == lost
        assert 5 < sum(lost.values()) == feed.problems["lost frame"] and feed.problems["repeated frame"] > 3

    def test_frozen_and_blind_pictures_are_counted(self) -> None:
        with (
            plugged_in(freeze_every_s=1.0, freeze_s=0.4, blind_every_s=1.7, blind_s=0.3) as (source, _),
            reading(source) as feed,
        ):
            wait_for(lambda: feed.count("depth") >= 75)
        assert feed.problems["frozen frame"] >= 8 and feed.problems["frame without depth"] >= 5
        blind = (feed.data("depth") == 0).all(axis=(1, 2))
        assert blind.sum() == feed.problems["frame without depth"] and not feed.lost("depth")

    def test_unplugged_for_a_moment_depthai_connects_again(self) -> None:
        with plugged_in() as (source, simulated):
            with reading(source) as feed:
                for turn in range(1, 4):
                    before = feed.count("depth")
                    wait_for(lambda before=before: feed.count("depth") >= before + 5)
                    simulated.unplug()
                    wait_for(lambda turn=turn: feed.problems["connection lost"] == turn)
                    simulated.plug()
                before = feed.count("depth")
                wait_for(lambda: feed.count("depth") >= before + 5)
            assert simulated.times_lit == 4, "when the pipeline had started, and after each of three reconnections"
            check(source, feed)
            shown(feed, simulated)
        assert feed.error is None and list(feed.lost("depth").values()) == [-1] * 3

    def test_unplugged_for_long_it_is_given_up(self) -> None:
        with plugged_in(replace(SMALL, reconnect_s=0.5)) as (source, simulated):
            with reading(source) as feed:
                wait_for(lambda: feed.count("depth") >= 5)
                simulated.unplug()
                wait_for(lambda: feed.error is not None)
            assert isinstance(feed.error, DeviceError) and "has not come back within 0.5 s" in str(feed.error)
            with reading(source) as feed:
                wait_for(lambda: feed.error is not None)
            assert str(feed.error) == NOT_FOUND
            simulated.plug()
            with reading(source) as feed:
                wait_for(lambda: feed.count("depth") >= 5)
            shown(feed, simulated)

    def test_silent_though_connected_it_is_given_up(self) -> None:
        stalls = FaultInjection(stall_every_s=1.0, stall_s=0.9)
        with plugged_in(replace(SMALL, lost_after_s=0.3), stalls) as (source, _), reading(source) as feed:
            wait_for(lambda: feed.error is not None)
        assert "no frame from the OAK camera for 0.3 s, though it is connected" in str(feed.error)

    def test_a_camera_of_another_size_is_refused(self) -> None:
        with plugged_in() as (source, _), reading(replace(source, height=200)) as feed:
            wait_for(lambda: feed.error is not None)
        assert "write width: 160 and height: 100" in str(feed.error)

    def test_opened_twenty_times_nothing_is_left(self) -> None:
        def usage() -> tuple[int, int]:
            gc.collect()
            return threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))

        with plugged_in() as (source, _):
            for turn in range(20):
                with reading(source) as feed:
                    wait_for(lambda feed=feed: feed.count("depth") >= 2)
                if turn == 2:
                    before = usage()
            assert usage() == before

    def test_the_room_is_seen_empty_however_late_the_camera_is_opened(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Kernels compile for a minute after the camera was plugged in: the performer must not be there already."""
        clock = time.monotonic
        with plugged_in(image="mono") as (source, simulated):
            monkeypatch.setattr("kinegraph.devices.oak.simulator.time.monotonic", lambda: clock() + 60.0)
            with reading(source) as feed:
                wait_for(lambda: feed.count("depth") >= 3)
            room = simulated.performer.frame(0, 0.0)
            assert (
                np.abs(feed.data("depth")[0].astype(int) - room)[(room > 0) & (feed.data("depth")[0] > 0)].max() < 200
            )

    def test_a_session_goes_on_after_the_camera_was_gone(self, tmp_path: Path) -> None:
        graph = load_text(
            "record: [level]\n"
            "nodes:\n"
            "  camera: {use: devices.oak.Oak, width: 160, height: 100, reconnect_s: 0.3}\n"
            "  level: {use: operators.bed.frames.region.RegionDepth, from: camera.depth}\n"
        )
        with plugged_in(graph.nodes["camera"].part) as (source, simulated):  # type: ignore[arg-type]
            graph.nodes["camera"].part = source
            session = Session(graph, tmp_path / "s")
            outcome: list[Any] = []
            thread = threading.Thread(target=lambda: outcome.append(session.run()), daemon=True)
            thread.start()
            wait_for(lambda: session.table.get("camera.depth", {}).get("samples", 0) > 10)
            simulated.unplug()
            wait_for(lambda: "OAK camera" in str(session.table))
            before = session.table["camera.depth"]["samples"]
            simulated.plug()
            wait_for(lambda: session.table["camera.depth"]["samples"] > before + 10)
            session.stop()
            thread.join(20)
        assert outcome and outcome[0].exit_code == 0 and not outcome[0].compiled
        with Recording.open(tmp_path / "s") as recording:
            stream = recording.streams["camera.depth"]
            assert stream.kept == "outline" and stream.samples == recording.streams["level"].samples > 20
            assert [c.lost for c in recording.chunks("level") if c.lost < 0] == [-1]
            kinds = [entry["kind"] for entry in recording.log]
            assert "source failed" in kinds and "source reopened" in kinds
            level = recording.read("level")[1]
            assert (abs(level[:, 0] - 2400) < 100).all() and (abs(level[:, 1] - 0.9) < 0.02).all()

    @pytest.mark.parametrize(
        "asked", [Oak(), Oak(preset="density"), Oak(depth="tof"), Oak(depth="tof", preset="mid_range")]
    )
    def test_the_depth_node_is_built_as_depthai_declares_it(self, asked: Oak) -> None:
        """A node of a camera can be made only with one; so what is asked of it is held against depthai's own signatures."""
        dai, calls = library(), []

        def create(node: Any) -> Any:
            return SimpleNamespace(build=lambda **given: calls.append((node.build.__doc__, given)))

        _depth(dai, SimpleNamespace(create=create), asked)
        ((text, given),) = calls
        overloads = re.findall(r"build\(self: [\w.]+, (.*)\) -> depthai", text)
        taken = [{part.split(":")[0] for part in re.split(r", (?=\w+:)", one)} for one in overloads]
        assert any(set(given) <= names for names in taken), (sorted(given), taken)

    @pytest.mark.parametrize(
        "method", ["setIrLaserDotProjectorIntensity", "setIrFloodLightIntensity"], ids=["projector", "flood"]
    )
    def test_lights_are_set_as_depthai_declares_it(self, method: str) -> None:
        declared = getattr(library().Device, method).__doc__
        assert f"{method}(self: depthai.DeviceBase, intensity: float, mask: int = -1) -> bool" in declared
        words = " ".join(declared.split())
        assert "Intensity on range 0 to 1" in words and "The emitter is turned off by default" in words
        assert "True on success, false if not found" in words

    def test_the_library_keeps_to_itself(self) -> None:
        """No report of its use goes out, and no crash dump is kept, unless the user's environment says so."""
        import os

        dai = library()
        assert os.environ["DEPTHAI_TELEMETRY"] == "0" and os.environ["DEPTHAI_DISABLE_CRASHDUMP_COLLECTION"] == "1"
        assert all_cameras(dai) == [] or ns(dai.Clock.now()) > 0
