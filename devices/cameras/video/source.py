"""A webcam, a video file or a camera on the network, as a stream of colour images."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.cameras.video import container
from kinegraph.devices.clocks.clock_log import ClockLog
from kinegraph.devices.clocks.stamps import Stamps
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec
from kinegraph.stream.domain.intrinsics import lens
from kinegraph.stream.errors import DeviceError, ParameterError, nearest
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

USUAL_FOCAL = 0.87
"""Focal length in widths of the image, if not given: 60 degrees from side to side, as many webcams and telephones have."""
MAX_WIDTH = 640
"""A file's frames are made this wide at most, if no width is given: networks look at a part of 256 pixels."""
SAME_SHAPE = 0.02
"""By this share the ratio of sides may differ from the declared one before a picture would look squeezed."""


@dataclass(frozen=True, slots=True)
class Video(Source):
    """A webcam (`/dev/video0`), a video file, or a camera on the network (`rtsp://`, `http://`: a telephone's app, a surveillance camera).

    image   (height, width, 3) uint8: red, green, blue
    timing  an event per frame: the camera's time, arrival, stamp; frames have no number, what is missing is known from the time

    Frames carry the camera's or the file's own times, on the session's clock; pictures without times (MJPEG over HTTP) are stamped on
    arrival. A file plays at its own pace and ends. Pictures are made as large as the graph says. Images are recorded only by a graph
    that lists this output in `record`. Needs PyAV: pip install 'kinegraph[video]'.
    """

    outputs: ClassVar[tuple[str, ...]] = ("image", "timing")

    url: str = param("", help="/dev/video0, a file, rtsp://... or http://...; left out: the first webcam")
    width: int = param(0, least=0, most=4096, help="pixels in a row; 0: 640 of a camera, at most 640 of a file")
    height: int = param(0, least=0, most=4096, help="rows; 0: 480 of a camera, a file's own shape")
    fps: float = param(30.0, above=0.0, most=240.0, help="frames per second of a camera; a file has its own")
    exposure_ms: float = param(0.0, least=0.0, most=1000.0, help="of a webcam; 0: as the camera chooses")
    mirror: bool = param(False, help="exchange left and right, as a mirror does: for a person who looks at it only")
    field_of_view_deg: float = param(0.0, least=0.0, most=170.0, help="from side to side; 0: 60 degrees, nominal")
    intrinsics: tuple[float, ...] = param((), least=0.0, help="fx, fy, cx, cy in pixels, of a calibration")
    distortion: tuple[float, ...] = param(
        (), help="k1, k2, p1, p2, k3 of a calibration (4, 5 or 8 numbers) for the spec"
    )
    lost_after_s: float = param(5.0, above=0.0, help="after how long without a frame it is opened again")
    latency_s: float = param(0.0, least=0.0, most=2.0, help="how long before its stamp a frame really was taken")
    realtime: bool = param(True, help="false: a file is played as fast as the graph takes it")
    shows: Literal["someone", "walker"] = param("someone", help="with --simulate: who the simulated camera shows")

    @property
    def is_file(self) -> bool:
        return bool(self.url) and not (container.is_address(self.url) or container.is_webcam(self.url))

    @property
    def live(self) -> bool:
        return self.realtime or not self.is_file

    @property
    def chunk_s(self) -> float:
        return 1 / self.fps

    def size(self) -> tuple[int, int]:
        """Width and height of the images. Raises ParameterError for a file that cannot be read."""
        if not self.is_file:
            return self.width or 640, self.height or (480 if not self.width else round(self.width * 0.75))
        facts = self._file()
        width = self.width or (
            round(self.height * facts.width / facts.height) if self.height else min(facts.width, MAX_WIDTH)
        )
        return width, self.height or max(1, round(width * facts.height / facts.width))

    def specs(self) -> Specs:
        width, height = self.size()
        focal = 0.5 / math.tan(math.radians(self.field_of_view_deg) / 2) if self.field_of_view_deg else USUAL_FOCAL
        camera = lens(self.intrinsics, width, height, focal, self.distortion or None)
        meta = {"device": "video", "camera": camera, "light": "room", "mirrored": self.mirror}
        rate = self._file().rate_hz if self.is_file else self.fps
        return {
            "image": StreamSpec((height, width, 3), np.dtype(np.uint8), rate_hz=rate, meta=meta),
            "timing": timing_spec(),
        }

    def _file(self) -> container.FileFacts:
        try:
            return container.file_facts(self.url)
        except OSError as error:
            raise ParameterError("url", self.url, f"a video file that is there ({error.strerror})") from None
        except DeviceError as error:
            raise ParameterError("url", self.url, f"a video file ({error})") from None

    def missing(self) -> str:
        container.library()
        if container.is_address(self.url):
            return container.unreachable(self.url)
        if self.is_file:
            return "" if Path(self.url).is_file() else f"there is no video {self.url}"
        there = [device for device, _ in container.webcams()]
        wanted = self.url or "/dev/video0"
        if (not self.url and there) or Path(wanted).exists():
            return ""
        others = nearest(wanted, there) if there else "no webcam is connected"
        return f"there is no webcam {wanted}; {others}"

    def present(self) -> bool | None:
        return None if container.is_address(self.url) else Path(self.address()).exists()

    def address(self) -> str:
        """What is opened."""
        if self.url:
            return self.url
        there = container.webcams()
        return there[0][0] if there else "/dev/video0"

    def read(self, feed: Feed) -> None:
        url, (width, height) = self.address(), self.size()
        with container.opened(url, width, height, self.fps, self.lost_after_s) as (opened, timed):
            if self.exposure_ms and container.is_webcam(url):
                container.set_exposure(url, self.exposure_ms)
            stream = opened.streams.video[0]
            codec = str(stream.codec_context.name)
            feed.identify("video", url=without_password(url), codec=codec, width=stream.width, height=stream.height)
            feed.ready()
            reading = VideoReading(self, (width, height), timed=timed)
            with ClockLog("video", feed, lambda: reading.stamps.state if not self.is_file else None) as clock_log:
                for frame in frames_of(opened, url):
                    if feed.stopped or not reading.take(frame, feed):
                        return
                    clock_log.tell()
        if not self.is_file:
            raise DeviceError(f"{url} has ended; it is opened again")


