"""How the path of a foot and of the body is followed: smoothed, its gaps filled, and reduced to one coordinate along the way."""

from __future__ import annotations

import numpy as np

from kinegraph.operators.contacts.legs import LIFTOFF, NO_VOTE, SURE, TOUCHDOWN, glide, judge, rest
from kinegraph.operators.filters.iir import one_value
from kinegraph.stream.chunk import NEVER, Array, Samples, Times
from kinegraph.stream.kernel import kernel

DEAD_M_S, FASTEST_M_S = 0.05, 30.0
MEMORY_S, BODY_S = 4.0, 1.0
NEAREST_M, FARTHEST_M = 0.1, 2.5
"""A marker on the foot or leg is no nearer to one on hip or sacrum, and no farther from it, whoever walks."""

WALK = np.dtype(
    [
        ("last", "<i8"),
        ("middle", "<i8"),
        ("speed", "<f8"),
        ("weight", "<f8"),
        ("body", "<f8"),
        ("cube", "<f8"),
        ("raw", "<f8", (6,)),
        ("smooth", "<f8", (6,)),
        ("drift", "<f8", (2,)),
        ("spread", "<f8", (3,)),
        ("axis", "<f8", (2,)),
        ("apart", "<f8"),
        ("strange", "<i8"),
    ]
)
"""The last stamp and the middle of the last interval, in ns; the speed along the way; decaying sums of time
(long, and for the body), and of the speed's cube; raw and smooth positions of foot and body; decaying sums of the body's
velocity and of the relative velocity's second moment xx, xy, yy; the way's direction; how far foot and body are apart; how many more
samples lay where no leg can be than where one can."""


@kernel
def start(walk: np.void, legs: np.void, place: Samples, sos: Samples, steady: Samples, z: Samples) -> None:
    """Begin at `place` (6,), as if both markers had always been there."""
    rest(legs)
    legs["vote"] = 0.0
    walk["speed"] = walk["weight"] = walk["body"] = walk["cube"] = 0.0
    walk["middle"] = NEVER
    for c in range(6):
        walk["raw"][c] = walk["smooth"][c] = place[c]
        for s in range(sos.shape[0]):
            z[c, s, 0] = steady[s, 0] * place[c]
            z[c, s, 1] = steady[s, 1] * place[c]
    for c in range(2):
        walk["drift"][c] = 0.0
        walk["axis"][c] = np.sqrt(0.5)
    for c in range(3):
        walk["spread"][c] = 1e-9


@kernel
def seen(place: Samples) -> bool:
    """Whether both markers of `place` (6,) were seen: finite, and not at 0, 0, 0, which stands for a lost marker."""
    total, foot, body = 0.0, 0.0, 0.0
    for c in range(3):
        total += place[c] + place[3 + c]
        foot += abs(place[c])
        body += abs(place[3 + c])
    return bool(np.isfinite(total) and foot > 0.0 and body > 0.0)


@kernel
def jumps(walk: np.void, place: Samples, elapsed_ns: int) -> bool:
    """Whether a marker moved faster to `place` (6,) than any limb: another marker took its name."""
    farthest = 0.0
    for c in range(6):
        farthest = max(farthest, abs(place[c] - walk["raw"][c]))
    return farthest > FASTEST_M_S * 1e-9 * elapsed_ns


@kernel
def stretched(walk: np.void, place: Samples) -> bool:
    """Whether foot and body are nearer to each other, or farther apart, than a leg is long."""
    apart = 0.0
    for c in range(3):
        apart += (place[c] - place[3 + c]) * (place[c] - place[3 + c])
    walk["apart"] = np.sqrt(apart)
    return bool(walk["apart"] < NEAREST_M or walk["apart"] > FARTHEST_M)


