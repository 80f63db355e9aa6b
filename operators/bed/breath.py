"""Breath in the depths of cells: cells as they come at a fixed rate, which of them breathe, and how fast.

A cell is a square of blocks; its depth is the mean of what was measured of it in a tick.
"""

from __future__ import annotations

import math

import numpy as np

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.data.ordering import median
from kinegraph.stream.kernel import kernel

BEST = 12
"""This many cells, those with the highest peaks, are taken for the chest."""
COLOURED, QUIET = 24, 0.35
"""From this many cells on the colour of their noise is known, as this quantile of them has it."""
HARMONIC = 0.45
"""Half of a rate with this much of its power is the rate."""


@kernel
def gather(blocks: Samples, size: int, sums: Samples, counts: Samples) -> None:
    """Take a frame's blocks (rows, columns) into the cells' `sums` and `counts` (cells,); cells of `size` x `size` blocks, row by row."""
    across = -(-blocks.shape[1] // size)
    for r in range(blocks.shape[0]):
        row = r // size * across
        for k in range(size):  # a column of every cell, for these are done in vectors
            for c in range((blocks.shape[1] - k + size - 1) // size):
                depth = blocks[r, c * size + k]
                measured = abs(depth) < math.inf
                sums[row + c] = sums[row + c] + depth if measured else sums[row + c]
                counts[row + c] += 1.0 if measured else 0.0


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
    """How every cell of x (n, cells) steps from tick `first` to `stop`: share measured, greatest and median step, into `out` (3, cells).

    Rows are a ring: a tick's row is its number modulo n. Steps join measured ticks that follow each other; NaN: there is no step.
    """
    n = x.shape[0]
    steps = np.empty(stop - first)
    for c in range(x.shape[1]):
        count, pairs, greatest = 0, 0, math.nan
        last = math.nan
        for t in range(first, stop):
            v = x[t % n, c]
            if abs(v) < math.inf:
                count += 1
                if abs(last) < math.inf:
                    steps[pairs] = abs(v - last)
                    greatest = steps[pairs] if pairs == 0 else max(greatest, steps[pairs])
                    pairs += 1
            last = v
        out[0, c] = count / (stop - first)
        out[1, c] = greatest
        out[2, c] = median(steps, pairs) if pairs > 0 else math.nan


@kernel
def spectra(
    x: Samples, first: int, segments: int, cells: Times, cosines: Samples, sines: Samples, out: Samples
) -> None:
    """Power spectra of some `cells` of the ring x (n, all cells) from tick `first` on, into `out` (cells, f); sums over `segments`."""
    n, size = x.shape[0], cosines.shape[1]
    piece, straight = np.empty(size), np.empty(size)
    out[:] = 0.0
    for k in range(cells.shape[0]):
        for segment in range(segments):
            for i in range(size):
                piece[i] = x[(first + segment * size + i) % n, cells[k]]
            straighten(piece, straight)
            powers(straight, cosines, sines, out[k])


def together(power: Samples, noise: float) -> tuple[Samples, Times]:
    """The whitened spectra of those cells that breathe most, summed: (f,), and which they are. 1 is a cell's own noise.

    power  (cells, f); noise: a power that no cell's noise is below

    Each cell's spectrum is divided by its own median, and by the colour that most cells share: cameras smooth their depths over time, so
    that noise is stronger at low rates. A chest is a small part of the region, so it hardly shows in that colour.
    """
    white = power / (np.median(power, axis=1) + noise)[:, None]
    if len(white) >= COLOURED:
        colour = np.quantile(white, QUIET, axis=0)
        colour = np.convolve(np.pad(colour, 2, mode="edge"), np.full(5, 0.2), mode="valid")
        white = white * (colour.mean() / np.maximum(colour, 0.05 * colour.mean()))
    best = np.sort(np.argsort(-white.max(axis=1), kind="stable")[:BEST])
    summed: Samples = white[best].sum(axis=0)
    return summed, best


def peak(power: Samples, rates: Samples, lowest: float, highest: float) -> tuple[float, float]:
    """The rate (per minute) at which the summed power (f,) is highest, between the grid's rates, and how high; (NaN, 0): there is none.

    Breath is no sine: half of that rate is taken where it has much of the power, too.
    """
    top = int(power.argmax())
    half = np.flatnonzero(np.abs(rates - rates[top] / 2) <= 1.0)
    if len(half) and power[half].max() >= HARMONIC * power[top]:
        top = int(half[power[half].argmax()])
    if top == 0 or top == len(power) - 1:
        return math.nan, 0.0
    before, here, after = (float(v) for v in power[top - 1 : top + 2])
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    rate = float(rates[top] + max(-0.5, min(0.5, shift)) * (rates[1] - rates[0]))
    return (rate, here) if lowest <= rate <= highest else (math.nan, 0.0)
