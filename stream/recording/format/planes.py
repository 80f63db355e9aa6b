"""A depth frame as two planes of bytes, and back: the kernels of packed frames (stream/recording/format/packed.py)."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.kernel import kernel

Frame: TypeAlias = NDArray[np.uint16]
Planes: TypeAlias = NDArray[np.uint8]


@kernel(nogil=True)
def split(frame: Frame, planes: Planes) -> None:
    """Write the two planes (2, height * width), low bytes first, of a frame (height, width).

    A row's first pixel differs from 0. Differences are taken modulo 2^16 and zigzag-coded: 0, -1, 1, -2, ... become 0, 1, 2, 3, ...
    """
    height, width = frame.shape
    at = 0
    for row in range(height):
        last = np.int32(0)
        for column in range(width):
            value = np.int32(frame[row, column])
            step = ((value - last + 0x8000) & 0xFFFF) - 0x8000
            coded = (step << 1) ^ (step >> 31)
            planes[0, at] = coded & 0xFF
            planes[1, at] = (coded >> 8) & 0xFF
            last = value
            at += 1


@kernel(nogil=True)
def join(planes: Planes, frame: Frame) -> None:
    """What `split` was given."""
    height, width = frame.shape
    at = 0
    for row in range(height):
        last = np.int32(0)
        for column in range(width):
            coded = np.int32(planes[0, at]) | (np.int32(planes[1, at]) << 8)
            last = (last + ((coded >> 1) ^ -(coded & 1))) & 0xFFFF
            frame[row, column] = last
            at += 1
