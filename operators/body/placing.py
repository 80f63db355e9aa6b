"""From what a frame shows of a person to places in space: depths judged, bones kept at their lengths.

Three steps for every frame, each a kernel: `unturned` (left_right.py: a network takes a back for a front and exchanges left and right),
`placed` (depth where it was measured and can be true, the network's own guess where not, the bone's length where neither can be),
`trusted` (confidence.py).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples
from kinegraph.stream.data.ordering import median
from kinegraph.stream.kernel import kernel

INSIDE = np.full(34, 0.03)
INSIDE[[0, 7, 8, 11, 12, 13, 14, 15, 16]] = 0.02, 0.07, 0.07, 0.055, 0.055, 0.035, 0.035, 0.025, 0.025
INSIDE[[23, 24, 25, 26, 27, 28, 31, 32, 33]] = 0.10, 0.10, 0.055, 0.055, 0.04, 0.04, 0.02, 0.02, 0.09
"""How far behind the body's surface a landmark lies (m); measured on rendered bodies."""
CHAINS = np.array(
    [(13, 11, 0), (14, 12, 0), (15, 13, 1), (16, 14, 1), (25, 23, 2), (26, 24, 2), (27, 25, 3), (28, 26, 3)]
)
"""A limb's joint, the one before it, and the bone between them, from the trunk outwards."""
PAIRS = np.array([(11, 12, 4), (23, 24, 5)])
"""Shoulders and hips, and the width between them."""
SIDES = np.array([(23, 11, 6), (24, 12, 6)])
"""Hip, shoulder, and the trunk between them: it bends, but a hip that is a hand's depth from its shoulder is a hand."""
LENGTHS = np.array([0.296, 0.270, 0.413, 0.421, 0.361, 0.198, 0.47])
"""Upper arm, forearm, thigh, shank, width of shoulders and hips, side of the trunk (m) before anything is known of the person."""
AGREES_M, POSSIBLE_M = 0.22, 0.45
"""A measured depth is believed if it differs by less from the guess; one that makes the bone as long as it is, by less than the second."""
BONE_SHARE = 0.25
"""A bone may differ this much from its length before its outer end is moved."""
EDGE, BACK_M, CHEST_M = 0.1, 0.08, 0.3
"""Of somebody who shows the back: the back reaches beyond shoulders and hips by this share of its width and height, and lies no nearer
than this before the plane of these (m); what is before the chest is this far behind the back's surface (m)."""
TWINS_M, FARTHER_M = 0.10, 0.05
"""Left and right landmarks that are nearer to each other in the image hide one another; farther away by less is not farther away."""
COVERED = np.array([(13, 15), (14, 16), (25, 28), (26, 27)])
"""Elbows and what may be before them, their own fists; knees, and the other side's ankles."""


@kernel
def placed(
    points: Samples, camera: Samples, lengths: Samples, counts: Samples, places: Samples, doubt: Samples
) -> float:
    """`points` (34, 8) in space: `places` (34, 3) in m, and `doubt` (34, 2): 1 where guessed; by what share of its length a bone is off.

    `camera` (4,) fx, fy, cx, cy; `lengths` (7,) of bones, learned from what was measured, with `counts` (7,). Returns how far away the
    trunk is (m); NaN, with nothing placed, where no depth was measured.
    """
    points = _without_hidden(points, camera)
    trunk = _trunk(points)
    placed_at(points, camera, trunk, lengths, counts, places, doubt)
    return trunk


