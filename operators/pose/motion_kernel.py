"""What a pose may do from one sample to the next: no bone turns faster than a limit, and a foot that stands stays where it is."""

from __future__ import annotations

import math

from kinegraph.operators.pose.limb_kernel import ANKLE_AT, FOOT, KNEE_AT, SIDE, THIGH, fit_limb, place_from
from kinegraph.operators.pose.rotation_kernel import angle_between, normalise, part_way, relative
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.skeleton import multiply
from kinegraph.stream.kernel import kernel

LOW_M, LIFTED_M = 0.02, 0.03
"""A foot comes to stand below the first of these heights above where feet stand, and leaves above the second."""
SLOW_M_S, FAST_M_S = 0.12, 0.25
"""The same for its level speed."""
STRAY_M = 0.015
"""A foot stands no longer where its marker is this far from where it stands."""
EASE, EASE_M = 0.75, 0.012
"""How much of a foot's distance from its marker is left a sample after it has been released; it shrinks by at least this much."""
RISE_M_S = 0.02
"""How fast the level at which feet stand may rise: whoever climbs stairs takes it along."""
NOISY_M, NOISE_M, MOST_NOISE, RISES, HEARS, AFTER_S, KNOWN_S = 0.007, 0.021, 1.5, 0.1, 0.1, 0.5, 2.0
"""A marker's noise is by how much its level step changes from sample to sample, in its quietest stretches (m). From the first of these it
is noisy, and limits are wider by as often as it is the second, at most this many times. It rises by this share a second, takes this share
of each sample, from half a second on, and is known after two."""
SLOWLY_S, STAYS_M, STRAYS_M, NOISY_LOW_M, NOISY_LIFTED_M = 0.3, 0.04, 0.05, 0.04, 0.06
"""Of a marker with noise NOISE_M: it comes to rest when this near to its own mean over that time, and leaves when this
far from its resting place; the heights for both."""
DRIFTS, DRIFTS_M_S, LEAVES_M_S, NOISY_EASE, NOISY_EASE_M, MOST_EASE_M = 0.05, 0.03, 0.57, 0.5, 0.006, 0.02
"""Where it stands follows the marker by this share a sample, at most so fast, and it is not let go faster than that (m/s); then, as EASE;
at most this much a sample."""
STANDS, LOCK, AWAY, WAS, SPEED, WENT, CHANGE, QUIET, HEARD, SLOW, PUT = 0, 1, 4, 7, 10, 12, 14, 15, 16, 17, 19
"""Columns of `feet` (2, 22): whether it stands; where; how far it is from its marker; where that was; its speed; whether it has one (11);
its level step; by how much that changes; the noise; for how long that was heard (s); its mean place, level; where the foot was put."""


@kernel
def limit_turns(
    before: Samples, was: Samples, parents: Times, most: float, turns: Samples, local: Samples, work: Samples
) -> bool:
    """Keep every bone within `most` rad of where it was, in the world and relative to its parent; returns whether one was held back.

    before  (22, 4) rotations in the world before; was (22, 4) those relative to parents
    turns   (22, 4) as wanted, then as taken; local (22, 4) the same relative to parents
    """
    held = False
    for b in range(turns.shape[0]):
        p = parents[b]
        if p < 0:
            angle = angle_between(before[b], turns[b])
            if angle > most:
                held = True
                part_way(before[b], turns[b], most / angle, turns[b])
            local[b] = turns[b]
            continue
        relative(turns[p], turns[b], work[0])
        angle = angle_between(was[b], work[0])
        share = 1.0 if angle <= most else most / angle
        local[b] = work[0]
        if share < 1.0 or angle_between(before[b], turns[b]) > most:
            held = True
            high, low = share, 0.0
            for step in range(7):
                middle = high if step == 0 else 0.5 * (low + high)
                part_way(was[b], work[0], middle, local[b])
                multiply(turns[p], local[b], work[1])
                if angle_between(before[b], work[1]) <= most:
                    low = middle
                    if step == 0:
                        break
                else:
                    high = middle
            part_way(was[b], work[0], low, local[b])
        multiply(turns[p], local[b], turns[b])
        normalise(turns[b])
    return held


