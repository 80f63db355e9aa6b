"""A background of farthest depths, kept pixel by pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.kernel import kernel

FAR = 5
"""Frames in a row that a pixel must be farther than its background until that is its background."""
STILL_MM = 40.0


@kernel(nogil=True)
def cut_out(
    frame: NDArray[np.uint16],
    behind: NDArray[np.float32],
    streak: NDArray[np.int32],
    front: NDArray[np.float32],
    min_mm: float,
    min_share: float,
    absorb: int,
    out: NDArray[np.uint16],
) -> float:
    """What of `frame` (h, w) stands before the background into `out`, 0 elsewhere; the share of measured pixels that lie behind it.

    `behind`, `streak`, `front` are the memory (BackgroundState), `absorb` frames without a change make background of what stands before it.
    """
    seen, farther = 0, 0
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            d = np.float32(frame[y, x])
            if d == 0:
                continue
            b = behind[y, x]
            seen += 1
            if b == 0:
                behind[y, x] = d
                continue
            room = np.float32(max(min_mm, min_share * b))
            if d > b + room:
                farther += 1
                streak[y, x] = max(streak[y, x], 0) + 1
                front[y, x] = d if streak[y, x] == 1 else front[y, x]
                if streak[y, x] >= FAR:
                    behind[y, x], streak[y, x] = front[y, x], 0
            elif d < b - room:
                out[y, x] = frame[y, x]
                if streak[y, x] >= 0 or abs(d - front[y, x]) > STILL_MM:
                    streak[y, x], front[y, x] = -1, d
                else:
                    streak[y, x] -= 1
                    if -streak[y, x] >= absorb:
                        behind[y, x], streak[y, x] = d, 0
            else:
                streak[y, x] = 0
                behind[y, x] = b + (d - b) * np.float32(0.05)
    return farther / seen if seen else 0.0
