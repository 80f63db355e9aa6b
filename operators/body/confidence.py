"""How far a marker can be trusted: what speaks against it, weighed as it did on rendered bodies (docs/lab/body.md)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

ASKED_HZ = 30.0
"""Leaps from frame to frame are those at this rate."""
SEEN, GUESSED, OFF, LEAP, DIFFERS, TWIN, PRESENCE, ALL_SEEN, ALL_OFF = (
    -0.154,
    2.159,
    -0.151,
    6.338,
    2.15,
    0.284,
    -0.33,
    -0.11,
    0.075,
)
HALF = 2.34
"""A logistic regression of "off by more than 20 cm" on the frontal, oblique and side clips of one mesh; HALF moves the confidence .5 to
where 90 % of the markers off by more than 25 cm have less."""
LIMBS = np.array([11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28])


@kernel
def trusted(
    points: Samples,
    places: Samples,
    doubt: Samples,
    before: Samples,
    seconds: float,
    presence: float,
    other_side: NDArray[np.int64],
    trunk: float,
    inside: Samples,
    focal: float,
    out: Samples,
) -> None:
    """Confidence (34,) of `places` (34, 3), which `placed` made of `points` (34, 8), with its `doubt`; `before` (34, 3) is a frame ago.

    The network's visibility (of this landmark and of all limbs) and presence speak for it; that it was guessed, a leap since the frame
    before, another depth than the network's guess, the other side's landmark at the same pixel, and bones that cannot be as long, against.
    """
    n = places.shape[0]
    logits = np.empty(n)
    all_off = 0.0
    for k in range(n):
        v = min(max(min(points[k, 3], points[k, 4]), 1e-4), 1.0 - 1e-4)
        logits[k] = math.log(v / (1.0 - v))
        all_off += doubt[k, 1]
    all_seen = 0.0
    for i in range(len(LIMBS)):
        all_seen += logits[LIMBS[i]] / len(LIMBS)
    frame = (
        PRESENCE * min(-math.log(max(1.0 - presence, 1e-3)), 7.0) + ALL_SEEN * all_seen + ALL_OFF * min(all_off, 3.0)
    )
    for k in range(n):
        against = frame + SEEN * logits[k] + GUESSED * doubt[k, 0] + OFF * min(doubt[k, 1], 1.0)
        differs = abs(points[k, 2] + inside[k] - trunk - points[k, 7])
        against += DIFFERS * (0.6 if math.isnan(differs) else min(differs, 0.6))
        if not math.isnan(before[k, 2]) and seconds > 0.0:
            way = 0.0
            for c in range(3):
                way += (places[k, c] - before[k, c]) ** 2
            against += LEAP * min(math.sqrt(way) / seconds / ASKED_HZ, 0.5)
        twin = other_side[k]
        if twin != k:
            apart = math.hypot(points[k, 0] - points[twin, 0], points[k, 1] - points[twin, 1]) * places[k, 2] / focal
            against += TWIN * math.exp(-((apart / 0.1) ** 2))
        out[k] = 1.0 / (1.0 + math.exp(min(against + HALF, 50.0)))
