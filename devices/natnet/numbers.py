"""The numbers of a NatNet frame that a graph wants, straight from its bytes: what `natnet.frame` reads, without an object for each marker.

Compiled, for frames come hundreds of times a second and hold hundreds of markers, of which a graph wants some.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.mti.xbus_numbers import Bytes
from kinegraph.devices.natnet.protocol import OCCLUDED
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.kernel import kernel

BODY_BYTES, MARKER_BYTES, POINT_BYTES = 38, 26, 12
TIMECODE_BYTES, PRECISE_BYTES = 8, 8
LONGEST_S = 9e9
"""No server runs for longer: a time beyond is garbled."""
HEAD = np.dtype([("number", "<i8"), ("time_ns", "<i8"), ("ticks", "<i8"), ("flags", "<i8")])
"""A frame's number, the server's time, the middle of the exposure, and what is set of `natnet.protocol`'s flags."""
WANTED = np.dtype([("of", "<i8"), ("id", "<i8"), ("part", "<i8")])
"""A row of the table of what is wanted. Of a body: the id of its skeleton (0: no skeleton), its own id; of a marker: the id of its model,
its number; of a channel: 0 (of a force plate) or 1 (of a device), the id of that, the channel's number."""


@kernel
def numbers(
    data: Bytes, sized: bool, wanted: Array, positions: Samples, rotations: Samples, points: Samples, analog: Samples, head: Array
) -> bool:  # fmt: skip
    """Read a frame's payload (n,); False: it is cut off, or has no valid time.

    sized      whether each section says how long it is (from version 4.1 on)
    wanted     (b + m + c,)  bodies, markers, channels, in the order of the rows that they go to
    positions  (1, b, 3) m; rotations (1, b, 4) as w, x, y, z; points (1, m, 3) m; analog (samples, c); NaN where the frame has nothing
    head       (1,)  see HEAD
    """
    word, at = np.zeros(1, np.uint32), 4
    positions[:], rotations[:], points[:], analog[:] = np.nan, np.nan, np.nan, np.nan
    if len(data) < 4:
        return False
    head[0]["number"] = _whole(data, 0, 4)
    for section in range(2):  # sets of markers by name; unlabelled ones
        n, at, end = _section(data, at, sized)
        most = end - at if sized else len(data)
        if section == 1:
            at = _behind(at, end, n * POINT_BYTES)
        else:
            for _ in range(n):
                at = _behind_text(data, at, end)
                of = _count(data, at, end, most)
                at = _behind(at, end, 4 + of * POINT_BYTES)
        if n < 0 or at < 0:
            return False
        at = end if sized else at
    n, at, end = _section(data, at, sized)
    if n < 0 or at < 0:
        return False
    at = _bodies(data, at, end, 0, n, wanted, positions, rotations, word)
    if at < 0:
        return False
    at = end if sized else at
    n, at, end = _section(data, at, sized)
    most = end - at if sized else len(data)
    for _ in range(n):
        bones = _count(data, at + 4, end, most)
        if bones < 0:
            return False
        at = _bodies(data, at + 8, end, _whole(data, at, 4), bones, wanted, positions, rotations, word)
        if at < 0:
            return False
    if n < 0:
        return False
    at = end if sized else at
    if sized:
        n, _, at = _section(data, at, sized)  # assets; their markers are among the labelled ones
        if n < 0:
            return False
    n, at, end = _section(data, at, sized)
    if n < 0 or _behind(at, end, n * MARKER_BYTES) < 0:
        return False
    for i in range(n):
        _marker(data, at + i * MARKER_BYTES, wanted, positions.shape[1], points, word)
    at = end if sized else at + n * MARKER_BYTES
    for kind in range(2):
        n, at, end = _section(data, at, sized)
        most = end - at if sized else len(data)
        for _ in range(n):
            at = _channels(data, at, end, most, kind, wanted, analog, word)
            if at < 0:
                return False
        if n < 0:
            return False
        at = end if sized else at
    return _tail(data, at + TIMECODE_BYTES, PRECISE_BYTES if sized else 0, head)


@kernel
def _whole(data: Bytes, at: int, size: int) -> int:
    """The signed number of 2, 4 or 8 bytes from `at` on, little-endian."""
    value = np.uint64(0)
    for k in range(size - 1, -1, -1):
        value = value << np.uint64(8) | np.uint64(data[at + k])
    if size == 2:
        return int(np.int16(value))
    return int(np.int32(value)) if size == 4 else int(np.int64(value))


@kernel
def _real(data: Bytes, at: int, word: NDArray[np.uint32]) -> float:
    """The number of four bytes from `at` on; `word` (1,) is for work."""
    word[0] = data[at] | data[at + 1] << 8 | data[at + 2] << 16 | data[at + 3] << 24
    return np.float64(word.view(np.float32)[0])


