"""The OAK camera through the depthai library itself, and the simulated one."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.oak import Oak
from kinegraph.devices.oak.archive import pose_archive
from kinegraph.devices.oak.camera import _seen
from kinegraph.devices.oak.keypoint_sets import COCO, MARKERS
from kinegraph.devices.oak.keypoints import Sight, markers_of, sight_of
from kinegraph.devices.oak.library import library
from kinegraph.devices.oak.network import located
from kinegraph.devices.oak.simulated_keypoints import detection
from kinegraph.devices.oak.simulator import BOOTED_S, SimulatedCamera, SimulatedOak
from kinegraph.devices.oak.simulator import OakSimulator as Simulated
from kinegraph.devices.people.rendered_performer import EMPTY_S, POINTS
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.errors import DeviceError
from tests.devices.oak_runs import HEAD, archive, config, standing
from tests.support.device_feed import Kept, check, reading, wait_for

needs_depthai = [
    pytest.mark.skipif(find_spec("depthai") is None, reason="depthai is not installed (pip install 'kinegraph[oak]')"),
    pytest.mark.timeout(120, method="thread"),
    pytest.mark.xdist_group("depthai"),
]
WIDTH, HEIGHT = 320, 240
CAMERA = (224.0, 224.0, 159.5, 119.5)


# depthai itself on this computer -------------------------------------------------------------------------------------


class Bench:
    """depthai's calculator as the camera has it: depth and detections in, what the source would read out."""

    def __init__(self, dai: Any, camera: Any = CAMERA, of: Oak | None = None) -> None:
        self.dai, self.camera, self.of = dai, camera, of or Oak(width=WIDTH, height=HEIGHT, network="x")

    @contextmanager
    def running(self) -> Iterator[Bench]:
        dai = self.dai

        class Sends(dai.node.ThreadedHostNode):  # type: ignore[misc, name-defined]
            def __init__(self) -> None:
                dai.node.ThreadedHostNode.__init__(self)
                self.depth, self.sight = self.createOutput(), self.createOutput()

            def run(self) -> None: ...

        with dai.Pipeline(createImplicitDevice=False) as pipeline:
            self.node = pipeline.create(Sends)
            self.queue = located(dai, pipeline, self.of, self.node.depth, self.node.sight)
            pipeline.start()
            yield self

    def lens(self) -> Any:
        fx, fy, cx, cy = (float(v) for v in self.camera)
        return self.dai.ImgTransformation(WIDTH, HEIGHT, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])

    def depth(self, number: int, frame: Any) -> None:
        message = self.dai.ImgFrame()
        message.setData(np.ascontiguousarray(frame, np.uint16).view(np.uint8).reshape(-1))
        message.setType(self.dai.ImgFrame.Type.RAW16)
        message.setWidth(WIDTH)
        message.setHeight(HEIGHT)
        message.setStride(2 * WIDTH)
        self._send(self.node.depth, message, number)

    def see(self, number: int, *people: Samples, lens: Any = None) -> None:
        """People as key points (n, 3): x and y in shares of the image, confidence."""
        message = self.dai.ImgDetections()
        message.detections = [detection(self.dai, points, 0.9) for points in people]
        self._send(self.node.sight, message, number, lens)

    def _send(self, output: Any, message: Any, number: int, lens: Any = None) -> None:
        message.setTransformation(lens or self.lens())
        message.setSequenceNum(number)
        message.setTimestamp(timedelta(seconds=1 + number / 30))
        message.setTimestampDevice(timedelta(seconds=9 + number / 30))
        output.send(message)

    def sight(self, wait_s: float = 5.0) -> Sight | None:
        message = self.queue.get(timedelta(seconds=wait_s))
        return None if message is None else sight_of(message)


def shares(places: Samples, camera: Any = CAMERA) -> Samples:
    """Places (n, 3) before the camera as key points (n, 3) of full confidence."""
    pixels = places[:, :2] / places[:, 2:] * np.array(camera[:2]) + np.array(camera[2:])
    return np.column_stack([pixels / [WIDTH, HEIGHT], np.full(len(places), 0.9)])


@pytest.fixture
def bench() -> Iterator[Bench]:
    with Bench(library()).running() as running:
        yield running