def frames_of(opened: Any, url: str) -> Any:
    """The decoded frames. Raises DeviceError."""
    av = container.library()
    try:
        yield from opened.decode(video=0)
    except (av.error.FFmpegError, OSError) as error:
        raise DeviceError(f"{url} is gone, or damaged here ({container.reason(error)})") from None


@dataclass(slots=True)
class VideoReading:
    """Frames to chunks."""

    of: Video
    size: tuple[int, int]
    timed: bool = True
    stamps: Stamps = field(init=False)
    rate_hz: float | None = None
    first: int | None = None
    began: int = 0
    last: int = -1
    count: int = 0

    def __post_init__(self) -> None:
        self.stamps = Stamps(self.of.fps, has_time=self.timed, latency_s=self.of.latency_s)
        self.rate_hz = self.of.specs()["image"].rate_hz

    def take(self, frame: Any, feed: Feed) -> bool:
        """Emit one frame; False when the session stops."""
        image = self.image(frame)
        stamp, device, lost = self.filed(frame) if self.of.is_file else self._arrived(frame, feed)
        if stamp is None:
            feed.problem("repeated frame")
            return True
        if self.of.is_file:
            if not self.began:
                self.began = feed.now()
            stamp += self.began
            if self.of.realtime and feed.wait(max(0, stamp - feed.now()) / NS):
                return False
        if lost:
            feed.problem("lost frame", max(lost, 1))
        times = np.array([stamp], np.int64)
        feed.emit(Chunk(times, image[None], stamp, lost), "image")
        feed.emit(timing_chunk(self.count, device, feed.now(), times), "timing")
        self.count += 1
        return True

    def image(self, frame: Any) -> NDArray[np.uint8]:
        """(height, width, 3), as large as declared, turned upright as a telephone's file says. Raises DeviceError."""
        width, height = self.size
        turn = container.quarter_turns(frame)
        shown = (frame.height, frame.width) if turn % 2 else (frame.width, frame.height)
        if abs(shown[0] * height / (shown[1] * width) - 1.0) > SAME_SHAPE:
            raise DeviceError(
                f"the pictures are {shown[0]} x {shown[1]}, and would be squeezed into {width} x {height}; "
                f"write width: {width} and height: {round(width * shown[1] / shown[0])}"
            )
        to = (height, width) if turn % 2 else (width, height)
        image = frame.reformat(width=to[0], height=to[1], format="rgb24").to_ndarray()
        image = np.rot90(image, turn) if turn else image
        return np.ascontiguousarray(image[:, ::-1] if self.of.mirror else image)

    def filed(self, frame: Any) -> tuple[int | None, int, int]:
        """Stamp from the file's first frame on, the file's own time, and how many are missing before."""
        own = container.stamp_ns(frame)
        if own is None:
            return None, -1, 0
        if self.first is None:
            self.first = own
        stamp, rate = own - self.first, self.rate_hz
        if stamp <= self.last:
            return None, own, 0
        lost = max(0, round((stamp - self.last) / NS * rate) - 1) if self.last >= 0 and rate else 0
        self.last = stamp
        return stamp, own, lost

    def _arrived(self, frame: Any, feed: Feed) -> tuple[int | None, int, int]:
        own = container.stamp_ns(frame) if self.timed else None
        packets = self.stamps.take(1, feed.now(), None if own is None else np.array([own]))
        if not len(packets.stamp):
            return None, own or -1, 0
        return int(packets.stamp[0]), -1 if own is None else own, int(packets.lost[0])


def without_password(url: str) -> str:
    """The address as it may stand in a log and a recording."""
    scheme, mark, rest = url.partition("://")
    host = rest.split("/", 1)[0]
    return f"{scheme}{mark}{rest[len(host.rpartition('@')[0]) + 1 :]}" if mark and "@" in host else url
