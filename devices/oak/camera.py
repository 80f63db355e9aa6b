"""An open camera: the pipeline on it, its queues, who it is, and how its connection fares."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, Protocol

from kinegraph.devices.oak.library import all_cameras, not_opened
from kinegraph.devices.oak.network import WantedNetwork, on_camera

QUEUE = 8
"""Messages that wait for us at most; then the oldest is dropped, which shows as a leap of the frames' numbers."""
BATCH = 10
"""Inertial packets at most in a message."""


class CameraLink:
    """The state of the connection, from a thread of depthai: RUNNING, DISCONNECTED, RECONNECTING or FAILED."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._state = "RUNNING"
        self._news: list[str] = []

    def tell(self, _device: Any, state: Any) -> None:
        """depthai's callback; returns at once."""
        with self._lock:
            if state.name != self._state:
                self._state = state.name
                self._news.append(state.name)

    @property
    def state(self) -> str:
        return self._state

    def news(self) -> list[str]:
        """The changes since the last call."""
        if not self._news:
            return []
        with self._lock:
            news, self._news = self._news, []
        return news


@dataclass(slots=True)
class Camera:
    """A camera with a running pipeline.

    depth      queue of depth frames
    imu        queue of inertial packets, where they are wanted
    image      queue of images, where they are wanted
    keypoints  queue of what the network on the camera sees, where there is one
    identity   serial number, model, sensors, USB speed
    light      sets the projector and the flood light; what the camera lacks of them
    """

    depth: Any
    imu: Any = None
    image: Any = None
    keypoints: Any = None
    identity: dict[str, Any] = field(default_factory=dict)
    light: Callable[[], list[str]] = list


class WantedOak(WantedNetwork, Protocol):
    """What is asked of a camera: the parameters of `devices.oak.Oak`, as far as they are read here."""

    @property
    def device(self) -> str: ...

    @property
    def depth(self) -> str: ...

    @property
    def preset(self) -> str: ...

    @property
    def height(self) -> int: ...

    @property
    def image(self) -> str: ...

    @property
    def imu_hz(self) -> float: ...

    @property
    def projector(self) -> float: ...

    @property
    def flood(self) -> float: ...


@contextmanager
def opened(dai: Any, of: WantedOak, link: CameraLink) -> Iterator[Camera]:
    """The camera that the source names, at work while the context lasts. Raises DeviceError.

    depthai itself would look for a camera for ten seconds, in which it cannot be stopped; so it is only asked for one that is there, or
    that is named by an address, for those beyond the next router are not seen.
    """
    if of.device.count(".") < 3 and not any(of.device in ("", info.deviceId, info.name) for info in all_cameras(dai)):
        raise not_opened(dai, of.device, RuntimeError("it is not there"))
    try:
        device = dai.Device(dai.DeviceInfo(of.device)) if of.device else dai.Device()
    except RuntimeError as error:
        raise not_opened(dai, of.device, error) from None
    with device, dai.Pipeline(device) as pipeline:
        try:
            node = _depth(dai, pipeline, of)
            depth = node.depth.createOutputQueue(maxSize=QUEUE, blocking=False)
            image, keypoints = _seen(dai, pipeline, of, node)
            imu = _imu(dai, pipeline, of) if of.imu_hz else None
            pipeline.setDeviceStateCallback(link.tell)
            pipeline.start()
        except RuntimeError as error:
            raise not_opened(dai, of.device, error) from None
        yield Camera(depth, imu, image, keypoints, identity_of(device), lambda: lit(device, of.projector, of.flood))


def lit(device: Any, projector: float, flood: float) -> list[str]:
    """Set the lights of a camera, which are off whenever its pipeline has started; the names of those that it lacks.

    What the graph does not ask for is left as it is: off.
    """
    wanted = (
        ("dot projector", projector, "setIrLaserDotProjectorIntensity"),
        ("flood light", flood, "setIrFloodLightIntensity"),
    )
    missing = []
    for name, intensity, method in wanted:
        if intensity > 0:
            try:
                done = bool(getattr(device, method)(intensity))
            except RuntimeError:  # the connection is gone again: when it is back this is called again
                continue
            if not done:
                missing.append(name)
    return missing


def _depth(dai: Any, pipeline: Any, of: WantedOak) -> Any:
    """The node of the pipeline that gives depth frames."""
    if of.depth == "tof":
        preset = {"profile": dai.ToFConfig.Profile.__members__[of.preset.upper()]} if of.preset else {}
        return pipeline.create(dai.node.ToF).build(fps=of.fps, **preset)
    presets = dai.node.StereoDepth.PresetMode.__members__
    return pipeline.create(dai.node.StereoDepth).build(
        autoCreateCameras=True,
        presetMode=presets[(of.preset or "default").upper()],
        size=(of.width, of.height),
        fps=of.fps,
    )


def _seen(dai: Any, pipeline: Any, of: WantedOak, depth: Any) -> tuple[Any, Any]:
    """The queues of images and of key points, None where they are not wanted.

    Images show what the depth shows, pixel by pixel: the rectified right camera, or colour to which depth is aligned. The network sees
    colour, which stays on the camera unless images are wanted too. Written after depthai's documentation; not tried on a camera.
    """
    image = keypoints = None
    if of.image == "mono":
        image = depth.rectifiedRight.createOutputQueue(maxSize=QUEUE, blocking=False)
    elif of.image or of.network:
        colour = pipeline.create(dai.node.Camera).build(dai.CameraBoardSocket.CAM_A)
        output = colour.requestOutput(
            (of.width, of.height), type=dai.ImgFrame.Type.RGB888i, fps=of.fps, enableUndistortion=True
        )
        output.link(depth.inputAlignTo)
        if of.image:
            image = output.createOutputQueue(maxSize=QUEUE, blocking=False)
        if of.network:
            keypoints = on_camera(dai, pipeline, of, depth, colour)
    return image, keypoints


def _imu(dai: Any, pipeline: Any, of: WantedOak) -> Any:
    node = pipeline.create(dai.node.IMU)
    sensors = [dai.IMUSensor.ACCELEROMETER_RAW, dai.IMUSensor.GYROSCOPE_RAW]
    node.enableIMUSensor(sensors, round(of.imu_hz))
    node.setBatchReportThreshold(1)
    node.setMaxBatchReports(BATCH)
    return node.out.createOutputQueue(maxSize=16 * QUEUE, blocking=False)


def identity_of(device: Any) -> dict[str, Any]:
    """Who a camera is, as far as it says."""
    asked: dict[str, Callable[[], Any]] = {
        "id": lambda: device.getDeviceId(),
        "model": lambda: device.getProductName() or device.getDeviceName(),
        "sensors": lambda: ", ".join(str(name) for name in device.getCameraSensorNames().values()),
        "imu": lambda: device.getConnectedIMU(),
        "bootloader": lambda: str(device.getBootloaderVersion() or ""),
        "usb": lambda: device.getUsbSpeed().name,
    }
    known: dict[str, Any] = {}
    for name, ask in asked.items():
        with suppress(RuntimeError, AttributeError):
            if answer := ask():
                known[name] = answer
    return known
