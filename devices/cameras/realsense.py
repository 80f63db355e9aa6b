"""Intel RealSense depth cameras through pyrealsense2; extra `realsense`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from kinegraph.devices.cameras.depth_camera import CameraFrame, DepthCamera, OpenCamera
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param
from kinegraph.stream.system.extras import optional

MS = 1_000_000


def library() -> Any:
    """pyrealsense2; raises DeviceError that says how to install it."""
    return optional("pyrealsense2", "a RealSense camera", "pip install 'kinegraph[realsense]'", DeviceError)


@dataclass(frozen=True, slots=True)
class RealSense(DepthCamera):
    """A RealSense D400 camera, or a recording (.db3, .bag) that its library plays.

    depth    (height, width) uint16 mm; 0: no measurement there. Regular, at `fps`
    mono     (height, width) uint8, with `image: mono`: the left infrared camera, the same pixels
    colour   (height, width, 3) uint8, with `image: colour`; the depth is then that of the colour camera's pixels
    timing   an event per frame: its number, the camera's time, arrival, stamp

    Stamps follow the time that the camera gives each frame; frames that are missing are known from their numbers.
    """

    maker: ClassVar[str] = "RealSense"
    rectified: ClassVar[bool] = True

    projector: bool = param(True, help="the infrared dot projector, as the maker has it: on")

    @property
    def light(self) -> str:
        return "dots" if self.projector and self.image == "mono" else "room"

    def prepare(self) -> None:
        DepthCamera.prepare(self)
        library()

    def missing(self) -> str:
        if self.recording:
            return ""
        rs = library()
        here = [device.get_info(rs.camera_info.serial_number) for device in rs.context().query_devices()]
        if self.device in here or (here and not self.device):
            return ""
        return f"no RealSense camera {self.device or 'is connected'}; there are {', '.join(here) or 'no others'}"

    @contextmanager
    def opened(self) -> Iterator[OpenCamera]:
        rs = library()
        config, pipeline = rs.config(), rs.pipeline()
        if self.recording:
            if not self.recording.exists():
                raise DeviceError(f"{self.recording} does not exist")
            config.enable_device_from_file(str(self.recording), repeat_playback=False)
        else:
            if self.device:
                config.enable_device(self.device)
            config.enable_stream(rs.stream.depth, self.width, self.height, rs.format.z16, round(self.fps))
            if self.image == "colour":
                config.enable_stream(rs.stream.color, self.width, self.height, rs.format.rgb8, round(self.fps))
            elif self.image:
                config.enable_stream(rs.stream.infrared, 1, self.width, self.height, rs.format.y8, round(self.fps))
        try:
            profile = pipeline.start(config)
        except RuntimeError as error:
            raise DeviceError(
                f"a RealSense camera cannot be opened: {error}; `kinegraph devices realsense` lists them"
            ) from None
        try:
            yield RealSenseCamera(rs, self, pipeline, profile)
        finally:
            with suppress(RuntimeError):
                pipeline.stop()


class RealSenseCamera:
    """A pipeline that runs."""

    def __init__(self, rs: Any, of: RealSense, pipeline: Any, profile: Any) -> None:
        self._rs, self._of, self._pipeline = rs, of, pipeline
        device = profile.get_device()
        wanted = {
            "name": rs.camera_info.name,
            "serial": rs.camera_info.serial_number,
            "firmware": rs.camera_info.firmware_version,
        }
        self.facts = {key: device.get_info(info) for key, info in wanted.items() if device.supports(info)}
        sensor = device.first_depth_sensor()
        self._mm = round(1000.0 * sensor.get_depth_scale(), 4)  # it comes as a float32
        if of.recording:
            device.as_playback().set_real_time(False)
            self._playback = device.as_playback()
        else:
            self._playback = None
            if sensor.supports(rs.option.emitter_enabled):
                sensor.set_option(rs.option.emitter_enabled, float(of.projector))
        self._align = rs.align(rs.stream.color) if of.image == "colour" else None
        stream = profile.get_stream(rs.stream.color if self._align else rs.stream.depth).as_video_stream_profile()
        lens = stream.get_intrinsics()
        self.intrinsics = (float(lens.fx), float(lens.fy), float(lens.ppx), float(lens.ppy))

    def frame(self, within_s: float) -> CameraFrame | None:
        came, frames = self._pipeline.try_wait_for_frames(round(within_s * 1000))
        if not came:
            if self._playback is not None and self._playback.current_status() == self._rs.playback_status.stopped:
                raise EOFError
            return None
        if self._align is not None:
            frames = self._align.process(frames)
        depth = frames.get_depth_frame()
        if not depth:
            return None
        image = None
        if self._of.image:
            shown = frames.get_color_frame() if self._of.image == "colour" else frames.get_infrared_frame(1)
            if not shown:
                return None
            image = np.array(shown.get_data(), np.uint8)
        number, at = int(depth.get_frame_number()), round(depth.get_timestamp() * MS)
        return CameraFrame(number, at, in_mm(np.asarray(depth.get_data()), self._mm), image)


def in_mm(raw: np.ndarray, mm: float) -> np.ndarray:
    """Depth (height, width) uint16 in mm, copied; `mm`: what a unit of `raw` stands for. What is too far for uint16 is 0."""
    if abs(mm - 1.0) < 1e-6:
        return np.array(raw, np.uint16)
    scaled = np.rint(raw * mm)
    return np.where(scaled > 65535, 0, scaled).astype(np.uint16)
