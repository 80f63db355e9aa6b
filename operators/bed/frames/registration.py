"""Which shift of the whole picture, with which tilt, turns one map of depths into another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Samples

MOST_MM = 200.0
"""A block counts for no more than this: one that shows something else is no reason to shift all the others."""
REACH = 3
EXPLAINS, EXPLAINS_PARTLY = 0.5, 0.75
CELLS = 8
EDGE_MM = 60.0
LEAST_BLOCKS, LEAST_TILT_MM = 0.25, 10.0


@dataclass(frozen=True, slots=True)
class Fit:
    """down, right: the shift in blocks. tilt: how far the plane between both departs from level (mm, rms). left, was: mean change (mm)."""

    down: float
    right: float
    tilt: float
    left: float
    was: float

    @property
    def explains(self) -> bool:
        """Whether it is a jump: large enough, and it explains at least half of the change."""
        return self._large and self.left < EXPLAINS * self.was

    @property
    def explains_partly(self) -> bool:
        """Whether it is one beside which something else has changed: it leaves at most three quarters."""
        return self._large and self.left < EXPLAINS_PARTLY * self.was

    @property
    def _large(self) -> bool:
        return max(abs(self.down), abs(self.right)) >= LEAST_BLOCKS or self.tilt >= LEAST_TILT_MM


def cost(difference: Samples) -> float:
    """Mean absolute difference (mm), of each block at most `MOST_MM`; NaN where next to nothing was measured in both."""
    seen = np.isfinite(difference)
    if 4 * int(seen.sum()) < difference.size:
        return float("nan")
    return float(np.minimum(np.abs(difference[seen]), MOST_MM).mean())


def registered(now: Samples, before: Samples) -> Fit:
    """The best shift by at most `REACH` blocks, to a quarter of a block: by whole ones, then halves, then quarters about the best."""
    was = cost(now - before)
    best = Fit(0.0, 0.0, 0.0, was, was)
    for reach, step in ((REACH, 1.0), (1, 0.5), (1, 0.25)):
        offsets = step * np.arange(-reach, reach + 1)
        middle = best
        for down, right in ((middle.down + d, middle.right + r) for d in offsets for r in offsets):
            left, tilt = _level(now - shifted(before, down, right))
            if left < best.left or (left == left and best.left != best.left):
                best = Fit(down, right, tilt, left, was)
    return best


def shifted(depth: Samples, down: float, right: float) -> Samples:
    """The map (rows, columns) moved by this many blocks; NaN where it came from outside.

    Where a block lies between two neighbours of other depths an edge runs through it, as far from either as its depth tells; the edge
    moves, nothing is blurred.
    """
    out = depth
    for axis, step in ((0, down), (1, right)):
        whole = int(np.floor(step))
        out = _by(out, whole, axis)
        if step != whole:
            out = _glided(out if axis else out.T, round((step - whole) * CELLS))
            out = out if axis else out.T
    return out


def _glided(depth: Samples, cells: int) -> Samples:
    """Moved to the right by this many of the `CELLS` that a block is wide."""
    rows, columns = depth.shape
    left = np.concatenate([depth[:, :1], depth[:, :-1]], axis=1)
    right = np.concatenate([depth[:, 1:], depth[:, -1:]], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (depth - right) / (left - right)
        edge = (np.abs(left - right) > EDGE_MM) & (share >= 0) & (share <= 1)
    fine = np.where(np.arange(CELLS) + 0.5 < CELLS * share[:, :, None], left[:, :, None], right[:, :, None])
    fine = np.where(edge[:, :, None], fine, depth[:, :, None]).reshape(rows, -1)
    moved = np.full_like(fine, np.nan)
    moved[:, cells:] = fine[:, : columns * CELLS - cells]
    made: Samples = moved.reshape(rows, columns, CELLS).mean(axis=2)
    return made


def _by(depth: Samples, step: int, axis: int) -> Samples:
    out = np.full_like(depth, np.nan)
    n = depth.shape[axis]
    if abs(step) < n:
        to, source = [slice(None)] * 2, [slice(None)] * 2
        to[axis] = slice(max(0, step), n + min(0, step))
        source[axis] = slice(max(0, -step), n - max(0, step))
        out[tuple(to)] = depth[tuple(source)]
    return out


def _level(difference: Samples) -> tuple[float, float]:
    """What is left of a difference without its plane (mm), and how far that plane departs from 0 (mm, rms)."""
    seen = np.isfinite(difference)
    if 4 * int(seen.sum()) < difference.size:
        return float("nan"), 0.0
    middle = float(np.median(difference[seen]))
    near = seen & (np.abs(difference - middle) < MOST_MM / 2)
    y, x = np.nonzero(near)
    x0, y0 = difference.shape[1] / 2, difference.shape[0] / 2
    terms = np.stack([np.ones(len(x)), (x - x0) / x0, (y - y0) / y0])
    solved = np.linalg.lstsq(terms @ terms.T, terms @ difference[near], rcond=None)[0]
    rows, columns = np.mgrid[: difference.shape[0], : difference.shape[1]]
    plane = solved[0] + solved[1] * (columns - x0) / x0 + solved[2] * (rows - y0) / y0
    return cost(difference - plane), float(np.sqrt(np.mean(plane**2)))
