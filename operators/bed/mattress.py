"""The mattress of a bed that was not seen empty, as a plane, and whether what stands out of it may be somebody."""

from __future__ import annotations

import numpy as np

from kinegraph.operators.bed.bed import WIDE
from kinegraph.stream.chunk import Samples

TRIES = 200
"""Planes through three blocks; with a third of the bed covered, one of seven of them lies in the mattress."""
BELOW = 0.5
"""What a block that is farther away counts against a plane: there is nothing beneath a mattress but some floor beside it."""
MIDDLE = (0.4, 0.6)
"""Who lies in bed lies across this part of its length; pillows and a folded blanket do not reach it."""

LEVEL, STRAY = 0.8, 0.02
"""A flat bed has this much in its plane; so few blocks that rise are edges."""
HIGHEST_MM = 400.0
"""Half of what stands out of a mattress is no higher; where it is, that is the bed, in a region that holds much of the floor."""


def mattress(depth: Samples, near: float) -> Samples:
    """Depths (rows, columns) of the plane with most blocks of `depth` within `near` mm, and few below; all NaN if there is no such plane.

    A plane in the room is one of the picture in 1 / depth, however the camera is tilted. The tries are the same every time.
    """
    rows, columns = np.nonzero(depth > 0)
    if len(rows) < 4:
        return np.full_like(depth, np.nan)
    terms = np.stack([np.ones(len(rows)), rows, columns], axis=1)
    z = depth[rows, columns]
    picked = np.random.default_rng(0).integers(0, len(rows), (TRIES, 3))
    corners = terms[picked]
    apart = np.abs(np.linalg.det(corners)) > 0.5
    planes = np.linalg.solve(corners[apart], 1 / z[picked[apart]][..., None])[..., 0]
    if not len(planes):
        return np.full_like(depth, np.nan)
    with np.errstate(divide="ignore"):
        below = z - 1 / (planes @ terms.T)
        plane = planes[((np.abs(below) < near).sum(axis=1) - BELOW * (below >= near).sum(axis=1)).argmax()]
        for _ in range(3):
            on = np.abs(1 / (terms @ plane) - z) < near
            plane = np.linalg.lstsq(terms[on], 1 / z[on], rcond=None)[0]
        down, right = np.mgrid[: depth.shape[0], : depth.shape[1]]
        made: Samples = 1 / (plane[0] + plane[1] * down + plane[2] * right)
    return made


def level(above: Samples, rise: float) -> bool:
    """Whether the bed is flat: nearly all that is measured lies in the mattress's plane, and nothing in the middle of its length rises.

    above  (rows, columns) mm above the plane, NaN: not known
    """
    known = np.isfinite(above)
    if not known.any() or 2 * known.sum() < above.size:
        return False
    first, last = (round(share * len(above)) for share in MIDDLE)
    middle = above[first : max(last, first + 1)]
    within = float((np.abs(above[known]) < rise / 2).mean())
    return within >= LEVEL and not bool((middle > rise).sum() > STRAY * middle.size)


def somebody(above: Samples, rise: float, least: float) -> bool:
    """Whether what is `above` the mattress (rows, columns; NaN: not known) by more than `rise` mm may be a body.

    It covers a share of `least` across the middle of the bed's length. Sleepers lie along the picture's columns, but in a bed that is much
    wider than long.
    """
    rows, columns = above.shape
    lies = above.T if columns >= WIDE * rows else above
    first, last = (round(share * len(lies)) for share in MIDDLE)
    middle = lies[first : max(last, first + 1)]
    known = middle[np.isfinite(middle)]
    if not len(known):
        return False
    raised = known[known > rise]
    return bool(len(raised) >= max(1.0, least * len(known)) and np.median(raised) < HIGHEST_MM)
