"""The bed in the mean depths of a room: the plateau above the floor, however the camera is tilted.

A plane in the room is one in 1 / depth in the picture, and planes that are parallel differ by a factor alone. So one slope makes every
level surface as far away everywhere as it is in the picture's middle: floor and mattress become two peaks of one histogram.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples

FOCAL = 0.7
"""Of a camera that sees 71 degrees, in widths of its picture; heights and areas need it roughly, the levels do not."""
TILTS = np.radians(np.arange(-10.0, 66.0, 2.5))
ROLLS = np.tan(np.radians(np.arange(-15.0, 16.0, 3.0)))
FINER = np.linspace(-1.0, 1.0, 9)
LEVEL_SHARE = 0.015
"""Levels this much apart, as a share of their distance, are held apart."""
NEARNESS = np.array([0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25])
HORIZON = 0.12
"""What is nearer than this to the floor's horizon (1 in the picture's middle) is not looked at."""
BIN_MM = 25.0
FLOOR_SHARE = 0.04
"""The floor: the lowest level at which this share of the frame is, within 75 mm."""
LEVEL_MM = 70.0
"""A mattress with its duvet is level within this."""
HIGHEST_BODY_MM = 350.0
"""Who lies on it parts it in two."""
TOPS, COVERED = 12, 0.7
MIN_FILLED = 0.5
"""How much of its rectangle a plateau must fill to be a bed."""
SMALLEST_M2, LARGEST_M2 = 0.5, 8.0
FULL = 0.4
"""Rows and columns at least this full, of the fullest, are the bed's: it is narrower where it is farther away."""
LARGE = 20
"""A bed of more blocks than this is reported without those at its edge."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class BedLimits:
    """How high above the floor a bed may be (mm), and how much of the frame it covers at least."""

    lowest_mm: float
    highest_mm: float
    min_share: float


def bed_in(depth: Samples, limits: BedLimits) -> tuple[int, int, int, int] | None:
    """The bed's first row and column, and how many, in blocks; None if there is no bed.

    depth  (rows, columns) mean depths of blocks, mm; NaN: not measured
    """
    valid = np.isfinite(depth) & (depth > 0)
    if valid.sum() < 0.1 * depth.size:
        return None
    down, right = _slope(depth, valid)
    factor = _factors(depth.shape, down, right)
    valid &= factor > HORIZON
    if not valid.any():
        return None
    upright = 1 / np.sqrt(1 + (FOCAL * down) ** 2 + (FOCAL * right) ** 2)
    below = np.where(valid, depth * factor * upright, np.nan)
    counts = np.bincount((below[valid] / BIN_MM).astype(np.int64), minlength=3)
    near = np.convolve(counts, np.ones(3), mode="same")
    floors = np.flatnonzero(
        (near >= FLOOR_SHARE * depth.size) & (near >= np.roll(near, 1)) & (near >= np.roll(near, -1))
    )
    if not len(floors):
        return None
    floor = float(np.median(below[np.abs(below - (floors[-1] + 0.5) * BIN_MM) < 1.5 * BIN_MM]))
    high = floor - below
    areas = np.where(valid, depth**3 / np.maximum(below, 1.0) * 1e-6 / (FOCAL * depth.shape[1]) ** 2, 0.0)
    return _plateau(high, areas, limits)


def _factors(shape: tuple[int, ...], down: float, right: float) -> Samples:
    """What makes level surfaces as far away everywhere as in the middle; down, right: per width of the picture."""
    rows, columns = shape
    v, u = np.mgrid[:rows, :columns]
    factors: Samples = 1 + (down * (v - (rows - 1) / 2) + right * (u - (columns - 1) / 2)) / columns
    return factors


def _slope(depth: Samples, valid: Mask) -> tuple[float, float]:
    """The slope down and to the right under which the room has the fewest levels."""

    def sharpness(down: float, right: float, share: float) -> float:
        factor = _factors(depth.shape, down, right)
        seen = valid & (factor > HORIZON)
        levels = np.log(depth[seen] * factor[seen]) * (4 / share)
        if not len(levels):
            return 0.0
        counts = np.bincount((levels - levels.min()).astype(np.int64), minlength=len(NEARNESS)).astype(np.float64)
        return float(counts @ np.convolve(counts, NEARNESS, mode="same"))

    tried = [(np.tan(tilt) / FOCAL, roll / np.cos(tilt) / FOCAL) for tilt in TILTS for roll in ROLLS]
    best = max(tried, key=lambda slope: sharpness(slope[0], slope[1], LEVEL_SHARE))
    for step in (0.06, 0.015):
        tried = [(best[0] + step * (1 + best[0] ** 2) * a, best[1] + step * b) for a in FINER for b in FINER]
        best = max(tried, key=lambda slope: sharpness(slope[0], slope[1], LEVEL_SHARE / 2))
    return best


def _plateau(high: Samples, areas: Samples, limits: BedLimits) -> tuple[int, int, int, int] | None:
    """The largest level surface at a bed's height; high: (rows, columns) mm above the floor, areas: m2 of blocks that are level."""
    from scipy.ndimage import label

    within = high[(high >= limits.lowest_mm) & (high <= limits.highest_mm)]
    if not len(within):
        return None
    counts = np.convolve(np.bincount((within / BIN_MM).astype(np.int64), minlength=3), np.ones(3), mode="same")
    best, found = 0, None
    for top in np.argsort(-counts, kind="stable")[:TOPS]:
        if not counts[top] or (top + 0.5) * BIN_MM < limits.lowest_mm:
            continue
        with np.errstate(invalid="ignore"):
            above = high - (top + 0.5) * BIN_MM
            level = np.abs(above) < LEVEL_MM
            covered = level | ((above > 0) & (above < HIGHEST_BODY_MM))
        parts, count = label(level)
        sizes = np.bincount(parts.ravel(), minlength=count + 1)
        sizes[0] = 0
        bed = parts == int(sizes.argmax())
        if sizes.max() <= max(best, limits.min_share * high.size - 1):
            continue
        if not SMALLEST_M2 <= areas[bed].sum() <= LARGEST_M2:
            continue
        spans = _spans(bed)
        rows, columns = _extent(spans.sum(axis=1)), _extent(spans.sum(axis=0))
        if rows[1] > rows[0] and columns[1] > columns[0] and spans[slice(*rows), slice(*columns)].mean() >= MIN_FILLED:
            rows = _beyond(rows, level[:, slice(*columns)], covered[:, slice(*columns)])
            columns = _beyond(columns, level[slice(*rows)].T, covered[slice(*rows)].T)
            rows, columns = _inset(*rows), _inset(*columns)
            best, found = int(sizes.max()), (rows[0], columns[0], rows[1] - rows[0], columns[1] - columns[0])
    return found


def _beyond(rows: tuple[int, int], level: Mask, covered: Mask) -> tuple[int, int]:
    """The same up to the level rows beyond who lies there, and parts the bed in two."""
    ends = [rows[0], rows[1] - 1]
    for end, step in ((0, -1), (1, 1)):
        row = ends[end] + step
        while 0 <= row < len(level) and covered[row].mean() >= COVERED:
            if level[row].mean() >= COVERED:
                ends[end] = row
            row += step
    return ends[0], ends[1] + 1


def _spans(bed: Mask) -> Mask:
    """The bed with what lies on it: each row from its first block to its last."""
    after = np.maximum.accumulate(bed, axis=1)
    before = np.maximum.accumulate(bed[:, ::-1], axis=1)[:, ::-1]
    spans: Mask = after & before
    return spans


def _extent(filled: NDArray[np.int64]) -> tuple[int, int]:
    """From the first to one past the last row (or column) that is full enough."""
    full = np.flatnonzero(filled >= FULL * filled.max())
    return int(full[0]), int(full[-1]) + 1


def _inset(first: int, stop: int) -> tuple[int, int]:
    inset = int(stop - first > LARGE)
    return first + inset, stop - inset