@kernel
def placed_at(
    points: Samples,
    camera: Samples,
    trunk: float,
    lengths: Samples,
    counts: Samples,
    places: Samples,
    doubt: Samples,
) -> None:
    """`placed`, where the middle of the hips is known to be `trunk` m away (NaN: nothing is placed)."""
    places[:] = math.nan
    doubt[:] = 1.0
    if math.isnan(trunk):
        return
    depth = np.empty(34)
    for k in range(34):
        guess = trunk + points[k, 7]
        depth[k] = guess
        doubt[k, 1] = 0.0
        measured = points[k, 2] + INSIDE[k]
        if abs(measured - guess) <= AGREES_M:
            depth[k], doubt[k, 0] = measured, 0.0
    for i in range(PAIRS.shape[0]):
        _hold_pair(points, camera, trunk, PAIRS[i], lengths, counts, depth, doubt)
    for i in range(SIDES.shape[0]):
        if doubt[SIDES[i, 0], 0] + doubt[SIDES[i, 1], 0] == 0.0:
            _hold_bone(points, camera, trunk, SIDES[i], lengths, counts, depth, doubt)
    for i in range(CHAINS.shape[0]):
        _hold_bone(points, camera, trunk, CHAINS[i], lengths, counts, depth, doubt)
    for k in range(34):
        places[k, 0] = (points[k, 0] - camera[2]) / camera[0] * depth[k]
        places[k, 1] = (points[k, 1] - camera[3]) / camera[1] * depth[k]
        places[k, 2] = depth[k]


@kernel
def _without_hidden(points: Samples, camera: Samples) -> Samples:
    """`points` (34, 8) without the depths that belong to something before the landmark, at the same pixels: to another part of a limb.

    Of a left and a right landmark within TWINS_M of each other in the image at the same depth, the one that the network sees less of and
    takes for the farther one is hidden.
    """
    out = points.copy()
    for i in range(COVERED.shape[0]):
        k, cover = COVERED[i]
        across, down = points[k, 0] - points[cover, 0], points[k, 1] - points[cover, 1]
        behind = points[k, 7] > points[cover, 7] + FARTHER_M and points[k, 2] - points[cover, 2] < FARTHER_M
        if behind and math.hypot(across, down) * points[cover, 2] < TWINS_M * camera[0]:
            out[k, 2] = math.nan
    for k in range(11, 33):
        twin = k + 1 if k % 2 else k - 1
        if points[k, 7] < points[twin, 7] + FARTHER_M or points[k, 3] > points[twin, 3]:
            continue
        across, down = points[k, 0] - points[twin, 0], points[k, 1] - points[twin, 1]
        if math.hypot(across, down) * points[twin, 2] > TWINS_M * camera[0]:
            continue
        if points[k, 2] - points[twin, 2] < FARTHER_M:
            out[k, 2] = math.nan
    return out


@kernel
def _trunk(points: Samples) -> float:
    """How far away the middle of the hips is (m), by shoulders and hips; by any landmark, if less than two of these were measured."""
    found = np.empty(34)
    n = 0
    for k in (11, 12, 23, 24):
        if not math.isnan(points[k, 2]):
            found[n] = points[k, 2] + INSIDE[k] - points[k, 7]
            n += 1
    if n < 2:
        n = 0
        for k in range(34):
            if not math.isnan(points[k, 2]):
                found[n] = points[k, 2] + INSIDE[k] - points[k, 7]
                n += 1
    return median(found, n) if n else math.nan


@kernel
def _hold_pair(
    points: Samples,
    camera: Samples,
    trunk: float,
    pair: NDArray[np.int64],
    lengths: Samples,
    counts: Samples,
    depth: Samples,
    doubt: Samples,
) -> None:
    """Shoulders or hips: learn their width, or move the far one to where it fits."""
    a, b, bone = pair
    long = lengths[bone]
    apart = _apart(points, camera, a, depth[a], b, depth[b])
    if abs(apart - long) < BONE_SHARE * long:
        if doubt[a, 0] + doubt[b, 0] == 0.0 and min(points[a, 3], points[b, 3]) > 0.8:
            _learn(lengths, counts, bone, apart)
        return
    far, near = (a, b) if points[a, 7] > points[b, 7] else (b, a)
    depth[far], off = _at_length(points, camera, far, near, depth[near], long, trunk + points[far, 7])
    doubt[far, 0], doubt[far, 1] = 1.0, off


