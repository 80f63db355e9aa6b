"""The fingers of a humanoid: how they bend, as angles that filters may smooth, and the bones' rotations that follow from these.

For each hand four fingers with a bend at knuckle, middle and end joint and a spread at the knuckle, and a thumb with the same. Angles are
in degrees, 0 for a flat hand with closed fingers; bends are positive towards the palm, spreads away from the middle finger.
"""

from __future__ import annotations

import numpy as np

from kinegraph.stream.chunk import Samples

FINGERS = ("Thumb", "Index", "Middle", "Ring", "Little")
JOINTS = ("Proximal", "Intermediate", "Distal")
SIDES = ("Left", "Right")
MOVES = ("bend", "spread", "bend2", "bend3")
FINGER_BONES = tuple(f"{side}{finger}{joint}" for side in SIDES for finger in FINGERS for joint in JOINTS)
"""As Unity and VRM 0 call them; 30."""
BENDS = tuple(f"{side}{finger}.{move}" for side in SIDES for finger in FINGERS for move in MOVES)
"""The channels of a stream of bends; 40."""
MIN_BENDS = np.tile([[-20.0, -35.0, -15.0, -25.0], *([[-25.0, -20.0, 0.0, -5.0]] * 4)], (2, 1, 1)).ravel()
MAX_BENDS = np.tile([[55.0, 45.0, 60.0, 80.0], *([[95.0, 25.0, 115.0, 80.0]] * 4)], (2, 1, 1)).ravel()
"""What joints of people allow (degrees), in the order of BENDS."""
RELAXED = np.tile(
    [[15.0, 10.0, 15.0, 15.0], *([[20.0 + 4 * k, 3.0 * (1 - k), 25.0, 15.0] for k in range(4)])], (2, 1, 1)
).ravel()
"""A hand that hangs."""

_LENGTHS = (
    (0.045, 0.035, 0.030),
    (0.085, 0.040, 0.024),
    (0.087, 0.044, 0.028),
    (0.082, 0.040, 0.027),
    (0.075, 0.032, 0.020),
)
_THUMB = np.radians(40.0)
_PLACES = (0.035, 0.026, 0.004, -0.016, -0.034)
"""How far each joint is from the one before it (m), the first from the wrist; and how far forward of the hand's middle a finger lies; a
thumb points forward by _THUMB."""


def finger_offsets() -> Samples:
    """Where FINGER_BONES begin, seen from the bone before (30, 3) in m, in the T-pose of usual hands."""
    made = np.zeros((2, 5, 3, 3))
    for hand, side in enumerate((1.0, -1.0)):
        for finger in range(5):
            slant = _THUMB if finger == 0 else 0.0
            made[hand, finger, :, 0] = side * np.cos(slant) * np.array(_LENGTHS[finger])
            made[hand, finger, :, 2] = np.sin(slant) * np.array(_LENGTHS[finger])
            made[hand, finger, 0, 2] = _PLACES[finger]
    return made.reshape(30, 3)


def finger_rotations(bends: Samples) -> Samples:
    """Rotations (..., 30, 4) of FINGER_BONES, local and relative to the T-pose (palms down), from `bends` (..., 40) in degrees.

    >>> finger_rotations(np.zeros(40))[0]
    array([1., 0., 0., 0.])
    """
    before = bends.shape[:-1]
    angles = np.radians(bends).reshape(*before, 2, 5, 4)
    made = np.zeros((*before, 2, 5, 3, 4))
    for hand, side in enumerate((1.0, -1.0)):
        for finger in range(5):
            bend, spread, second, third = np.moveaxis(angles[..., hand, finger, :], -1, 0)
            away = (1.0, 1.0, 0.0, -1.0, -1.0)[
                finger
            ] * spread  # from the middle finger, towards the thumb or away from it
            turns = made[..., hand, finger, :, :]
            if finger == 0:  # down out of the palm's plane; spread, and bent further, within it
                turns[..., 0, :] = _times(_about(1, -side * away), _about(0, bend))
                turns[..., 1, :], turns[..., 2, :] = _about(1, side * second), _about(1, side * third)
                continue
            turns[..., 0, :] = _times(_about(1, -side * away), _about(2, -side * bend))
            turns[..., 1, :], turns[..., 2, :] = _about(2, -side * second), _about(2, -side * third)
    return made.reshape(*before, 30, 4)


def _about(axis: int, angle: Samples) -> Samples:
    """Rotations (..., 4) about x, y or z (0, 1, 2) by angles (...)."""
    made = np.zeros((*np.shape(angle), 4))
    made[..., 0], made[..., 1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
    return made


def _times(p: Samples, q: Samples) -> Samples:
    """The products of quaternions (..., 4)."""
    (pw, px, py, pz), (qw, qx, qy, qz) = np.moveaxis(p, -1, 0), np.moveaxis(q, -1, 0)
    return np.stack(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ],
        axis=-1,
    )
