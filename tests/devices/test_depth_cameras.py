"""Depth cameras: RealSense through its library on a recording that the library itself made; Orbbec and Azure Kinect on stand-ins for
theirs, and Orbbec's frames as its library makes them."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.cameras.discovery import find_orbbec
from kinegraph.devices.cameras.kinect import AzureKinect
from kinegraph.devices.cameras.orbbec import Orbbec, depth_of, pixels
from kinegraph.devices.cameras.orbbec_simulator import SERIAL, OrbbecLibrary, camera
from kinegraph.devices.cameras.realsense import RealSense, in_mm
from kinegraph.devices.oak import Oak
from kinegraph.stream.errors import DeviceError, ParameterError
from tests.support.device_feed import check, reading, wait_for

WIDTH, HEIGHT = 160, 120


@pytest.mark.parametrize("image", ["", "mono", "colour"])
def test_an_orbbec_camera(image: Any) -> None:
    source = Orbbec(width=WIDTH, height=HEIGHT, image=image)
    with camera(OrbbecLibrary()) as library:
        with reading(source) as feed:
            wait_for(lambda: feed.error is not None or feed.count("depth") > 8)
        assert library.stopped == 1
    assert feed.error is None, feed.error
    check(source, feed)
    first = int(feed.data("timing")["counter"][0])
    for i, frame in enumerate(feed.data("depth")[:5]):
        assert np.array_equal(frame, library.depth(first + i))
    assert feed.identity["serial"] == SERIAL and feed.identity["fx"] == 252.3
    if image:
        assert feed.count(image) == feed.count("depth")


@pytest.mark.parametrize(
    ("source", "light", "distortion"),
    [
        (RealSense(image="mono"), "dots", [0.0] * 5),
        (RealSense(image="mono", projector=False), "room", [0.0] * 5),
        (RealSense(image="colour"), "room", [0.0] * 5),
        (AzureKinect(image="mono"), "flood", None),
        (Orbbec(image="mono"), "unknown", None),
        (Orbbec(image="mono", infrared="dots", distortion=(0.1, -0.2, 0.0, 0.0)), "dots", [0.1, -0.2, 0.0, 0.0]),
        (Oak(image="mono"), "room", [0.0] * 5),
        (Oak(image="mono", flood=0.5), "flood", [0.0] * 5),
        (Oak(image="mono", flood=0.5, projector=0.5), "dots", [0.0] * 5),
        (Oak(image="colour", projector=0.5), "room", [0.0] * 5),
    ],
    ids=repr,
)
def test_the_spec_says_lens_place_and_light_of_an_image(source: Any, light: str, distortion: Any) -> None:
    specs = source.specs()
    image, depth = specs[source.image], specs["depth"]
    assert image.meta["light"] == light and image.dtype == np.uint8 and image.shape[:2] == depth.shape
    for lens in (image.meta["camera"], depth.meta["camera"]):
        assert {"fx", "fy", "cx", "cy"} < set(lens) and lens["distortion"] == distortion
        assert lens["extrinsics"] == {"rotation": np.eye(3).tolist(), "translation": [0.0, 0.0, 0.0]}


def test_coefficients_of_no_lens_are_refused() -> None:
    with pytest.raises(ParameterError, match="4, 5 or 8 numbers"):
        Orbbec(distortion=(0.1, 0.2)).specs()


def test_orbbec_frames_that_are_missing_are_counted_and_a_pulled_cable_is_told() -> None:
    with camera(OrbbecLibrary(lose=4)) as library, reading(Orbbec(width=WIDTH, height=HEIGHT)) as feed:
        wait_for(lambda: feed.error is not None or feed.count("depth") > 9)
        library.pulled = True
        wait_for(lambda: feed.error is not None)
    assert "the Orbbec camera is gone: device disconnected" in str(feed.error)
    assert set(feed.lost("depth").values()) == {1} and feed.problems["lost frame"] == len(feed.lost("depth"))


def test_orbbec_cameras_are_found() -> None:
    with camera(OrbbecLibrary()):
        (found,) = find_orbbec()
        with reading(Orbbec(device="other")) as feed:
            wait_for(lambda: feed.error is not None)
    assert (found.address, found.yaml) == (SERIAL, f'use: devices.cameras.orbbec.Orbbec\ndevice: "{SERIAL}"')
    assert f"no Orbbec camera other; there are Orbbec Femto Bolt {SERIAL}" in str(feed.error)


def test_a_size_that_is_not_the_cameras_is_told() -> None:
    with camera(OrbbecLibrary()), reading(Orbbec(width=320, height=240)) as feed:
        wait_for(lambda: feed.error is not None)
    assert "write width: 160 and height: 120" in str(feed.error)


def test_frames_of_orbbecs_own_library() -> None:
    sdk = pytest.importorskip("pyorbbecsdk")
    raw = (np.arange(HEIGHT * WIDTH, dtype=np.uint16) % 4000).reshape(HEIGHT, WIDTH)
    frame = sdk.Frame.create_video_frame(sdk.OBFrameType.DEPTH_FRAME, sdk.OBFormat.Y16, WIDTH, HEIGHT, 2 * WIDTH)
    frame.update_data(raw.tobytes())
    depth = frame.as_depth_frame()
    scale = depth.get_depth_scale() or 1.0
    if not depth.get_depth_scale():
        depth = SimpleNamespace(
            get_height=depth.get_height, get_width=depth.get_width, get_data=depth.get_data, get_depth_scale=lambda: 1.0
        )
    assert np.array_equal(depth_of(depth), in_mm(raw, scale))
    grey = sdk.Frame.create_video_frame(sdk.OBFrameType.IR_FRAME, sdk.OBFormat.Y8, WIDTH, HEIGHT, WIDTH)
    grey.update_data((raw % 256).astype(np.uint8).tobytes())
    assert np.array_equal(pixels(sdk, grey.as_video_frame()), raw % 256)


@pytest.fixture
def realsense_recording(tmp_path: Path) -> tuple[Path, np.ndarray]:
    """Ten frames of a software device, written by the library's own recorder; and what they hold."""
    rs = pytest.importorskip("pyrealsense2")
    device = rs.software_device()
    sensor = device.add_sensor("Depth")
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.width, stream.height = rs.stream.depth, 0, 1, WIDTH, HEIGHT
    stream.fps, stream.bpp, stream.fmt = 30, 2, rs.format.z16
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = WIDTH, HEIGHT, 120.0, 121.0, 79.5, 59.5
    stream.intrinsics = lens
    profile = sensor.add_video_stream(stream)
    sensor.add_read_only_option(rs.option.depth_units, 0.0005)
    path = tmp_path / "made.db3"
    recorder = rs.recorder(str(path), device)
    recording = recorder.query_sensors()[0]
    recording.open(recording.get_stream_profiles()[0])
    queue = rs.frame_queue(20)
    recording.start(queue)
    raw = (np.arange(10)[:, None, None] * 100 + np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) % 5000).astype(
        np.uint16
    )
    for i, pixels_of in enumerate(raw):
        frame = rs.software_video_frame()
        frame.stride, frame.bpp, frame.timestamp, frame.frame_number = (
            2 * WIDTH,
            2,
            1000.0 + i * 1000 / 30,
            i + 1 + (i > 5),
        )
        frame.domain, frame.profile, frame.pixels = (
            rs.timestamp_domain.hardware_clock,
            profile.as_video_stream_profile(),
            pixels_of,
        )
        sensor.on_video_frame(frame)
    recording.stop()
    recording.close()
    del recorder
    return path, raw


