"""What the ends of a body's surface can be, head, hand or foot, and where the image's border cuts the body instead."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Array, Samples

ENDS = ("head", "left hand", "right hand", "left foot", "right foot")
USUAL = np.array([(0.0, 0.72), (0.35, 0.1), (-0.35, 0.1), (0.12, -0.85), (-0.12, -0.85)])
"""Where the ends are from the middle of a body that stands, to its left and upwards (m, for 1.75 m)."""
MEMORY = np.array([0.4, 0.8, 0.8, 0.5, 0.5])
"""How much where an end was counts against where it usually is: a head and feet that were mistaken for another must be found again."""
MOST_ENDS = 6
"""How many ends are searched for: knees and elbows may lie farther out than the head."""
ORDERS = np.array(list(permutations(range(MOST_ENDS + 1), len(ENDS))))
"""Every way to assign the ends to what was found; the last number means no end."""
ROUND_M, UNLIKE = 0.18, 0.4
AREAS, HEADS, TIPS = (0.014, 0.019, 0.030, 0.036), (1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 1.0, 1.0)
"""The visible surface within ROUND_M of an end (m2, for 1.75 m), and by how much it rules out a head, a hand or foot: hands and feet show
0.005 to 0.016, heads 0.019 to 0.030, knees mostly more; what it costs to take one for the other (m)."""
FAR_M = 0.55
"""An end farther from where it is expected is not taken for it."""
CUT_M = 0.06
"""An end this near to the image's border is ignored: the border cuts the body there."""


def costs(at: Samples, areas: Samples, usual: Samples, before: Samples, fresh: Array, size: float) -> Samples:
    """Costs (m) of matching each end found with each of ENDS (5, MOST_ENDS + 1); the last column means no end.

    at, areas      (n, 3) places, (n,) the surface around them (m2; NaN: not known)
    usual, before  (5, 3) where each of ENDS usually is, and where it was, which counts where that is `fresh` (5,)
    size           the body's, in 1.75 m
    """
    cost = np.full((len(ENDS), MOST_ENDS + 1), FAR_M * size)
    for k, place in enumerate(at):
        apart = np.linalg.norm(usual - place, axis=1)
        since = np.linalg.norm(before - place, axis=1)
        cost[:, k] = np.where(fresh, MEMORY * np.nan_to_num(since) + (1 - MEMORY) * apart, 0.8 * apart)
        cost[:, k] += UNLIKE * size * unlike(areas[k])
    return cost


def cheapest(cost: Samples) -> list[int]:
    """The cheapest way to name what was found; what costs as much as not being found, the last column, is not: -1."""
    ends = np.arange(len(ENDS))
    best = ORDERS[int(np.minimum(cost, cost[:, -1:])[ends, ORDERS].sum(axis=1).argmin())]
    return [int(k) if cost[e, k] < cost[e, -1] else -1 for e, k in enumerate(best)]


def unlike(area: float) -> Samples:
    """By how much the surface around an end (m2) rules out each of ENDS: 0 to 1."""
    if math.isnan(area):
        return np.zeros(len(ENDS))
    head, tip = np.interp(area, AREAS, HEADS), np.interp(area, AREAS, TIPS)
    return np.array([head, tip, tip, tip, tip])


def border_of(points: Samples) -> Samples:
    """The places (n, 3) of the body at the border of `points` (h, w, 3)."""
    border = np.concatenate([points[0], points[-1], points[1:-1, 0], points[1:-1, -1]])
    return np.asarray(border[np.isfinite(border[:, 2])])


def cut_off(border: Samples, ends: Samples, near_m: float) -> NDArray[np.bool_]:
    """Which `ends` (n, 3) are less than `near_m` from a place of the body at the image's `border` (m, 3)."""
    return np.asarray((np.linalg.norm(ends[:, None] - border, axis=2) < near_m).any(axis=1))


def head_cut_off(border: Samples, head: Samples, usual: Samples) -> bool:
    """Whether the body reaches to the image's border nearer to where a head usually is (3,) than what is taken for it, a shoulder."""
    return bool((np.linalg.norm(border - usual, axis=1) < math.dist(head, usual)).any())


def outside(places: Samples, camera: Samples, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Which `places` (n, 3) an image of `shape` (h, w) does not show; `camera` (4,) fx, fy, cx, cy in pixels."""
    u, v = (camera[2 + a] + camera[a] * places[:, a] / places[:, 2] for a in range(2))
    return np.asarray((u < -0.5) | (u > shape[1] - 0.5) | (v < -0.5) | (v > shape[0] - 0.5))


def beside(points: Samples, place: Samples, camera: Samples, near_m: float) -> bool:
    """Whether the camera, `camera` (4,) as in `outside`, sees no surface of the body within `near_m` of `place` (3,) across its image.

    `points` (h, w, 3) are that surface. False for a place that is not known.
    """
    if not np.isfinite(place).all():
        return False
    near = near_m / place[2] * camera[:2]
    middle = camera[2:] + place[:2] / place[2] * camera[:2]
    left, top = np.maximum(np.ceil(middle - near), 0.0).astype(int)
    right, bottom = np.maximum(np.floor(middle + near) + 1.0, 0.0).astype(int)
    return not bool(np.isfinite(points[top:bottom, left:right, 2]).any())
