"""Depths second by second: means of blocks, how much they vary over a stretch, and how high they are above the empty bed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import NEVER, NS, Samples, Times
from kinegraph.stream.kernel import kernel

EDGE_MM = 100.0
"""So far apart are neighbouring blocks where there is an edge."""


@kernel
def add(blocks: Samples, sums: Samples, counts: Samples) -> None:
    """Take a frame's blocks (rows, columns) into the second's `sums` and `counts`; what is not finite was not measured."""
    for r in range(blocks.shape[0]):
        for c in range(blocks.shape[1]):
            if abs(blocks[r, c]) < math.inf:
                sums[r, c] += blocks[r, c]
                counts[r, c] += 1.0


@kernel
def close(sums: Samples, counts: Samples, mean: Samples, stretch: Samples) -> None:
    """The second's `mean` (rows, columns), NaN where nothing was measured, also into the `stretch` (3, rows, columns).

    stretch  of the means: how many, their sum, their squares' sum
    """
    for r in range(mean.shape[0]):
        for c in range(mean.shape[1]):
            mean[r, c] = sums[r, c] / counts[r, c] if counts[r, c] > 0 else math.nan
            if counts[r, c] > 0:
                stretch[0, r, c] += 1.0
                stretch[1, r, c] += mean[r, c]
                stretch[2, r, c] += mean[r, c] * mean[r, c]
            sums[r, c] = 0.0
            counts[r, c] = 0.0


@kernel
def look(mean: Samples, empty: Samples, regions: Times, rise: float, out: Samples) -> None:
    """Of every region (k, 4), into `out` (k, 3): the share of blocks more than `rise` above `empty`, the mean height, the share measured.

    The first two are NaN where less than half of what is measured has a known empty depth.
    """
    for k in range(regions.shape[0]):
        row, column, rows, columns = regions[k]
        measured, known, raised, height = 0, 0, 0, 0.0
        for r in range(row, row + rows):
            for c in range(column, column + columns):
                if mean[r, c] == mean[r, c]:
                    measured += 1
                    above = empty[r, c] - mean[r, c]
                    if above == above:
                        known += 1
                        height += above
                        raised += above > rise
        enough = known > 0 and 2 * known >= measured
        out[k, 0] = raised / known if enough else math.nan
        out[k, 1] = height / known if enough else math.nan
        out[k, 2] = measured / (rows * columns) if rows * columns > 0 else 0.0


def steep(depth: Samples, limit: float) -> NDArray[np.bool_]:
    """Where neighbours of `depth` (rows, columns) differ by more than `limit`: edges.

    The mean of a block that holds both sides of an edge trembles with the pixels that happen to be measured in a frame. A tilted plane has
    no edge: there the depth goes on as it came.
    """
    edge = np.zeros(depth.shape, np.bool_)
    down, right = _leaps(np.diff(depth, axis=0), limit), _leaps(np.diff(depth, axis=1).T, limit).T
    for part, far in ((np.s_[1:], down), (np.s_[:-1], down), (np.s_[:, 1:], right), (np.s_[:, :-1], right)):
        edge[part] |= far
    return edge


def _leaps(step: Samples, limit: float) -> NDArray[np.bool_]:
    """Which of the steps (n, m) between rows are larger than `limit`, and by as much unlike the step before or after them."""
    unlike = np.abs(np.diff(step, axis=0))
    around = np.full((2, *step.shape), np.nan)
    around[0, 1:], around[1, :-1] = unlike, unlike
    alone = np.isnan(around).all(axis=0)
    leaps: NDArray[np.bool_] = (np.abs(step) > limit) & (alone | (around > limit).any(axis=0))
    return leaps


def restless(stretch: Samples, region: Times, least: float) -> int:
    """How many blocks of a region vary, see `restless_blocks`; -1: the stretch was not seen."""
    found = restless_blocks(stretch, region, least)
    return -1 if found is None else int(found.sum())


def restless_blocks(stretch: Samples, region: Times, least: float) -> NDArray[np.bool_] | None:
    """Which blocks of a region vary by more than `least` and three times the frame's median; None: the stretch was not seen.

    Blocks on an edge are left out: see `steep`.
    """
    count = stretch[0]
    most = count.max()
    usable = (count >= 0.8 * most) & (count > 1)
    row, column, rows, columns = (int(v) for v in region)
    part = (slice(row, row + rows), slice(column, column + columns))
    if not usable[part].any():
        return None
    n = np.maximum(count, 1.0)
    usable &= ~steep(np.where(usable, stretch[1] / n, np.nan), EDGE_MM)
    if not usable[part].any():
        return None
    spread = np.sqrt(np.maximum(stretch[2] / n - (stretch[1] / n) ** 2, 0.0))
    limit = max(least, 3.0 * float(np.median(spread[usable])))
    found: NDArray[np.bool_] = usable[part] & (spread[part] > limit)
    return found


@dataclass(slots=True)
class Seconds:
    """
    begin         of the present second (ns); NEVER if closed. sums, counts (rows, columns): of it
    mean          (rows, columns) of the newest second
    closed        end of the newest second (ns)
    since         begin of the present stretch (ns); NEVER if closed. stretch (3, rows, columns): its sums, as `close` has them
    """

    begin: int
    sums: Samples
    counts: Samples
    mean: Samples
    closed: int
    since: int
    stretch: Samples

    @staticmethod
    def of(shape: tuple[int, ...]) -> Seconds:
        return Seconds(
            NEVER, np.zeros(shape), np.zeros(shape), np.full(shape, np.nan), NEVER, NEVER, np.zeros((3, *shape))
        )

    def end(self, longest_pause_ns: int) -> None:
        """The second is over. A stretch does not go on across a longer pause."""
        if self.since == NEVER or self.begin - self.closed > longest_pause_ns:
            self.since = self.begin
            self.stretch[:] = 0.0
        close(self.sums, self.counts, self.mean, self.stretch)
        self.closed = self.begin + NS
        self.begin = NEVER

    def depth(self) -> Samples:
        """The mean depths (rows, columns) of the stretch."""
        with np.errstate(invalid="ignore"):
            mean: Samples = self.stretch[1] / self.stretch[0]
        return mean