def test_a_realsense_recording_comes_back_bit_for_bit(realsense_recording: tuple[Path, np.ndarray]) -> None:
    path, raw = realsense_recording
    source = RealSense(width=WIDTH, height=HEIGHT, recording=path)
    with reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("depth") == 10)
    assert feed.error is None, feed.error
    check(source, feed)
    assert np.array_equal(feed.data("depth"), np.rint(raw * 0.5).astype(np.uint16)), "in mm"
    assert feed.lost("depth") == {6: 1} and np.allclose(np.diff(feed.time("depth")), 1e9 / 30, atol=2000)
    assert (feed.identity["fx"], feed.identity["cy"]) == (120.0, 59.5)


class KinectFailure(Exception):
    """What stands in for pyk4a's exception."""


class KinectRecording:
    """Three frames, then the end, as pyk4a's playback gives them."""

    def __init__(self, path: str) -> None:
        self.at = 0
        self.calibration = SimpleNamespace(
            get_camera_matrix=lambda _: np.array([[504.6, 0, 332.8], [0, 504.7, 327.1], [0, 0, 1]])
        )

    def open(self) -> None: ...

    def close(self) -> None: ...

    def get_next_capture(self) -> Any:
        if self.at == 3:
            raise EOFError
        self.at += 1
        depth = np.full((576, 640), 1000 + self.at, np.uint16)
        return SimpleNamespace(depth=depth, ir=depth, depth_timestamp_usec=self.at * 33_333)


def test_an_azure_kinect_on_a_stand_in_for_its_library(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fake = SimpleNamespace(
        PyK4APlayback=KinectRecording, K4AException=KinectFailure, CalibrationType=SimpleNamespace(DEPTH=1)
    )
    monkeypatch.setitem(sys.modules, "pyk4a", fake)  # type: ignore[arg-type]
    (tmp_path / "made.mkv").touch()
    source = AzureKinect(recording=tmp_path / "made.mkv", image="mono")
    with reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("mono") == 3)
    assert feed.error is None, feed.error
    check(source, feed)
    assert feed.data("depth")[:, 0, 0].tolist() == [1001, 1002, 1003] and feed.data("mono").max() == 255


def test_what_a_kinect_cannot_do_is_told() -> None:
    for more in ({"width": 641}, {"fps": 20.0}, {"image": "colour"}):
        with pytest.raises(ParameterError):
            AzureKinect(**more).specs()  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("source", "module"), [(Orbbec(), "pyorbbecsdk"), (RealSense(), "pyrealsense2"), (AzureKinect(), "pyk4a")]
)
def test_without_the_library_it_is_named(source: Any, module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)  # type: ignore[arg-type]
    with pytest.raises(DeviceError, match="pip install"):
        source.prepare()


def test_no_camera_is_told() -> None:
    pytest.importorskip("pyrealsense2")
    with reading(RealSense()) as feed:
        wait_for(lambda: feed.error is not None)
    assert "a RealSense camera cannot be opened" in str(feed.error)
