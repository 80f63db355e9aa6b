"""What depth cameras share: frames with a number and the camera's time, to chunks of depth and images."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.clocks import line_below
from kinegraph.devices.clocks.clock_log import ClockLog
from kinegraph.devices.clocks.stamps import Stamps
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.stream.chunk import Array, Chunk, Specs, StreamSpec
from kinegraph.stream.domain.intrinsics import lens
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source, outputs_by_parameters

FIRST_FRAME_S = 15.0
USUAL_FOCAL = 0.80
"""Focal length in widths of the frame, if not given: nominal, of no camera."""


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """depth (height, width) uint16 mm; device_ns: the camera's time; number: -1 if frames are not numbered; image: None or its pixels."""

    number: int
    device_ns: int
    depth: NDArray[np.uint16]
    image: Array | None = None


class OpenCamera(Protocol):
    """A camera that runs. facts: what it is; intrinsics: fx, fy, cx, cy of its depth frames in pixels, if it says them."""

    @property
    def facts(self) -> Mapping[str, str | float]: ...

    @property
    def intrinsics(self) -> tuple[float, float, float, float] | None: ...

    def frame(self, within_s: float) -> CameraFrame | None:
        """The next frame, or None. Raises DeviceError when the camera is gone, EOFError at a recording's end."""


@dataclass(frozen=True, slots=True)
class DepthCamera(Source):
    """What a graph says of any of these cameras; each has a class of its own."""

    maker: ClassVar[str] = ""
    rectified: ClassVar[bool] = False
    """Whether its frames are free of distortion as they come."""

    device: str = param("", help="which camera: its serial number; left out: the first that is found")
    width: int = param(640, least=16, most=4096, help="pixels in a row of a depth frame")
    height: int = param(480, least=16, most=4096, help="rows of a depth frame")
    fps: float = param(30.0, above=0, most=240, help="frames per second")
    image: Literal["", "mono", "colour"] = param(
        "", help="images beside the depth: mono (infrared) or colour, on the same pixels"
    )
    intrinsics: tuple[float, ...] = param(
        (), least=0.0, help="fx, fy, cx, cy in pixels; left out: about what such cameras have"
    )
    distortion: tuple[float, ...] = param(
        (),
        help="the lens's k1, k2, p1, p2, k3 (4, 5 or 8 numbers, as OpenCV has them) for the spec; left out: not known",
    )
    recording: Path | None = param(None, help="a recording in the maker's format, played instead of a camera")
    lost_after_s: float = param(5.0, above=0, help="after how long without a frame it is opened again")
    latency_s: float = param(0.0, least=0, most=1, help="how long before its stamp a frame really was taken")

    @outputs_by_parameters("depth", "timing")
    def outputs(self) -> tuple[str, ...]:
        return "depth", *filter(None, (self.image,)), "timing"

    @property
    def live(self) -> bool:
        return self.recording is None

    @property
    def chunk_s(self) -> float:
        return 1 / self.fps

    @property
    def light(self) -> str:
        """What lights the images: `room`, `flood` or `dots`; `unknown`: models differ."""
        return "room"

    def specs(self) -> Specs:
        distortion = self.distortion or ((0.0,) * 5 if self.rectified else None)
        camera = lens(self.intrinsics, self.width, self.height, USUAL_FOCAL, distortion)
        size, meta = (self.height, self.width), {"device": self.maker, "invalid": 0, "camera": camera}
        specs = {
            "depth": StreamSpec(size, np.dtype(np.uint16), rate_hz=self.fps, units=("mm",), meta=meta),
            "timing": timing_spec(),
        }
        if self.image:
            shape = size if self.image == "mono" else (*size, 3)
            facts = {"device": self.maker, "camera": camera, "light": self.light}
            specs[self.image] = StreamSpec(shape, np.dtype(np.uint8), rate_hz=self.fps, meta=facts)
        return specs

    def opened(self) -> AbstractContextManager[OpenCamera]:
        """The camera, running; raises DeviceError."""
        raise NotImplementedError

    def prepare(self) -> None:
        line_below.prepare()

    def read(self, feed: Feed) -> None:
        with self.opened() as camera:
            facts = dict(camera.facts)
            if camera.intrinsics:
                facts |= {k: round(v, 3) for k, v in zip(("fx", "fy", "cx", "cy"), camera.intrinsics, strict=True)}
            feed.identify(self.maker, **facts)
            feed.ready()
            reading = CameraReading(self, camera)
            name = f"{self.maker} {facts.get('serial', '')}".strip()
            with ClockLog(name, feed, lambda: reading.stamps.state) as clock_log:
                while not feed.stopped and reading.step(feed):
                    clock_log.tell()


@dataclass(slots=True)
class CameraReading:
    """Frames to chunks."""

    of: DepthCamera
    camera: OpenCamera
    stamps: Stamps = field(init=False)
    heard: float = field(default_factory=time.monotonic)
    patience_s: float = FIRST_FRAME_S
    zero: int | None = None
    last: int = -1

    def __post_init__(self) -> None:
        self.stamps = Stamps(self.of.fps, has_time=True, latency_s=self.of.latency_s)

    def step(self, feed: Feed) -> bool:
        """Wait for a frame and emit it; False at a recording's end. Raises DeviceError."""
        try:
            frame = self.camera.frame(0.1)
        except EOFError:
            return False
        if frame is None:
            if time.monotonic() - self.heard > self.patience_s:
                raise DeviceError(f"no frame of the {self.of.maker} for {self.patience_s:g} s; it is reopened")
            return True
        self.heard, self.patience_s = time.monotonic(), self.of.lost_after_s
        self._emit(frame, feed)
        return True

    def _emit(self, frame: CameraFrame, feed: Feed) -> None:
        self._check(frame)
        arrival = self._arrival(frame, feed)
        packets = self.stamps.take(1, arrival, np.array([frame.device_ns]))
        if not len(packets.stamp) or (frame.number >= 0 and frame.number == self.last):
            feed.problem("repeated frame")
            return
        lost = int(packets.lost[0])
        if frame.number > self.last >= 0 and lost >= 0:
            lost = frame.number - self.last - 1
        self.last = frame.number
        if lost:
            feed.problem("lost frame" if lost > 0 else "device restarted", max(lost, 1))
        stamp = packets.stamp
        feed.emit(Chunk(stamp, frame.depth[None], int(stamp[0]), lost), "depth")
        if self.of.image and frame.image is not None:
            feed.emit(Chunk(stamp, frame.image[None], int(stamp[0]), lost), self.of.image)
        feed.emit(timing_chunk(frame.number, frame.device_ns, arrival, stamp), "timing")

    def _arrival(self, frame: CameraFrame, feed: Feed) -> int:
        """When it came; a recording's frames come at its own pace, from now on."""
        if self.of.live:
            return feed.now()
        if self.zero is None:
            self.zero = feed.now() - frame.device_ns
        return self.zero + frame.device_ns

    def _check(self, frame: CameraFrame) -> None:
        height, width = frame.depth.shape
        if (height, width) != (self.of.height, self.of.width):
            raise DeviceError(
                f"the {self.of.maker} gives frames of {width} x {height}, the graph says {self.of.width} x {self.of.height}; "
                f"write width: {width} and height: {height}"
            )
