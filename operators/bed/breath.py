"""Breath in the depths of cells: cells as they come at a fixed rate, which of them breathe, and how fast.

A cell is a square of blocks; its depth is the mean of what was measured of it in a tick.
"""

from __future__ import annotations

import math

import numpy as np

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

HALF_WIDTH = 4.0
"""Power within this many breaths per minute of the peak counts as the peak's: a window of 30 s smears it so far."""


@kernel
def gather(blocks: Samples, size: int, sums: Samples, counts: Samples) -> None:
    """Take a frame's blocks (rows, columns) into the cells' `sums` and `counts` (cells,); cells of `size` x `size` blocks, row by row."""
    across = -(-blocks.shape[1] // size)
    for r in range(blocks.shape[0]):
        for c in range(blocks.shape[1]):
            if abs(blocks[r, c]) < math.inf:
                cell = r // size * across + c // size
                sums[cell] += blocks[r, c]
                counts[cell] += 1.0


@kernel
def straighten(x: Samples, out: Samples) -> float:
    """`x` (n,) without its straight line and under a Hann window, into `out`; gaps (NaN) are 0. Returns the share of finite values."""
    n = x.shape[0]
    count, st, sx, stt, stx = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        if abs(x[i]) < math.inf:
            count += 1.0
            st += i
            sx += x[i]
            stt += i * i
            stx += i * x[i]
    if count < 3:
        out[:] = 0.0
        return float(count / n)
    spread = stt - st * st / count
    slope = (stx - st * sx / count) / spread if spread > 0 else 0.0
    level = (sx - slope * st) / count
    for i in range(n):
        window = 0.5 - 0.5 * math.cos(2.0 * math.pi * (i + 0.5) / n)
        out[i] = (x[i] - level - slope * i) * window if abs(x[i]) < math.inf else 0.0
    return float(count / n)


@kernel
def powers(x: Samples, cosines: Samples, sines: Samples, out: Samples) -> None:
    """Add the power of `x` (n,) at every frequency to `out` (f,). cosines, sines (f, n)."""
    for f in range(out.shape[0]):
        a, b = 0.0, 0.0
        for i in range(x.shape[0]):
            a += x[i] * cosines[f, i]
            b += x[i] * sines[f, i]
        out[f] += a * a + b * b


@kernel
def vary(x: Samples, first: int, stop: int, out: Samples) -> None:
    """How every cell of x (n, cells) varies from tick `first` to `stop`, into `out` (2, cells): slow variance, greatest step.

    Rows are a ring: a tick's row is its number modulo n. Slow variance: the variance, less half the mean square of a step (noise alone
    would give 0); NaN where less than half was measured.
    """
    n = x.shape[0]
    for c in range(x.shape[1]):
        level = math.nan
        total, squares, steps, count, pairs, highest = 0.0, 0.0, 0.0, 0, 0, 0.0
        last = math.nan
        for t in range(first, stop):
            v = x[t % n, c]
            if abs(v) < math.inf:
                level = v if count == 0 else level
                total += v - level
                squares += (v - level) * (v - level)
                count += 1
                if abs(last) < math.inf:
                    steps += (v - last) * (v - last)
                    highest = max(highest, abs(v - last))
                    pairs += 1
            last = v
        if 2 * count >= stop - first and pairs > 0:
            out[0, c] = squares / count - (total / count) * (total / count) - 0.5 * steps / pairs
        else:
            out[0, c] = math.nan
        out[1, c] = highest


def peak(power: Samples, rates: Samples) -> tuple[float, float]:
    """The rate (per minute) at which the power (f,) is highest, between the grid's rates, and how much of all power is about it.

    A peak at either end of the rates does not count: (NaN, 0).
    """
    total = float(power.sum())
    top = int(power.argmax())
    if top == 0 or top == len(power) - 1 or not total > 0:
        return math.nan, 0.0
    before, here, after = (float(v) for v in power[top - 1 : top + 2])
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    rate = float(rates[top] + shift * (rates[1] - rates[0]))
    near = np.abs(rates - rate) <= HALF_WIDTH
    return rate, float(power[near].sum()) / total
