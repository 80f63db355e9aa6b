"""Orbbec depth cameras (Femto, Gemini, Astra) through pyorbbecsdk, which asks for numpy 1: pip install --no-deps pyorbbecsdk2."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from kinegraph.devices.cameras.depth_camera import CameraFrame, DepthCamera, OpenCamera
from kinegraph.devices.cameras.realsense import in_mm
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param
from kinegraph.stream.system.extras import optional

simulated: list[Any] = []
"""Libraries that replace pyorbbecsdk; the last one added."""


def library() -> Any:
    """pyorbbecsdk; raises DeviceError that says how to install it."""
    if simulated:
        return simulated[-1]
    return optional(
        "pyorbbecsdk", "an Orbbec camera", "pip install --no-deps pyorbbecsdk2 (it asks for numpy 1)", DeviceError
    )


def cameras(sdk: Any) -> list[dict[str, str]]:
    """What each connected camera says of itself: name, serial number, connection. Nothing is opened."""
    devices = sdk.Context().query_devices()
    return [
        {
            "name": devices.get_device_name_by_index(i),
            "serial": devices.get_device_serial_number_by_index(i),
            "connection": devices.get_device_connection_type_by_index(i),
        }
        for i in range(devices.get_count())
    ]


@dataclass(frozen=True, slots=True)
class Orbbec(DepthCamera):
    """An Orbbec depth camera, or a recording (.bag) that its library plays.

    depth    (height, width) uint16 mm; 0: no measurement there. Regular, at `fps`
    mono     (height, width) uint8, with `image: mono`: infrared, the same pixels; of 16 bits, the upper eight
    colour   (height, width, 3) uint8, with `image: colour`; the depth is then that of the colour camera's pixels
    timing   an event per frame: its number, the camera's time, arrival, stamp
    """

    maker: ClassVar[str] = "Orbbec"

    infrared: Literal["unknown", "flood", "dots"] = param(
        "unknown", help="what lights the infrared images: flood (Femto) or dots (Gemini, Astra)"
    )

    @property
    def light(self) -> str:
        return self.infrared if self.image == "mono" else "room"

    def prepare(self) -> None:
        DepthCamera.prepare(self)
        library()

    @contextmanager
    def opened(self) -> Iterator[OpenCamera]:
        sdk = library()
        try:
            pipeline = self._pipeline(sdk)
            config = self._config(sdk, pipeline)
            pipeline.enable_frame_sync()
            pipeline.start(config)
        except (RuntimeError, sdk.OBError) as error:
            raise DeviceError(
                f"an Orbbec camera cannot be opened: {error}; `kinegraph devices orbbec` lists them"
            ) from None
        try:
            yield OrbbecCamera(sdk, self, pipeline)
        finally:
            with suppress(RuntimeError, sdk.OBError):
                pipeline.stop()

    def missing(self) -> str:
        return "" if self.recording else self._missing(cameras(library()))

    def _missing(self, here: Sequence[Mapping[str, str]]) -> str:
        if any(self.device in ("", one["serial"]) for one in here):
            return ""
        known = ", ".join(f"{one['name']} {one['serial']}" for one in here) or "no others"
        return f"no Orbbec camera {self.device or 'is connected'}; there are {known}"

    def _pipeline(self, sdk: Any) -> Any:
        if self.recording:
            if not self.recording.exists():
                raise DeviceError(f"{self.recording} does not exist")
            return sdk.Pipeline(sdk.PlaybackDevice(str(self.recording)))
        here = cameras(sdk)
        if not_there := self._missing(here):
            raise DeviceError(not_there)
        chosen = [i for i, one in enumerate(here) if self.device in ("", one["serial"])]
        return sdk.Pipeline(sdk.Context().query_devices().get_device_by_index(chosen[0]))

    def _config(self, sdk: Any, pipeline: Any) -> Any:
        config = sdk.Config()
        if self.recording:
            config.enable_all_stream()
            return config
        wanted = [(sdk.OBSensorType.DEPTH_SENSOR, sdk.OBFormat.Y16)]
        if self.image:
            kinds = {
                "colour": (sdk.OBSensorType.COLOR_SENSOR, sdk.OBFormat.RGB),
                "mono": (sdk.OBSensorType.IR_SENSOR, sdk.OBFormat.Y8),
            }
            wanted.append(kinds[self.image])
        for sensor, form in wanted:
            profiles = pipeline.get_stream_profile_list(sensor)
            config.enable_stream(profiles.get_video_stream_profile(self.width, self.height, form, round(self.fps)))
        config.set_frame_aggregate_output_mode(sdk.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE)
        return config


class OrbbecCamera:
    """A pipeline that runs."""

    def __init__(self, sdk: Any, of: Orbbec, pipeline: Any) -> None:
        self._sdk, self._of, self._pipeline = sdk, of, pipeline
        info = pipeline.get_device().get_device_info()
        self.facts = {
            "name": info.get_name(),
            "serial": info.get_serial_number(),
            "firmware": info.get_firmware_version(),
        }
        self._align = sdk.AlignFilter(align_to_stream=sdk.OBStreamType.COLOR_STREAM) if of.image == "colour" else None
        self.intrinsics: tuple[float, float, float, float] | None = None
        with suppress(RuntimeError, sdk.OBError):
            params = pipeline.get_camera_param()
            lens = params.rgb_intrinsic if self._align else params.depth_intrinsic
            self.intrinsics = (float(lens.fx), float(lens.fy), float(lens.cx), float(lens.cy))

    def frame(self, within_s: float) -> CameraFrame | None:
        try:
            frames = self._pipeline.wait_for_frames(round(within_s * 1000))
        except (RuntimeError, self._sdk.OBError) as error:
            raise DeviceError(f"the Orbbec camera is gone: {error}") from None
        if frames is None:
            return None
        if self._align is not None:
            aligned = self._align.process(frames)
            frames = aligned.as_frame_set() if aligned is not None else None
        depth = frames.get_depth_frame() if frames is not None else None
        if depth is None:
            return None
        image = None
        if self._of.image:
            shown = frames.get_color_frame() if self._of.image == "colour" else frames.get_ir_frame()
            if shown is None:
                return None
            image = pixels(self._sdk, shown)
        return CameraFrame(int(depth.get_index()), int(depth.get_timestamp_us()) * 1000, depth_of(depth), image)


def depth_of(frame: Any) -> np.ndarray:
    """A depth frame (height, width) uint16 in mm. Raises DeviceError for one that is shorter than it says."""
    height, width = frame.get_height(), frame.get_width()
    data = np.frombuffer(frame.get_data(), np.uint8)
    if len(data) < 2 * height * width:
        raise DeviceError(f"a depth frame of {width} x {height} has {len(data)} bytes")
    return in_mm(data[: 2 * height * width].view(np.uint16).reshape(height, width), float(frame.get_depth_scale()))


def pixels(sdk: Any, frame: Any) -> np.ndarray:
    """An image: (height, width) uint8 of infrared, (height, width, 3) of colour. Raises DeviceError for a format that is not known."""
    height, width, form = frame.get_height(), frame.get_width(), frame.get_format()
    data = np.frombuffer(frame.get_data(), np.uint8)
    if form == sdk.OBFormat.RGB:
        return data.reshape(height, width, 3).copy()
    if form == sdk.OBFormat.BGR:
        return np.ascontiguousarray(data.reshape(height, width, 3)[..., ::-1])
    if form == sdk.OBFormat.Y8:
        return data.reshape(height, width).copy()
    if form == sdk.OBFormat.Y16:
        return (data.view(np.uint16).reshape(height, width) >> 8).astype(np.uint8)
    raise DeviceError(f"an image of format {form}; RGB, BGR, Y8 and Y16 are read")