@kernel
def same_signs(was: Samples, local: Samples) -> None:
    """Of the two quaternions of each rotation, take the one nearer to that before."""
    for b in range(local.shape[0]):
        d = 0.0
        for a in range(4):
            d += was[b, a] * local[b, a]
        if d < 0.0:
            for a in range(4):
                local[b, a] = -local[b, a]


@kernel
def plant(side: int, ankle: Samples, dt: float, ground: float, feet: Samples) -> float:
    """Whether the foot of a side stands, by height and speed with hysteresis; `ankle` (3,) becomes where it is to be.

    A foot that stands stays where it is on the ground; the ankle above it may rise, as a foot rolls. A noisy marker has no speed that tells
    anything: by it a foot stands while it stays near its own mean, within limits as wide as the noise.

    Returns the ground's level. A foot that is released goes back to its marker by degrees, so that nothing leaps.
    """
    foot = feet[side]
    ground = ankle[1] if foot[11] == 0.0 and ground == math.inf else min(ankle[1], ground + RISE_M_S * dt)
    if foot[11] > 0.0:
        across, along = ankle[0] - foot[WAS], ankle[2] - foot[WAS + 2]
        speed = math.sqrt(across**2 + along**2) / dt
        foot[SPEED] += 0.5 * (speed - foot[SPEED])
        _listen(foot, across, along, dt)
        foot[SLOW] += (ankle[0] - foot[SLOW]) * dt / (SLOWLY_S + dt)
        foot[SLOW + 1] += (ankle[2] - foot[SLOW + 1]) * dt / (SLOWLY_S + dt)
    else:
        foot[SPEED] = FAST_M_S
        foot[SLOW], foot[SLOW + 1] = ankle[0], ankle[2]
    foot[11] = 1.0
    for a in range(3):
        foot[WAS + a] = ankle[a]
    if _noisy(foot):
        _put_noisy(foot, ankle, dt, ankle[1] - ground)
    else:
        _put(foot, ankle, ankle[1] - ground)
    foot[PUT : PUT + 3] = ankle
    return ground


@kernel
def _noisy(foot: Samples) -> bool:
    """Whether a foot's marker leaps by itself."""
    return bool(foot[HEARD] >= KNOWN_S and foot[QUIET] > NOISY_M)


@kernel
def _listen(foot: Samples, across: float, along: float, dt: float) -> None:
    """How noisy a foot's marker is, by its level step (m) now and before."""
    foot[CHANGE] += HEARS * (math.hypot(across - foot[WENT], along - foot[WENT + 1]) - foot[CHANGE])
    foot[WENT], foot[WENT + 1] = across, along
    foot[HEARD] = min(foot[HEARD] + dt, 2 * KNOWN_S)
    if foot[HEARD] >= AFTER_S:
        quiet = math.inf if foot[QUIET] == 0.0 else foot[QUIET] * (1.0 + RISES * dt)
        foot[QUIET] = min(quiet, foot[CHANGE])


@kernel
def _hold(foot: Samples, ankle: Samples, ease: float) -> None:
    """The ankle of a foot that stands, over its place; what is left of its height above the marker shrinks to this share."""
    foot[AWAY + 1] *= ease
    ankle[1] += foot[AWAY + 1]
    for a in (0, 2):
        foot[AWAY + a] = foot[LOCK + a] - ankle[a]
        ankle[a] = foot[LOCK + a]


