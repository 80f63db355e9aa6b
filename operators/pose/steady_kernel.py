"""What noise would make of a pose: bones, limbs that are nearly straight, and a head whose markers are close together follow by degrees."""

from __future__ import annotations

import math

from kinegraph.operators.pose.limb_kernel import (
    ANKLE_AT,
    BENT,
    EAR_AT,
    ELBOW_AT,
    HEAD,
    HIP_AT,
    KNEE_AT,
    NECK,
    NOSE_AT,
    SHOULDER_AT,
    UPPER_CHEST,
    WRIST_AT,
    smooth_step,
)
from kinegraph.operators.pose.rotation_kernel import angle_between, dot, normalise, part_way, relative, turn_by, unit
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.domain.skeleton import multiply, turn
from kinegraph.stream.kernel import kernel

STRAIGHT_S, MOVED, REST = 0.15, 0.12, 0.015
"""How quickly the bend of a limb follows its markers where it is straight, or differs by less than the second; and how much the usual
direction of a straight one counts (both as parts of half its length)."""
LEVEL_MOST = 0.7
"""Whoever is calibrated looks ahead, up to this error of the markers (rad)."""
NECK_MOST, HEAD_MOST = 0.8, 1.2
"""How far the neck turns from the chest, and the head (rad): the limits of an adult's neck in any direction, rounded up."""
HEAD_HZ, HEAD_BETA, AGREES_S = 1.5, 2.0, 0.1
"""The head follows with this cut-off, and faster by this (Hz per rad) the farther away its markers agree, for this long, that it is."""
SHRUNK, STRETCHED = 0.5, 1.5
"""Nose and ears that are not as far apart as when the body was calibrated, by these factors, do not show where the head is turned."""
MOST_RAD_S2 = 80.0
"""Limbs of people hardly ever turn faster or slower by more than this within a second: 1 % of the frames of motion capture at 30 Hz."""
STIFFER, STIFFEST = 120.0, 50.0
"""A bone follows at a rate that rises by the first for each rad between it and where it is wanted, up to the second (1/s)."""
LEADS, LEAD_S, MOVES_RAD_S = 0.7, 0.05, 0.3
"""A bone that moves, at about the third or faster, is shown where it will be after the first's share of the time by which it lags, at most
the second."""
LEVEL, TURN, AWAY, KNOWN, NOSE_M, EARS_M = 0, 1, 5, 8, 9, 10
"""Places in `head` (11,): by how much its markers look up when it is level; its rotation as seen from the chest; how far the markers have
been from that of late (3,); whether there is one; how far the nose is from the ears' middle, and these from each other."""


@kernel
def steady_bends(marks: Samples, known: Array, left: Samples, dt: float, bends: Samples, work: Samples) -> None:
    """Put elbows and knees where their limbs have bent to of late: the straighter a limb, the less a sample's noise turns it.

    left  (3,)    the level direction to the body's left
    bends (4, 4)  of the arms and the legs: how far, and to which side of its axis, the middle joint lies, as seen from the body (x to its
                  left, y up, z to its front; m), and whether that is known
    work  (4, 4)  room
    """
    for limb in range(4):
        side, leg = limb % 2, limb > 1
        first = (HIP_AT if leg else SHOULDER_AT) + side
        middle = (KNEE_AT if leg else ELBOW_AT) + side
        end = (ANKLE_AT if leg else WRIST_AT) + side
        if not (known[first] and known[middle] and known[end]):
            continue
        axis, aside, was, usual = work[0, :3], work[1, :3], work[2, :3], work[3, :3]
        half = 0.0
        for a in range(3):
            axis[a] = marks[end, a] - marks[first, a]
            aside[a] = marks[middle, a] - marks[first, a]
            half += (marks[end, a] - marks[middle, a]) ** 2
        half = 0.5 * (math.sqrt(half) + math.sqrt(dot(aside, aside)))
        if unit(axis) == 0.0 or half == 0.0:
            continue
        along = dot(aside, axis)
        b = bends[limb]
        was[0], was[1], was[2] = b[0] * left[0] - b[2] * left[2], b[1], b[0] * left[2] + b[2] * left[0]
        ahead = 1.0 if leg else -1.0
        usual[0], usual[1], usual[2] = -ahead * left[2], 0.0 if leg else -0.5, ahead * left[0]
        across, forward = dot(was, axis), dot(usual, axis)
        for a in range(3):
            aside[a] -= along * axis[a]
            was[a] -= across * axis[a]
            usual[a] -= forward * axis[a]
        bend = max(math.sqrt(dot(aside, aside)), math.sqrt(dot(was, was)))
        share = smooth_step(bend / (BENT * half))
        if b[3] > 0.0:
            moved = 0.0
            for a in range(3):
                moved += (aside[a] - was[a]) ** 2
            slowly = 1.0 - math.exp(-dt / STRAIGHT_S)
            follows = slowly + (1.0 - slowly) * share * smooth_step(math.sqrt(moved) / (MOVED * half))
            for a in range(3):
                aside[a] = was[a] + follows * (aside[a] - was[a])
        b[0] = aside[0] * left[0] + aside[2] * left[2]
        b[1] = aside[1]
        b[2] = aside[2] * left[0] - aside[0] * left[2]
        b[3] = 1.0
        size = math.sqrt(dot(aside, aside))
        unit(usual)
        for a in range(3):
            aside[a] += REST * half * (1.0 - share) * usual[a]
        unit(aside)
        for a in range(3):
            marks[middle, a] = marks[first, a] + along * axis[a] + size * aside[a]


