"""A depth camera that was moved: whether it shows its old view again, and the people who stand in the new one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinegraph.operators.body.components import components
from kinegraph.operators.body.floor import NEAR_M, floor_of
from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

APART_MM = 120.0
"""Neighbouring pixels that differ by more in depth belong to two things, as operators.body.persons.Persons has it."""
MOST_THINGS = 256
HEIGHTS_M, AREAS_M2 = (0.5, 2.4), (0.08, 2.0)
"""The height of what is seen of a person, and its surface across the line of sight."""
ALIKE = 1.5
"""Height and surface of a person differ by this factor at most between two views."""


@kernel(nogil=True)
def disagreement(
    frame: NDArray[np.uint16], behind: NDArray[np.float32], min_mm: float, min_share: float
) -> tuple[float, float]:
    """Which shares of the measured pixels of `frame` (h, w) lie farther away than `behind` (h, w), and nearer, by more than noise."""
    seen, farther, nearer = 0, 0, 0
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            d, b = np.float32(frame[y, x]), behind[y, x]
            if d == 0 or b == 0:
                continue
            seen += 1
            room = max(min_mm, min_share * b)
            farther += d > b + room
            nearer += d < b - room
    return (farther / seen, nearer / seen) if seen else (0.0, 0.0)


def people_cut_out(
    behind: NDArray[np.float32], camera: Samples, shown: NDArray[np.uint16], *, upside_down: bool
) -> tuple[int, bool]:
    """Take out of a new background `behind` (h, w) whoever stands in it: the background goes on behind them, straight from left to right.

    `shown` (h, w) is what stood before the background that was known before. A thing of the new one that is as high and has as much
    surface as one of it, and stands by itself (the floor apart, where one is seen), is taken for it; whatever else there is stays
    background. Returns how many there were, and whether they stand on a floor at the wrong side of the image: nothing is cut out then.
    """
    if np.isnan(camera).any():
        return 0, False
    before = [size for _, size in _things(shown, camera) if _human(size)]
    if not before:
        return 0, False
    there, over = (_standing(before, behind, camera, upside_down=side) for side in (upside_down, not upside_down))
    if over and over[0] and not (there and there[0]):
        return 0, True
    found = there[1] if there else [] if over else _like(before, behind, camera, np.full(behind.shape, np.inf))
    for mask in found:
        _go_on_behind(behind, mask)
    return len(found), False


def floors_of(behind: NDArray[np.float32], camera: Samples, *, upside_down: bool) -> Samples:
    """The floor of a background, and the one in the image turned over: (2, 4) normal and height; NaN if there is no such plane."""
    planes = np.full((2, 4), np.nan)
    for plane, side in zip(planes, (upside_down, not upside_down), strict=True):
        for floor in floor_of(behind, camera, 0, upside_down=side):
            plane[:3], plane[3] = floor["normal"], floor["height_m"]
    return planes


def stand_on(shown: NDArray[np.uint16], planes: Samples, camera: Samples) -> list[bool]:
    """For each of the planes (2, 4) of `floors_of` whether somebody in `shown` (h, w) stands on it."""
    people = [mask for mask, size in _things(shown, camera) if _human(size)]
    depth = shown.astype(np.float32)
    heights = [_above(depth, camera, plane[:3], float(plane[3])) for plane in planes]
    return [any(bool(above[mask].min() < 4 * NEAR_M) for mask in people) for above in heights]


def _standing(
    before: list[tuple[float, float]], behind: NDArray[np.float32], camera: Samples, *, upside_down: bool
) -> tuple[bool, list[NDArray[np.bool_]]] | None:
    """The people that were there `before`, by the floor below (or above) them, and whether one of them stands on it; None: no floor."""
    floor = floor_of(behind, camera, 0, upside_down=upside_down)
    if not floor:
        return None
    above = _above(behind, camera, floor[0]["normal"], float(floor[0]["height_m"]))
    found = _like(before, behind, camera, above)
    return any(above[mask].min() < 4 * NEAR_M for mask in found), found


def _like(
    before: list[tuple[float, float]], behind: NDArray[np.float32], camera: Samples, above: Samples
) -> list[NDArray[np.bool_]]:
    """The things off the floor that are most like those there were `before`: each one once."""
    rest = np.where(np.abs(above) > 1.5 * NEAR_M, behind, 0.0).clip(0, 65535).astype(np.uint16)
    things = [(mask, size) for mask, size in _things(rest, camera) if _human(size)]
    found = []
    for old in before:
        unlike = [max(np.abs(np.log(np.array(size) / np.array(old)))) for _, size in things]
        if unlike and min(unlike) < np.log(ALIKE):
            found.append(things.pop(int(np.argmin(unlike)))[0])
    return found


def _human(size: tuple[float, float]) -> bool:
    return HEIGHTS_M[0] < size[0] < HEIGHTS_M[1] and AREAS_M2[0] < size[1] < AREAS_M2[1]


def _things(frame: NDArray[np.uint16], camera: Samples) -> list[tuple[NDArray[np.bool_], tuple[float, float]]]:
    """The connected things in a depth image: their pixels, their height in m, and their surface across the line of sight in m2."""
    parts, sizes = np.zeros(frame.shape, np.int32), np.zeros(MOST_THINGS + 1, np.int64)
    count = components(frame, APART_MM, max(8, frame.size // 400), parts, sizes, np.zeros((MOST_THINGS + 1, 3)))
    found = []
    for k in range(1, count + 1):
        mask = parts == k
        z = frame[mask] / 1000.0
        y = (np.nonzero(mask)[0] - camera[3]) / camera[1] * z
        found.append((mask, (float(np.ptp(y)), float((z * z).sum() / (camera[0] * camera[1])))))
    return found


def _above(behind: NDArray[np.float32], camera: Samples, normal: Samples, height_m: float) -> Samples:
    """How high every pixel's place lies above the floor (h, w), in m."""
    y, x = np.indices(behind.shape)
    z = behind / 1000.0
    slope = normal[0] * (x - camera[2]) / camera[0] + normal[1] * (y - camera[3]) / camera[1] + normal[2]
    return np.asarray(slope * z + height_m)


def _go_on_behind(behind: NDArray[np.float32], mask: NDArray[np.bool_]) -> None:
    """Fill `mask` in `behind` from left and right: a plane's depth is one over something linear along a row; what is unknown is 0."""
    columns = np.arange(behind.shape[1])
    wide = mask.copy()
    wide[:, 1:] |= mask[:, :-1]
    wide[:, :-1] |= mask[:, 1:]
    for row in np.flatnonzero(mask.any(axis=1)):
        known = ~wide[row] & (behind[row] > 0)
        behind[row, wide[row]] = 0.0
        if known.any():
            behind[row, wide[row]] = 1.0 / np.interp(columns[wide[row]], columns[known], 1.0 / behind[row, known])
