"""Geodesic extrema of a body in a depth image: the points farthest along its surface from its middle and from each other.

After Plagemann 2010 and Baak 2011: pixels side by side are connected where they are close in space; Dijkstra from the middle, take the
farthest point, make it a source, and again.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.data.ordering import median
from kinegraph.stream.kernel import kernel

ACROSS, FARTHEST_ACROSS_M = 3, 0.6
"""A piece that is cut off is joined to what lies at most this many pixels beside it, and at most this far away (m)."""
LEAST_PIECE = 12
"""What has fewer pixels is noise."""


@kernel(nogil=True)
def surface_of(depth: NDArray[np.uint16], camera: Samples, step: int, points: Samples) -> int:
    """Every `step`-th pixel of a person's `depth` (h, w), 0 elsewhere, in space, into `points` (h // step, w // step, 3) m; NaN: no person.

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
        middle[a] = median(kept[a], n)
    best, at = math.inf, -1
    for i in range(h):
        for j in range(w):
            apart = _squared(points[i, j], middle)
            if apart < best:
                best, at = apart, i * w + j
    return at


@kernel(nogil=True)
def extrema_of(
    points: Samples, source: int, apart_m: float, distance: Samples, parent: Times, found: Times, min_m: float
) -> int:
    """The pixels farthest along the surface, one after the other, into `found` (k,); how many there are.

    points    (h, w, 3)  m, NaN where no person is; small isolated pieces are set to NaN
    distance  (h * w,)   from the nearest source along the surface (m), inf where that cannot be reached
    parent    (h * w,)   the pixel before each on its way; -1: a source, or not reached

    One nearer than `min_m` to all sources ends the search. A pixel's way is that of the round in which it was found. What is cut off
    by something nearer, as a head behind a raised arm, hangs together with the rest by the shortest way across.
    """
    distance[:], parent[:] = math.inf, -1
    keys, items, way = np.empty(64 * 1024), np.empty(64 * 1024, np.int64), np.empty(distance.shape[0], np.int64)
    way[:] = -1
    across = np.full(distance.shape[0], -1, np.int64)
    distance[source] = 0.0
    _spread(points, source, apart_m, distance, parent, across, keys, items)
    _join(points, apart_m, distance, parent, across, keys, items)
    for k in range(found.shape[0]):
        far = -1
        for i in range(distance.shape[0]):
            if math.isfinite(distance[i]) and (far < 0 or distance[i] > distance[far]):
                far = i
        if far < 0 or distance[far] < min_m:
            parent[:] = way
            return int(k)
        found[k] = far
        at = far
        while at >= 0 and way[at] < 0:  # the way back, as it is before this pixel becomes a source
            way[at] = parent[at]
            at = parent[at]
        distance[far], parent[far] = 0.0, -1
        _spread(points, far, apart_m, distance, parent, across, keys, items)
    parent[:] = way
    return int(found.shape[0])


@kernel(nogil=True)
def _join(
    points: Samples, apart_m: float, distance: Samples, parent: Times, across: Times, keys: Samples, items: Times
) -> None:
    """Reach the pieces that the first source does not reach: each by the shortest way across, which `across` (h * w,) then knows."""
    h, w = points.shape[0], points.shape[1]
    while True:
        best, here, there = math.inf, -1, -1
        for i in range(h):
            for j in range(w):
                if math.isnan(points[i, j, 2]) or math.isfinite(distance[i * w + j]):
                    continue
                for v in range(max(0, i - ACROSS), min(h, i + ACROSS + 1)):
                    for u in range(max(0, j - ACROSS), min(w, j + ACROSS + 1)):
                        if math.isfinite(distance[v * w + u]):
                            gap = math.sqrt(_squared(points[v, u], points[i, j]))
                            if gap < FARTHEST_ACROSS_M and gap + distance[v * w + u] < best:
                                best, here, there = gap + distance[v * w + u], v * w + u, i * w + j
        if here < 0:
            return
        distance[there], parent[there] = best, here
        before = across.copy()
        across[here], across[there] = there, here
        if _spread(points, there, apart_m, distance, parent, across, keys, items) < LEAST_PIECE:
            across[:] = before
            _forget(points, there, apart_m, distance, parent, items)


