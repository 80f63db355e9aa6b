"""Depth frames packed without loss: differences along each row, in two planes of bytes, by zstd; some 1 ms per 640 x 480 frame.

Neighbours in a depth image are alike, so their difference is small: the plane of its high bytes is nearly all zeros, and the other one is
left with the noise. `docs/extend/format.md` says how to read one without kinegraph.
"""

from __future__ import annotations

import struct

import numpy as np
import zstandard

from kinegraph.stream.chunk import Array
from kinegraph.stream.data.bounded import unpack_zstd
from kinegraph.stream.errors import RecordingError

ENCODING = "kinegraph.packed"
"""Message encoding and schema of packed frames."""
SCHEMA = b"""{"title": "kinegraph.packed", "description": "int64 index, int64 stamp (ns), uint32 height, uint32 width, then zstd: low \
bytes, then high bytes, of the zigzag-coded differences along each row of a uint16 frame"}"""
HEAD = struct.Struct("<qqII")
"""Cumulative index, stamp (ns), height, width."""
LEVEL = 1
"""Of zstd. Level 3 takes ten times as long on a noisy frame, for a tenth less."""


class Packer:
    """Packs frames, one after the other, on one thread. Making one compiles (or loads) both kernels, so that nothing compiles later."""

    def __init__(self) -> None:
        from kinegraph.stream.recording.format.planes import split

        self._split = split
        self._zstd = zstandard.ZstdCompressor(level=LEVEL)
        self._planes = np.empty((2, 0), np.uint8)
        unpack(memoryview(self.pack(0, 0, np.zeros((1, 2), np.uint16))))

    def pack(self, index: int, stamp: int, frame: Array) -> bytes:
        """The message of a frame (height, width) uint16 at `stamp` ns."""
        height, width = frame.shape
        if self._planes.shape[1] != frame.size:
            self._planes = np.empty((2, frame.size), np.uint8)
        self._split(np.require(frame, np.uint16, ["C", "A", "W"]), self._planes)
        return HEAD.pack(index, stamp, height, width) + self._zstd.compress(self._planes.data)


def unpack(body: memoryview) -> tuple[int, Array]:
    """A frame's cumulative index, and the frame in fresh memory. Raises RecordingError where it is damaged."""
    from kinegraph.stream.recording.format.planes import join

    try:
        index, _, height, width = HEAD.unpack_from(body)
        data = unpack_zstd(body[HEAD.size :], 2 * height * width)
        planes = np.frombuffer(data, np.uint8).reshape(2, height * width).copy()
    except (struct.error, ValueError, MemoryError, zstandard.ZstdError) as error:
        raise RecordingError(f"a packed frame is damaged ({error})") from None
    frame = np.empty((height, width), np.uint16)
    join(planes, frame)
    return int(index), frame
