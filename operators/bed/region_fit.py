"""Whether the regions hold who lies in bed: asked by a setup check, and in the first minutes of a night."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

MIN_INSIDE = 0.75
"""This much of who lies in bed must be within the regions."""
MIN_BLOCKS = 4
STEADY = 0.6
"""Who lies there covers this much of the same blocks from minute to minute, of all that are covered."""

Region = tuple[int, int, int, int]
Mask = NDArray[np.bool_]


def within(regions: Sequence[Region], shape: tuple[int, ...]) -> Mask:
    """Which blocks are in any of the regions (row, column, rows, columns)."""
    inside: Mask = np.zeros(shape, np.bool_)
    for row, column, rows, columns in regions:
        inside[row : row + rows, column : column + columns] = True
    return inside


def body_at(raised: Mask, inside: Mask) -> Mask:
    """What is raised in one piece, and is in the regions with most of its blocks; empty where nothing is."""
    from scipy.ndimage import label

    parts, count = label(raised)
    sizes = np.bincount(parts[inside], minlength=count + 1)
    sizes[0] = 0
    made: Mask = (parts == int(sizes.argmax())) & raised if sizes.max() else np.zeros_like(raised)
    return made


def is_same(body: Mask, before: Mask) -> bool:
    """Whether it still lies where it lay."""
    return bool(body.sum() >= MIN_BLOCKS and (body & before).sum() >= STEADY * (body | before).sum())


def suggested(bodies: Mapping[str, Mask], block: int) -> str:
    """The rectangle of what is raised and a block around it, in pixels; several share it, cut halfway between neighbours."""
    boxes = [_box(body) for body in bodies.values()]
    if not all(len(box) for box in boxes):
        return "set it: regions: [[row, column, rows, columns]]"
    edges = np.array(boxes)  # (sleepers, 4): first row, first column, one past the last row and column
    shape = next(iter(bodies.values())).shape
    outer = np.append(np.maximum(edges[:, :2].min(axis=0) - 1, 0), np.minimum(edges[:, 2:].max(axis=0) + 1, shape))
    parts = np.tile(outer, (len(edges), 1))
    middles = (edges[:, :2] + edges[:, 2:]) / 2
    side = int(np.ptp(middles[:, 1]) >= np.ptp(middles[:, 0]))
    order = np.argsort(middles[:, side])
    for a, b in pairwise(order.tolist()):
        cut = round(float(edges[a, 2 + side] + edges[b, side]) / 2)
        parts[a, 2 + side] = parts[b, side] = cut
    suggested = [[int(v) * block for v in (top, left, end - top, right - left)] for top, left, end, right in parts]
    return f"try regions: {suggested}"


def _box(body: Mask) -> list[int]:
    """First row, first column, one past the last row, and the last column; [] where too little is raised."""
    rows, columns = np.flatnonzero(body.sum(axis=1) > 1), np.flatnonzero(body.sum(axis=0) > 1)
    return (
        [int(rows[0]), int(columns[0]), int(rows[-1]) + 1, int(columns[-1]) + 1] if len(rows) and len(columns) else []
    )
