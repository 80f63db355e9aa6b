"""The floor's plane in a depth image of a room."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Array, Samples

FLOOR = np.dtype([("onset", "<i8"), ("normal", "<f8", (3,)), ("height_m", "<f8"), ("share", "<f8")])
"""Since `onset` the floor lies at the points p (m, camera's axes) with p . normal = -height_m; `share` of the background is on it."""
TRIES, NEAR_M, LEAST_SHARE, LEAST_POINTS = 200, 0.04, 0.08, 200
UPRIGHT = 0.7
"""A floor's normal differs from the image's vertical by less than 45 degrees."""


def floor_of(behind: NDArray[np.float32], camera: Samples, onset: int, *, upside_down: bool) -> list[Array]:
    """The floor in a background `behind` (h, w) of depths in mm, as one event; [] if there is no such plane.

    Planes through three points each are drawn (the same ones for the same image); of those that are nearly level, the one with most points
    on it and few beneath it is fitted again to its points by least squares.
    """
    points = _points(behind, camera)
    if len(points) < LEAST_POINTS:
        return []
    random = np.random.default_rng(0)
    up = np.array([0.0, 1.0 if upside_down else -1.0, 0.0])
    best, most = np.zeros(len(points), bool), LEAST_SHARE * len(points)
    for a, b, c in points[random.integers(0, len(points), (TRIES, 3))]:
        normal = np.cross(b - a, c - a)
        length = np.sqrt((normal * normal).sum())
        if length < 1e-6:
            continue
        normal = normal / length * np.sign((normal * up).sum())
        if (normal * up).sum() < UPRIGHT:
            continue
        above = ((points - a) * normal).sum(axis=1)
        on = np.abs(above) < NEAR_M
        score = on.sum() - 2.0 * (above < -3 * NEAR_M).sum()
        if score > most:
            best, most = on, score
    if not best.any():
        return []
    middle = points[best].mean(axis=0)
    normal = np.linalg.svd(points[best] - middle, full_matrices=False)[2][2]
    normal = normal * np.sign((normal * up).sum())
    return [np.array((onset, normal, -(middle * normal).sum(), best.mean()), FLOOR)]


def _points(behind: NDArray[np.float32], camera: Samples) -> Samples:
    """At most some thousand points (n, 3) of a background, in m."""
    step = max(1, round(np.sqrt(behind.size / 4000)))
    if np.isnan(camera).any():
        return np.empty((0, 3))
    depth = behind[::step, ::step].astype(np.float64) / 1000
    y, x = np.nonzero(depth)
    z = depth[y, x]
    return np.stack([(x * step - camera[2]) / camera[0] * z, (y * step - camera[3]) / camera[1] * z, z], axis=1)
