"""A pose network on an OAK camera: its archive, depthai's own calculator on this computer, its markers, and the simulated camera.

What needs a camera (the camera node, stereo, the network) is held against depthai's signatures.
"""

from __future__ import annotations

import io
import json
import re
import tarfile
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
from kinegraph.devices.oak.keypoint_sets import BLAZEPOSE, COCO, INSIDE_M, MARKERS
from kinegraph.devices.oak.keypoints import Keypoints, Sight, markers_of, sight_of
from kinegraph.devices.oak.library import library
from kinegraph.devices.oak.network import located
from kinegraph.devices.oak.simulated_keypoints import detection
from kinegraph.devices.oak.simulator import BOOTED_S, SimulatedCamera, SimulatedOak
from kinegraph.devices.oak.simulator import OakSimulator as Simulated
from kinegraph.devices.people.rendered_performer import EMPTY_S, POINTS
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.operators.body import names, placing
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.engine.warmup import warm_up
from kinegraph.stream.errors import DeviceError, GraphError, ParameterError
from kinegraph.stream.graph.reading.load import load_text
from tests.support.device_feed import Kept, check, reading, wait_for

needs_depthai = [
    pytest.mark.skipif(find_spec("depthai") is None, reason="depthai is not installed (pip install 'kinegraph[oak]')"),
    pytest.mark.timeout(120, method="thread"),
    pytest.mark.xdist_group("depthai"),
]
WIDTH, HEIGHT = 320, 240
NOW = 1_700_000_000 * NS
FRAME = NS // 30
CAMERA = (224.0, 224.0, 159.5, 119.5)
HEAD: dict[str, Any] = {
    "parser": "YOLO",
    "metadata": {"n_keypoints": 17, "keypoints_outputs": ["kpt"], "yolo_outputs": ["out"], "classes": ["person"]},
}


# the archive ---------------------------------------------------------------------------------------------------------


def config(*heads: Any) -> dict[str, Any]:
    inputs = {"name": "images", "dtype": "uint8", "input_type": "image", "shape": [1, 3, 256, 256], "layout": "NCHW"}
    inputs["preprocessing"] = {"mean": [0, 0, 0], "scale": [255, 255, 255]}
    facts = {"name": "pose", "path": "pose.onnx", "precision": "float16"}
    outputs = [{"name": name, "dtype": "float32"} for name in ("out", "kpt")]
    return {
        "config_version": "1.0",
        "model": {"metadata": facts, "inputs": [inputs], "outputs": outputs, "heads": list(heads)},
    }


def archive(folder: Path, reported: Any, name: str = "config.json") -> str:
    path = folder / "pose.tar.xz"
    with tarfile.open(path, "w:xz") as tar:
        for entry, data in (
            (name, reported if isinstance(reported, bytes) else json.dumps(reported).encode()),
            ("pose.onnx", b"made up"),
        ):
            about = tarfile.TarInfo(entry)
            about.size = len(data)
            tar.addfile(about, io.BytesIO(data))
    return str(path)


@pytest.mark.parametrize("points", [17, 33])
def test_an_archive_of_a_pose_network_is_taken(points: int, tmp_path: Path) -> None:
    head = {**HEAD, "metadata": {**HEAD["metadata"], "n_keypoints": points}}
    path = archive(tmp_path, config({"parser": "YOLO", "metadata": {}}, head))
    assert pose_archive(path) == ("pose", points)


@pytest.mark.parametrize(
    ("expected", "name", "why"),
    [
        (config(HEAD), "settings.json", "config.json in it; this archive lacks it"),
        (b"{broken", "config.json", "this one is not JSON"),
        ([1, 2], "config.json", "holds no settings"),
        ({"model": {}}, "config.json", "names the network's heads"),
        (config({"parser": "YOLO", "metadata": {"classes": ["cup"]}}), "config.json", "YOLO with no key points"),
        (
            config({**HEAD, "metadata": {"n_keypoints": 21}}),
            "config.json",
            r"17 \(COCO\), 33 \(BlazePose\); this one is YOLO with 21",
        ),
        (config({**HEAD, "parser": "HRNetParser"}), "config.json", "with the parser YOLO.*HRNetParser with 17"),
        (config("YOLO"), "config.json", "YOLO with no key points"),
    ],
)
def test_another_archive_is_refused_with_what_to_do(expected: Any, name: str, why: str, tmp_path: Path) -> None:
    path = archive(tmp_path, expected, name)
    with pytest.raises(ParameterError, match=why) as refused:
        pose_archive(path)
    assert path in str(refused.value)


