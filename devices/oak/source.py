"""An OAK depth camera as a source."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import timedelta
from ipaddress import ip_address
from typing import Any, Literal

import numpy as np
import structlog

from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.devices.oak.adapter import Frames, ImuPackets, image_of, message_of
from kinegraph.devices.oak.archive import pose_archive
from kinegraph.devices.oak.camera import Camera, CameraLink, opened
from kinegraph.devices.oak.keypoint_sets import MARKERS
from kinegraph.devices.oak.keypoints import Keypoints, sight_of
from kinegraph.devices.oak.library import all_cameras, library, missing, zero_ns
from kinegraph.devices.oak.network import apart_s
from kinegraph.stream.chunk import NS, Specs, StreamSpec
from kinegraph.stream.domain.axes import CAMERA
from kinegraph.stream.domain.intrinsics import lens
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source, outputs_by_parameters

FIRST_FRAME_S = 20.0
"""How long a camera may take from being opened to its first frame: its program is sent to it first."""
PRESETS = {
    "stereo": ("default", "face", "high_detail", "robotics", "fast_accuracy", "fast_density", "accuracy", "density"),
    "tof": ("low_range", "mid_range", "high_range"),
}
"""depthai's own settings for a purpose."""
USUAL_FOCAL = 0.70
"""Focal length in widths of the frame: 71 degrees from side to side, as most of these cameras have. Nominal, not of any one camera."""
MOTION = ("ax", "ay", "az", "gx", "gy", "gz")

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Oak(Source):
    """A depth camera of Luxonis, by USB or network: stereo (OAK-D and its kin) or time of flight (OAK-D ToF).

    depth    (height, width) uint16: distance from the camera's plane in mm; 0: no measurement there. Regular, at `fps`
    imu      (6,) float64, with `imu_hz`: acceleration (m/s2) and angular velocity (rad/s) of the camera itself
    mono     (height, width) uint8, with `image: mono`: what the right camera sees, the same pixels as the depth; with the projector's dots
    colour   (height, width, 3) uint8, with `image: colour`: red, green, blue, and the depth is that of the colour camera's pixels
    timing   an event per frame: its number, the camera's time, arrival, stamp

    With `network`, a pose network that runs on the camera (its archive, a file of yours), of one person in view, under the stamps of depth:
    markers     (20, 3) m: x right, y down, z away from the camera; NaN where one is not seen or has no depth
    confidence  (20,) 0 to 1, the network's own; below `least` a marker is NaN

    Images are recorded only where the graph names them in `record`, as depth is. Their stamps are their own. The specs of depth and images
    say `camera`: fx, fy, cx, cy, in pixels, from `intrinsics`, or from the angle of view that these cameras usually have (`known: false`);
    distortion, zero, as depthai takes it out of stereo and colour images (of a ToF camera it is not known); extrinsics from the depth
    to the image, which are none.

    A frame's stamp is the middle of its exposure, on the host clock that depthai keeps in step with the camera's. Frames that are missing
    are known from their numbers. depthai itself connects again to a camera that comes back; one that stays away for `reconnect_s`, or
    brings no frame for `lost_after_s` though it is connected, is closed and searched for again.

    `projector` and `flood` are set once the pipeline runs, and again whenever the camera has come back: it forgets them. A camera that
    lacks what is asked for goes on without it; that is logged, and counted as a problem.
    """

    device: str = param("", help="which camera: its id, IP address or USB port; left out: the first that is found")
    depth: Literal["stereo", "tof"] = param(
        "stereo", help="how it measures: by two cameras, or by the time of flight of light"
    )
    width: int = param(640, least=16, most=4096, help="pixels in a row of a frame")
    height: int = param(400, least=16, most=4096, help="rows of a frame; 480 for time of flight")
    fps: float = param(30.0, above=0, most=240, help="frames per second")
    image: Literal["", "mono", "colour"] = param("", help="images beside the depth: mono (the right camera) or colour")
    intrinsics: tuple[float, ...] = param(
        (), least=0.0, help="fx, fy, cx, cy in pixels at this width and height; left out: about what these cameras have"
    )
    network: str = param("", help="the archive (NNArchive, .tar.xz) of a pose network that is to run on the camera")
    least: float = param(0.5, least=0.0, most=1.0, help="a marker of which the network is less sure is NaN")
    preset: str = param(
        "",
        help="depthai's preset: for stereo default, accuracy, density, ...; for tof low_range, mid_range, high_range",
    )
    projector: float = param(
        0.0,
        least=0.0,
        most=1.0,
        help="intensity of the infrared dot projector (models named Pro); 0: off, as the maker has it",
    )
    flood: float = param(
        0.0, least=0.0, most=1.0, help="intensity of the infrared flood light (models named Pro); 0: off"
    )
    lit_room: bool = param(False, help="the room stays light all night, so that a stereo camera needs no projector")
    imu_hz: float = param(0.0, least=0, most=1000, help="rate of the inertial output; 0: off")
    people: int = param(1, least=1, most=2, help="with --simulate: how many people the simulated camera shows")
    lost_after_s: float = param(5.0, above=0, help="after how long without a frame it is opened again")
    reconnect_s: float = param(30.0, above=0, help="how long depthai may try to reach a camera that was unplugged")
    latency_s: float = param(0.0, least=0, most=1, help="how long before its stamp a frame really was taken")

    @outputs_by_parameters("depth", "timing")
    def outputs(self) -> tuple[str, ...]:
        points = ("markers", "confidence") if self.network else ()
        return "depth", *filter(None, (self.image, *points, "imu" if self.imu_hz else "")), "timing"

    @property
    def chunk_s(self) -> float:
        return 1 / self.fps

    @property
    def blind_at_night(self) -> str:
        """Why it sees nothing in the dark; "": it does, or the room is lit."""
        if self.depth == "tof" or self.projector or self.flood or self.lit_room:
            return ""
        return (
            "a stereo camera sees nothing in the dark without projector or flood; give it one, or say `lit_room: true`"
        )

    def specs(self) -> Specs:
        if self.preset and self.preset not in PRESETS[self.depth]:
            raise ParameterError("preset", self.preset, f"one of {', '.join(PRESETS[self.depth])}, or left out")
        clear = (0.0,) * 5 if self.depth == "stereo" else None
        camera = lens(self.intrinsics, self.width, self.height, USUAL_FOCAL, clear)
        if self.image and self.depth == "tof":
            raise ParameterError("image", self.image, "left out for a camera that measures the time of flight")
        if self.network and (self.depth == "tof" or self.image == "mono"):
            kind = "stereo camera" if self.depth == "tof" else "camera that gives no mono images: it sees colour"
            raise ParameterError("network", self.network, f"left out, or used with a {kind}")
        meta = {"device": "OAK", "depth": self.depth, "invalid": 0, "camera": camera}
        specs = {
            "depth": StreamSpec(
                (self.height, self.width), np.dtype(np.uint16), rate_hz=self.fps, units=("mm",), meta=meta
            ),
            "timing": timing_spec(),
        }
        if self.image:
            shape = (self.height, self.width) if self.image == "mono" else (self.height, self.width, 3)
            lights = "dots" if self.projector else "flood" if self.flood else "room"
            light = lights if self.image == "mono" else "room"  # the colour camera sees no infrared
            facts = {"device": "OAK", "camera": camera, "light": light}
            specs[self.image] = StreamSpec(shape, np.dtype(np.uint8), rate_hz=self.fps, meta=facts)
        if self.network:
            of_points = {"device": "OAK", "axes": CAMERA.facts(), "camera": camera}
            specs["markers"] = StreamSpec(
                (len(MARKERS), 3), rate_hz=self.fps, channels=MARKERS, units=("m",), meta=of_points
            )
            specs["confidence"] = StreamSpec((len(MARKERS),), rate_hz=self.fps, channels=MARKERS, meta=of_points)
        if self.imu_hz:
            units = ("m/s2",) * 3 + ("rad/s",) * 3
            specs["imu"] = StreamSpec((6,), rate_hz=self.imu_hz, channels=MOTION, units=units, meta={"device": "OAK"})
        return specs

    def open(self, dai: Any, link: CameraLink) -> AbstractContextManager[Camera]:
        """The camera; a simulated one gives its own."""
        return opened(dai, self, link)

    def missing(self) -> str:
        """A camera that is named by its IP address may be in another network, where only opening finds it."""
        return "" if _is_ip(self.device) else missing(all_cameras(library()), self.device)

    def prepare(self) -> None:
        library()  # where it is missing, waiting for it would be in vain
        self.check_network()

    def check_network(self) -> None:
        """Raises ParameterError unless the archive holds a pose network."""
        if self.network:
            pose_archive(self.network)

    def read(self, feed: Feed) -> None:
        dai, link = library(), CameraLink()
        with self.open(dai, link) as camera:
            feed.identify("OAK", **camera.identity)
            _CameraReading(dai, self, camera, link, feed).run()


