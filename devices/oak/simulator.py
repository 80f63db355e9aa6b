"""A simulated OAK camera over a bed: depthai itself, with a pipeline that runs on this computer alone and shows a sleeper.

It lives in the process that reads it. For other software it writes depthai's own recording (`record=FILE.mcap`), which any program of
depthai's can play.
"""

from __future__ import annotations

import math
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, fields, replace
from datetime import timedelta
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.oak.camera import QUEUE, Camera, CameraLink
from kinegraph.devices.oak.library import NOT_FOUND, library
from kinegraph.devices.oak.network import located
from kinegraph.devices.oak.simulated_keypoints import KeypointSight
from kinegraph.devices.oak.source import Oak as OakSource
from kinegraph.devices.people.rendered_performer import RenderedPerformer
from kinegraph.devices.people.sleeper import Sleeper
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection, FaultInjector
from kinegraph.devices.simulation.serve import Simulator
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param

HEAD = struct.Struct("<qq")
"""A packet, as misbehaviour spoils it: number, time on this computer (us); then the frame's bytes."""
TICK_S = 0.005
MAX_BEHIND = QUEUE // 2
"""Where the computer is too slow, the camera's clock is set back to this many frames: a fault is what was asked for, and nothing else."""
BOOTED_S, DRIFT = 3.25, 20e-6
"""The camera's own clock: when it started, and by how much it is fast."""
GRAVITY = 9.81
MOVING_S = 5.0
"""By then somebody moves before the camera."""


@dataclass(frozen=True, slots=True)
class OakSimulator(Simulator):
    """An OAK depth camera above a bed with a sleeper in it (Luxonis, through depthai itself).

    With `image` or `network` it stands before a person who walks on the spot and moves the arms, rendered in depth and grey (colour: grey
    three times). With `network` it gives what a pose network would: key points of that person in the image, a little off, as
    depthai's detections; depthai's own nodes put them in space.

    Besides what goes wrong with every device, the picture may freeze (the same frame under new numbers), or be blind (no pixel valid).
    After the camera was unplugged its frames are numbered from 0 again. A fault that changes a byte mostly changes a pixel.
    """

    width: int = param(640, least=16, help="pixels in a row")
    height: int = param(400, least=16, help="rows")
    fps: float = param(30.0, above=0, most=240, help="frames per second")
    imu_hz: float = param(0.0, least=0, most=1000, help="inertial packets per second; 0: off")
    image: str = param("", help="mono or colour: images beside the depth, of someone who moves before the camera")
    people: int = param(1, least=1, most=2, help="how many people move before it; of two the first has key points")
    network: bool = param(False, help="key points, as of a pose network on the camera, of someone who moves before it")
    seed: int = param(0, least=0, help="another seed, another night")
    per_min: float = param(1.5, least=0, help="movements per minute, on average")
    invalid: float = param(0.1, least=0, most=1, help="share of pixels without a measurement")
    freeze_every_s: float = param(0.0, least=0, help="how often the picture freezes; 0: never")
    freeze_s: float = param(1.0, above=0, help="for how long")
    blind_every_s: float = param(0.0, least=0, help="how often no pixel is valid; 0: never")
    blind_s: float = param(1.0, above=0, help="for how long")
    record: str = param("", help="write depthai's own recording into this file, FILE.mcap")

    @property
    def shows_someone(self) -> bool:
        """Whether somebody stands before it; else somebody sleeps below it."""
        return bool(self.image) or self.network

    @property
    def cannot(self) -> dict[str, str]:
        return {"reset_every_s": "its frames are numbered again from 0 whenever it was unplugged, and only then"}

    @contextmanager
    def serving(self, faults: FaultInjection = GOOD, address: str = "") -> Iterator[str]:
        if address:
            raise DeviceError(f"a simulated OAK camera has no address such as {address!r}")
        if not self.record:
            raise DeviceError(
                "a simulated OAK camera lives in the process that reads it: kinegraph run CONFIG --simulate; "
                "or let it write a recording that depthai plays, with record=FILE.mcap"
            )
        with self.plugged_in(faults) as camera, camera.recording(Path(self.record)):
            yield self.record

    @contextmanager
    def plugged_in(self, faults: FaultInjection = GOOD) -> Iterator[SimulatedCamera]:
        """A camera that can be opened, and unplugged, while the context lasts."""
        camera = SimulatedCamera(self, faults)
        try:
            yield camera
        finally:
            camera.unplug()