def test_no_archive_at_all_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"nothing_there\.tar\.xz.*no such file"):
        pose_archive(str(tmp_path / "nothing_there.tar.xz"))
    text = tmp_path / "text.tar.xz"
    text.write_text("a page that says: not found")
    with pytest.raises(ParameterError, match=r"cannot be read as one.*fetch it again"):
        pose_archive(str(text))
    whole = Path(archive(tmp_path, config(HEAD))).read_bytes()
    text.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ParameterError, match="fetch it again"):
        pose_archive(str(text))


def test_the_source_says_what_is_wrong_before_it_opens_anything(tmp_path: Path) -> None:
    pytest.importorskip("depthai")
    source = Oak(network=str(tmp_path / "none.tar.xz"))
    assert source.outputs == ("depth", "markers", "confidence", "timing") and set(source.specs()) == set(source.outputs)
    with pytest.raises(ParameterError, match="no such file"):
        source.prepare()
    facts = {"nodes": {"eye": {"use": "devices.oak.Oak", "network": source.network}}, "record": ["eye.markers"]}
    with pytest.raises(GraphError, match=r"node 'eye': network is .*no such file"):
        warm_up(Pipeline(load_text(json.dumps(facts))))
    for other in (Oak(network="x", image="mono"), Oak(network="x", depth="tof", height=480)):
        with pytest.raises(ParameterError, match="network is 'x'"):
            other.specs()


# from key points to markers, without depthai -------------------------------------------------------------------------


def test_names_and_depths_are_those_of_the_body() -> None:
    assert MARKERS == names.MARKERS
    assert np.array_equal(INSIDE_M, placing.INSIDE[names.TAKEN])
    assert BLAZEPOSE.names == names.LANDMARKS[:33]
    assert set(COCO.names) - set(MARKERS) == {"left_eye", "right_eye"}


def standing(x: float = 0.0, z: float = 2.5, sure: float = 0.9, *, known: Any = COCO) -> Samples:
    """Someone upright: key points (n, 4) on the body's surface."""
    up = {
        "nose": -0.6,
        "ear": -0.6,
        "shoulder": -0.4,
        "elbow": -0.15,
        "wrist": 0.1,
        "hip": 0.1,
        "knee": 0.5,
        "ankle": 0.9,
        "heel": 0.95,
        "toe": 0.95,
    }
    points = np.empty((len(known.names), 4))
    for row, name in zip(points, known.names, strict=True):
        side = 0.18 if name.startswith("left") else -0.18 if name.startswith("right") else 0.0
        part = name.removeprefix("left_").removeprefix("right_")
        row[:] = x + (side if part not in ("ear", "eye") else side / 3), up.get(part, -0.6), z, sure
    return points


@pytest.mark.parametrize("known", [COCO, BLAZEPOSE])
def test_key_points_become_markers_inside_the_body(known: Any) -> None:
    places, confidence = markers_of(standing(known=known))
    absent = {MARKERS[k] for k in np.flatnonzero(np.isnan(places).any(axis=1))}
    assert absent == ({"left_heel", "right_heel", "left_toe", "right_toe"} if known is COCO else set())
    hip, on = MARKERS.index("left_hip"), np.array([0.18, 0.1, 2.5])
    assert places[hip] == pytest.approx(on * 2.6 / 2.5) and confidence[hip] == 0.9
    ears = places[[MARKERS.index("left_ear"), MARKERS.index("right_ear")]]
    assert places[MARKERS.index("head")] == pytest.approx(ears.mean(axis=0))


