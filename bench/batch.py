"""The segmentation as the thesis does it: a whole recording at once, every distance there is (2.2, 2.3); to compare the live one with.

Where the thesis is silent or prints an error: the density's maximum is sought (2.4 prints argmin); a block holds at least MASS pairs of
neighbours; a block that grows backward over the end of the one before meets it in the middle; a stretch between blocks that is longer
than TRANSITION is no transition but an action done once, as in the live one; cuts are where paths start in the later frame. Symmetry and
clusters (2.4, 2.5) are left out: no annotation knows them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import find_objects, label
from scipy.spatial import cKDTree

from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.kernel import kernel

QUIET, SHORTEST, MASS, TRANSITION = 8, 5, 120, 75
"""Frames without a new neighbour that end a block; frames of the shortest path, and between two cuts; pairs of neighbours in a block;
frames of the longest transition."""
K, VARIANCE = 32, 0.975
STEPS = np.array([[1, 1, 0], [1, 1, 1], [0, 1, 1]])
"""Nodes that steps (1,1), (0,1) and (1,0) connect."""


@dataclass(slots=True)
class Batch:
    """Frames: of activities (first, last + 1), whether each is a transition, of primitives and the number of the repetition, or 0."""

    activities: Array
    transition: Array
    primitives: Array
    repetition: Array


def distances(x: Samples) -> Samples:
    """All distances between the rows of `x` (n, features), (n, n), per feature: a radius is R of section 2.3.1."""
    squares = (x * x).sum(1)
    apart: Samples = np.sqrt(np.maximum(squares[:, None] + squares[None] - 2.0 * x @ x.T, 0.0) / x.shape[1])
    return apart


def cut(apart: Samples, radius: float, band: int, quiet: int = QUIET) -> Batch:
    """Activities and primitives, neighbours within `band` frames being passed over."""
    activities, transition = blocks(apart <= radius, band, quiet)
    primitives, repetition = [], []
    for (first, stop), passing in zip(activities, transition, strict=True):
        cuts = [] if passing else paths_begin(apart[first:stop, first:stop], radius, band)
        edges = [first, *(first + c for c in cuts), stop]
        primitives += list(pairwise(edges))
        repetition += list(range(1, len(edges))) if cuts else [0]
    return Batch(activities, transition, np.array(primitives), np.array(repetition))


def blocks(near: Array, band: int, quiet: int = QUIET) -> tuple[Array, Array]:
    """Activities between the upper left corners of blocks grown backward and the lower right ones of blocks grown forward (2.3.2)."""
    n = len(near)
    ends = [last + 1 for last in corners(near, band, quiet)]
    starts = [n - 1 - last for last in corners(near[::-1, ::-1], band, quiet)]
    marks = sorted([(frame, 0) for frame in starts] + [(frame, 1) for frame in ends])
    edges: list[tuple[int, int]] = []
    for frame, is_end in marks:
        overlaps = is_end and edges and not edges[-1][1] and len(edges) > 1 and not edges[-2][1]
        if overlaps and frame - edges[-1][0] < band:
            edges[-1] = ((edges[-1][0] + frame) // 2, 0)
        else:
            edges.append((frame, is_end))
    edges = [(0, 1), *edges, (n, 0)]
    spans = [
        (a, b, before and not after and b - a <= TRANSITION) for (a, before), (b, after) in pairwise(edges) if b > a
    ]
    return np.array([span[:2] for span in spans]), np.array([bool(passing) for *_, passing in spans])


def corners(near: Array, band: int, quiet: int = QUIET) -> list[int]:
    """The last frames of blocks, grown downward from their first frame over rows of the lower triangle."""
    made, seed, last, pairs = [], 0, -1, 0
    for i in range(len(near)):
        found = int(near[i, seed : max(seed, i - band + 1)].sum())
        if found:
            last, pairs = i, pairs + found
        elif last >= 0 and i - last >= quiet:
            if pairs >= MASS:
                made.append(last)
            seed, last, pairs = last + 1, -1, 0
    return [*made, last] if pairs >= MASS else made


def paths_begin(apart: Samples, radius: float, band: int) -> list[int]:
    """Where shortest warping paths begin, one in each component of the activity's graph of neighbours (2.3.3)."""
    graph = np.tril(apart <= radius, -band)
    numbers, _ = label(graph, STEPS)
    found = []
    for number, box in enumerate(find_objects(numbers), 1):
        price, begin, end, nodes = shortest_path(np.where(numbers[box] == number, apart[box], np.inf))
        if is_valid(box[0].stop - box[0].start, end - begin + 1, nodes):
            found.append((int(box[0].start), price))
    return apart_enough(found)


