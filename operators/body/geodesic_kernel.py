"""Geodesic extrema of a body in a depth image: the points farthest along its surface from its middle and from each other.

After Plagemann 2010 and Baak 2011: pixels side by side are connected where they are close in space; Dijkstra from the middle, take the
farthest point, make it a source, and again.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from stream.chunk import Samples, Times
from stream.kernel import kernel


@kernel(nogil=True)
def surface_of(depth: NDArray[np.uint16], camera: Samples, step: int, points: Samples) -> int:
    """Every `step`-th pixel of a person's `depth` (h, w), 0 elsewhere, in space, into `points` (h // step, w // step, 3) m; NaN: nobody.

    Returns how many there are.
    """
    n = 0
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            z = depth[i * step, j * step] / 1000.0
            points[i, j, 0] = (j * step - camera[2]) / camera[0] * z if z > 0.0 else math.nan
            points[i, j, 1] = (i * step - camera[3]) / camera[1] * z if z > 0.0 else math.nan
            points[i, j, 2] = z if z > 0.0 else math.nan
            n += z > 0.0
    return n


@kernel(nogil=True)
def middle_of(points: Samples, middle: Samples) -> int:
    """The number of the pixel nearest to the medians of all places, which go into `middle` (3,)."""
    h, w = points.shape[0], points.shape[1]
    kept, n = np.empty((3, h * w)), 0
    for i in range(h):
        for j in range(w):
            if not math.isnan(points[i, j, 2]):
                kept[0, n], kept[1, n], kept[2, n] = points[i, j, 0], points[i, j, 1], points[i, j, 2]
                n += 1
    for a in range(3):
        middle[a] = np.median(kept[a, :n])
    best, at = math.inf, -1
    for i in range(h):
        for j in range(w):
            apart = _squared(points[i, j], middle)
            if apart < best:
                best, at = apart, i * w + j
    return at


@kernel(nogil=True)
def extrema_of(
    points: Samples, source: int, apart_m: float, distance: Samples, parent: Times, found: Times, least_m: float
) -> int:
    """The pixels farthest along the surface, one after the other, into `found` (k,); how many there are.

    points    (h, w, 3)  m, NaN where nobody is
    distance  (h * w,)   from the nearest source along the surface (m), inf where that cannot be reached
    parent    (h * w,)   the pixel before each on its way; -1: a source, or not reached

    One nearer than `least_m` to all sources ends the search. A pixel's way is that of the round in which it was found.
    """
    distance[:], parent[:] = math.inf, -1
    keys, items, way = np.empty(64 * 1024), np.empty(64 * 1024, np.int64), np.empty(distance.shape[0], np.int64)
    way[:] = -1
    for k in range(-1, found.shape[0]):
        if k >= 0:
            far = -1
            for i in range(distance.shape[0]):
                if math.isfinite(distance[i]) and (far < 0 or distance[i] > distance[far]):
                    far = i
            if far < 0 or distance[far] < least_m:
                parent[:] = way
                return int(k)
            found[k] = far
            at = far
            while at >= 0 and way[at] < 0:  # the way back, as it is before this pixel becomes a source
                way[at] = parent[at]
                at = parent[at]
            source = far
        distance[source], parent[source] = 0.0, -1
        _spread(points, source, apart_m, distance, parent, keys, items)
    parent[:] = way
    return int(found.shape[0])


@kernel(nogil=True)
def _spread(
    points: Samples, source: int, apart_m: float, distance: Samples, parent: Times, keys: Samples, items: Times
) -> None:
    """Dijkstra from one source more; `keys` and `items` are a heap's room."""
    h, w = points.shape[0], points.shape[1]
    n = _push(keys, items, 0, 0.0, source)
    while n > 0:
        near, at = keys[0], items[0]
        n = _pop(keys, items, n)
        if near > distance[at]:
            continue
        i, j = at // w, at % w
        for v in range(max(0, i - 1), min(h, i + 2)):
            for u in range(max(0, j - 1), min(w, j + 2)):
                apart = math.sqrt(_squared(points[v, u], points[i, j]))
                other = v * w + u
                if apart < apart_m and near + apart < distance[other] and n < keys.shape[0]:
                    distance[other], parent[other] = near + apart, at
                    n = _push(keys, items, n, near + apart, other)


@kernel(nogil=True)
def _push(keys: Samples, items: Times, n: int, key: float, item: int) -> int:
    at = n
    while at > 0 and keys[(at - 1) // 2] > key:
        keys[at], items[at] = keys[(at - 1) // 2], items[(at - 1) // 2]
        at = (at - 1) // 2
    keys[at], items[at] = key, item
    return n + 1


@kernel(nogil=True)
def _pop(keys: Samples, items: Times, n: int) -> int:
    n -= 1
    key, item, at = keys[n], items[n], 0
    while 2 * at + 1 < n:
        child = 2 * at + 1
        if child + 1 < n and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[at], items[at] = keys[child], items[child]
        at = child
    keys[at], items[at] = key, item
    return n


@kernel(nogil=True)
def walk_back(points: Samples, parent: Times, start: int, along_m: float, out: Samples) -> bool:
    """The place (3,) `along_m` from the pixel `start` on its way back, into `out`; False where the way is shorter."""
    w, at, gone = points.shape[1], start, 0.0
    while gone < along_m:
        before = parent[at]
        if before < 0:
            return False
        gone += math.sqrt(_squared(points[before // w, before % w], points[at // w, at % w]))
        at = before
    for a in range(3):
        out[a] = points[at // w, at % w, a]
    return True


@kernel(nogil=True)
def area_around(points: Samples, place: Samples, within_m: float, camera: Samples) -> float:
    """The surface that the camera sees within `within_m` of `place` (3,), in m2; `camera` is that of `points` (h, w, 3)."""
    area = 0.0
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            if _squared(points[i, j], place) < within_m**2:
                area += points[i, j, 2] ** 2
    return float(area / (camera[0] * camera[1]))


@kernel(nogil=True)
def surface_at(points: Samples, place: Samples, within_m: float) -> float:
    """How deep (m) the surface is before `place` (3,): the median of what the camera sees beside it; NaN: hardly anything is there.

    What lies much nearer or deeper, four times `within_m`, is something else: an arm, or another one's.
    """
    kept, n = np.empty(points.shape[0] * points.shape[1]), 0
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            beside = (points[i, j, 0] - place[0]) ** 2 + (points[i, j, 1] - place[1]) ** 2
            if beside < within_m**2 and abs(points[i, j, 2] - place[2]) < 4.0 * within_m:
                kept[n] = points[i, j, 2]
                n += 1
    return float(np.median(kept[:n])) if n >= 8 else math.nan


@kernel(nogil=True)
def _squared(p: Samples, q: Samples) -> float:
    """The squared distance of two places; NaN where one is."""
    return float((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)
