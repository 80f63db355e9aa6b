"""depthai's own recordings: the decoder on garbage, files with and without an end, damaged ones, and those that depthai itself wrote."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from kinegraph.devices.people.sleeper import Sleeper
from kinegraph.devices.recorded import depthai_frames as protocol
from kinegraph.devices.recorded.depthai_frames import SCHEMA, decode
from kinegraph.devices.recorded.depthai_replay import DepthaiReplay
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.recording.format.image import _field, _number
from kinegraph.stream.recording.read.records import RecordFile, declared, messages
from tests.support.device_feed import Kept, check, reading, wait_for

needs_depthai = [
    pytest.mark.skipif(find_spec("depthai") is None, reason="depthai is not installed (pip install 'kinegraph[oak]')"),
    pytest.mark.timeout(120, method="thread"),
    pytest.mark.xdist_group("depthai"),
]
SLEEPER = Sleeper(64, 48, seed=3)
FRAMES = [SLEEPER.frame(k, k / 30) for k in range(60)]


def body_of(number: int, frame: np.ndarray, *, stride: int = 0, type_: int = protocol.RAW16) -> bytes:
    """The message that depthai writes for a frame, with fields that we do not read among those that we do."""
    height, width = frame.shape
    stride = stride or 2 * width
    rows = np.zeros((height, stride), np.uint8)
    rows[:, : 2 * width] = frame.view(np.uint8)
    host, device = 5000 * NS + round(number * NS / 30), round(number * NS / 30)

    def stamp(ns: int) -> bytes:
        return _number(1, ns // NS) + _number(2, ns % NS)

    layout = _number(1, type_) + _number(2, width) + _number(3, height) + _number(4, stride) + _number(5, 2)
    head = _field(1, stamp(host)) + _field(2, stamp(device)) + _number(3, number) + _field(4, layout)
    return head + _field(5, _number(1, 33)) + _number(8, 1) + _field(11, rows.tobytes()) + _field(12, stamp(host))


def write(path: Path, numbered: list[tuple[int, bytes]], chunk_bytes: int = 30_000) -> None:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_bytes, compression=CompressionType.LZ4)
        writer.start("protobuf", "depthai3.12.0")
        other = writer.register_channel(
            "imu", "protobuf", writer.register_schema("dai.proto.imu_data.IMUData", "protobuf", b"")
        )
        channel = writer.register_channel("img_frame", "protobuf", writer.register_schema(SCHEMA, "protobuf", b""))
        for number, body in numbered:
            writer.add_message(other, number, b"something else", number)
            writer.add_message(channel, number, body, number)
        writer.finish()


def read(path: Path, **parameters: Any) -> tuple[DepthaiReplay, Kept]:
    source = DepthaiReplay(str(path), **{"width": 64, "height": 48, "speed": 0.0, **parameters})
    with reading(source) as feed:
        done = time.monotonic() + 20
        before = -1
        while time.monotonic() < done and feed.error is None and (feed.count("depth") != before or before <= 0):
            before = feed.count("depth")
            time.sleep(0.3)
    return source, feed


def test_a_frame_is_decoded_also_with_padded_rows() -> None:
    for stride in (0, 192):
        found = decode(memoryview(body_of(7, FRAMES[7], stride=stride)))
        assert found and (found.number, found.type, found.width) == (7, protocol.RAW16, 64)
        assert (found.host, found.device) == (5000 * NS + round(7 * NS / 30), round(7 * NS / 30))
        assert np.array_equal(np.ascontiguousarray(found.rows[:, :128]).view(np.uint16), FRAMES[7])


@given(st.binary(max_size=400))
def test_garbage_is_no_frame_and_no_exception(data: bytes) -> None:
    decode(memoryview(data))


@given(st.integers(0, 6500), st.lists(st.tuples(st.integers(0, 6400), st.integers(0, 255)), max_size=8))
def test_a_spoilt_or_cut_frame_is_no_exception(stop: int, changes: list[tuple[int, int]]) -> None:
    body = bytearray(body_of(1, FRAMES[1]))
    for at, value in changes:
        body[at % len(body)] = value
    found = decode(memoryview(bytes(body[:stop])))
    if found:
        assert found.rows.shape[1] >= 2 * found.width


def test_a_file_gives_its_frames_with_what_is_missing(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", [(k, body_of(k, FRAMES[k])) for k in range(60) if k not in (10, 11, 40)])
    source, feed = read(tmp_path / "a.mcap")
    check(source, feed)
    kept = [k for k in range(60) if k not in (10, 11, 40)]
    assert np.array_equal(feed.data("depth"), np.array([FRAMES[k] for k in kept]))
    assert feed.lost("depth") == {10: 2, 38: 1} and feed.problems == {"lost frame": 3}
    assert feed.data("timing")["counter"].tolist() == kept
    steps = feed.time("depth") - feed.time("depth")[0]
    assert np.array_equal(steps, [round(k * NS / 30) for k in kept])
    assert feed.error is None


def test_a_file_plays_at_its_own_pace(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", [(k, body_of(k, FRAMES[k])) for k in range(30)])
    with reading(DepthaiReplay(str(tmp_path / "a.mcap"), width=64, height=48)) as feed:
        wait_for(lambda: feed.count("depth") == 30)
    timing = feed.data("timing")
    assert (timing["arrival"] >= timing["stamp"]).all()


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8, 0.99])
def test_a_file_without_its_end_is_read_as_far_as_it_is_whole(share: float, tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", [(k, body_of(k, FRAMES[k])) for k in range(60)])
    whole = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: int(len(whole) * share)])
    _, feed = read(tmp_path / "cut.mcap")
    n = feed.count("depth")
    assert abs(n - 60 * share) < 10 and np.array_equal(feed.data("depth"), np.array(FRAMES[:n]))


def test_a_damaged_part_is_passed_over_and_counted(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", [(k, body_of(k, FRAMES[k])) for k in range(60)])
    damaged = bytearray((tmp_path / "a.mcap").read_bytes())
    damaged[len(damaged) // 2] ^= 0xFF
    (tmp_path / "a.mcap").write_bytes(damaged)
    _, feed = read(tmp_path / "a.mcap")
    missing = sum(feed.lost("depth").values())
    assert feed.problems["damaged part"] == 1 and 0 < missing < 12 and feed.count("depth") == 60 - missing
    kept = feed.data("timing")["counter"]
    assert np.array_equal(feed.data("depth"), np.array([FRAMES[k] for k in kept]))


def test_what_cannot_be_read_is_told(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", [(0, body_of(0, FRAMES[0]))])
    write(tmp_path / "grey.mcap", [(0, body_of(0, FRAMES[0], type_=30))])
    write(tmp_path / "empty.mcap", [])
    (tmp_path / "text.mcap").write_text("no recording at all")
    for name, parameters, reported in (
        ("none.mcap", {}, "cannot be read"),
        ("text.mcap", {}, "not an MCAP recording"),
        ("empty.mcap", {}, "holds no whole depth frame"),
        ("grey.mcap", {}, "frames of type 30, not RAW16"),
        ("a.mcap", {"topic": "img_fram"}, "did you mean 'img_frame'"),
        ("a.mcap", {"width": 80}, "write width: 64 and height: 48"),
    ):
        _, feed = read(tmp_path / name, **parameters)
        assert isinstance(feed.error, DeviceError) and reported in str(feed.error), name


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("depthai") / "night.mcap"
    command = [
        sys.executable,
        "-m",
        "kinegraph",
        "dev",
        "simulate",
        "oak",
        f"record={path}",
        "width=64",
        "height=48",
        "seed=3",
        "--for",
        "3",
    ]
    subprocess.run(command, check=True, timeout=100, capture_output=True)
    return path


class TestWithDepthai:
    """Files that depthai's RecordMessage wrote."""

    pytestmark = needs_depthai

    def test_every_frame_comes_back_bit_by_bit(self, recorded: Path) -> None:
        source, feed = read(recorded)
        check(source, feed)
        timing = feed.data("timing")
        assert len(timing) > 40 and feed.error is None
        for frame, event in zip(feed.data("depth"), timing, strict=True):
            index = round((event["device"] / NS - 3.25) * 30)
            assert np.array_equal(frame, SLEEPER.frame(index, index / 30))
        steps = np.diff(timing["stamp"]) - np.diff(timing["counter"]) * NS / 30
        assert abs(steps).max() < 3000

    def test_the_decoder_agrees_with_the_schema_in_the_file(self, recorded: Path) -> None:
        pytest.importorskip("google.protobuf", reason="protobuf is not installed")
        from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

        file = RecordFile(recorded)
        try:
            data = [file.unpack(record) for record in file.chunks]
        finally:
            file.close()
        schema = next(item for item in declared(data[0]) if getattr(item, "name", "") == SCHEMA)
        pool = descriptor_pool.DescriptorPool()
        for one in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:  # type: ignore[union-attr]
            pool.Add(one)
        kind: Any = message_factory.GetMessageClass(pool.FindMessageTypeByName(SCHEMA))
        count = 0
        for message in (m for part in data for m in messages(part)):
            theirs, ours = kind.FromString(bytes(message.body)), decode(message.body)
            assert ours and ours.number == theirs.sequenceNum and ours.width == theirs.fb.width
            assert ours.host == theirs.ts.sec * NS + theirs.ts.nsec
            assert ours.device == theirs.tsDevice.sec * NS + theirs.tsDevice.nsec
            assert ours.rows.shape == (theirs.fb.height, theirs.fb.stride) and ours.rows.tobytes() == theirs.data
            assert ours.type == theirs.fb.type
            count += 1
        assert count > 40

    def test_what_a_killed_recorder_left(self, tmp_path: Path) -> None:
        path = tmp_path / "killed.mcap"
        command = [
            sys.executable,
            "-m",
            "kinegraph",
            "dev",
            "simulate",
            "oak",
            f"record={path}",
            "width=320",
            "height=200",
        ]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
            try:
                wait_for(lambda: path.exists() and path.stat().st_size > 3_000_000, 90)
            finally:
                process.send_signal(signal.SIGKILL)
        _, feed = read(path, width=320, height=200)
        assert feed.error is None and feed.count("depth") > 5
        assert (feed.data("depth") > 0).mean() == pytest.approx(0.9, abs=0.01)