@kernel
def _hold_bone(
    points: Samples,
    camera: Samples,
    trunk: float,
    chain: NDArray[np.int64],
    lengths: Samples,
    counts: Samples,
    depth: Samples,
    doubt: Samples,
) -> None:
    """A limb's joint: measured if that makes the bone as long as it is, else where its line of sight is a bone's length away.

    Of an elbow or wrist before the chest the camera sees only the back: it lies behind that, on the farther of the two places.
    """
    joint, before, bone = chain
    long = lengths[bone]
    guess, measured = trunk + points[joint, 7], points[joint, 2] + INSIDE[joint]
    apart = _apart(points, camera, joint, measured, before, depth[before])
    behind = 13 <= joint <= 16 and _behind_back(points, joint)
    if not behind and abs(apart - long) < BONE_SHARE * long and abs(measured - guess) < POSSIBLE_M:
        depth[joint], doubt[joint, 0] = measured, 0.0
        if doubt[before, 0] == 0.0 and min(points[joint, 3], points[before, 3]) > 0.7:
            _learn(lengths, counts, bone, apart)
        return
    if not math.isnan(measured):  # what is hidden lies behind what hides it
        guess = max(guess, measured - 0.05)
    if behind:
        guess = max(guess, measured + CHEST_M)
    depth[joint], off = _at_length(points, camera, joint, before, depth[before], long, guess)
    doubt[joint, 0], doubt[joint, 1] = 1.0, off


@kernel
def _behind_back(points: Samples, joint: int) -> bool:
    """Whether an elbow or wrist of somebody who shows the back lies before the chest: what is measured at its pixel is the back."""
    left, right = points[11, 0], points[12, 0]
    top, bottom = (points[11, 1] + points[12, 1]) / 2, (points[23, 1] + points[24, 1]) / 2
    if right <= left or bottom <= top:
        return False
    down, aside = (points[joint, 1] - top) / (bottom - top), EDGE * (right - left)
    if not -EDGE <= down <= 1.0:
        return False
    down = max(down, 0.0)
    first, last = left + down * (points[23, 0] - left), right + down * (points[24, 0] - right)
    if not first - aside <= points[joint, 0] <= last + aside:
        return False
    plane = (1.0 - down) * (points[11, 2] + points[12, 2]) / 2 + down * (points[23, 2] + points[24, 2]) / 2
    return bool(points[joint, 2] > plane - BACK_M)


@kernel
def _learn(lengths: Samples, counts: Samples, bone: int, apart: float) -> None:
    if 0.6 < apart / LENGTHS[bone] < 1.5:
        counts[bone] = min(counts[bone] + 1.0, 40.0)
        lengths[bone] += 0.25 / counts[bone] ** 0.8 * min(max(apart - lengths[bone], -0.1), 0.1)


@kernel
def _apart(points: Samples, camera: Samples, a: int, depth_a: float, b: int, depth_b: float) -> float:
    """How far two landmarks are apart (m) if they lie at these depths."""
    x = (points[a, 0] - camera[2]) / camera[0] * depth_a - (points[b, 0] - camera[2]) / camera[0] * depth_b
    y = (points[a, 1] - camera[3]) / camera[1] * depth_a - (points[b, 1] - camera[3]) / camera[1] * depth_b
    return math.sqrt(x * x + y * y + (depth_a - depth_b) ** 2)


@kernel
def _at_length(
    points: Samples, camera: Samples, joint: int, before: int, depth_before: float, long: float, guess: float
) -> tuple[float, float]:
    """The depth, of the two near `guess` the nearer, at which a joint's line of sight is `long` from another joint; 0.

    Where it is nowhere so near: the depth at which it is nearest, and by how much of the length it is too far.
    """
    x, y = (points[joint, 0] - camera[2]) / camera[0], (points[joint, 1] - camera[3]) / camera[1]
    p = (points[before, 0] - camera[2]) / camera[0] * depth_before
    q = (points[before, 1] - camera[3]) / camera[1] * depth_before
    a = x * x + y * y + 1.0
    b = x * p + y * q + depth_before
    c = p * p + q * q + depth_before * depth_before - long * long
    root = b * b - a * c
    if root < 0.0:
        return b / a, math.sqrt(max(c + long * long - b * b / a, 0.0)) / long - 1.0
    near, far = (b - math.sqrt(root)) / a, (b + math.sqrt(root)) / a
    return (near if abs(near - guess) <= abs(far - guess) else far), 0.0