class SimulatedCamera:
    """The camera at the end of its cable. What it sees begins when it is opened first, and goes on between openings.

    So a room that is empty at first is seen empty, however long the session took to get ready.
    """

    def __init__(self, of: OakSimulator, faults: FaultInjection) -> None:
        self.of, self.injector = of, FaultInjector(faults)
        self.performer = RenderedPerformer(of.width, of.height, seed=of.seed, people=of.people)
        self.sleeper = Sleeper(of.width, of.height, seed=of.seed, per_min=of.per_min, invalid=of.invalid)
        self.began = math.nan
        self._freeze = FaultInjector(FaultInjection(stall_every_s=of.freeze_every_s, stall_s=of.freeze_s))
        self._blind = FaultInjector(FaultInjection(stall_every_s=of.blind_every_s, stall_s=of.blind_s))
        self._pulled = threading.Event()
        self.times_lit = 0

    def unplug(self) -> None:
        """Pull the cable out."""
        self._pulled.set()

    def plug(self) -> None:
        """Put it in again."""
        self._pulled.clear()

    def out(self) -> bool:
        """Whether the cable is out."""
        return self._pulled.is_set() or self.injector.unplugged(self.since())

    def since(self) -> float:
        """How long ago it was opened first (s)."""
        return 0.0 if math.isnan(self.began) else time.monotonic() - self.began

    def caught_up(self, frames: int) -> float:
        """How long ago it was opened first (s), by a clock that is slower while `frames` were sent and the computer does not keep up."""
        late = self.since() * self.of.fps - frames - MAX_BEHIND
        if late >= 1.0 and frames > 0:
            self.began += int(late) / self.of.fps
        return self.since()

    @contextmanager
    def opened(self, dai: Any, link: CameraLink) -> Iterator[Camera]:
        """As a real camera is opened. Raises DeviceError while the cable is out."""
        self._begin()
        if self.out():
            raise DeviceError(NOT_FOUND)
        with dai.Pipeline(createImplicitDevice=False) as pipeline:
            node = self._node(dai, pipeline, link)
            depth = node.depth.createOutputQueue(maxSize=QUEUE, blocking=False)
            imu = node.imu.createOutputQueue(maxSize=16 * QUEUE, blocking=False) if self.of.imu_hz else None
            image = node.image.createOutputQueue(maxSize=QUEUE, blocking=False) if self.of.image else None
            keypoints = (
                located(dai, pipeline, OakSource(width=self.of.width, fps=self.of.fps), node.depth, node.sight)
                if self.of.network
                else None
            )
            pipeline.start()
            yield Camera(
                depth,
                imu,
                image,
                keypoints,
                {"id": "simulated", "model": "OAK without hardware", "depthai": dai.__version__},
                self.light,
            )

    def _begin(self) -> None:
        if math.isnan(self.began):
            self.began = time.monotonic()

    def light(self) -> list[str]:
        """The lights are set; how often is counted."""
        self.times_lit += 1
        return []

    @contextmanager
    def recording(self, path: Path) -> Iterator[None]:
        """Within: depthai records what the camera shows."""
        self._begin()
        dai = library()
        with dai.Pipeline(createImplicitDevice=False) as pipeline:
            recorder = pipeline.create(dai.node.RecordMessage)
            recorder.setRecordFile(str(path))
            self._node(dai, pipeline, CameraLink()).depth.link(recorder.input)
            pipeline.start()
            yield

    def _node(self, dai: Any, pipeline: Any, link: CameraLink) -> Any:
        node = pipeline.create(_node_class())
        node.shown = RunningScene(dai, self, link)
        return node

    def frame(self, index: int, seconds: float) -> np.ndarray:
        """What is seen at a second; frozen or blind when it is due."""
        if self._freeze.stalled(seconds):
            index = int((seconds - seconds % self.of.freeze_every_s) * self.of.fps)
            seconds = index / self.of.fps
        frame = (self.performer if self.of.shows_someone else self.sleeper).frame(index, seconds)
        return np.zeros_like(frame) if self._blind.stalled(seconds) else frame


