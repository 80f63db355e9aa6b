"""How far away a person is whom one camera sees: by the body's height, and by what the network takes the body for."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kinegraph.operators.body.placing import CHAINS, LENGTHS, PAIRS
from kinegraph.stream.chunk import Samples
from kinegraph.stream.data.ordering import median
from kinegraph.stream.kernel import kernel

STATURE_M = 1.75
"""The height of a body with bones as long as LENGTHS."""
BODY = np.array([0, 11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32])
"""Landmarks that lie on the skeleton, or nearly so."""
MIN_SEEN = 0.3
"""Landmarks that the network sees less of do not count; four must remain."""
TOO_LITTLE_PX = 4.0
"""A body that fills less of the image than this (a standard deviation of its landmarks) has no distance."""


@kernel
def scale_of(points: Samples, lengths: Samples) -> float:
    """How much larger the bones are than the network takes them for; NaN where too little is seen.

    points   (34, 8)  what the network sees; its own guess of places in columns 5 to 7 (m)
    lengths  (7,)     of the bones (m)
    """
    found = np.empty(CHAINS.shape[0] + PAIRS.shape[0])
    n = 0
    for i in range(CHAINS.shape[0] + PAIRS.shape[0]):
        a, b, bone = CHAINS[i] if i < CHAINS.shape[0] else PAIRS[i - CHAINS.shape[0]]
        if min(points[a, 3], points[b, 3]) < MIN_SEEN:
            continue
        guess = 0.0
        for c in range(5, 8):
            guess += (points[a, c] - points[b, c]) ** 2
        if guess > 1e-4:
            found[n] = lengths[bone] / math.sqrt(guess)
            n += 1
    return median(found, n) if n >= 3 else math.nan


@kernel
def distance(points: Samples, camera: Samples, scale: float, body: NDArray[np.int64]) -> float:
    """The depth of the middle of the hips (m) at which the network's guess, `scale` times as large, covers its own landmarks best.

    A least-squares fit of three unknowns (where the hips are) to the landmarks' rays, weighed by how well each is seen; NaN where that is
    too little. `camera` (4,): fx, fy, cx, cy.
    """
    weight = mean_u = mean_v = mean_a = mean_b = 0.0
    n = 0
    for i in range(body.shape[0]):
        k = body[i]
        w = min(points[k, 3], points[k, 4])
        if not w >= MIN_SEEN:
            continue
        n += 1
        u, v = (points[k, 0] - camera[2]) / camera[0], (points[k, 1] - camera[3]) / camera[1]
        weight += w
        mean_u += w * u
        mean_v += w * v
        mean_a += w * scale * (u * points[k, 7] - points[k, 5])
        mean_b += w * scale * (v * points[k, 7] - points[k, 6])
    if n < 4:
        return math.nan
    mean_u, mean_v, mean_a, mean_b = mean_u / weight, mean_v / weight, mean_a / weight, mean_b / weight
    both = spread = 0.0
    for i in range(body.shape[0]):
        k = body[i]
        w = min(points[k, 3], points[k, 4])
        if not w >= MIN_SEEN:
            continue
        u, v = (points[k, 0] - camera[2]) / camera[0], (points[k, 1] - camera[3]) / camera[1]
        a, b = scale * (u * points[k, 7] - points[k, 5]), scale * (v * points[k, 7] - points[k, 6])
        both += w * ((u - mean_u) * (a - mean_a) + (v - mean_v) * (b - mean_b))
        spread += w * ((u - mean_u) ** 2 + (v - mean_v) ** 2)
    if spread * camera[0] * camera[0] < TOO_LITTLE_PX * TOO_LITTLE_PX * weight:
        return math.nan
    away = -both / spread
    return away if away > 0.0 else math.nan


def bones_of(height_m: float) -> Samples:
    """The lengths (7,) of the bones of somebody of that height, in the proportions of most people."""
    return LENGTHS * (height_m / STATURE_M)