class TestOnDepthai:
    pytestmark = needs_depthai

    def test_key_points_get_places_by_the_cameras_geometry(self, bench: Bench) -> None:
        people = [standing(-0.5, 2.5)[:, :3], standing(0.5, 2.5)[:, :3]]
        bench.depth(0, np.full((HEIGHT, WIDTH), 2500))
        bench.see(0, *[shares(person) for person in people])
        sight = bench.sight()
        assert sight and len(sight.people) == 2 and (sight.number, sight.device) == (0, 9 * NS)
        for seen, true in zip(sight.people, people, strict=True):
            assert np.abs(seen[:, :3] - true).max() < 0.015, "a pixel at this distance is 11 mm"
            assert seen[:, 3] == pytest.approx(0.9)

    def test_outside_the_picture_and_without_depth_nothing_is_made_up(self, bench: Bench) -> None:
        frame, points = np.full((HEIGHT, WIDTH), 2500), shares(standing()[:, :3])
        frame[:, :160] = 0
        points[COCO.names.index("left_ankle"), :2] = 0.6, 1.3
        points[COCO.names.index("left_wrist"), :2] = -0.2, 0.5
        points[COCO.names.index("left_knee"), 0] = 1.0
        bench.depth(0, frame)
        bench.see(0, points)
        sight = bench.sight()
        assert sight
        places, confidence = markers_of(sight.people[0])
        missing = {MARKERS[k] for k in np.flatnonzero(np.isnan(places).any(axis=1))}
        assert {"left_ankle", "left_wrist", "right_shoulder", "right_hip"} <= missing
        assert "left_shoulder" not in missing and not confidence[MARKERS.index("right_hip")]

    @pytest.mark.parametrize("value", [0, 65535])
    def test_no_valid_depth_is_nobody(self, value: int, bench: Bench) -> None:
        bench.depth(0, np.full((HEIGHT, WIDTH), value))
        bench.see(0, shares(standing()[:, :3]))
        sight = bench.sight()
        assert sight and np.isnan(markers_of(sight.people[0])[0]).all()

    def test_nobody_is_a_sample_too(self, bench: Bench) -> None:
        bench.depth(0, np.full((HEIGHT, WIDTH), 2500))
        bench.see(0)
        sight = bench.sight()
        assert sight and sight.people == []

    def test_what_the_network_says_late_meets_its_own_depth(self, bench: Bench) -> None:
        """depthai's calculator alone takes whatever depth waits."""
        points = shares(standing()[:, :3])
        for number in range(9):
            bench.depth(number, np.full((HEIGHT, WIDTH), 2000 + 100 * number))
        for number in (3, 5, 8):
            bench.see(number, points)
        found = [bench.sight() for _ in range(3)]
        assert [(s.number, round(float(s.people[0][5, 2]), 3)) for s in found if s] == [(3, 2.3), (5, 2.5), (8, 2.8)]

    def test_out_of_step_there_are_no_markers(self, bench: Bench) -> None:
        for number in range(4):
            bench.depth(number, np.full((HEIGHT, WIDTH), 2500))
        bench.see(7, shares(standing()[:, :3]))  # 130 ms later than any depth
        assert bench.sight(0.5) is None
        bench.depth(8, np.full((HEIGHT, WIDTH), 2600))
        bench.see(8, shares(standing()[:, :3]))
        sight = bench.sight()
        assert sight and sight.number == 8, "it goes on with the next pair"

    def test_the_network_may_see_the_image_within_borders(self, bench: Bench) -> None:
        """256 x 256 pixels, of which the image fills 256 x 192: its calculator alone would measure 20 cm off."""
        lens = bench.lens()
        lens.addScale(0.8, 0.8)
        lens.addPadding(32, 32, 0, 0)
        assert tuple(lens.getSize()) == (256, 256)
        true = standing()[:, :3]
        points = shares(true)
        points[:, 1] = (points[:, 1] * 192 + 32) / 256
        bench.depth(0, np.full((HEIGHT, WIDTH), 2500))
        bench.see(0, points, lens=lens)
        sight = bench.sight()
        assert sight and np.abs(sight.people[0][:, :3] - true).max() < 0.02

    def test_depthai_itself_takes_such_an_archive(self, tmp_path: Path) -> None:
        dai, path = library(), archive(tmp_path, config(HEAD))
        read = dai.NNArchive(path)
        (head,) = read.getConfig().model.heads
        assert (head.parser, head.metadata.nKeypoints) == ("YOLO", pose_archive(path).points)

    @pytest.mark.parametrize("image", ["", "colour"])
    def test_the_network_is_built_as_depthai_declares_it(self, image: Any, tmp_path: Path) -> None:
        """Camera and network can be made only with a camera: what is asked of them is held against depthai's own signatures."""
        dai, calls, links = library(), [], []
        real = ("Sync", "SpatialLocationCalculator", "Carrier")

        def output(name: str) -> Any:
            return SimpleNamespace(
                link=lambda to: links.append((name, to)), createOutputQueue=lambda **_: links.append((name, "host"))
            )

        class Made:
            """A node that writes down what is asked of it."""

            def __init__(self, name: str, kind: Any = None) -> None:
                self._name, self._kind = name, kind
                if kind is not None and kind.__name__ not in real:
                    self.out = output(f"{name}.out")

            def build(self, *given: Any, **named: Any) -> Any:
                calls.append((self._kind, given, named))
                return self

            def requestOutput(self, size: Any, **named: Any) -> Any:
                calls.append((self._kind.requestOutput, (size,), named))
                return output("image")

        with dai.Pipeline(createImplicitDevice=False) as pipeline:

            def create(kind: Any) -> Any:
                return pipeline.create(kind) if kind.__name__ in real else Made(kind.__name__, kind)

            depth = SimpleNamespace(depth=output("depth"), inputAlignTo="align")
            path = archive(tmp_path, config(HEAD))
            queues = _seen(dai, SimpleNamespace(create=create), Oak(network=path, image=image), depth)
        kinds = [kind for kind, _, _ in calls]
        assert kinds == [dai.node.Camera, dai.node.Camera.requestOutput, dai.node.DetectionNetwork]
        network = calls[2][2]
        assert network["resizeMode"] == dai.ImgResizeMode.LETTERBOX and isinstance(network["model"], dai.NNArchive)
        overloads = re.findall(r"build\(self: [\w.]+, (.*)\) -> depthai", dai.node.DetectionNetwork.build.__doc__)
        assert any(
            set(re.findall(r"(\w+): ", one)) >= set(network) and "depthai.node.Camera" in one for one in overloads
        )
        assert set(calls[1][2]) <= set(re.findall(r"(\w+): ", dai.node.Camera.requestOutput.__doc__))
        assert calls[1][2]["enableUndistortion"] is True, "the spec says that images are free of distortion"
        assert ("image", "align") in links, "depth is aligned to colour"
        assert (("image", "host") in links) == bool(image), "images stay on the camera unless they are wanted"
        assert {"depth", "DetectionNetwork.out"} <= {name for name, _ in links} and queues[1] is not None