@kernel
def along(walk: np.void, step: Samples, dt: float, alone: bool) -> tuple[float, float, float]:
    """The foot's speed in m/s relative to the body along the way, and two votes for that way to be forward (negative: backward).

    step (6,) is what foot and body moved in `dt` s; without a body marker (`alone`) the body moves as the foot did on average.
    The way is the horizontal direction of most relative motion, followed by one step of the power method a sample. The body
    goes forward; on a treadmill, where it stays, the foot is faster on its way forward than on its way back.
    """
    keep = np.exp(-dt / MEMORY_S)
    slow = keep if alone else np.exp(-dt / BODY_S)
    walk["weight"] = keep * walk["weight"] + dt
    walk["body"] = slow * walk["body"] + dt
    for c in range(2):
        walk["drift"][c] = slow * walk["drift"][c] + (step[c] if alone else step[3 + c])
    east, north = walk["drift"][0] / walk["body"], walk["drift"][1] / walk["body"]
    u = step[0] / dt - (east if alone else step[3] / dt)
    v = step[1] / dt - (north if alone else step[4] / dt)
    walk["spread"][0] = keep * walk["spread"][0] + u * u * dt
    walk["spread"][1] = keep * walk["spread"][1] + u * v * dt
    walk["spread"][2] = keep * walk["spread"][2] + v * v * dt
    a = walk["spread"][0] * walk["axis"][0] + walk["spread"][1] * walk["axis"][1]
    b = walk["spread"][1] * walk["axis"][0] + walk["spread"][2] * walk["axis"][1]
    length = np.sqrt(a * a + b * b)
    walk["axis"][0], walk["axis"][1] = a / length, b / length
    speed = u * walk["axis"][0] + v * walk["axis"][1]
    walk["cube"] = keep * walk["cube"] + speed * speed * speed * dt
    typical = np.sqrt((walk["spread"][0] + walk["spread"][2]) / walk["weight"])
    skew = walk["cube"] / walk["weight"] / (typical * typical * typical)
    return speed, 2.0 * (east * walk["axis"][0] + north * walk["axis"][1]) / typical, skew


@kernel
def advance(
    walk: np.void,
    legs: np.void,
    since: int,
    at: int,
    delay_ns: int,
    alone: bool,
    sos: Samples,
    z: Samples,
    limits: Array,
) -> int:
    """Take the raw place of both markers at the time `at`, `since` being the one before; returns which contacts are now certain."""
    step = np.empty(6)
    for c in range(6):
        value = one_value(walk["raw"][c], sos, z[c])
        step[c] = value - walk["smooth"][c]
        walk["smooth"][c] = value
    dt = 1e-9 * (at - since)
    speed, going, skew = along(walk, step, dt, alone)
    legs["vote"] = going + skew
    speed = speed - DEAD_M_S if speed > DEAD_M_S else speed + DEAD_M_S if speed < -DEAD_M_S else 0.0
    middle = since + (at - since) // 2 - delay_ns
    if walk["middle"] != NEVER:
        glide(legs, walk["middle"], middle, walk["speed"], speed)
    walk["middle"], walk["speed"] = middle, speed
    return judge(legs, middle, limits[0], SURE if abs(going) > 1.0 and not alone else NO_VOTE)


@kernel
def follow(
    time: Times,
    place: Samples,
    spans_ns: tuple[int, int, int],
    alone: bool,
    sos: Samples,
    steady: Samples,
    z: Samples,
    limits: Array,
    memory: Array,
    motion: Array,
    found: Times,
) -> tuple[int, int]:
    """Follow foot and body, `place` (n, 6) m with the vertical third; what is missing is filled on a straight line.

    spans_ns         time between samples; how long a gap is filled at most; the filter's delay
    found  (2, 2 n + 2, 2)  touch-downs and lift-offs: stamp, onset. Returns how many of each.
    """
    period_ns, fill_ns, delay_ns = spans_ns
    legs, walk = memory[0], motion[0]
    downs = ups = 0
    ends = np.empty(6)
    for i in range(time.shape[0]):
        at, since = time[i], walk["last"]
        if not seen(place[i]) or at == since:
            continue
        walk["last"] = at
        leaps = since != NEVER and jumps(walk, place[i], at - since)
        strange = leaps or (not alone and stretched(walk, place[i]))
        walk["strange"] = walk["strange"] + 1 if strange else max(0, walk["strange"] - 1)
        if since == NEVER or at - since - period_ns > fill_ns or leaps:
            start(walk, legs, place[i], sos, steady, z)
            continue
        parts = max(1, round((at - since) / period_ns))
        down, up = NEVER, NEVER
        for c in range(6):
            ends[c] = walk["raw"][c]
        for k in range(parts):
            for c in range(6):
                walk["raw"][c] = place[i, c] if k + 1 == parts else ends[c] + (place[i, c] - ends[c]) * (k + 1) / parts
            one, two = since + (at - since) * k // parts, since + (at - since) * (k + 1) // parts
            certain = advance(walk, legs, one, two, delay_ns, alone, sos, z, limits)
            up = legs["liftoff_at"] if certain & LIFTOFF else up
            down = legs["touchdown_at"] if certain & TOUCHDOWN else down
        if up != NEVER:
            found[1, ups, 0], found[1, ups, 1] = at, up
            ups += 1
        if down != NEVER:
            found[0, downs, 0], found[0, downs, 1] = at, down
            downs += 1
    return downs, ups