def _is_ip(device: str) -> bool:
    try:
        return bool(ip_address(device))
    except ValueError:
        return False


class _CameraReading:
    """One opening of a camera: frames and inertial packets are passed on as they come."""

    def __init__(self, dai: Any, of: Oak, camera: Camera, link: CameraLink, feed: Feed) -> None:
        self._dai, self._of, self._camera, self._link, self._feed = dai, of, camera, link, feed
        latency, zero = round(of.latency_s * NS), zero_ns(dai, feed.now)
        self._frames = Frames(of.specs()["depth"], zero, latency)
        self._motion = ImuPackets(of.imu_hz, zero, latency) if of.imu_hz else None
        self._images = Frames(of.specs()[of.image], zero, latency) if of.image else None
        self._points = Keypoints(zero, latency, of.least, round(apart_s(of.fps) * NS)) if of.network else None
        self._patience_s = FIRST_FRAME_S
        self._heard = self._saw = time.monotonic()

    def run(self) -> None:
        """Runs until stopped; raises DeviceError when the camera is lost."""
        self._light()
        wait = timedelta(milliseconds=10 if self._motion or self._images or self._points else 100)
        while not self._feed.stopped:
            try:
                message = self._camera.depth.get(wait)
                motion = self._camera.imu.tryGetAll() if self._motion else ()
            except self._dai.MessageQueue.QueueException:
                raise DeviceError(f"the OAK camera's pipeline has ended ({self._link.state})") from None
            images = self._camera.image.tryGetAll() if self._images else ()
            sights = self._camera.keypoints.tryGetAll() if self._points else ()
            self._look_at_link()
            if message is not None:
                self._frame(message)
            for image in images:
                self._image(image)
            for packets in motion:
                self._packets(packets)
            self._see(sights)
            self._check_silence()

    def _light(self) -> None:
        """Switch on what sees in the dark."""
        for name in self._camera.light():
            log.error(
                f"this OAK camera has no {name}: in the dark it sees nothing (models named Pro have one; docs/devices/oak.md)",
                device=self._of.device,
            )
            self._feed.problem(f"no {name}")

    def _frame(self, message: Any) -> None:
        arrival = self._feed.now()
        taken = self._frames.take(message_of(self._dai, message), arrival)
        for problem in taken.problems:
            self._feed.problem(problem)
        if taken.chunk is None:
            return
        self._heard, self._patience_s = time.monotonic(), self._of.lost_after_s
        chunk = taken.chunk
        if chunk.lost > 0:
            self._feed.problem("lost frame", chunk.lost)
        self._feed.emit(chunk, "depth")
        if self._points:
            self._points.depth(taken.device, int(chunk.time[0]))
        self._feed.emit(timing_chunk(taken.number, taken.device, arrival, chunk.time, chunk.lost), "timing")

    def _image(self, message: Any) -> None:
        assert self._images
        taken = self._images.take(image_of(self._dai, message), self._feed.now())
        for problem in taken.problems:
            self._feed.problem(problem)
        if taken.chunk is not None:
            self._feed.emit(taken.chunk, self._of.image)

    def _see(self, sights: Any) -> None:
        if not self._points:
            return
        for message in sights:
            self._saw = time.monotonic()
            self._points.see(sight_of(message))
        for markers, confidence in self._points.take():
            if markers.lost > 0:
                self._feed.problem("image the network has not seen", markers.lost)
            self._feed.emit(markers, "markers")
            self._feed.emit(confidence, "confidence")

    def _packets(self, message: Any) -> None:
        assert self._motion
        for chunk in self._motion.take(message.packets, self._feed.now()):
            if chunk.lost > 0:
                self._feed.problem("lost inertial packet", chunk.lost)
            self._feed.emit(chunk, "imu")

    def _look_at_link(self) -> None:
        for state in self._link.news():
            log.warning("OAK connection", device=self._of.device, state=state)
            if state == "FAILED":
                raise DeviceError("the OAK camera is gone, and depthai has given up connecting to it again")
            if state == "RUNNING":
                self._light()
            if state == "DISCONNECTED":
                self._feed.problem("connection lost")
            self._frames.interrupted()
            if self._images:
                self._images.interrupted()
            if self._motion:
                self._motion.interrupted()
            if self._points:
                self._points.interrupted()

    def _check_silence(self) -> None:
        silent = time.monotonic() - self._heard
        if self._link.state != "RUNNING":
            if silent > self._of.reconnect_s:
                raise DeviceError(
                    f"the OAK camera was unplugged and has not come back within {self._of.reconnect_s:g} s"
                )
        elif silent > self._patience_s:
            raise DeviceError(f"no frame from the OAK camera for {self._patience_s:g} s, though it is connected")
        elif self._points and self._heard - self._saw > self._patience_s:
            raise DeviceError(
                f"the network on the OAK camera has given nothing for {self._patience_s:g} s, though depth comes: does it run on this "
                "camera? (write a lower fps if it is slow)"
            )
