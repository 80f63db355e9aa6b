"""Depth frames: images that Foxglove shows, and for us the same bits, stamps and boundaries as were recorded."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader

from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec, empty
from kinegraph.stream.cli import main as cli
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.operator import grid
from kinegraph.stream.recording import Recorder, Recording
from kinegraph.stream.recording.format.packed import Packer, unpack
from tests.recordings.test_recording import START, same
from tests.support.command_line import succeeding

DEPTH = StreamSpec((48, 64), np.dtype(np.uint16), 30.0, units=("mm",))
EMG = StreamSpec((2,), rate_hz=1000.0)


def session(frames: int = 60) -> list[tuple[str, Chunk, int]]:
    rng = np.random.default_rng(5)
    times = grid(30.0, frames, START)
    made: list[tuple[str, Chunk, int]] = []
    at = 0
    while at < frames:
        n = int(rng.integers(0, 4))
        end = min(at + n, frames)
        until = int(times[end - 1]) if end else START - 1
        depth = rng.integers(0, 65535, (end - at, 48, 64), np.uint16)
        made.append(("cam", Chunk(times[at:end], depth, until, 5 if end > at and rng.random() < 0.2 else 0), until))
        made.append(("emg", Chunk(np.array([until]), rng.normal(size=(1, 2)), until), until))
        at = end
    return [*made, ("cam", empty(DEPTH, FOREVER), int(times[-1]))]


def record(path: Path, made: list[tuple[str, Chunk, int]], frames: Any = "packed", outline: bool = False) -> None:
    with Recorder(path, {}, RecordingOptions(frames=frames), wait=True) as recorder:
        cam = recorder.add_stream("cam", DEPTH, "input", outline=outline)
        numbers = {"cam": cam, "emg": recorder.add_stream("emg", EMG, "input")}
        for sequence, (name, chunk, arrival) in enumerate(made):
            recorder.write(numbers[name], chunk, arrival, sequence)


def assert_recorded(path: Path, made: list[tuple[str, Chunk, int]], after: int = -1) -> None:
    with Recording.open(path) as recording:
        found = list(recording.inputs(after))
        assert [f[0] for f in found] == list(range(after + 1, len(made)))
        assert all(f[1] == m[0] and same(f[2], m[1]) for f, m in zip(found, made[after + 1 :], strict=True))


@pytest.mark.parametrize("frames", ["packed", "image"])
def test_frames_come_back_bit_for_bit(tmp_path: Path, frames: str) -> None:
    made = session(400)
    record(tmp_path / "s", made, frames)
    for after in (-1, 0, 100, 200, 301, len(made) - 2):
        assert_recorded(tmp_path / "s", made, after)
    with Recording.open(tmp_path / "s") as recording:
        assert recording.streams.keys() == {"cam", "emg"}
        assert recording.streams["cam"].samples == 400 and recording.read("cam")[1].shape == (400, 48, 64)
        assert recording.read("cam")[1].flags.writeable


def test_an_image_is_what_protocol_buffers_and_foxglove_say(tmp_path: Path) -> None:
    protobuf = pytest.importorskip("google.protobuf", reason="protobuf is not installed")
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    assert protobuf
    made = session()
    record(tmp_path / "one.mcap", made, "image")
    frames = np.concatenate([c.data for name, c, _ in made if name == "cam"])
    with (tmp_path / "one.mcap").open("rb") as file:
        read = list(make_reader(file, validate_crcs=True).iter_messages(topics=["cam"], log_time_order=False))
    assert len(read) == len(frames)
    files = descriptor_pb2.FileDescriptorSet.FromString(read[0][0].data)
    pool = descriptor_pool.DescriptorPool()
    for one in files.file:
        pool.Add(one)
    image_class = message_factory.GetMessageClass(pool.FindMessageTypeByName("foxglove.RawImage"))
    for i, (schema, channel, message) in enumerate(read):
        assert schema.name == "foxglove.RawImage" and schema.encoding == channel.message_encoding == "protobuf"
        image = image_class.FromString(message.data)
        assert (image.width, image.height, image.step, image.encoding) == (64, 48, 128, "16UC1")
        assert image.data == frames[i].tobytes()
        assert (
            image.timestamp.seconds * 10**9 + image.timestamp.nanos == message.publish_time == grid(30.0, 60, START)[i]
        )


def test_foxgloves_own_library_decodes_images(tmp_path: Path) -> None:
    decoder = pytest.importorskip("mcap_protobuf.decoder", reason="mcap-protobuf-support is not installed")
    made = session()
    record(tmp_path / "one.mcap", made, "image")
    frames = np.concatenate([c.data for name, c, _ in made if name == "cam"])
    with (tmp_path / "one.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        images = [image for *_, image in reader.iter_decoded_messages(topics=["cam"])]
    found = [np.frombuffer(image.data, "<u2").reshape(image.height, image.width) for image in images]
    assert np.array_equal(found, frames)


@pytest.mark.parametrize("frames", ["packed", "image"])
def test_frames_of_a_cut_or_damaged_file(tmp_path: Path, frames: str) -> None:
    made = session(400)
    record(tmp_path / "one.mcap", made, frames)
    whole = (tmp_path / "one.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    with Recording.open(tmp_path / "cut.mcap") as recording:
        found = list(recording.inputs())
    assert 100 < len(found) < len(made) and all(same(f[2], m[1]) for f, m in zip(found, made, strict=False))
    broken = bytearray(whole)
    broken[len(whole) // 2] ^= 0xFF
    (tmp_path / "broken.mcap").write_bytes(broken)
    with succeeding():
        cli.call("recover", [str(tmp_path / "broken.mcap"), "-o", str(tmp_path / "out.mcap")])
    with Recording.open(tmp_path / "out.mcap") as recording:
        assert recording.finished and 0 < recording.streams["cam"].dropped < 250
        kept = {sequence: chunk for sequence, _, chunk, _ in recording.inputs()}
    assert all(np.array_equal(chunk.data, made[sequence][1].data) for sequence, chunk in kept.items())
    assert len(kept) > len(made) // 3


FRAMES = {
    "noise": np.random.default_rng(1).integers(0, 65536, (48, 64), np.uint16),
    "extremes": np.tile(np.array([0, 65535, 32767, 32768, 1, 65534], np.uint16), (5, 4)),
    "nothing": np.zeros((3, 7), np.uint16),
    "one pixel": np.array([[40_000]], np.uint16),
    "ramp": np.arange(48 * 64, dtype=np.uint16).reshape(48, 64),
}


@pytest.mark.parametrize("name", FRAMES)
def test_a_packed_frame_is_what_the_documentation_says(name: str) -> None:
    """Read by the recipe of docs/extend/format.md, in numpy alone; and by our own reader."""
    frame = FRAMES[name]
    body = Packer().pack(7, START, frame)
    index, stamp, height, width = struct.unpack_from("<qqII", body)
    assert (index, stamp, height, width) == (7, START, *frame.shape)
    low, high = np.frombuffer(zstandard.decompress(body[24:]), np.uint8).reshape(2, height, width).astype(np.uint16)
    coded = low | high << 8
    step = (coded >> 1) ^ (0 - (coded & 1)).astype(np.uint16)
    assert np.array_equal(np.cumsum(step, axis=1, dtype=np.uint16), frame)
    index, back = unpack(memoryview(body))
    assert index == 7 and np.array_equal(back, frame) and back.flags.writeable


def test_a_damaged_packed_frame_is_told() -> None:
    body = Packer().pack(0, START, FRAMES["ramp"])
    for bad in (body[:10], body[:-5], body[:24], body[:20] + b"\xff\xff\xff\xff" + body[24:], body[:30] + b"\0" * 40):
        with pytest.raises(RecordingError, match="damaged"):
            unpack(memoryview(bad))


def test_of_an_outline_only_the_times_are_kept(tmp_path: Path) -> None:
    """No pixel is in the file; how many frames came, when, and what was lost between them is."""
    made = session(400)
    marked = [(n, Chunk(c.time, np.full_like(c.data, 0xABCD), c.until, c.lost), a) for n, c, a in made if n == "cam"]
    record(tmp_path / "s", marked, outline=True)
    assert (tmp_path / "s" / "session.0000.mcap").stat().st_size < 40_000
    with Recording.open(tmp_path / "s") as recording:
        stream = recording.streams["cam"]
        assert stream.kept == "outline" and stream.samples == 400 and stream.spec == DEPTH
        assert (stream.first, stream.last) == (START, int(grid(30.0, 400, START)[-1]))
        found = list(recording.inputs())
        assert [f[0] for f in found] == list(range(len(marked)))
        for (_, _, chunk, arrival), (_, was, came) in zip(found, marked, strict=True):
            assert len(chunk) == len(chunk.data) == 0 and chunk.until == was.until and arrival == came
            assert chunk.lost == (was.lost + len(was) if was.lost >= 0 else -1)
        with pytest.raises(RecordingError, match="names it under `record`"):
            recording.read("cam")
    with succeeding():
        cli.call("recover", [str(tmp_path / "s"), "-o", str(tmp_path / "again")])
    with Recording.open(tmp_path / "again") as recording:
        assert recording.streams["cam"].kept == "outline" and recording.streams["cam"].samples == 400


@pytest.mark.parametrize("frames", ["packed", "image"])
def test_frames_are_read_from_any_moment_on(tmp_path: Path, frames: str) -> None:
    """Also where a message's frames began in a chunk of records before its own."""
    record(tmp_path / "s", session(400), frames)
    with Recording.open(tmp_path / "s") as recording:
        time, data = recording.read("cam")
        for i in range(0, 400, 3):
            chunks = list(recording.chunks_from("cam", int(time[i])))
            found = np.concatenate([c.time for c in chunks])
            assert found[0] <= time[i] and np.array_equal(found, time[-len(found) :])
            assert np.array_equal(np.concatenate([c.data for c in chunks]), data[-len(found) :])
