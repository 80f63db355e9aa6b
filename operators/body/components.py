"""Connected things in a depth image, and whose they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stream.chunk import Samples
from stream.kernel import kernel


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
    for start in range(h * w):
        if frame[start // w, start % w] == 0 or parts[start // w, start % w] != 0:
            continue
        mark = count + 1 if count < most else -1
        size, taken = 0, 1
        stack[0] = start
        parts[start // w, start % w] = mark
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


@kernel(nogil=True)
def overlaps(parts: NDArray[np.int32], labels: NDArray[np.uint8], out: NDArray[np.int64]) -> None:
    """How many pixels every part has in common with everybody of the frame before, into `out` (parts + 1, people + 1)."""
    for y in range(parts.shape[0]):
        for x in range(parts.shape[1]):
            out[parts[y, x], labels[y, x]] += 1


@kernel(nogil=True)
def share_out(
    frame: NDArray[np.uint16],
    parts: NDArray[np.int32],
    owners: NDArray[np.int64],
    places: Samples,
    labels: NDArray[np.uint8],
) -> None:
    """Whose pixel it is, into `labels` (h, w): the part's owner's; of several owners' the nearest one's, by the `places` before."""
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