@kernel
def clamp(chest: Samples, most: float, rotation: Samples, work: Samples) -> None:
    """Let the world rotation `rotation` (4,) be within `most` rad of that of the `chest`. `work` (4,)."""
    angle = angle_between(chest, rotation)
    if angle > most:
        part_way(chest, rotation, most / angle, work)
        rotation[:] = work


@kernel
def shows_head(marks: Samples, seen: Array, standing: float, head: Samples) -> bool:
    """Whether nose and ears show where the head is turned: they are seen, and as far apart as those of this head are."""
    if not (seen[NOSE_AT] and seen[EAR_AT] and seen[EAR_AT + 1]):
        return False
    nose = ears = 0.0
    for a in range(3):
        nose += (marks[NOSE_AT, a] - 0.5 * (marks[EAR_AT, a] + marks[EAR_AT + 1, a])) ** 2
        ears += (marks[EAR_AT, a] - marks[EAR_AT + 1, a]) ** 2
    nose, ears = math.sqrt(nose), math.sqrt(ears)
    if standing > 0.0:
        count = standing if head[NOSE_M] > 0.0 else 1.0  # they may first be seen late in the calibration
        head[NOSE_M] += (nose - head[NOSE_M]) / count
        head[EARS_M] += (ears - head[EARS_M]) / count
        return True
    if head[NOSE_M] == 0.0 or head[EARS_M] == 0.0:
        return True
    nose, ears = nose / head[NOSE_M], ears / head[EARS_M]
    return bool(min(nose, ears) > SHRUNK and max(nose, ears) < STRETCHED)


@kernel
def steady_head(turns: Samples, dt: float, shown: bool, standing: float, head: Samples, work: Samples) -> None:
    """Keep neck and head within what a neck can do, level when the body was calibrated, and steady while its markers are not.

    shown     whether markers show where the head is turned; if not, it is turned as it was, as seen from the chest
    standing  samples of the calibration so far; 0: not being calibrated   head (11,) what is remembered of it   work (4, 4) room
    """
    chest, target, q, to = turns[UPPER_CHEST], work[0], head[TURN : TURN + 4], work[1]
    clamp(chest, NECK_MOST, turns[NECK], work[2])
    work[3, 0], work[3, 1], work[3, 2] = 0.0, 0.0, 1.0
    turn(turns[HEAD], work[3, :3], work[2, :3])
    if not shown and head[KNOWN] > 0.0:
        multiply(chest, q, turns[HEAD])
        normalise(turns[HEAD])
        return
    if standing > 0.0:
        looks = math.asin(min(max(work[2, 1], -1.0), 1.0))
        head[LEVEL] += (min(max(looks, -LEVEL_MOST), LEVEL_MOST) - head[LEVEL]) / standing
    to[0], to[1], to[2], to[3] = math.cos(0.5 * head[LEVEL]), math.sin(0.5 * head[LEVEL]), 0.0, 0.0
    multiply(turns[HEAD], to, turns[HEAD])
    clamp(chest, HEAD_MOST, turns[HEAD], work[2])
    relative(chest, turns[HEAD], target)
    if head[KNOWN] == 0.0:
        q[:] = target
        head[KNOWN] = 1.0
    relative(q, target, to)
    sign = -1.0 if to[0] < 0.0 else 1.0
    share = 1.0 - math.exp(-dt / AGREES_S)
    away = 0.0
    for a in range(3):
        head[AWAY + a] += share * (2.0 * sign * to[1 + a] - head[AWAY + a])
        away += head[AWAY + a] ** 2
    cutoff_hz = HEAD_HZ + HEAD_BETA * math.sqrt(away)
    part_way(q, target, 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * dt), q)
    multiply(chest, q, turns[HEAD])
    normalise(turns[HEAD])