@kernel
def _put(foot: Samples, ankle: Samples, height: float) -> None:
    """Put a foot by its height and speed."""
    if foot[STANDS] > 0.0:
        stray = math.sqrt(
            (ankle[0] - foot[LOCK]) ** 2 + (ankle[1] - foot[LOCK + 1]) ** 2 + (ankle[2] - foot[LOCK + 2]) ** 2
        )
        if height > LIFTED_M or foot[SPEED] > FAST_M_S or stray > STRAY_M:
            foot[STANDS] = 0.0
    elif height < LOW_M and foot[SPEED] < SLOW_M_S:
        foot[STANDS] = 1.0
        for a in range(3):
            foot[LOCK + a] = ankle[a] + foot[AWAY + a]
    if foot[STANDS] > 0.0:
        _hold(foot, ankle, EASE)
        return
    away = math.sqrt(foot[AWAY] ** 2 + foot[AWAY + 1] ** 2 + foot[AWAY + 2] ** 2)
    left = max(0.0, min(EASE * away, away - EASE_M))
    for a in range(3):
        foot[AWAY + a] *= left / away if away > 1e-9 else 0.0
        ankle[a] += foot[AWAY + a]


@kernel
def _put_noisy(foot: Samples, ankle: Samples, dt: float, height: float) -> None:
    """Put a foot with a noisy marker: by its distance from its own mean, or from its resting place."""
    wide, stood = min(foot[QUIET] / NOISE_M, MOST_NOISE), foot[STANDS] > 0.0
    if stood:
        stray = math.hypot(ankle[0] - foot[LOCK], ankle[2] - foot[LOCK + 2])
        if stray > STRAYS_M * wide or height > NOISY_LIFTED_M * wide:
            foot[STANDS] = 0.0
    elif max(height / NOISY_LOW_M, math.hypot(ankle[0] - foot[SLOW], ankle[2] - foot[SLOW + 1]) / STAYS_M) < wide:
        foot[STANDS] = 1.0
        foot[LOCK : LOCK + 3] = foot[PUT : PUT + 3]
    if foot[STANDS] > 0.0:
        across, along = ankle[0] - foot[LOCK], ankle[2] - foot[LOCK + 2]
        apart = math.hypot(across, along)
        share = min(DRIFTS, DRIFTS_M_S * dt / apart) if apart > 1e-9 else 0.0
        foot[LOCK] += share * across
        foot[LOCK + 2] += share * along
        _hold(foot, ankle, NOISY_EASE)
        return
    away = math.sqrt(foot[AWAY] ** 2 + foot[AWAY + 1] ** 2 + foot[AWAY + 2] ** 2)
    left = max(0.0, min(NOISY_EASE * away, away - NOISY_EASE_M), away - MOST_EASE_M)
    step = 0.0
    for a in range(3):
        foot[AWAY + a] *= left / away if away > 1e-9 else 0.0
        step += (ankle[a] + foot[AWAY + a] - foot[PUT + a]) ** 2
    most = LEAVES_M_S * dt / math.sqrt(step) if stood and step > 1e-18 else 1.0
    for a in range(3):
        if most < 1.0:
            foot[AWAY + a] = foot[PUT + a] + most * (ankle[a] + foot[AWAY + a] - foot[PUT + a]) - ankle[a]
        ankle[a] += foot[AWAY + a]


@kernel
def put_feet(
    marks: Samples,
    known: Array,
    dt: float,
    memory: Samples,
    feet: Samples,
    offsets: Samples,
    turns: Samples,
    joints: Samples,
    work: Samples,
) -> None:
    """Put both feet where they stand or are, and bend the legs to it. `memory[2]` is the level at which ankles stand."""
    for side in range(2):
        foot, thigh = FOOT + SIDE * side, THIGH + SIDE * side
        work[6, :3] = joints[foot]
        memory[2] = plant(side, work[6, :3], dt, memory[2], feet)
        aside = 0.0
        for a in range(3):
            aside = max(aside, abs(work[6, a] - joints[foot, a]))
        if aside > 0.0:
            knee, ankle = KNEE_AT + side, ANKLE_AT + side
            work[7, :3], work[8, :3] = marks[ankle], marks[knee]
            was_known = known[ankle]
            marks[ankle] = work[6, :3]
            known[ankle] = True
            fit_limb(thigh, knee, ankle, marks, known, offsets, turns, joints, work, True)
            marks[ankle], marks[knee] = work[7, :3], work[8, :3]
            known[ankle] = was_known
            place_from(foot + 1, foot, offsets, turns, joints)
