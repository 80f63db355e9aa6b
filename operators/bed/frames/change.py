"""How much every pixel, and every region, of a frame has changed since the frame before (thesis, eq. 4.1 and 4.2), in one pass."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kinegraph.operators.bed.frames.blocks import Frame
from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

Sums = NDArray[np.uint32]
Seen = NDArray[np.uint16]


@kernel(nogil=True)
def change(
    frame: Frame, last: Frame, regions: Times, edges: Times, least: float, sums: Sums, seen: Seen, out: Samples
) -> int:
    """N(t), the mean |frame - last| in every region, into `out` (k,), and the same of every pixel into the epoch's `sums` (h, w).

    Only pixels that were measured in both frames count (0: not measured): `seen` (h, w) says how often. `last` becomes `frame`.

    regions  (k, 4)  row, column, rows, columns; a region without rows is not known
    edges    (e,)    the columns at which regions begin and end, with 0 and w, in order
    least    share of a region's pixels that must have been measured in both frames; else its N is NaN

    Returns the change of the whole frame. Types are narrow throughout, so that the inner loop is done in vectors.
    """
    known = regions.shape[0]
    total = np.zeros(known, np.int64)
    count = np.zeros(known, np.int64)
    whole = np.int64(0)
    for y in range(frame.shape[0]):
        for e in range(edges.shape[0] - 1):
            moved, measured = np.uint32(0), np.uint32(0)
            for x in range(np.uint64(edges[e]), np.uint64(edges[e + 1])):
                a, b = frame[y, x], last[y, x]
                both = np.uint16((a != 0) & (b != 0))
                d = np.uint32(np.uint16((max(a, b) - min(a, b)) * both))
                sums[y, x] += d
                seen[y, x] += both
                moved = np.uint32(moved + d)
                measured = np.uint32(measured + both)
                last[y, x] = a
            whole += np.int64(moved)
            for k in range(known):
                row, column, rows, columns = regions[k]
                if row <= y < row + rows and column <= edges[e] < column + columns:
                    total[k] += np.int64(moved)
                    count[k] += np.int64(measured)
    for k in range(known):
        size = regions[k, 2] * regions[k, 3]
        out[k] = total[k] / count[k] if count[k] > 0 and count[k] >= least * size else math.nan
    return int(whole)


@kernel(nogil=True)
def distance(frame: Frame, other: Frame, regions: Times, least: float, out: Samples) -> None:
    """The mean |frame - other| in every region (k, 4), into `out` (k,), NaN as `change` has it."""
    for k in range(regions.shape[0]):
        row, column, rows, columns = regions[k]
        total, count = np.int64(0), np.int64(0)
        for y in range(row, row + rows):
            for x in range(column, column + columns):
                a, b = frame[y, x], other[y, x]
                if a != 0 and b != 0:
                    total += np.int64(max(a, b) - min(a, b))
                    count += 1
        out[k] = total / count if count > 0 and count >= least * rows * columns else math.nan


@kernel(nogil=True)
def conclude(sums: Sums, seen: Seen, cell: int, out: Samples) -> None:
    """D(p) of the epoch as the mean of each cell, into `out` (h/cell, w/cell), NaN where nothing was measured; the sums start again."""
    for r in range(out.shape[0]):
        for q in range(out.shape[1]):
            total, count = 0.0, 0
            for y in range(r * cell, r * cell + cell):
                for x in range(q * cell, q * cell + cell):
                    if seen[y, x] > 0:
                        total += sums[y, x] / seen[y, x]
                        count += 1
            out[r, q] = total / count if count > 0 else math.nan
    sums[:] = 0
    seen[:] = 0
