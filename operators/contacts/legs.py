"""A limb that swings to and fro: its forward and backward legs, and the contacts between them.

While a foot is on the ground the limb turns (or moves, relative to the body) one way, in the swing the other way. The
turning points of that one coordinate are the contacts: it turns forwards at lift-off and back at touch-down. They are
found by a zigzag with hysteresis, which needs no threshold on speed: a leg is over once the coordinate has come back from
its extreme by `reverse`, or has stood still.
Which of the two directions is the swing, the polarity, is put to a vote, by the legs themselves or by the caller.
"""

from __future__ import annotations

import numpy as np

from kinegraph.stream.kernel import kernel

LEGS = np.dtype(
    [
        ("coordinate", "<f8"),
        ("start", "<f8"),
        ("extreme", "<f8"),
        ("extreme_at", "<i8"),
        ("start_at", "<i8"),
        ("direction", "<i8"),
        ("before", "<f8"),
        ("before_direction", "<i8"),
        ("before_at", "<i8"),
        ("reported", "<i8"),
        ("vote", "<f8"),
        ("liftoff_at", "<i8"),
        ("touchdown_at", "<i8"),
    ]
)
"""The leg under way (`direction` 0: at rest), the size, direction and end of the one before, whether its lift-off has been reported,
the vote on polarity: positive where the swing runs towards positive coordinates, and the onsets of the last contacts. Times are ns."""

LIFTOFF, TOUCHDOWN = 1, 2
LIMITS = np.dtype([("swing", "<f8"), ("stance", "<f8"), ("reverse", "<f8"), ("still_ns", "<f8"), ("wait_ns", "<f8")])
"""How long a swing and the leg before it must be, by how much a turn must come back to be certain, after how many ns without progress a
limb is at rest, and how many ns old a turn must be."""
NO_VOTE, SURE, BY_SIZE, BY_ENERGY = range(4)
FORGET = 0.97
"""What a leg's vote keeps with each later leg."""
LONGEST_NS = 1_500_000_000
"""A longer swing is not a swing."""


@kernel
def grow(legs: np.void, since: int, at: int, step: float) -> None:
    """Move the coordinate by `step` between the times `since` and `at`; the sign of the speed does not change in between."""
    legs["coordinate"] += step
    if legs["direction"] == 0 and step != 0.0:
        legs["direction"] = 1 if step > 0.0 else -1
        legs["start"] = legs["coordinate"] - step
        legs["start_at"] = since
        legs["extreme"] = legs["coordinate"]
        legs["extreme_at"] = at
    elif (legs["coordinate"] - legs["extreme"]) * legs["direction"] > 0.0:
        legs["extreme"] = legs["coordinate"]
        legs["extreme_at"] = at


@kernel
def glide(legs: np.void, since: int, at: int, before: float, now: float) -> None:
    """Move the coordinate by a speed that goes straight from `before` to `now`; where it changes sign the coordinate has turned."""
    if before * now < 0.0:
        share = before / (before - now)
        turn = since + int(share * (at - since))
        grow(legs, since, turn, 0.5e-9 * before * (turn - since))
        grow(legs, turn, at, 0.5e-9 * now * (at - turn))
    else:
        grow(legs, since, at, 0.5e-9 * (before + now) * (at - since))


@kernel
def over(legs: np.void, at: int, limits: np.void) -> bool:
    """Whether the leg under way has ended: the coordinate has come back from its extreme, or has not gone on for a while."""
    back = (legs["extreme"] - legs["coordinate"]) * legs["direction"]
    age = at - legs["extreme_at"]
    return bool(
        legs["direction"] != 0 and age >= limits["wait_ns"] and (back > limits["reverse"] or age > limits["still_ns"])
    )


@kernel
def swings(legs: np.void, swing: float, stance: float) -> bool:
    """Whether the leg under way is a swing: the right way, longer than `swing`, after a leg back longer than `stance`."""
    return bool(
        legs["direction"] * legs["vote"] > 0.0
        and abs(legs["extreme"] - legs["start"]) > swing
        and legs["before_direction"] == -legs["direction"]
        and legs["before"] > stance
        and legs["extreme_at"] - legs["before_at"] < LONGEST_NS
    )


@kernel
def judge(legs: np.void, at: int, limits: np.void, voting: int) -> int:
    """Judge the leg under way at the time `at`; returns which contacts are now certain: LIFTOFF and TOUCHDOWN, added up.

    A lift-off is certain as soon as the swing is long enough, and its onset is where the leg began; a touch-down once the
    swing is over, and its onset is the swing's extreme. So every touch-down has its lift-off before it; but where the caller
    is sure of the polarity, the first leg of all may be a swing with an unseen start.

    limits  see LIMITS
    voting  NO_VOTE or SURE: the caller votes; BY_SIZE, BY_ENERGY: a leg that is over counts for the swing running its way by its size
            squared, or that per second
    """
    certain = 0
    ends = over(legs, at, limits)
    size = abs(legs["extreme"] - legs["start"])
    if ends and voting >= BY_SIZE and size > limits["reverse"]:
        weight = size * size
        if voting == BY_ENERGY:
            weight /= max(1e-9 * (legs["extreme_at"] - legs["start_at"]), 0.05)
        legs["vote"] = FORGET * legs["vote"] + legs["direction"] * weight
    if not legs["reported"] and swings(legs, limits["swing"], limits["stance"]):
        legs["reported"] = 1
        legs["liftoff_at"] = legs["before_at"]
        certain += LIFTOFF
    if ends and voting == SURE and legs["before_direction"] == 0 and size > limits["swing"]:
        legs["reported"] = 1 if legs["direction"] * legs["vote"] > 0.0 else 0
    if ends:
        if legs["reported"]:
            legs["touchdown_at"] = legs["extreme_at"]
            certain += TOUCHDOWN
        next_leg(legs, at, limits["reverse"])
    return certain


@kernel
def next_leg(legs: np.void, at: int, reverse: float) -> None:
    """Put the leg that is over behind; what reversed it is the next one, else the limb rests. Legs below `reverse` are forgotten."""
    size = abs(legs["extreme"] - legs["start"])
    if size > reverse:
        legs["before"] = 0.0 if legs["reported"] else size
        legs["before_direction"] = legs["direction"]
        legs["before_at"] = legs["extreme_at"]
    legs["reported"] = 0
    if (legs["extreme"] - legs["coordinate"]) * legs["direction"] > reverse:
        legs["direction"] = -legs["direction"]
        legs["start"], legs["start_at"] = legs["extreme"], legs["extreme_at"]
        legs["extreme"], legs["extreme_at"] = legs["coordinate"], at
    else:
        legs["direction"] = 0


@kernel
def rest(legs: np.void) -> None:
    """Forget the legs, but not which way the swing runs: after a gap."""
    legs["coordinate"] = legs["start"] = legs["extreme"] = legs["before"] = 0.0
    legs["direction"] = legs["before_direction"] = legs["reported"] = 0
