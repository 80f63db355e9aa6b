"""How the fingers of a hand bend, from its 21 landmarks in space."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

CHAINS = np.array([(1, 2, 3, 4), (5, 6, 7, 8), (9, 10, 11, 12), (13, 14, 15, 16), (17, 18, 19, 20)])
"""Landmarks of thumb, index, middle, ring and little finger, from the palm to the tip; 0 is the wrist."""
THUMB_RESTS = math.radians(35.0)
"""A thumb beside a flat hand points this far from the fingers' direction, in the palm's plane."""


@kernel
def hand_bends(points: Samples, is_left: bool, out: Samples) -> None:
    """Bend, spread, second and third bend (degrees) of each finger into `out` (5, 4), from `points` (21, 3) in any right-handed axes."""
    forward, aside, inward = np.empty(3), np.empty(3), np.empty(3)
    for c in range(3):
        forward[c] = points[9, c] - points[0, c]
        aside[c] = points[5, c] - points[17, c]
    _unit(forward)
    along = _dot(aside, forward)
    for c in range(3):
        aside[c] -= along * forward[c]
    _unit(aside)
    sign = 1.0 if is_left else -1.0  # towards the palm
    inward[0] = sign * (forward[1] * aside[2] - forward[2] * aside[1])
    inward[1] = sign * (forward[2] * aside[0] - forward[0] * aside[2])
    inward[2] = sign * (forward[0] * aside[1] - forward[1] * aside[0])
    bones = np.empty((3, 3))
    middle = 0.0
    for turn in range(5):
        finger = (2, 0, 1, 3, 4)[turn]  # the middle finger first: the others spread from it
        for joint in range(3):
            for c in range(3):
                bones[joint, c] = points[CHAINS[finger, joint + 1], c] - points[CHAINS[finger, joint], c]
            _unit(bones[joint])
        first, second = _between(bones[0], bones[1]), _between(bones[1], bones[2])
        if finger == 0:
            flat = math.atan2(_dot(bones[0], aside), _dot(bones[0], forward))
            out[0, 0] = math.degrees(math.asin(min(max(_dot(bones[0], inward), -1.0), 1.0)))
            out[0, 1] = math.degrees(flat - THUMB_RESTS)
            out[0, 2], out[0, 3] = math.degrees(first), math.degrees(second)
            continue
        out[finger, 0] = math.degrees(math.atan2(_dot(bones[0], inward), _dot(bones[0], forward)))
        slant = math.degrees(math.asin(min(max(_dot(bones[0], aside), -1.0), 1.0)))
        if finger == 2:
            middle = slant
        straight = math.cos(math.radians(min(abs(out[finger, 0]), 90.0)))  # a bent finger hides how far it is spread
        out[finger, 1] = 0.0 if finger == 2 else (slant - middle) * straight * (1.0 if finger == 1 else -1.0)
        out[finger, 2], out[finger, 3] = math.degrees(first), math.degrees(second)


@kernel
def _unit(v: Samples) -> None:
    long = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    for c in range(3):
        v[c] = v[c] / long if long > 0.0 else 0.0


@kernel
def _dot(a: Samples, b: Samples) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@kernel
def _between(a: Samples, b: Samples) -> float:
    return math.acos(min(max(_dot(a, b), -1.0), 1.0))
