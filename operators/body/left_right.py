"""Keeps left and right of a person apart: a network mistakes a back for a front, and swaps them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

LIMBS = np.array([11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28])
LEGS = np.arange(25, 33)
WIDE, CLEAR, ASTRAY = 0.5, 0.15, -0.5
"""From these shares of the trunk on legs are wide apart, and hips seen clearly; legs that go on worse than this are the other way round."""
WORD = np.array([0.3, 0.0, -1.2])
"""What speaks for the three readings of a frame, before anything is compared: as given, a back taken for a front, exchanged."""
ALIKE, SLACK_PX, SHARP, LEAST_BROKEN = 1.0, 2.0, 3.0, 0.003
"""How much going on in the image counts beside going on in heading; how sharply the better one of two readings is the right one."""
SHAPE, GIVEN, AWAY, CHANGES, MOST_ODDS = 0.6, 0.05, 0.2, -0.1, 4.0
"""Log odds a frame of where the person faces, of the network's word, and of its word that it sees a back, which it hardly ever says of a
front; below which left and right change places; the most there are."""
SURE = 0.1
"""Below these log odds left is as likely right."""
TURNS, FACES = 0.15, 0.15
"""How quickly the heading follows what was read, and the shape."""
DEPTHS, MOST_DEPTHS, ODDS_DEPTHS = 10.0, 0.4, 0.4
"""What it counts when shoulders and hips were measured on the side, before or behind the other, where a reading has them; the share of it
that counts for left having been left all along: arms before shoulders and hips mislead for many frames on end."""
NOSE, TOE, KNEE, MOST_AWAY = 1.5, 1.5, 2.0, 0.6
"""What a metre counts by which the nose is behind the shoulders, a toe behind its ankle, a knee behind its leg; the most of all."""
NOSE_M, JOINT_M, TOE_BEFORE_M, KNEE_BEHIND_M = 0.2, 0.15, 0.03, 0.03
"""The most that is counted of each; where toe and knee are, on the surface, of somebody who faces neither way."""


@kernel
def unturned(
    points: Samples, facing: Samples, other_side: NDArray[np.int64], memory: Samples, before: Samples, out: Samples
) -> int:
    """`points` (34, 8) with left and right as they should be, into `out`; 0: as given, 1: a back taken for a front, 2: exchanged.

    `facing` (2,) is where the shape faces. `memory` (4,): x and z of where the person faced, whether that is known, and the log odds that
    left is left; `before` (34, 2): where the landmarks were in the image.

    A body seen from behind looks like one from the front with left and right swapped and depths mirrored. From frame to frame it takes
    the reading closer to the one before: people do not turn round in a thirtieth of a second. Whether left has
    been left all along is a question of its own: the shape, depths and the network's word count for or against it, as far as they tell the
    reading from the one that it would be otherwise, and each frame in which that one would go on as well makes it less certain. Where it
    has become unlikely, left and right change places.
    """
    faces = _faces(points, facing)
    x = (points[11, 7] - points[12, 7]) + (points[23, 7] - points[24, 7])
    z = -((points[11, 5] - points[12, 5]) + (points[23, 5] - points[24, 5]))
    length = math.sqrt(x * x + z * z)
    deeper = DEPTHS * _deeper(points) * x
    if length > 0.0:
        x, z = x / length, z / length
    seen = min(max(deeper, -MOST_DEPTHS), MOST_DEPTHS) * z * z
    readings = np.array([[x, z], [x, -z], [-x, -z]])
    if memory[2] == 0.0:
        memory[0], memory[1], memory[2], memory[3] = faces[0], faces[1], 1.0, 0.0
        before[:] = math.nan
    going_on = _going_on(points, LIMBS, other_side, before)
    best, scores = 0, np.empty(3)
    for c in range(3):
        scores[c] = readings[c, 0] * memory[0] + readings[c, 1] * memory[1] + WORD[c]
        scores[c] += (ALIKE * going_on if c == 0 else -ALIKE * going_on) + (-seen if c == 1 else seen)
        if scores[c] > scores[best]:
            best = c
    other = (1 if scores[1] >= scores[2] else 2) if best == 0 else 0
    broken = min(max(1.0 / (1.0 + math.exp(min(SHARP * (scores[best] - scores[other]), 50.0))), LEAST_BROKEN), 0.5)
    right = 1.0 / (1.0 + math.exp(-memory[3]))
    right = right * (1.0 - broken) + (1.0 - right) * broken
    clear = _clear(points)
    speaks = (readings[best, 0] - readings[other, 0]) * faces[0] + (readings[best, 1] - readings[other, 1]) * faces[1]
    word = GIVEN + AWAY * max(z, 0.0)
    odds = math.log(right / (1.0 - right)) + SHAPE * clear * speaks / 2 + (word if best == 0 else -word)
    if best + other == 1:
        odds += ODDS_DEPTHS * (-seen if best == 1 else seen)
    if odds < CHANGES:
        best, odds = other, -odds
        memory[0], memory[1] = readings[best]
    memory[3] = min(max(odds, -MOST_ODDS), MOST_ODDS)
    for i in range(2):
        memory[i] += TURNS * (readings[best, i] - memory[i]) + FACES * clear * (faces[i] - memory[i])
    for k in range(points.shape[0]):
        out[k] = points[other_side[k] if best else k]
        if best == 1:
            out[k, 7] = -out[k, 7]
    if odds >= 0.0 and _legs_exchanged(out, other_side, before):
        exchange_legs(out)
    before[:] = out[:, :2]
    return best


@kernel
def _faces(points: Samples, facing: Samples) -> Samples:
    """Where the person faces (2,): `facing` of the shape, and depths that tell a front from a back whoever is left.

    On a front the nose is nearer than the shoulders, toes than ankles, knees than the line from hip to ankle; on a back they are not, or
    farther. The shape is misled for a second on end by how somebody stands; these err at other times.
    """
    away, shoulders = 0.0, (points[11, 2] + points[12, 2]) / 2
    nose = points[0, 2] - shoulders
    if not math.isnan(nose):
        away += NOSE * min(max(nose, -NOSE_M), NOSE_M)
    for side in range(2):
        toe = points[31 + side, 2] - points[27 + side, 2] + TOE_BEFORE_M
        knee = points[25 + side, 2] - (points[23 + side, 2] + points[27 + side, 2]) / 2 - KNEE_BEHIND_M
        if not math.isnan(toe):
            away += TOE * min(max(toe, -JOINT_M), JOINT_M)
        if not math.isnan(knee):
            away += KNEE * min(max(knee, -JOINT_M), JOINT_M)
    faces = facing.copy()
    faces[1] += min(max(away, -MOST_AWAY), MOST_AWAY)
    length = math.hypot(faces[0], faces[1])
    if length > 1.0:
        faces[0] /= length
        faces[1] /= length
    return faces


@kernel
def _clear(points: Samples) -> float:
    """From 0 to 1: how far what is seen of the limbs, and a trunk that stands, let a shape say where it faces."""
    shown = 0.0
    for k in LIMBS:
        shown += min(points[k, 3], points[k, 4]) / len(LIMBS)
    return shown * shown * _upright(points)


@kernel
def _legs_exchanged(points: Samples, other_side: NDArray[np.int64], before: Samples) -> bool:
    """Whether legs, wide apart in the image, are the other way round than the hips, or, where these show no side, than before.

    Seen from behind, the network exchanges legs and trunk each by itself. In 11 000 frames of motion capture ankles never cross by 10 cm.
    """
    hips, knees, ankles = (
        points[23, 0] - points[24, 0],
        points[25, 0] - points[26, 0],
        points[27, 0] - points[28, 0],
    )
    trunk, legs = 0.0, 0.0
    for i in range(2):
        trunk += (points[11, i] + points[12, i] - points[23, i] - points[24, i]) ** 2 / 4
        legs += (points[27, i] + points[28, i] - points[23, i] - points[24, i]) ** 2 / 4
    size = max(math.sqrt(trunk), math.sqrt(legs) / 2)
    if ankles * knees <= 0.0 or abs(ankles) < WIDE * size or abs(knees) < CLEAR * size:
        return False
    return hips * ankles < 0.0 if abs(hips) > CLEAR * size else _going_on(points, LEGS, other_side, before) < ASTRAY


@kernel
def exchange_legs(points: Samples) -> None:
    for k in range(LEGS[0], LEGS[-1], 2):
        for i in range(points.shape[1]):
            points[k, i], points[k + 1, i] = points[k + 1, i], points[k, i]


@kernel
def _upright(points: Samples) -> float:
    """The cosine of how far the trunk leans, by the network's own guess; at least 0, as the facing of a horizontal trunk is undefined."""
    total, up = 1e-12, 0.0
    for i in (5, 6, 7):
        along = points[11, i] + points[12, i] - points[23, i] - points[24, i]
        total += along * along
        up = -along if i == 6 else up
    return max(up, 0.0) / math.sqrt(total)


@kernel
def _deeper(points: Samples) -> float:
    """By how much the left shoulder and hip were measured farther away than the right ones (m, both added); 0 where they were not."""
    more = 0.0
    for a, b in ((11, 12), (23, 24)):
        apart = points[a, 2] - points[b, 2]
        if not math.isnan(apart):
            more += min(max(apart, -0.4), 0.4)
    return more


@kernel
def _going_on(points: Samples, which: NDArray[np.int64], other_side: NDArray[np.int64], before: Samples) -> float:
    """From -1 to 1: how much better `which` of `points` go on in the image from `before` (34, 2) than with left and right exchanged."""
    better, apart = 0.0, 1e-9
    for k in which:
        o = other_side[k]
        if math.isnan(before[k, 0]) or math.isnan(before[o, 0]):
            continue
        better += math.hypot(points[o, 0] - before[k, 0], points[o, 1] - before[k, 1])
        better -= math.hypot(points[k, 0] - before[k, 0], points[k, 1] - before[k, 1])
        apart += math.hypot(before[k, 0] - before[o, 0], before[k, 1] - before[o, 1]) + SLACK_PX
    return better / apart
