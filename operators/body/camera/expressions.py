"""What a face does, from the 468 points of its surface: eyes, mouth, brows, as shares of what faces can do."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

VOWELS = ("A", "I", "U", "E", "O")
EXPRESSIONS = (
    "Blink_L", "Blink_R", *VOWELS, "eyeBlinkLeft", "eyeBlinkRight", "jawOpen", "mouthFunnel", "mouthPucker", "mouthSmileLeft",
    "mouthSmileRight", "mouthStretchLeft", "mouthStretchRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight", "browDownLeft",
    "browDownRight",
)  # fmt: skip
"""Channels: VRM 0's and VMC's names of blinks and vowels, then the coefficients of ARKit that these points determine."""

EYES = np.array([[263, 362, 386, 374, 385, 380], [33, 133, 159, 145, 158, 153]])
"""Left and right eye of the person: outer and inner corner, then twice the upper and the lower lid."""
BROWS = np.array([[336, 296, 334, 293, 300], [107, 66, 105, 63, 70]])
"""From the inner to the outer end."""
MOUTH = np.array([61, 291, 13, 14, 0, 17])
"""Right and left corner, upper and lower lip inside, then outside."""
FACE = np.array([10, 152, 234, 454])
"""Forehead, chin, right and left edge."""
MEASURES = 11
"""eyes (2), mouth: open, wide, smile left and right, round; brows: inner left and right, outer left and right."""


@kernel
def measures(points: Samples, out: Samples) -> None:
    """Lengths and ratios (MEASURES,) into `out` from `points` (468, 3): relative to the face's own size, in any unit."""
    tall, wide = _far(points, FACE[0], FACE[1]), _far(points, FACE[2], FACE[3])
    for eye in range(2):
        e = EYES[eye]
        out[eye] = (_far(points, e[2], e[3]) + _far(points, e[4], e[5])) / (2.0 * _far(points, e[0], e[1]))
    out[2] = _far(points, MOUTH[2], MOUTH[3]) / tall
    out[3] = _far(points, MOUTH[0], MOUTH[1]) / wide
    up = np.empty(3)  # from chin to forehead
    for c in range(3):
        up[c] = (points[FACE[0], c] - points[FACE[1], c]) / tall
    for side in range(2):  # left, then right: how far the corner is above the middle of the lips
        corner, rise = MOUTH[1 - side], 0.0
        for c in range(3):
            rise += (points[corner, c] - (points[MOUTH[4], c] + points[MOUTH[5], c]) / 2.0) * up[c]
        out[4 + side] = rise / tall
    out[6] = _far(points, MOUTH[4], MOUTH[5]) / _far(points, MOUTH[0], MOUTH[1])
    for side in range(2):
        for end in range(2):  # inner, outer
            height = 0.0
            corner = EYES[side, 1 - end]
            for k in range(2):
                brow = BROWS[side, k if end == 0 else 4 - k]
                for c in range(3):
                    height += (points[brow, c] - points[corner, c]) * up[c] / 2.0
            out[7 + 2 * end + side] = height / tall


@kernel
def expressions(now: Samples, rest: Samples, out: Samples) -> None:
    """Weights (21,) 0 to 1 into `out` from `measures` now, and of this face at rest."""
    for eye in range(2):
        blink = _share(rest[eye] - now[eye], 0.15 * rest[eye], 0.50 * rest[eye])  # closed lids still measure a third
        out[eye], out[7 + eye] = blink, blink
    opened = _share(now[2] - rest[2], 0.012, 0.17)
    wider = (now[3] - rest[3]) / rest[3]
    wide, narrow = _share(wider, 0.04, 0.22), _share(-wider, 0.06, 0.30)
    smile_left, smile_right = _share(now[4] - rest[4], 0.008, 0.05), _share(now[5] - rest[5], 0.008, 0.05)
    out[9], out[10], out[11] = opened, min(opened * 2.0, 1.0) * narrow, narrow * (1.0 - opened)
    out[2] = opened * (1.0 - narrow) * (1.0 - 0.5 * wide)  # A
    out[3] = wide * (1.0 - opened) * (1.0 - max(smile_left, smile_right))  # I
    out[4] = narrow * (1.0 - opened)  # U
    out[5] = wide * min(opened * 2.0, 1.0) * (1.0 - 0.5 * opened)  # E
    out[6] = narrow * min(opened * 2.0, 1.0)  # O
    out[12], out[13] = smile_left, smile_right
    out[14] = out[15] = wide * (1.0 - max(smile_left, smile_right))
    inner_left, inner_right = now[7] - rest[7], now[8] - rest[8]
    out[16] = _share((inner_left + inner_right) / 2.0, 0.008, 0.05)
    out[17], out[18] = _share(now[9] - rest[9], 0.008, 0.05), _share(now[10] - rest[10], 0.008, 0.05)
    out[19], out[20] = _share(-inner_left, 0.008, 0.04), _share(-inner_right, 0.008, 0.04)


@kernel
def learn_rest(now: Samples, share: float, count: float, rest: Samples) -> None:
    """Move what is taken for this face's rest (MEASURES,) towards `now`: eyes quickly to wider ones and slowly to narrower ones.

    The first `count` < 1 frame sets it.
    """
    for k in range(MEASURES):
        if count < 1.0 or math.isnan(rest[k]):
            rest[k] = now[k]
        elif k < 2:
            rest[k] += (0.2 if now[k] > rest[k] else 0.1 * share) * (now[k] - rest[k])
        elif k == 2:
            rest[k] += (0.2 if now[k] < rest[k] else 0.05 * share) * (now[k] - rest[k])
        else:
            rest[k] += share * (now[k] - rest[k])


@kernel
def _share(value: float, low: float, high: float) -> float:
    return min(max((value - low) / (high - low), 0.0), 1.0)


@kernel
def _far(points: Samples, a: int, b: int) -> float:
    total = 0.0
    for c in range(3):
        total += (points[a, c] - points[b, c]) ** 2
    return math.sqrt(total)
