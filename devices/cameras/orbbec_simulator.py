"""A simulated Orbbec camera before a performer: a replacement for pyorbbecsdk, with the calls and the frames of that library."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from enum import Enum
from types import SimpleNamespace
from typing import Any

import numpy as np

from kinegraph.devices.cameras import orbbec
from kinegraph.devices.cameras.orbbec import Orbbec
from kinegraph.devices.people.sleeper import Sleeper
from kinegraph.stream.chunk import Array

SERIAL = "CL8F0000001"
SCALE = 0.25
"""mm in a unit of its depth."""


class OrbbecFailure(Exception):
    """Replaces pyorbbecsdk.OBError."""


class SimulatedFrame:
    """A frame as the library gives it."""

    def __init__(self, number: int, us: int, pixels: Array, form: Any) -> None:
        self._number, self._us, self._pixels, self._form = number, us, pixels, form

    def get_height(self) -> int:
        return int(self._pixels.shape[0])

    def get_width(self) -> int:
        return int(self._pixels.shape[1])

    def get_data(self) -> Array:
        return np.frombuffer(self._pixels.tobytes(), np.uint8)

    def get_format(self) -> Any:
        return self._form

    def get_index(self) -> int:
        return self._number

    def get_timestamp_us(self) -> int:
        return self._us

    def get_depth_scale(self) -> float:
        return SCALE


class OrbbecLibrary:
    """The library, with one camera. `lose`: every `lose`-th frame is dropped; `pulled`: the cable is out."""

    OBError = OrbbecFailure
    OBSensorType = Enum("OBSensorType", "DEPTH_SENSOR IR_SENSOR COLOR_SENSOR")
    OBFormat = Enum("OBFormat", "Y16 Y8 RGB BGR MJPG")
    OBStreamType = Enum("OBStreamType", "COLOR_STREAM")
    OBFrameAggregateOutputMode = Enum("OBFrameAggregateOutputMode", "FULL_FRAME_REQUIRE")

    def __init__(self, width: int = 160, height: int = 120, fps: float = 30.0, lose: int = 0) -> None:
        self.scene = Sleeper(width, height, seed=1, per_min=10, invalid=0.05)
        self.fps, self.lose, self.pulled, self.stopped = fps, lose, False, 0
        self.began = time.monotonic()

    def depth(self, number: int) -> Array:
        """What the camera measured (height, width) uint16 mm, in its own steps."""
        return np.asarray(self.scene.frame(number, number / self.fps), np.uint16)

    def Context(self) -> Any:
        return SimpleNamespace(query_devices=lambda: self)

    def get_count(self) -> int:
        return 0 if self.pulled else 1

    def get_device_name_by_index(self, _: int) -> str:
        return "Orbbec Femto Bolt"

    def get_device_serial_number_by_index(self, _: int) -> str:
        return SERIAL

    def get_device_connection_type_by_index(self, _: int) -> str:
        return "USB3.0"

    def get_device_by_index(self, _: int) -> Any:
        return self

    def get_device_info(self) -> Any:
        return SimpleNamespace(
            get_name=lambda: "Orbbec Femto Bolt", get_serial_number=lambda: SERIAL, get_firmware_version=lambda: "1.1.2"
        )

    def Config(self) -> Any:
        nothing: Any = lambda *_: None  # noqa: E731
        return SimpleNamespace(
            enable_stream=nothing, enable_all_stream=nothing, set_frame_aggregate_output_mode=nothing
        )

    def AlignFilter(self, align_to_stream: Any) -> Any:
        return SimpleNamespace(process=lambda frames: SimpleNamespace(as_frame_set=lambda: frames))

    def Pipeline(self, device: Any) -> Any:
        return OrbbecPipeline(self)


class OrbbecPipeline:
    """A camera that runs."""

    def __init__(self, of: OrbbecLibrary) -> None:
        self._of, self._said = of, 0

    def get_stream_profile_list(self, _: Any) -> Any:
        return SimpleNamespace(get_video_stream_profile=lambda *_: None)

    def enable_frame_sync(self) -> None: ...

    def start(self, _: Any) -> None:
        self._said = int((time.monotonic() - self._of.began) * self._of.fps)

    def stop(self) -> None:
        self._of.stopped += 1

    def get_device(self) -> Any:
        return self._of

    def get_camera_param(self) -> Any:
        lens = SimpleNamespace(fx=252.3, fy=252.4, cx=80.1, cy=60.2)
        return SimpleNamespace(depth_intrinsic=lens, rgb_intrinsic=lens)

    def wait_for_frames(self, timeout_ms: int) -> Any:
        if self._of.pulled:
            raise OrbbecFailure("device disconnected")
        number = self._said
        due = self._of.began + (number + 1) / self._of.fps
        if (left := due - time.monotonic()) > timeout_ms / 1000:
            time.sleep(timeout_ms / 1000)
            return None
        time.sleep(max(0.0, left))
        self._said += 1
        if self._of.lose and number % self._of.lose == 0:
            return None
        us, forms = round(1e6 * number / self._of.fps) + 77_000_000, self._of.OBFormat
        depth = self._of.depth(number)
        frames = {
            "depth": SimulatedFrame(number, us, np.asarray(depth / SCALE, np.uint16), forms.Y16),
            "ir": SimulatedFrame(number, us, (depth >> 4).astype(np.uint8), forms.Y8),
            "color": SimulatedFrame(number, us, np.stack([depth >> 4] * 3, -1).astype(np.uint8), forms.RGB),
        }
        return SimpleNamespace(**{f"get_{kind}_frame": (lambda f=frame: f) for kind, frame in frames.items()})


@contextmanager
def camera(library: OrbbecLibrary) -> Iterator[OrbbecLibrary]:
    """While the context lasts, this camera is the only one connected."""
    orbbec.simulated.append(library)
    try:
        yield library
    finally:
        orbbec.simulated.remove(library)


@contextmanager
def simulated(source: Orbbec) -> Iterator[Orbbec]:
    """What `--simulate` puts in its place."""
    with camera(OrbbecLibrary(source.width, source.height, source.fps)):
        yield replace(source, device=SERIAL, recording=None)
