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
    w = levels.shape[2] * b
    sums = np.empty((3, w), np.int32)
    for r in range(levels.shape[1]):
        sums[:] = 0
        for j in range(b):
            for x in range(w):
                there = np.int32(frame[r * b + j, x] != 0)
                sums[0, x] += frame[r * b + j, x]
                sums[1, x] += there
                sums[2, x] += there * np.int32(j)
        for q in range(levels.shape[2]):
            total, count, down, right = 0, 0, 0, 0
            for x in range(q * b, q * b + b):
                total += sums[0, x]
                count += sums[1, x]
                down += sums[2, x]
                right += sums[1, x] * (x - q * b)
            enough = count >= needed
            levels[0, r, q] = total / count if enough else math.nan
            levels[1, r, q] = down / count - 0.5 * (b - 1) if enough else 0.0
            levels[2, r, q] = right / count - 0.5 * (b - 1) if enough else 0.0


@kernel
def levelled(levels: Samples, by: Samples, b: int, r: int, q: int) -> float:
    """The level at the middle of a block of `levels` (3, rows, columns), as `measure` has them, with the slopes of `by` (rows, columns)."""
    down, right = slope(by, r, q, 1, 0), slope(by, r, q, 0, 1)
    level: float = levels[0, r, q] - (down * levels[1, r, q] + right * levels[2, r, q]) / b
    return level


@kernel
def slope(level: Samples, r: int, q: int, down: int, right: int) -> float:
    """How much `level` (rows, columns) rises per block about one block; 0 at an edge, and where no neighbour is measured."""
    rows, columns = level.shape
    one = level[r, q] - level[r - down, q - right] if r >= down and q >= right else math.nan
    two = level[r + down, q + right] - level[r, q] if r + down < rows and q + right < columns else math.nan
    # NaN, which differs from itself: there is no neighbour on that side, or it is not measured
    if one != one or two != two:
        only = two if one != one else one
        return only if abs(only) < EDGE_MM else 0.0
    if not one * two > 0.0:
        return 0.0
    return 2.0 * one * two / (one + two)  # no jump where an edge comes near: at most twice the smaller one


@kernel(nogil=True)
def flatten(frame: Frame, level: Samples, weight: float, centre: float, shift: Single, out: Frame) -> None:
    """What `simplify` makes of `frame` with one flat vector of this `weight`: one number a block, in the same order of sums."""
    b, w = frame.shape[0] // level.shape[0], frame.shape[1]
    means, sums, line = np.empty(w, np.float32), np.empty(w, np.float32), np.empty(w, np.uint16)
    for r in range(level.shape[0]):
        for q in range(level.shape[1]):
            mean = level[r, q]
            for x in range(q * b, q * b + b):
                means[x] = np.float32(mean) if mean == mean else np.float32(0.0)
                sums[x] = np.float32(0.0)
        for j in range(b):
            for x in range(w):
                p = frame[r * b + j, x]
                sums[x] += (np.float32(p) - means[x] if p != 0 else np.float32(0.0)) * weight
        for q in range(level.shape[1]):
            c = means[q * b] * shift[0] - shift[1]
            for x in range(q * b, q * b + b):
                c += sums[x]
            v = min(max(centre + np.float32(0.5) + c * weight, np.float32(1.0)), np.float32(65535.0))
            value = np.uint16(np.int32(v)) if means[q * b] > np.float32(0.0) else np.uint16(0)
            for x in range(q * b, q * b + b):
                line[x] = value
        for j in range(b):
            for x in range(w):
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
    first = np.empty_like(means)
    for r in range(means.shape[0]):
        for q in range(means.shape[1]):
            first[r, q] = levelled(levels, levels[0], b, r, q)
    for r in range(means.shape[0]):
        for q in range(means.shape[1]):
            means[r, q] = levelled(levels, first, b, r, q)  # slopes of levels that tremble less
    if m == 1:
        flatten(frame, levels[0], tiles[0, 0, 0], centre[0, 0], shift[0], out)
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