# the simulated camera ------------------------------------------------------------------------------------------------


@contextmanager
def plugged_in(faults: FaultInjection = GOOD, **more: Any) -> Iterator[tuple[SimulatedOak, SimulatedCamera]]:
    of = Oak(width=320, height=200, network="is not needed")
    with Simulated(width=320, height=200, network=True, **more).plugged_in(faults) as camera:
        source = SimulatedOak.of(of, camera)
        source.prepare()
        yield source, camera


def errors(feed: Kept, camera: SimulatedCamera) -> Samples:
    """Distances of the markers to the performer's true joints (n, 13) m, of the frames in which somebody was there."""
    taken = {int(event["stamp"]): round((int(event["device"]) / NS - BOOTED_S) * 30) for event in feed.data("timing")}
    which, rows = [MARKERS.index(name) for name in POINTS], []
    for time, markers in zip(feed.time("markers").tolist(), feed.data("markers"), strict=True):
        seconds = taken[time] / 30  # a stamp that no depth frame bears is a KeyError
        if seconds < EMPTY_S:
            assert np.isnan(markers).all(), "no person is there"
        else:
            rows.append(np.linalg.norm(markers[which] - camera.performer.joints(seconds), axis=1))
    return np.array(rows)


class TestSimulated:
    pytestmark = needs_depthai

    def test_markers_are_where_the_performer_is(self) -> None:
        with plugged_in() as (source, camera):
            with reading(source) as feed:
                wait_for(lambda: feed.error is not None or feed.count("markers") >= 210, 60)
            check(source, feed)
            assert feed.error is None
            off = errors(feed, camera)
        assert len(off) > 60 and np.isfinite(off).mean() > 0.9
        assert np.nanmean(off) < 0.06 and np.nanmean(off, axis=0).max() < 0.12, np.nanmean(off, axis=0)

    def test_frames_that_were_lost_are_gaps_and_the_rest_is_right(self) -> None:
        with plugged_in(FaultInjection(lose=0.2, seed=3), blind_every_s=1.5, blind_s=0.3) as (source, camera):
            with reading(source) as feed:
                wait_for(lambda: feed.error is not None or feed.count("markers") >= 150, 60)
            assert feed.error is None
            off = errors(feed, camera)
        assert sum(feed.lost("markers").values()) > 10 and np.isnan(off).all(axis=1).any()
        assert np.nanmean(off) < 0.06

    def test_after_it_was_unplugged_it_goes_on(self) -> None:
        with plugged_in() as (source, camera), reading(source) as feed:
            wait_for(lambda: feed.count("markers") >= 10)
            camera.unplug()
            wait_for(lambda: feed.problems["connection lost"] == 1)
            camera.plug()
            before = feed.count("markers")
            wait_for(lambda: feed.count("markers") >= before + 10)
        assert -1 in feed.lost("markers").values() and (np.diff(feed.time("markers")) > 0).all()

    def test_a_network_that_says_nothing_is_an_error(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("kinegraph.devices.oak.source.FIRST_FRAME_S", 0.5)
        with plugged_in() as (source, _):
            monkeypatch.setattr(
                "kinegraph.devices.oak.simulator.RunningScene._sight", lambda self, frame: self._dai.ADatatype()
            )
            object.__setattr__(source, "lost_after_s", 0.5)
            with reading(source) as feed:
                wait_for(lambda: feed.error is not None)
        assert isinstance(feed.error, DeviceError) and "has given nothing" in str(feed.error)