class RunningScene:
    """One opening of the camera: what is sent as time passes."""

    def __init__(self, dai: Any, camera: SimulatedCamera, link: CameraLink) -> None:
        self._dai, self._camera, self._link = dai, camera, link
        self._zero_us = round(camera.began * 1e6)
        self._gone = False
        self._kept: list[bytes] = []
        self._sees = KeypointSight(camera.of.width, camera.of.height, camera.of.seed)
        self._begin()

    def _begin(self) -> None:
        """Nothing of what was before is sent, and numbers start again."""
        now = self._camera.since()
        self._first = self._said = int(now * self._camera.of.fps) + 1
        self._moved = int(now * self._camera.of.imu_hz)
        self._kept.clear()

    def step(self, node: Any) -> None:
        """Send what is due by now."""
        camera = self._camera
        if camera.out() != self._gone:
            self._gone = not self._gone
            self._report_state("DISCONNECTED" if self._gone else "RUNNING")
            if self._gone:
                self._report_state("RECONNECTING")
            self._begin()
        if self._gone:
            return
        seconds = camera.caught_up(self._said)
        for packet in self._due(seconds):
            message = self._message(packet)
            if camera.of.image and message.getSequenceNum() >= 0:
                node.image.send(self._image(message.getSequenceNum()))
            if camera.of.network and message.getSequenceNum() >= 0:
                node.sight.send(self._sight(message))
            node.depth.send(message)
        if camera.of.imu_hz:
            self._send_motion(node, seconds)

    def _report_state(self, state: str) -> None:
        self._link.tell(None, self._dai.DeviceState.__members__[state])

    def _due(self, seconds: float) -> list[bytes]:
        camera, fps = self._camera, self._camera.of.fps
        due = int(seconds * fps)
        first, self._said = self._said, max(self._said, due + 1)
        packets = [
            HEAD.pack(k - self._first, self._zero_us + round(k / fps * 1e6)) + camera.frame(k, k / fps).tobytes()
            for k in range(first, due + 1)
        ]
        packets = camera.injector.spoil(packets, seconds)
        if camera.injector.stalled(seconds):
            self._kept += packets
            return []
        kept, self._kept = self._kept, []
        return [*kept, *packets]

    def _message(self, packet: bytes) -> Any:
        of, number, host_us = self._camera.of, *HEAD.unpack_from(packet)
        message = self._dai.ImgFrame()
        message.setData(np.frombuffer(packet, np.uint8, offset=HEAD.size))
        message.setType(self._dai.ImgFrame.Type.RAW16)
        message.setWidth(of.width)
        message.setHeight(of.height)
        message.setStride(2 * of.width)
        message.setSequenceNum(number)
        message.setTimestamp(timedelta(microseconds=host_us))
        message.setTimestampDevice(timedelta(microseconds=self._by_camera(host_us)))
        if of.network:
            message.setTransformation(self._sees.lens(self._dai))
        return message

    def _sight(self, frame: Any) -> Any:
        """What the network sees in the image of a depth frame's moment."""
        k = self._first + frame.getSequenceNum()
        message = self._sees.message(self._dai, k, k / self._camera.of.fps)
        message.setSequenceNum(frame.getSequenceNum())
        message.setTimestamp(frame.getTimestamp())
        message.setTimestampDevice(frame.getTimestampDevice())
        return message

    def _image(self, number: int) -> Any:
        """The image that belongs to the depth frame of this number."""
        of, k = self._camera.of, self._first + number
        seconds = k / of.fps
        grey = self._camera.performer.image(k, seconds)
        message = self._dai.ImgFrame()
        kind, pixels = ("GRAY8", grey) if of.image == "mono" else ("RGB888i", np.repeat(grey[..., None], 3, 2))
        message.setData(np.ascontiguousarray(pixels).reshape(-1))
        message.setType(self._dai.ImgFrame.Type.__members__[kind])
        message.setWidth(of.width)
        message.setHeight(of.height)
        message.setStride(pixels.nbytes // of.height)
        message.setSequenceNum(number)
        host_us = self._zero_us + round(seconds * 1e6)
        message.setTimestamp(timedelta(microseconds=host_us))
        message.setTimestampDevice(timedelta(microseconds=self._by_camera(host_us)))
        return message

    def _by_camera(self, host_us: int) -> int:
        """The camera's clock at this time of the computer's."""
        since = host_us - self._zero_us
        return round(BOOTED_S * 1e6 + since * (1 + DRIFT))

    def _send_motion(self, node: Any, seconds: float) -> None:
        """The camera hangs still: gravity, and noise."""
        dai, rate = self._dai, self._camera.of.imu_hz
        due = int(seconds * rate)
        packets = []
        for k in range(max(self._moved, due - round(rate)), due):
            noise = np.random.default_rng([self._camera.of.seed, 4, k]).normal(0, [0.02] * 3 + [0.002] * 3)
            packet, host_us = dai.IMUPacket(), self._zero_us + round(k / rate * 1e6)
            a, w = packet.acceleroMeter, packet.gyroscope
            a.x, a.y, a.z = float(noise[0]), float(noise[1]), float(GRAVITY + noise[2])
            w.x, w.y, w.z = (float(v) for v in noise[3:])
            for report in (a, w):
                report.sequence = k & 0x7FFFFFFF
                report.timestamp = _stamp(dai, host_us)
                report.tsDevice = _stamp(dai, self._by_camera(host_us))
            packet.acceleroMeter, packet.gyroscope = a, w
            packets.append(packet)
        self._moved = due
        if packets:
            message = dai.IMUData()
            message.packets = packets
            node.imu.send(message)


def _stamp(dai: Any, us: int) -> Any:
    stamp = dai.Timestamp()
    stamp.sec, stamp.nsec = us // 1_000_000, us % 1_000_000 * 1000
    return stamp


@cache
def _node_class() -> type[Any]:
    """The host node; its class can only be made when depthai is there."""
    dai = library()

    class SimulatedOakNode(dai.node.ThreadedHostNode):  # type: ignore[misc, name-defined]
        """Calls `shown.step` some hundred times a second, in depthai's own thread."""

        def __init__(self) -> None:
            dai.node.ThreadedHostNode.__init__(self)
            self.depth, self.imu = self.createOutput(), self.createOutput()
            self.image, self.sight = self.createOutput(), self.createOutput()

        def run(self) -> None:
            with suppress(dai.MessageQueue.QueueException):  # somebody closed the pipeline while we were sending
                while self.isRunning():
                    self.shown.step(self)
                    time.sleep(TICK_S)

    return SimulatedOakNode


@dataclass(frozen=True, slots=True)
class SimulatedOak(OakSource):
    """An OAK source that reads a simulated camera: all is the same but where the camera comes from."""

    camera: Any = param(None, help="the simulated camera; set by `kinegraph run --simulate`")

    @classmethod
    def of(cls, source: OakSource, camera: SimulatedCamera) -> SimulatedOak:
        return cls(**{f.name: getattr(source, f.name) for f in fields(source)}, camera=camera)

    def missing(self) -> str:
        return ""

    def prepare(self) -> None:
        """Compiles what the picture is drawn with here, before the session: in depthai's own thread it would hold up the first frames."""
        OakSource.prepare(self)
        if self.image or self.network:
            RenderedPerformer(64, 48).frame(0, MOVING_S)

    def check_network(self) -> None:
        """None runs here: its archive need not be there."""

    def open(self, dai: Any, link: CameraLink) -> AbstractContextManager[Camera]:
        if self.camera is None:
            raise DeviceError(
                "a simulated camera is set up by `kinegraph run --simulate`; name devices.oak.Oak instead"
            )
        camera: SimulatedCamera = self.camera
        return camera.opened(dai, link)


@contextmanager
def simulated(source: OakSource) -> Iterator[SimulatedOak]:
    """What `--simulate` puts in its place."""
    device = OakSimulator(
        width=source.width,
        height=source.height,
        fps=source.fps,
        imu_hz=source.imu_hz,
        image=source.image,
        people=source.people,
        network=bool(source.network),
    )
    with device.plugged_in() as camera:
        yield SimulatedOak.of(replace(source, device=""), camera)
