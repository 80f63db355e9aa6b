"""The depths of all cells at a fixed rate, and how fast a region of them breathes: what breathing and presence both ask."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.bed.breath import BEST, gather, peak, spectra, together, vary
from kinegraph.operators.bed.frames.seconds import steep
from kinegraph.stream.chunk import NEVER, NS, Array, Samples, Times

FASTEST_TICK_HZ = 4.0
LOWEST, HIGHEST, STEP = 6.0, 45.0, 1.0
"""Breaths per minute that are looked for; spectra go on to `WIDEST`, where noise is alone."""
WIDEST = 60.0
SEGMENT_S = 30.0
"""Longer windows are cut into pieces of about this length."""
SURE = 90.0
"""A peak of the summed spectra that has a confidence of one half: noise reaches it in less than one window of a thousand."""
NOISE_MM = 0.03
"""No cell's noise is taken to be lower."""
EDGE_MM = 150.0
"""So far apart are neighbouring cells where there is an edge: their means jump, see `operators.bed.frames.seconds.steep`."""
NOISY = 6.0
"""A step of this many standard deviations of a cell's usual ones is movement."""
FLICKER = 0.01
"""This share of the cells, and at least one, may jump where nothing moves: edges, and pixels that are measured now and then."""
LEAST_CELLS = 6
ERROR, FLOOR = 60.0, 0.05
"""The rate's interval, from rooms of chosen seeds: this over the window's length (s), by how far the peak is above the noise."""


@dataclass(frozen=True, slots=True)
class CellBreath:
    """
    rate, confidence   per minute; 0 to 1
    moved              whether anything moved in the region, so that no rate is looked for
    cells              numbers of those that breathe most
    error              half the width of the rate's 95 % interval
    """

    rate: float
    confidence: float
    moved: bool
    cells: Times
    error: float


@dataclass(slots=True)
class BreathCells:
    """
    size       of a cell in blocks; across: cells in a row of the frame
    ticks      (n, cells)  the newest depths (mm) of all cells, tick by tick, a ring; NaN: not measured
    tick       number of the open tick since 1970; NEVER: none. sums, counts (cells,): of it
    segments   into how many pieces a window is cut
    cosines, sines (rates, ticks of a segment), rates (rates,): what is looked for
    still_mm   a greater step from tick to tick is movement, unless the cell is noisy
    """

    size: int
    across: int
    tick_ns: int
    segments: int
    ticks: Samples
    tick: int
    sums: Samples
    counts: Samples
    rates: Samples
    cosines: Samples
    sines: Samples
    still_mm: float

    @staticmethod
    def of(shape: tuple[int, ...], rate_hz: float, window_s: float, size: int, still_mm_s: float) -> BreathCells:
        """For blocks (rows, columns) at `rate_hz`; `size` 0: about 27 cells in a row of the frame."""
        tick_ns = round(NS / min(FASTEST_TICK_HZ, rate_hz))
        tick_hz = NS / tick_ns
        segments = max(1, round(window_s / SEGMENT_S))
        n = math.ceil(window_s / segments * tick_hz)
        size = size or max(1, round(shape[1] / 27))
        across = -(-shape[1] // size)
        cells = -(-shape[0] // size) * across
        rates = np.arange(LOWEST - STEP, min(WIDEST, 60 * tick_hz * 0.45) + STEP / 2, STEP)
        angles = 2 * np.pi * np.outer(rates / 60, np.arange(n) / tick_hz)
        # compiled now: made-up samples of the warm-up seldom breathe
        vary(np.zeros((1, 1)), 0, 1, np.empty((3, 1)))
        spectra(np.zeros((4, 1)), 0, 1, np.zeros(1, np.int64), np.zeros((1, 4)), np.zeros((1, 4)), np.empty((1, 1)))
        return BreathCells(
            size, across, tick_ns, segments, np.full((n * segments, cells), np.nan), NEVER, np.zeros(cells), np.zeros(cells),
            rates, np.cos(angles), np.sin(angles), still_mm_s / tick_hz,
        )  # fmt: skip

    def add(self, blocks: Samples, time: int) -> None:
        """A frame's blocks (rows, columns)."""
        tick = time // self.tick_ns
        if tick != self.tick:
            self.close(tick)
            self.tick = tick
        gather(blocks, self.size, self.sums, self.counts)

    def close(self, following: int) -> None:
        """Keep the open tick; those before `following` that had no frame were not measured."""
        n = len(self.ticks)
        if self.tick != NEVER:
            with np.errstate(invalid="ignore"):
                self.ticks[self.tick % n] = self.sums / self.counts
            for tick in range(max(self.tick + 1, following - n), following):
                self.ticks[tick % n] = np.nan
        self.sums[:] = 0.0
        self.counts[:] = 0.0
        self.tick = NEVER

    def forget(self) -> None:
        self.ticks[:] = np.nan

    def breaths(self, begin: int, regions: Times) -> list[CellBreath]:
        """The breath of every region (k, 4) of blocks in the window that begins at `begin` (ns)."""
        first = begin // self.tick_ns
        stop = first + len(self.ticks)
        self.close(stop)
        varying = np.empty((3, self.ticks.shape[1]))
        vary(self.ticks, first, stop, varying)
        finite = np.isfinite(self.ticks)
        with np.errstate(invalid="ignore"):
            depth = np.where(finite, self.ticks, 0.0).sum(axis=0) / finite.sum(axis=0)
        edges = steep(depth.reshape(-1, self.across), EDGE_MM).ravel()
        return [self._breath(region, varying, edges, first) for region in regions]

    def _breath(self, region: Times, varying: Samples, edges: Array, first: int) -> CellBreath:
        cells = self._cells(region)
        cells = cells[varying[0, cells] >= 0.5]
        if len(cells) < LEAST_CELLS:
            return CellBreath(math.nan, 0.0, False, cells[:0], math.nan)
        usual = NOISY * 1.4826 * varying[2, cells]
        fast = (varying[1, cells] > np.maximum(self.still_mm, usual)) & ~edges[cells]
        if fast.sum() > max(1.0, FLICKER * len(cells)):
            return CellBreath(math.nan, 0.0, True, cells[:0], math.nan)
        power = np.empty((len(cells), len(self.rates)))
        spectra(self.ticks, first, self.segments, cells, self.cosines, self.sines, power)
        noise = NOISE_MM**2 * 0.375 * self.cosines.shape[1] * self.segments
        summed, best = together(power, noise)
        rate, height = peak(summed, self.rates, LOWEST, HIGHEST)
        sure = height / (height + SURE * min(len(cells), BEST) / BEST)
        window_s = len(self.ticks) * self.tick_ns / NS
        error = ERROR / window_s * math.sqrt(FLOOR**2 + 1 / max(height, 1.0))
        return CellBreath(rate, sure, False, cells[best], error)

    def _cells(self, region: Times) -> Times:
        """The numbers of the cells whose middle lies in a region of blocks."""
        row, column, rows, columns = (int(v) for v in region)
        count = self.ticks.shape[1]
        middles = (
            np.arange(count) // self.across * self.size + self.size / 2,
            np.arange(count) % self.across * self.size + self.size / 2,
        )
        inside = (
            (middles[0] >= row) & (middles[0] < row + rows) & (middles[1] >= column) & (middles[1] < column + columns)
        )
        return np.flatnonzero(inside)
