"""Azure Kinect (and Orbbec's cameras with its interface) through pyk4a; its wheels need numpy 1 until they are rebuilt."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from kinegraph.devices.cameras.depth_camera import CameraFrame, DepthCamera, OpenCamera
from kinegraph.stream.chunk import Specs
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.system.extras import optional

MODES = {
    (320, 288): "NFOV_2X2BINNED",
    (640, 576): "NFOV_UNBINNED",
    (512, 512): "WFOV_2X2BINNED",
    (1024, 1024): "WFOV_UNBINNED",
}
"""pyk4a's names of the sizes of depth frames."""
RATES = {5: "FPS_5", 15: "FPS_15", 30: "FPS_30"}
MAX_INFRARED = 1000
"""What is white; brighter is as white."""


def library() -> Any:
    """pyk4a; raises DeviceError that says how to install it."""
    return optional(
        "pyk4a",
        "an Azure Kinect",
        "pip install --no-deps --no-binary pyk4a pyk4a (its wheels need numpy 1)",
        DeviceError,
    )


@dataclass(frozen=True, slots=True)
class AzureKinect(DepthCamera):
    """An Azure Kinect, or a recording (.mkv) that its library plays.

    depth    (height, width) uint16 mm; 0: no measurement there. The size chooses the mode: 640 x 576, 320 x 288, 512 x 512, 1024 x 1024
    mono     (height, width) uint8, with `image: mono`: infrared, the same pixels, brightest at 1000 counts
    timing   an event per frame: the camera's time, arrival, stamp; frames have no number, what is missing is known from the time

    There is no `image: colour`: the colour camera has other pixels.
    """

    maker: ClassVar[str] = "Azure Kinect"

    height: int = param(576, least=16, most=4096, help="rows of a depth frame")

    def specs(self) -> Specs:
        if (self.width, self.height) not in MODES:
            raise ParameterError("width", self.width, f"with height one of {', '.join(f'{w} x {h}' for w, h in MODES)}")
        if self.fps not in RATES:
            raise ParameterError("fps", self.fps, "5, 15 or 30")
        if self.image == "colour":
            raise ParameterError("image", "colour", "mono, or left out: the colour camera has other pixels")
        return super(AzureKinect, self).specs()

    @property
    def light(self) -> str:
        return "flood"

    def missing(self) -> str:
        if self.recording:
            return ""
        count = library().connected_device_count()
        wanted = int(self.device) if self.device.isdigit() else 0
        return (
            ""
            if wanted < count
            else f"no Azure Kinect of number {wanted} is connected; there are {count or 'no others'}"
        )

    def prepare(self) -> None:
        DepthCamera.prepare(self)
        library()

    @contextmanager
    def opened(self) -> Iterator[OpenCamera]:
        k4a = library()
        if self.recording:
            if not self.recording.exists():
                raise DeviceError(f"{self.recording} does not exist")
            device = k4a.PyK4APlayback(str(self.recording))
            start, stop = device.open, device.close
        else:
            mode, rate = getattr(k4a.DepthMode, MODES[self.width, self.height]), getattr(k4a.FPS, RATES[int(self.fps)])
            config = k4a.Config(
                color_resolution=k4a.ColorResolution.OFF,
                depth_mode=mode,
                camera_fps=rate,
                synchronized_images_only=False,
            )
            device = k4a.PyK4A(config, device_id=int(self.device) if self.device.isdigit() else 0)
            start, stop = device.start, device.stop
        try:
            start()
        except k4a.K4AException as error:
            raise DeviceError(
                f"an Azure Kinect cannot be opened: {error}; is it plugged into USB 3 and into its power supply?"
            ) from None
        try:
            yield KinectCamera(k4a, self, device)
        finally:
            stop()


class KinectCamera:
    """A camera, or a recording, that runs."""

    def __init__(self, k4a: Any, of: AzureKinect, device: Any) -> None:
        self._k4a, self._of, self._device = k4a, of, device
        self.facts = {} if of.recording else {"serial": str(device.serial)}
        lens = device.calibration.get_camera_matrix(k4a.CalibrationType.DEPTH)
        self.intrinsics = (float(lens[0, 0]), float(lens[1, 1]), float(lens[0, 2]), float(lens[1, 2]))

    def frame(self, within_s: float) -> CameraFrame | None:
        if self._of.recording:
            capture = self._device.get_next_capture()  # raises EOFError at the end
        else:
            try:
                capture = self._device.get_capture(timeout=round(within_s * 1000))
            except self._k4a.K4ATimeoutException:
                return None
            except self._k4a.K4AException as error:
                raise DeviceError(f"the Azure Kinect is gone: {error}") from None
        if capture.depth is None:
            return None
        image = None
        if self._of.image:
            if capture.ir is None:
                return None
            image = (np.minimum(capture.ir, MAX_INFRARED) * (255.0 / MAX_INFRARED)).astype(np.uint8)
        return CameraFrame(-1, int(capture.depth_timestamp_usec) * 1000, np.array(capture.depth, np.uint16), image)