@kernel
def follow_turns(
    unsure: Samples, dt: float, rest_rad_s: float, followed: Samples, speeds: Samples, turns: Samples, work: Samples
) -> None:
    """Let every bone follow as on a spring that is critically damped, the stiffer the farther it lags: still at rest, in time in motion.

    Neither how far nor how fast shows anything of a bone that is unsure: it follows as at rest.

    unsure    (22,)    how doubtful the markers of each are, 0 to 1   rest_rad_s  the rate of a bone at rest
    followed  (22, 4)  where the springs have brought the bones; turns (22, 4) as wanted, then as taken: ahead by what the springs lag
    speeds    (22, 3)  their angular velocity (rad/s, in the axes of the bone)   work (1, 4) room
    """
    for b in range(turns.shape[0]):
        relative(followed[b], turns[b], work[0])
        sign = -1.0 if work[0, 0] < 0.0 else 1.0
        sine = math.sqrt(work[0, 1] ** 2 + work[0, 2] ** 2 + work[0, 3] ** 2)
        to_angle = 2.0 * sign * math.atan2(sine, abs(work[0, 0])) / sine if sine > 1e-12 else 0.0
        sure = 1.0 - unsure[b]
        rate = rest_rad_s + sure * min(STIFFER * abs(to_angle) * sine, max(STIFFEST - rest_rad_s, 0.0))
        left = math.exp(-rate * dt)
        for a in range(3):
            away = -to_angle * work[0, 1 + a]
            pull = speeds[b, a] + rate * away
            work[0, 1 + a] = (away + pull * dt) * left - away
            speeds[b, a] = (speeds[b, a] - rate * pull * dt) * left
        turn_by(followed[b], work[0, 1:], 1.0, followed[b], work[0])
        fast = dot(speeds[b], speeds[b])
        lead = sure * min(2.0 * LEADS / rate, LEAD_S) * fast / (fast + MOVES_RAD_S**2)
        turn_by(followed[b], speeds[b], lead, turns[b], work[0])


@kernel
def ease_turns(before: Samples, dt: float, speeds: Samples, turns: Samples, work: Samples) -> None:
    """Let every bone's speed change only as much as people's do, and let it come to rest where it is wanted: markers leap, limbs do not.

    before  (22, 4) rotations in the world before; turns (22, 4) as wanted, then as taken
    speeds  (22, 3) their angular velocity (rad/s, in the axes of the bone)   work (2, 4) room
    """
    for b in range(turns.shape[0]):
        relative(before[b], turns[b], work[0])
        if work[0, 0] < 0.0:
            for a in range(4):
                work[0, a] = -work[0, a]
        sine = math.sqrt(work[0, 1] ** 2 + work[0, 2] ** 2 + work[0, 3] ** 2)
        angle = 2.0 * math.atan2(sine, work[0, 0])
        fast = min(angle / dt, math.sqrt(2.0 * MOST_RAD_S2 * angle))
        change = 0.0
        for a in range(3):
            work[1, a] = fast * work[0, 1 + a] / sine if sine > 1e-12 else 0.0
            change += (work[1, a] - speeds[b, a]) ** 2
        change = math.sqrt(change)
        share = min(1.0, MOST_RAD_S2 * dt / change) if change > 0.0 else 1.0
        if share == 1.0 and fast * dt >= angle:
            speeds[b] = work[1, :3]
            continue
        fast = 0.0
        for a in range(3):
            speeds[b, a] += share * (work[1, a] - speeds[b, a])
            fast += speeds[b, a] ** 2
        fast = math.sqrt(fast)
        half = 0.5 * fast * dt
        work[0, 0] = math.cos(half)
        for a in range(3):
            work[0, 1 + a] = math.sin(half) * speeds[b, a] / fast if fast > 1e-12 else 0.0
        multiply(before[b], work[0], turns[b])
        normalise(turns[b])
