"""Finds connected things in a depth image, assigns them to persons, and measures each person's share of the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel


@kernel(nogil=True)
def components(
    frame: NDArray[np.uint16],
    apart: float,
    least: int,
    parts: NDArray[np.int32],
    sizes: NDArray[np.int64],
    middles: Samples,
) -> int:
    """Number the connected things of `frame` (h, w) that hold at least `least` pixels, into `parts` (h, w); how many there are.

    `sizes` (m + 1,) and `middles` (m + 1, 3; x, y, depth) are written; there are at most m, the first ones from the top.
    """
    h, w = frame.shape
    most = len(sizes) - 1
    stack = np.empty(h * w, np.int64)
    count = 0
    for row in range(h):
        for column in range(w):
            if frame[row, column] == 0 or parts[row, column] != 0:
                continue
            mark = count + 1 if count < most else -1
            parts[row, column] = mark
            stack[0] = row * w + column
            size = _fill(frame, apart, mark, parts, stack)
            if size < least or mark < 0:
                for k in range(size):
                    parts[stack[k] // w, stack[k] % w] = -1
                continue
            count += 1
            sizes[count] = size
            for k in range(size):
                y, x = stack[k] // w, stack[k] % w
                middles[count, 0] += x / size
                middles[count, 1] += y / size
                middles[count, 2] += frame[y, x] / size
    for y in range(h):
        for x in range(w):
            parts[y, x] = max(parts[y, x], 0)
    return count


@kernel
def _fill(
    frame: NDArray[np.uint16], apart: float, mark: int, parts: NDArray[np.int32], stack: NDArray[np.int64]
) -> int:
    """Give `mark` to all that is connected with the first pixel of `stack`; how many there are: their numbers are in `stack`."""
    h, w = frame.shape
    size, taken = 0, 1
    while size < taken:  # the stack is a queue: what was taken stays in it
        y, x = stack[size] // w, stack[size] % w
        size += 1
        for k in range(4):
            v, u = y + (k == 0) - (k == 1), x + (k == 2) - (k == 3)
            if v < 0 or u < 0 or v >= h or u >= w or frame[v, u] == 0 or parts[v, u] != 0:
                continue
            if abs(float(frame[v, u]) - float(frame[y, x])) <= apart:
                parts[v, u] = mark
                stack[taken] = v * w + u
                taken += 1
    return size


@kernel(nogil=True)
def overlaps(parts: NDArray[np.int32], labels: NDArray[np.uint8], out: NDArray[np.int64]) -> None:
    """How many pixels every part has in common with everybody of the frame before, into `out` (parts + 1, people + 1)."""
    for y in range(parts.shape[0]):
        for x in range(parts.shape[1]):
            out[parts[y, x], labels[y, x]] += 1


@kernel(nogil=True)
def ahead_at_border(
    frame: NDArray[np.uint16],
    parts: NDArray[np.int32],
    depths: NDArray[np.uint16],
    leap: float,
    ahead: NDArray[np.int64],
) -> None:
    """How many pixels of a part are nearer by `leap` than what was there before, into `ahead` (parts + 1,); 0 if it is off the border.

    `depths` (h, w) are of the people in the frame before, 0 elsewhere.
    """
    h, w = frame.shape
    at_border = np.zeros(len(ahead), np.bool_)
    for y in range(h):
        for x in range(w):
            k = parts[y, x]
            if k == 0:
                continue
            if y == 0 or x == 0 or y == h - 1 or x == w - 1:
                at_border[k] = True
            ahead[k] += float(frame[y, x]) + leap < float(depths[y, x])
    for k in range(len(ahead)):
        if not at_border[k]:
            ahead[k] = 0


@kernel(nogil=True)
def leaps(
    frame: NDArray[np.uint16],
    parts: NDArray[np.int32],
    labels: NDArray[np.uint8],
    depths: NDArray[np.uint16],
    leap: float,
    nearer: NDArray[np.int64],
    farther: NDArray[np.int64],
) -> None:
    """Of the pixels that every part shares with everybody of the frame before, how many are nearer or farther by `leap` than they were.

    `nearer`, `farther` (parts + 1, people + 1) are written; `labels`, `depths` (h, w) are those of the frame before.
    """
    for y in range(parts.shape[0]):
        for x in range(parts.shape[1]):
            k, who = parts[y, x], labels[y, x]
            if k == 0 or who == 0:
                continue
            nearer[k, who] += float(frame[y, x]) + leap < float(depths[y, x])
            farther[k, who] += float(frame[y, x]) > float(depths[y, x]) + leap


@kernel(nogil=True)
def share_out(
    frame: NDArray[np.uint16],
    parts: NDArray[np.int32],
    owners: NDArray[np.int64],
    places: Samples,
    labels: NDArray[np.uint8],
) -> None:
    """Writes each pixel's owner into `labels` (h, w): the part's owner; of several, the nearest one by the `places` before."""
    for y in range(parts.shape[0]):
        for x in range(parts.shape[1]):
            k = parts[y, x]
            if k == 0:
                continue
            best, least = 0, np.inf
            for who in range(1, owners.shape[1]):
                if owners[k, who] == 0:
                    continue
                place = places[who - 1]
                d = float(frame[y, x])
                pixel = d / 300.0  # about mm per pixel
                way = ((x - place[0]) * pixel) ** 2 + 0.1 * ((y - place[1]) * pixel) ** 2 + (d - place[2]) ** 2
                if best == 0 or way < least:
                    best, least = who, way
            labels[y, x] = best


@kernel(nogil=True)
def only(frame: NDArray[np.uint16], labels: NDArray[np.uint8], who: int, out: NDArray[np.uint16]) -> None:
    """The pixels of `frame` (h, w) that are `who`'s, into `out` (h, w), which is 0."""
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            if labels[y, x] == who:
                out[y, x] = frame[y, x]


@kernel(nogil=True)
def measure(frame: NDArray[np.uint16], labels: NDArray[np.uint8], out: NDArray[np.int64]) -> None:
    """Writes what each person fills of `frame` (h, w) into `out` (people + 1, 8); row 0 has no owner.

    Pixels, sums of their columns and of their rows, first and last row, first and last column, and twice the median of their depths.
    """
    h, w = frame.shape
    out[:] = 0
    out[:, 3], out[:, 5] = h, w
    for y in range(h):
        for x in range(w):
            k = labels[y, x]
            if k != 0:
                out[k, 0] += 1
                out[k, 1] += x
                out[k, 2] += y
                out[k, 3], out[k, 4] = min(out[k, 3], y), max(out[k, 4], y)
                out[k, 5], out[k, 6] = min(out[k, 5], x), max(out[k, 6], x)
    for k in range(1, out.shape[0]):
        if out[k, 0] == 0:
            continue
        counts = np.zeros(65536, np.int32)
        for y in range(out[k, 3], out[k, 4] + 1):
            for x in range(out[k, 5], out[k, 6] + 1):
                if labels[y, x] == k:
                    counts[frame[y, x]] += 1
        seen, before = 0, 0
        for depth in range(65536):
            seen += counts[depth]
            out[k, 7] += depth * ((before <= (out[k, 0] - 1) // 2 < seen) + (before <= out[k, 0] // 2 < seen))
            if seen > out[k, 0] // 2:
                break
            before = seen