@kernel(nogil=True)
def _spread(
    points: Samples, source: int, apart_m: float, distance: Samples, parent: Times, across: Times, keys: Samples, items: Times
) -> int:  # fmt: skip
    """Dijkstra from one more source of known distance; `keys` and `items` hold the heap. Returns how many pixels came nearer."""
    h, w = points.shape[0], points.shape[1]
    n, nearer = _push(keys, items, 0, distance[source], source), 0
    while n > 0:
        near, at = keys[0], items[0]
        n = _pop(keys, items, n)
        if near > distance[at]:
            continue
        nearer += 1
        i, j = at // w, at % w
        for v in range(max(0, i - 1), min(h, i + 2)):
            for u in range(max(0, j - 1), min(w, j + 2)):
                apart = math.sqrt(_squared(points[v, u], points[i, j]))
                other = v * w + u
                if apart < apart_m and near + apart < distance[other] and n < keys.shape[0]:
                    distance[other], parent[other] = near + apart, at
                    n = _push(keys, items, n, near + apart, other)
        other = across[at]
        if other >= 0 and n < keys.shape[0]:
            apart = near + math.sqrt(_squared(points[other // w, other % w], points[i, j]))
            if apart < distance[other]:
                distance[other], parent[other] = apart, at
                n = _push(keys, items, n, apart, other)
    return nearer


@kernel(nogil=True)
def _forget(points: Samples, start: int, apart_m: float, distance: Samples, parent: Times, items: Times) -> None:
    """Remove the piece around the pixel `start`; `items` is room for pixels."""
    h, w, n, place = points.shape[0], points.shape[1], 1, np.empty(3)
    items[0] = start
    while n > 0:
        n -= 1
        at = items[n]
        i, j = at // w, at % w
        place[:] = points[i, j]
        points[i, j], distance[at], parent[at] = math.nan, math.inf, -1
        for v in range(max(0, i - 1), min(h, i + 2)):
            for u in range(max(0, j - 1), min(w, j + 2)):
                if _squared(points[v, u], place) < apart_m**2 and n < items.shape[0]:
                    items[n] = v * w + u
                    n += 1


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
def walk_back(points: Samples, parent: Times, start: int, along_m: float, apart_m: float, out: Samples) -> bool:
    """The place (3,) `along_m` from the pixel `start` on its way back, into `out`; False where that is too short, or leaps."""
    w, at, gone = points.shape[1], start, 0.0
    while gone < along_m:
        before = parent[at]
        if before < 0:
            return False
        step = math.sqrt(_squared(points[before // w, before % w], points[at // w, at % w]))
        if step >= apart_m:
            return False
        gone += step
        at = before
    for a in range(3):
        out[a] = points[at // w, at % w, a]
    return True


@kernel(nogil=True)
def place_between(points: Samples, parent: Times, start: int, end: int, share: float, out: Samples) -> float:
    """The place (3,) at a `share` of the way from the pixel `start` to `end`, into `out`, by where their ways back meet.

    Returns how long the whole way is (m); 0 where they do not meet.
    """
    pixels = points.reshape(-1, 3)
    way, n, at = np.empty(parent.shape[0] + 1, np.int64), 0, start
    while at >= 0:
        way[n] = at
        n += 1
        at = parent[at]
    meet, at = -1, end
    while at >= 0 and meet < 0:
        for k in range(n):
            if way[k] == at:
                meet = k
                break
        at = parent[at]
    if meet < 0:
        return 0.0
    rest, at = 0, end
    while at != way[meet]:
        rest += 1
        at = parent[at]
    at = end
    for k in range(meet + rest, meet, -1):
        way[k] = at
        at = parent[at]
    length = 0.0
    for k in range(1, meet + rest + 1):
        length += math.sqrt(_squared(pixels[way[k]], pixels[way[k - 1]]))
    gone = 0.0
    for k in range(meet + rest + 1):
        if k > 0:
            gone += math.sqrt(_squared(pixels[way[k]], pixels[way[k - 1]]))
        if gone >= share * length:
            out[:] = pixels[way[k]]
            break
    return length


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
    return median(kept, n) if n >= 8 else math.nan


@kernel(nogil=True)
def _squared(p: Samples, q: Samples) -> float:
    """The squared distance of two places; NaN where one is."""
    return float((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)
