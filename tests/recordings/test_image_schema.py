"""Recorded images: the numbers that Foxglove gives the fields of foxglove.RawImage, and what Google's own library makes of our bytes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.format.image import (
    decode_image,
    descriptor,
    encode_image,
    frames_of,
    is_frames,
    is_picture,
    wire_fields,
)

NUMBERS = {"timestamp": 1, "frame_id": 7, "width": 2, "height": 3, "encoding": 4, "step": 5, "data": 6}
FIELD, NAME, NUMBER = 0x12, 0x0A, 0x18
"""Tags within a message's descriptor: a field of the message; a field's name, and its number."""


def test_fields_of_an_image_have_the_numbers_of_foxglove() -> None:
    schema = descriptor()
    image = schema[schema.index(b"foxglove/RawImage.proto") :]
    for name, number in NUMBERS.items():
        at = image.index(bytes([NAME, len(name)]) + name.encode()) + 2 + len(name)
        assert image[at] == NUMBER and image[at + 1] == number, name


def read_by_google(body: bytes) -> Any:
    """A message as Google's own library reads it by our descriptor."""
    found = descriptor_pb2.FileDescriptorSet.FromString(descriptor())
    pool = descriptor_pool.DescriptorPool()
    for file in found.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("foxglove.RawImage")).FromString(body)


def test_the_schema_is_what_google_writes_for_the_same_messages() -> None:
    stamp, image = descriptor_pb2.FileDescriptorSet.FromString(descriptor()).file
    assert (stamp.name, stamp.package, stamp.syntax, [*stamp.dependency]) == (
        "google/protobuf/timestamp.proto", "google.protobuf", "proto3", [],
    )  # fmt: skip
    assert (image.name, image.package, image.syntax) == ("foxglove/RawImage.proto", "foxglove", "proto3")
    assert [*image.dependency] == [stamp.name]
    kinds = {
        (f.name, f.number, f.type, f.label, f.type_name)
        for f in [*stamp.message_type[0].field, *image.message_type[0].field]
    }
    of = descriptor_pb2.FieldDescriptorProto
    wanted = {
        ("seconds", 1, of.TYPE_INT64, ""), ("nanos", 2, of.TYPE_INT32, ""), ("frame_id", 7, of.TYPE_STRING, ""),
        ("timestamp", 1, of.TYPE_MESSAGE, ".google.protobuf.Timestamp"), ("width", 2, of.TYPE_FIXED32, ""),
        ("height", 3, of.TYPE_FIXED32, ""), ("encoding", 4, of.TYPE_STRING, ""), ("step", 5, of.TYPE_FIXED32, ""),
        ("data", 6, of.TYPE_BYTES, ""),
    }  # fmt: skip
    assert kinds == {(name, number, kind, of.LABEL_OPTIONAL, type_name) for name, number, kind, type_name in wanted}


@pytest.mark.parametrize("stamp", [0, 1, 999_999_999, 1_000_000_000, 1_700_000_000_123_456_789, -5])
@pytest.mark.parametrize("index", [0, 1, 127, 128, 16_383, 16_384, 2**40])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 5), (2, 200)])
def test_a_frame_is_read_by_google_and_by_ourselves_as_it_was(stamp: int, index: int, height: int, width: int) -> None:
    frame = np.arange(height * width, dtype=np.uint16).reshape(height, width) * 163 + 7
    body = encode_image(stamp, index, frame)
    message = read_by_google(body)
    assert message.timestamp.seconds * 10**9 + message.timestamp.nanos == max(stamp, 0)
    assert (message.width, message.height, message.step, message.encoding) == (width, height, 2 * width, "16UC1")
    assert message.data == frame.astype("<u2").tobytes()
    found, samples = decode_image(memoryview(body))
    assert found == index and bytes(samples) == message.data
    spec = StreamSpec((height, width), np.dtype("<u2"))
    assert (frames_of(spec, index, 1, [memoryview(body)], packed=False) == frame).all()


def test_fields_of_every_kind_are_passed_over_and_a_cut_is_told() -> None:
    frame = np.full((2, 3), 513, np.uint16)
    fixed = bytes([9 << 3 | 1]) + b"\xff" * 8 + bytes([10 << 3 | 5]) + b"\xff" * 4
    body = fixed + encode_image(5, 3, frame) + fixed
    assert decode_image(memoryview(body))[0] == 3
    numbers = [number for number, _ in wire_fields(memoryview(body))]
    assert numbers == [1, 4, 1000, 6]
    last = bytes([8]) + b"\xff" * 9 + b"\x01"
    assert [*wire_fields(memoryview(last))] == [(1, 2**64 - 1)]
    for cut in (bytes([8]), bytes([8, 0x80]), bytes([8]) + b"\x80" * 10 + b"\x01"):
        with pytest.raises(IndexError):
            [*wire_fields(memoryview(cut))]


def test_frames_are_found_by_their_numbers_and_one_that_is_missing_is_named() -> None:
    spec = StreamSpec((2, 3), np.dtype("<u2"))
    frames = np.arange(4 * 6, dtype=np.uint16).reshape(4, 2, 3)
    images = [memoryview(encode_image(0, 7 + k, frame)) for k, frame in enumerate(frames)]
    assert (frames_of(spec, 7, 4, images[::-1], packed=False) == frames).all()
    assert (frames_of(spec, 8, 2, images, packed=False) == frames[1:3]).all()
    with pytest.raises(RecordingError, match="1 of 4 frames are missing"):
        frames_of(spec, 7, 4, images[:3], packed=False)
    with pytest.raises(RecordingError, match="frame 8 is missing"):
        frames_of(spec, 7, 3, [images[0], images[0], images[2], images[3]], packed=False)
    for body in (encode_image(0, 0, frames[0])[:-14], bytes([6 << 3 | 2, 1, 0])):
        with pytest.raises((RecordingError, IndexError)):
            decode_image(memoryview(body))


@pytest.mark.parametrize(
    ("shape", "dtype", "frames", "picture"),
    [
        ((4, 5), "<u2", True, True), ((4, 5), "<u1", False, True), ((4, 5), "<i2", False, False),
        ((4, 5, 3), "<u1", False, True), ((4, 5, 3), "<u2", False, True), ((4,), "<u2", False, False),
        ((4, 5), "<f8", False, False),
    ],
)  # fmt: skip
def test_what_frames_and_pictures_are(shape: tuple[int, ...], dtype: str, frames: bool, picture: bool) -> None:
    spec = StreamSpec(shape, np.dtype(dtype))
    assert (is_frames(spec), is_picture(spec)) == (frames, picture)