def test_what_was_measured_on_something_else_is_missing() -> None:
    points = standing()
    points[COCO.names.index("left_wrist"), 2] = 4.2  # the wall beside the hand
    points[COCO.names.index("right_knee"), 2] = 1.7  # a chair before it
    points[COCO.names.index("left_ear"), 2] = 0.0  # not measured
    points[COCO.names.index("nose"), 0] = np.nan
    places, confidence = markers_of(points)
    missing = {MARKERS[k] for k in np.flatnonzero(~np.isfinite(places).all(axis=1))}
    assert {"left_wrist", "right_knee", "left_ear", "nose"} <= missing and not confidence[
        [MARKERS.index(n) for n in missing]
    ].any()
    assert "head" not in missing and "left_elbow" not in missing


def sights(
    *people: list[Samples], number: int = 0, step: int = 1, least: float = 0.5
) -> list[tuple[Samples, int, int]]:
    """Markers, stamp and loss of each of these frames."""
    kept, out = Keypoints(NOW, 0, least, FRAME // 3), []
    for i, seen in enumerate(people):
        device = (number + i * step) * FRAME
        kept.depth(device, NOW + device + 5)
        kept.see(Sight(number + i * step, device, device, seen))
        out += [(markers.data[0], int(markers.time[0]), markers.lost) for markers, _ in kept.take()]
    return out


def test_of_several_people_the_nearest_is_followed_and_kept() -> None:
    near, far = standing(-0.5, 2.0), standing(0.8, 3.0)
    frames = [[far, near]] * 3 + [[standing(-0.5 + 0.02 * i, 2.0), standing(0.8, 3.0 - 0.05 * i)] for i in range(30)]
    middles = [float(np.nanmedian(markers[:, 0])) for markers, _, _ in sights(*frames)]
    assert np.all(np.abs(np.diff(middles)) < 0.05) and middles[-1] < 0.2, "the other one came nearer, and was taken"
    gone = sights(*[[near, far]] * 3, *[[far]] * 45)
    seen = [bool(np.isfinite(markers).any()) for markers, _, _ in gone]
    assert seen[:3] == [True] * 3 and not any(seen[3:30]) and seen[-1], "another one is followed after a second"


def test_nobody_in_view_is_nan_and_time_goes_on() -> None:
    found = sights([], [], [standing()], [])
    assert [bool(np.isfinite(m).any()) for m, _, _ in found] == [False, False, True, False]
    assert [stamp for _, stamp, _ in found] == [NOW + i * FRAME + 5 for i in range(4)]
    one = standing()
    one[3:] = 0.0
    assert np.isnan(sights([one])[0][0]).all(), "three points are no person"


def test_low_confidence_is_missing() -> None:
    unsure = standing()
    unsure[COCO.names.index("left_elbow"), 3] = 0.3
    elbow = MARKERS.index("left_elbow")
    assert np.isnan(sights([unsure])[0][0][elbow]).all()
    assert np.isfinite(sights([unsure], least=0.2)[0][0][elbow]).all()
    assert np.isnan(sights([standing(sure=0.3)])[0][0]).all()


def test_what_is_missing_is_known_and_late_words_bear_the_stamp_of_their_depth() -> None:
    assert [lost for _, _, lost in sights([], [], [], step=3)] == [0, 2, 2]
    kept, got = Keypoints(NOW, 0, 0.5, FRAME // 3), []
    for i in range(10):
        kept.depth(i * FRAME, NOW + i * FRAME)
        if i >= 4:  # the network is four frames late
            kept.see(Sight(i - 4, (i - 4) * FRAME + 1_000_000, (i - 4) * FRAME, [standing()]))
        got += kept.take()
    assert [int(m.time[0]) for m, _ in got] == [NOW + i * FRAME for i in range(6)]
    early = Keypoints(NOW, 0, 0.5, FRAME // 3)
    early.see(Sight(1, FRAME, FRAME, []))
    early.depth(0, NOW)
    assert not early.take(), "its depth is still to come"
    early.depth(FRAME, NOW + FRAME)
    assert [int(m.time[0]) for m, _ in early.take()] == [NOW + FRAME]
    early.interrupted()
    early.depth(0, NOW + 9 * FRAME)
    early.see(Sight(0, 0, 9 * FRAME, []))
    assert [m.lost for m, _ in early.take()] == [-1]


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