def apart_enough(found: list[tuple[int, float]]) -> list[int]:
    """Of cuts closer than SHORTEST frames, that of the cheaper path."""
    kept: list[tuple[int, float]] = []
    for frame, price in sorted(found):
        if kept and frame - kept[-1][0] < SHORTEST:
            if price < kept[-1][1]:
                kept[-1] = (frame, price)
        elif frame >= SHORTEST:
            kept.append((frame, price))
    return [frame for frame, _ in kept]


def is_valid(rows: int, columns: int, nodes: int) -> bool:
    """Long enough, and of a mean slope from 1/2 to 2."""
    return min(rows, nodes) >= SHORTEST and rows <= 2 * columns <= 4 * rows and 2 * min(rows, columns) >= nodes


@kernel
def shortest_path(apart: Samples) -> tuple[float, int, int, int]:
    """The cheapest way from the first row to the last of `apart` (rows, columns; inf: no node), by steps (1,1), (0,1), (1,0).

    Returns its cost (the sum of its nodes' distances), first and last column, and number of nodes, or 0.
    """
    rows, columns = apart.shape
    cost, begin, nodes = (
        np.full((2, columns), np.inf),
        np.zeros((2, columns), np.int64),
        np.zeros((2, columns), np.int64),
    )
    for i in range(rows):
        now, old = i % 2, 1 - i % 2
        for j in range(columns):
            cost[now, j] = apart[i, j] if i == 0 else np.inf
            begin[now, j], nodes[now, j] = j, 1
            for back in range(3):
                row, column = (old, j - 1) if back == 0 else (old, j) if back == 1 else (now, j - 1)
                if column < 0 or (row == old and i == 0):
                    continue
                price = cost[row, column] + apart[i, j]
                if price < cost[now, j]:
                    cost[now, j], begin[now, j], nodes[now, j] = price, begin[row, column], nodes[row, column] + 1
    last = (rows - 1) % 2
    best = 0
    for j in range(columns):
        if cost[last, j] < cost[last, best]:
            best = j
    if cost[last, best] == np.inf:
        return np.inf, 0, 0, 0
    return cost[last, best], begin[last, best], best, nodes[last, best]


def bundled(x: Samples) -> Samples:
    """Every row of `x` (n, features) moved to the densest place of its K nearest, across its direction (2.2), after one PCA of all."""
    middle = x.mean(0)
    _, sizes, axes = np.linalg.svd(x - middle, full_matrices=False)
    kept = int(np.searchsorted(np.cumsum(sizes**2) / (sizes**2).sum(), VARIANCE)) + 1
    y = (x - middle) @ axes[:kept].T
    _, nearest = cKDTree(y).query(y, K + 1)
    way = np.zeros_like(y)
    way[2:-2] = 8.0 * (y[3:-1] - y[1:-3]) - (y[4:] - y[:-4])
    made = y.copy()
    for i in range(len(y)):
        if way[i].any():
            across = np.linalg.qr(np.column_stack([way[i], np.eye(kept)[:, np.argsort(np.abs(way[i]))[:-1]]]))[0][:, 1:]
            made[i] += across @ densest((y[[j for j in nearest[i] if j != i][:K]] - y[i]) @ across)
    return made @ axes[:kept] + middle


def densest(points: Samples) -> Samples:
    """The maximum of the density of `points` (k, dimensions) that is climbed to from 0; Gaussian kernels, Scott's bandwidth."""
    wide = points.std(0, ddof=1) * len(points) ** (-1.0 / (points.shape[1] + 4))
    scaled = points / np.maximum(wide, 1e-12)
    here = np.zeros(points.shape[1])
    for _ in range(200):
        squares = ((scaled - here) ** 2).sum(1)
        weights = np.exp((squares.min() - squares) / 2.0)
        there = weights @ scaled / weights.sum()
        if math.dist(there, here) < 1e-4:
            break
        here = there
    return here * wide
