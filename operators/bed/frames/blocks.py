"""Frames in square blocks: each block as its projection on a few vectors, its mean depth, and the sums from which vectors are learned.

A pixel of 0 was not measured. In a block that holds enough measured pixels it stands for the mean of those; any other block is 0
throughout, so that the pattern of missing pixels, too, has no detail finer than a block.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

Frame = NDArray[np.uint16]
Single = NDArray[np.float32]


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
    """Every block of `frame` (h, w) as `centre` plus its projections on `tiles`, into `out` (h, w); its mean into `means` (h/b, w/b).

    tiles    (m, b, w)  orthonormal vectors (b, b), side by side as often as there are blocks in a row
    centre   (b, w)     what is subtracted from a block before it is projected, side by side
    shift    (m, 2)     of every vector: the sum of its numbers; its product with the centre
    needed   pixels that a block must have to count as measured; `means` is NaN elsewhere

    Room to work in is made here, not kept: nothing of a frame must stand in a snapshot.
    """
    m, b, w = tiles.shape
    sums = np.empty((2, w), np.int32)
    rows = np.empty((b + 1 + m, w), np.float32)
    for r in range(frame.shape[0] // b):
        top = r * b
        sums[:] = 0
        for j in range(b):
            for x in range(w):
                sums[0, x] += frame[top + j, x]
                sums[1, x] += np.int32(frame[top + j, x] != 0)
        for q in range(w // b):
            total, count = 0, 0
            for x in range(q * b, q * b + b):
                total += sums[0, x]
                count += sums[1, x]
            mean = total / count if count >= needed else 0.0
            means[r, q] = mean if count >= needed else math.nan
            for x in range(q * b, q * b + b):
                rows[b, x] = np.float32(mean)
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
