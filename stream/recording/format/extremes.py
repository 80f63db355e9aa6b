"""What the overview of a recorded signal is made of, in machine code: the recorder's thread shares the interpreter with the session."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Array, Times
from kinegraph.stream.kernel import kernel

Rows: TypeAlias = NDArray[np.float32]
NAN = np.float32(np.nan)


@kernel
def extremes(data: Array, time: Times, width: int, pieces: Times, low: Rows, high: Rows) -> None:
    """The minimum and maximum finite value of each run of stamps in one piece, or NaN; piece k lasts from k to k + 1 times `width`.

    What float32 cannot hold counts as not finite.


    data    (n, c)  numbers
    time    (n,)    their stamps
    pieces  (m,)    out: the number of the piece of each run
    low     (m, c)  out, float32; so is `high`
    """
    k = -1
    for i in range(data.shape[0]):
        piece = time[i] // width
        if k < 0 or piece != pieces[k]:
            k += 1
            pieces[k] = piece
            for c in range(data.shape[1]):
                low[k, c] = high[k, c] = NAN
        for c in range(data.shape[1]):
            v = np.float32(data[i, c])
            if np.isfinite(v):
                if not low[k, c] <= v:
                    low[k, c] = v
                if not high[k, c] >= v:
                    high[k, c] = v


@kernel
def torn(rows: Times, time: Times, before: int, longest: int, gaps: Times) -> int:
    """Where samples are missing: behind a step longer than `longest`, and before a chunk that says so.

    rows    (chunks, 5)  a message's table
    time    (n,)         its stamps; `before` is the one before them
    gaps    (most, 2)    out: until when there were samples, and from when again

    Returns how many rows of `gaps` were written.
    """
    found = at = 0
    for k in range(rows.shape[0]):
        for i in range(at, at + rows[k, 0]):
            if (time[i] - before > longest or (i == at and rows[k, 2] != 0)) and found < gaps.shape[0]:
                gaps[found, 0], gaps[found, 1] = before, time[i]
                found += 1
            before = time[i]
        at += rows[k, 0]
    return found