@kernel
def _count(data: Bytes, at: int, end: int, most: int) -> int:
    """How many parts follow, which cannot be more than `most`; -1: it does not say, or what cannot be."""
    if at < 0 or at + 4 > end:
        return -1
    n = _whole(data, at, 4)
    return n if 0 <= n <= most else -1


@kernel
def _behind(at: int, end: int, size: int) -> int:
    """Where what has `size` bytes ends; -1: behind `end`, or nowhere."""
    return at + size if at >= 0 and 0 <= size <= end - at else -1


@kernel
def _behind_text(data: Bytes, at: int, end: int) -> int:
    """The offset behind the zero that ends a text, or -1."""
    if at < 0:
        return -1
    for i in range(at, end):
        if data[i] == 0:
            return i + 1
    return -1


@kernel
def _section(data: Bytes, at: int, sized: bool) -> tuple[int, int, int]:
    """Of the section that begins at `at`: how many parts it has (-1: it is cut off), where they begin, where it ends at the latest."""
    n = _count(data, at, len(data), len(data))
    if n < 0 or not sized:
        return n, at + 4, len(data)
    size = _count(data, at + 4, len(data), len(data) - at - 8)
    return (n, at + 8, at + 8 + size) if size >= 0 else (-1, at, at)


@kernel
def _bodies(
    data: Bytes, at: int, end: int, skeleton: int, n: int, wanted: Array, positions: Samples, rotations: Samples, word: NDArray[np.uint32]
) -> int:  # fmt: skip
    """Place those of `n` bodies that are wanted and tracked; returns where they end, -1: they do not."""
    after = _behind(at, end, n * BODY_BYTES)
    if after < 0 or not positions.shape[1]:
        return after
    for begin in range(at, after, BODY_BYTES):
        if not data[begin + 36] & 1:
            continue
        body = _whole(data, begin, 4)
        body = body & 0xFFFF if skeleton else body
        for row in range(positions.shape[1]):
            if wanted[row]["of"] == skeleton and wanted[row]["id"] == body:
                for k in range(3):
                    positions[0, row, k] = _real(data, begin + 4 + 4 * k, word)
                for k in range(4):
                    rotations[0, row, (k + 1) % 4] = _real(data, begin + 16 + 4 * k, word)
    return after


@kernel
def _marker(data: Bytes, at: int, wanted: Array, first: int, points: Samples, word: NDArray[np.uint32]) -> None:
    """Place a marker if it is wanted and seen."""
    if data[at + 20] & OCCLUDED:
        return
    both = _whole(data, at, 4)
    for row in range(points.shape[1]):
        if wanted[first + row]["of"] == both >> 16 and wanted[first + row]["id"] == both & 0xFFFF:
            for k in range(3):
                points[0, row, k] = _real(data, at + 4 + 4 * k, word)


@kernel
def _channels(
    data: Bytes, at: int, end: int, most: int, kind: int, wanted: Array, analog: Samples, word: NDArray[np.uint32]
) -> int:
    """Place the wanted channels of one force plate or device; returns where it ends, -1: it does not."""
    n = _count(data, at + 4, end, most)
    if n < 0:
        return -1
    number, at, first = _whole(data, at, 4), at + 8, len(wanted) - analog.shape[1]
    for channel in range(n):
        samples = _count(data, at, end, most)
        after = _behind(at, end, 4 + 4 * samples) if samples >= 0 else -1
        if after < 0:
            return -1
        for row in range(first, len(wanted)):
            if wanted[row]["of"] == kind and wanted[row]["id"] == number and wanted[row]["part"] == channel:
                for i in range(min(samples, len(analog))):
                    analog[i, row - first] = _real(data, at + 4 + 4 * i, word)
        at = after
    return at


@kernel
def _tail(data: Bytes, at: int, more: int, head: Array) -> bool:
    """The times at a frame's end, and its flags behind `more` bytes; False: it is cut off, or has no valid time."""
    if at + 32 + more + 2 > len(data):
        return False
    double = np.zeros(1, np.int64)
    double[0] = _whole(data, at, 8)
    seconds = double.view(np.float64)[0]
    if not abs(seconds) < LONGEST_S:
        return False
    head[0]["time_ns"], head[0]["ticks"] = np.int64(np.rint(seconds * 1e9)), _whole(data, at + 8, 8)
    head[0]["flags"] = _whole(data, at + 32 + more, 2)
    return True


def prepare() -> None:
    """Compile it, or take it from the cache."""
    bodies, turns, points, analog = np.zeros((1, 0, 3)), np.zeros((1, 0, 4)), np.zeros((1, 0, 3)), np.zeros((1, 0))
    data, wanted = np.frombuffer(bytes(4), np.uint8), np.zeros(0, WANTED)
    numbers(data, False, wanted, bodies, turns, points, analog, np.zeros(1, HEAD))
