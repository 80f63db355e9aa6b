"""Where a body faces, from its shape in the depth image alone: what tells a back from a front where a network cannot.

A small network (1152 numbers, 32 hidden, 2 out) that was trained on 3921 rendered poses of one mesh in 13 motions; of 498
poses of another mesh it turns 8.6 % round. `python -m bench.facing` trains one of the same kind; the
script that trained this one is not in this repository, so that these very numbers cannot be made again.
The idea has no published source; measured in docs/lab/body.md.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples
from kinegraph.stream.data.model_file import read_model
from kinegraph.stream.kernel import kernel

CELLS = 24
"""The person's square is cut into this many cells along a side."""
DEEP_MM, DEEPEST = 300.0, 1.5
FILE = Path(__file__).with_name("facing.npz")


class Weights(NamedTuple):
    """hidden (1152, 32) and its bias (32,), out (32, 2) and its bias (2,)."""

    hidden: Samples
    hidden_bias: Samples
    out: Samples
    out_bias: Samples


@cache
def weights() -> Weights:
    """What was learned."""
    kept = read_model(FILE, "facing")
    shapes = {"hidden": (2 * CELLS**2, None), "hidden_bias": (None,), "out": (None, 2), "out_bias": (2,)}
    return Weights(**{name: kept.array(name, shape) for name, shape in shapes.items()})


@kernel(nogil=True)
def shape_of(depth: NDArray[np.uint16], out: Samples) -> int:
    """A person's `depth` (h, w), 0 elsewhere, as `out` (2, n, n): depth against the middle one, and how full; how many pixels there are.

    The square around the person, with a side as long as the longer one of the person's box, is cut into n x n cells.
    """
    h, w = depth.shape
    n = out.shape[1]
    top, bottom, left, right, total = h, -1, w, -1, 0
    histogram = np.zeros(1024, np.int64)
    for y in range(h):
        for x in range(w):
            if depth[y, x] != 0:
                top, bottom, left, right = min(top, y), max(bottom, y), min(left, x), max(right, x)
                histogram[min(int(depth[y, x]) // 16, 1023)] += 1
                total += 1
    out[:] = 0.0
    if total == 0:
        return 0
    seen, middle = 0, 0.0
    for k in range(1024):
        seen += histogram[k]
        if 2 * seen >= total:
            middle = k * 16.0 + 8.0
            break
    side = float(max(bottom - top + 1, right - left + 1))
    centre_x, centre_y = (left + right + 1) / 2.0, (top + bottom + 1) / 2.0
    for y in range(top, bottom + 1):
        for x in range(left, right + 1):
            if depth[y, x] != 0:
                i = min(max(int((y + 0.5 - centre_y) / side * n + n / 2.0), 0), n - 1)
                j = min(max(int((x + 0.5 - centre_x) / side * n + n / 2.0), 0), n - 1)
                out[0, i, j] += min(max((depth[y, x] - middle) / DEEP_MM, -DEEPEST), DEEPEST)
                out[1, i, j] += 1.0
    cell = (side / n) ** 2
    for i in range(n):
        for j in range(n):
            if out[1, i, j] > 0.0:
                out[0, i, j] /= out[1, i, j]
                out[1, i, j] = min(out[1, i, j] / cell, 1.0)
    return total


@kernel
def facing_of(
    shape: Samples, hidden: Samples, hidden_bias: Samples, out: Samples, out_bias: Samples, made: Samples
) -> None:
    """Where a `shape` (2, n, n) faces, into `made` (2,): x and z in the camera's axes; its length, at most 1, says how sure that is."""
    flat = shape.reshape(-1)
    layer = hidden_bias.copy()
    for k in range(len(flat)):
        v = flat[k]
        if v != 0.0:
            for j in range(len(layer)):
                layer[j] += v * hidden[k, j]
    for i in range(2):
        v = out_bias[i]
        for j in range(len(layer)):
            if layer[j] > 0.0:
                v += layer[j] * out[j, i]
        made[i] = v
    length = math.sqrt(made[0] ** 2 + made[1] ** 2)
    if length > 1.0:
        made[0] /= length
        made[1] /= length
