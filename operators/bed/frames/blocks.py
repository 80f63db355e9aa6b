"""Frames in square blocks: each block as its projection on a few vectors, its mean depth, and the sums from which vectors are learned.

A pixel of 0 was not measured. In a block that holds enough measured pixels it stands for the mean of those; any other block is 0
throughout, so that the pattern of missing pixels, too, has no detail finer than a block.

The level of a tilted block is that of its middle: the mean of what is measured would tremble with the pixels that happen to be missing.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

Frame = NDArray[np.uint16]
Single = NDArray[np.float32]
EDGE_MM = 100.0
"""No more of a step to the only neighbour that is measured is a slope."""


@kernel(nogil=True)
def measure(frame: Frame, b: int, needed: int, levels: Samples) -> None:
    """Of every block of `frame` (h, w), into `levels` (3, h/b, w/b): the mean of what is measured, and how far down and right that lies.

    NaN, where less than `needed` pixels are measured; how far: from the block's middle, in pixels, on average.
    """
    columns, middle = levels.shape[2], 0.5 * (b - 1)
    sums, there = np.empty(columns * b, np.uint32), np.empty(columns * b, np.uint16)
    blocks, marks = sums.reshape(columns, b), there.reshape(columns, b)
    for r in range(levels.shape[1]):
        sums[:] = 0
        there[:] = 0
        for j in range(b):
            # how many, in 9 bits, and above them the sum of how far down: at most 16 pixels, of which the last is 15 down
            mark = np.uint16(1 + 512 * j)
            for x in range(columns * b):
                p = frame[r * b + j, x]
                sums[x] += p
                there[x] += mark if p != 0 else np.uint16(0)
        for q in range(columns):
            total, both, right = np.uint32(0), np.uint32(0), np.uint32(0)
            for k in range(b):
                total = np.uint32(total + blocks[q, k])
                both = np.uint32(both + marks[q, k])
                right = np.uint32(right + np.uint32(marks[q, k] & np.uint16(511)) * np.uint32(k))
            count, down = np.int32(both & np.uint32(511)), np.int32(both >> np.uint32(9))
            enough = count >= needed
            levels[0, r, q] = np.int32(total) / count if enough else math.nan
            levels[1, r, q] = down / count - middle if enough else 0.0
            levels[2, r, q] = np.int32(right) / count - middle if enough else 0.0


@kernel
def middles(levels: Samples, by: Samples, b: int, out: Samples) -> None:
    """The levels at the middles of blocks, into `out` (rows, columns), of `levels` (3, rows, columns) as `measure` has them.

    by   (rows + 2, columns + 2)  levels of which slopes are taken, with NaN around
    """
    for r in range(out.shape[0]):
        for q in range(out.shape[1]):
            here = by[r + 1, q + 1]
            down = slope(here - by[r, q + 1], by[r + 2, q + 1] - here)
            right = slope(here - by[r + 1, q], by[r + 1, q + 2] - here)
            out[r, q] = levels[0, r, q] - (down * levels[1, r, q] + right * levels[2, r, q]) / b


@kernel
def slope(one: float, two: float) -> float:
    """How much depth rises per block about a block, from the steps to it and from it; 0 at an edge, and where no neighbour is measured.

    A step is NaN where there is no neighbour on that side, or it is not measured. Both answers are made, so that rows are done in vectors.
    """
    both = one * two
    # no jump where an edge comes near: at most twice the smaller one
    level = 2.0 * one * two / (one + two) if both > 0.0 else 0.0
    only = two if one != one else one
    return level if both == both else only if abs(only) < EDGE_MM else 0.0


@kernel(nogil=True)
def flatten(level: Samples, out: Frame) -> None:
    """Every block of `out` (h, w) as its `level` (h/b, w/b) in whole mm; 0 where that is NaN."""
    b = out.shape[0] // level.shape[0]
    line = np.empty(out.shape[1], np.uint16)
    for r in range(level.shape[0]):
        for q in range(level.shape[1]):
            mean = level[r, q]
            value = np.uint16(np.int32(min(mean + 0.5, 65535.0))) if mean == mean else np.uint16(0)
            for x in range(q * b, q * b + b):
                line[x] = value
        for j in range(b):
            for x in range(out.shape[1]):
                out[r * b + j, x] = line[x]


@kernel(nogil=True)
def simplify(
    frame: Frame,
    tiles: Single,
    centre: Single,
    shift: Single,
    needed: int,
    out: Frame,
    means: Samples,
) -> None:
    """Every block of `frame` (h, w) as `centre` plus its projections on `tiles`, into `out` (h, w); its level into `means` (h/b, w/b).

    tiles    (m, b, w)  orthonormal vectors (b, b), side by side as often as there are blocks in a row; one alone is flat
    centre   (b, w)     what is subtracted from a block before it is projected, side by side; flat beside one vector
    shift    (m, 2)     of every vector: the sum of its numbers; its product with the centre
    needed   pixels that a block must have to count as measured; `means` is NaN elsewhere

    Room to work in is made here, not kept: nothing of a frame must stand in a snapshot.
    """
    m, b, w = tiles.shape
    levels = np.empty((3, frame.shape[0] // b, w // b))
    measure(frame, b, needed, levels)
    by = np.full((means.shape[0] + 2, means.shape[1] + 2), math.nan)
    by[1:-1, 1:-1] = levels[0]
    middles(levels, by, b, means)
    by[1:-1, 1:-1] = means
    middles(levels, by, b, means)  # slopes of levels that tremble less
    if m == 1:
        flatten(levels[0], out)
        return
    rows = np.empty((b + 1 + m, w), np.float32)
    for r in range(frame.shape[0] // b):
        top = r * b
        for q in range(w // b):
            mean = levels[0, r, q]
            for x in range(q * b, q * b + b):
                rows[b, x] = np.float32(mean) if mean == mean else np.float32(0.0)
        for j in range(b):
            for x in range(w):
                p = frame[top + j, x]
                rows[j, x] = np.float32(p) - rows[b, x] if p != 0 else np.float32(0.0)
        for k in range(m):
            for x in range(w):
                rows[b + 1 + k, x] = rows[0, x] * tiles[k, 0, x]
            for j in range(1, b):
                for x in range(w):
                    rows[b + 1 + k, x] += rows[j, x] * tiles[k, j, x]
            for q in range(w // b):
                c = rows[b, q * b] * shift[k, 0] - shift[k, 1]
                for x in range(q * b, q * b + b):
                    c += rows[b + 1 + k, x]
                for x in range(q * b, q * b + b):
                    rows[b + 1 + k, x] = c
        for j in range(b):
            for x in range(w):
                rows[j, x] = centre[j, x] + np.float32(0.5)
            for k in range(m):
                for x in range(w):
                    rows[j, x] += rows[b + 1 + k, x] * tiles[k, j, x]
            for x in range(w):
                v = min(max(rows[j, x], np.float32(1.0)), np.float32(65535.0))
                out[top + j, x] = np.uint16(np.int32(v)) if rows[b, x] > np.float32(0.0) else np.uint16(0)


@kernel(nogil=True)
def gather(frame: Frame, b: int, needed: int, first: int, step: int, most: int, sums: Samples) -> int:
    """Add up to `most` blocks of `frame` (h, w), `step` apart from number `first` on, to `sums` (b*b + 1, b*b); how many were measured.

    The last row takes the blocks' sum, the others the sum of their products.
    """
    block = np.empty(b * b)
    across = frame.shape[1] // b
    blocks = across * (frame.shape[0] // b)
    taken = 0
    for i in range(most):
        index = (first + i * step) % blocks
        top, left = index // across * b, index % across * b
        total, count = 0, 0
        for j in range(b):
            for x in range(b):
                # integers add up exactly, in whatever order the compiler takes them
                p = frame[top + j, left + x]
                total += p
                count += p != 0
        if count < needed:
            continue
        taken += 1
        mean = total / count
        for j in range(b):
            for x in range(b):
                p = frame[top + j, left + x]
                block[j * b + x] = p if p != 0 else mean
        n = b * b
        for j in range(n):
            sums[n, j] += block[j]
            v = block[j]
            for x in range(n):
                sums[j, x] += v * block[x]
    return taken


@kernel
def iterate(covariance: Samples, vectors: Samples, work: Samples) -> None:
    """One step of orthogonal iteration: `vectors` (m, n) come nearer to the `covariance`'s (n, n) first ones beside the first of them.

    The first one stays; `work` (n,) is room.
    """
    m, n = vectors.shape
    for k in range(1, m):
        for i in range(n):
            v = 0.0
            for j in range(n):
                v += covariance[i, j] * vectors[k, j]
            work[i] = v
        for i in range(n):
            vectors[k, i] = work[i]
        # Gram-Schmidt against those before: without it all vectors turn to the first component
        for other in range(k):
            along = 0.0
            for i in range(n):
                along += vectors[k, i] * vectors[other, i]
            for i in range(n):
                vectors[k, i] -= along * vectors[other, i]
        length = 0.0
        for i in range(n):
            length += vectors[k, i] * vectors[k, i]
        length = math.sqrt(length)
        for i in range(n):
            vectors[k, i] = vectors[k, i] / length if length > 0.0 else vectors[k, i]


@kernel
def left_over(covariance: Samples, vectors: Samples) -> float:
    """How much of the `covariance`'s (n, n) trace the orthonormal `vectors` (m, n) do not hold."""
    m, n = vectors.shape
    rest = 0.0
    for i in range(n):
        rest += covariance[i, i]
    for k in range(m):
        for i in range(n):
            for j in range(n):
                rest -= vectors[k, i] * covariance[i, j] * vectors[k, j]
    return max(rest, 0.0)
