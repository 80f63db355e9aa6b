"""What betrays a marker that has taken another's name: it leaps, or the bone to its neighbour has another length."""

from __future__ import annotations

import numpy as np

from kinegraph.stream.chunk import NEVER, Array, Samples, Times
from kinegraph.stream.kernel import kernel

JUMP, LENGTH, LENGTH_OVER, JUMP_OVER = range(4)
FOUND = np.dtype([("kind", "<i8"), ("which", "<i8"), ("sample", "<i8"), ("since", "<i8"), ("value", "<f8"), ("other", "<i8")])  # fmt: skip
"""What happened to which marker or segment, with which sample, since when (ns); how far it leapt (m), or the segment's length over what
it was; and the marker that was where it leapt to, or -1."""

TRACK = np.dtype([
    ("known", "<i8"), ("at", "<i8"), ("before", "<i8"), ("here", "<f8", (3,)), ("there", "<f8", (3,)),
    ("leapt", "<i8"), ("size", "<f8"), ("other", "<i8"), ("lasts", "<i8"),
    ("since", "<i8"),
])  # fmt: skip
"""A marker: how many positions of it are known (two suffice), when the latest and the one before were seen, and where; when it leapt
(NEVER: not lately), how far, to which marker's place; whether an alarm lasts, and since when."""

BONE = np.dtype([
    ("length", "<f8"), ("begun", "<i8"), ("sum", "<f8"), ("n", "<i8"), ("least", "<f8"), ("most", "<f8"), ("off", "<i8"), ("right", "<i8"),
    ("lasts", "<i8"),
])  # fmt: skip
"""A segment: its usual length in m (0: not known yet); the window under way: its begin, the sum, number and extremes of lengths; since
when it has another length, and since when its own (NEVER: it has not); whether an alarm lasts."""

LIMITS = np.dtype([(name, "<f8") for name in ("jump_m", "pause_s", "stretch", "first_s", "lasts_s", "calm_s")])
"""The limits: how far a leap goes (m), the longest pause to ignore (s); by which part of its length a segment may differ, how long it is
watched first, for how long it must have another length, and its own again (s)."""

SPEED_M_S, SWAY_M_S2 = 10.0, 100.0
"""A marker of unknown speed moves no faster; one of known speed changes it no faster."""
NEAR_M = 0.1
"""A marker that leaps lands this near to the one it was mistaken for."""


@kernel
def between(a: Samples, b: Samples) -> float:
    """The distance of two points."""
    total = 0.0
    for c in range(3):
        total += (a[c] - b[c]) * (a[c] - b[c])
    return float(np.sqrt(total))


@kernel
def visible(place: Samples) -> bool:
    """Whether a marker was seen: finite, and not at 0, 0, 0."""
    total = place[0] + place[1] + place[2]
    return bool(np.isfinite(total) and (place[0] != 0.0 or place[1] != 0.0 or place[2] != 0.0))


@kernel
def leap(track: np.void, place: Samples, at: int, limits: np.void) -> float:
    """How far (m) a marker is from where it would have come without a leap; 0 where that is near enough, or not known."""
    dt = 1e-9 * (at - track["at"])
    if track["known"] == 0 or dt > limits["pause_s"]:
        return 0.0
    if track["known"] == 1:
        far = between(place, track["here"])
        return far if far > limits["jump_m"] + SPEED_M_S * dt else 0.0
    share = dt / (1e-9 * (track["at"] - track["before"]))
    far = 0.0
    for c in range(3):
        off = place[c] - track["here"][c] - share * (track["here"][c] - track["there"][c])
        far += off * off
    far = np.sqrt(far)
    return float(far) if far > limits["jump_m"] + SWAY_M_S2 * dt * dt else 0.0


@kernel
def step(track: np.void, place: Samples, at: int, far: float, limits: np.void) -> None:
    """Take a marker's new place. One that leaps back at once was a ghost."""
    if far > 0.0 or (track["known"] and 1e-9 * (at - track["at"]) > limits["pause_s"]):
        track["known"] = 0
    if far > 0.0:
        ghost = track["leapt"] != NEVER
        track["leapt"], track["size"] = NEVER if ghost else at, far
    track["before"] = track["at"]
    track["at"] = at
    for c in range(3):
        track["there"][c] = track["here"][c]
        track["here"][c] = place[c]
    track["known"] = min(2, track["known"] + 1)


@kernel
def measure(bone: np.void, length: float, at: int, limits: np.void) -> int:
    """Take a segment's length; returns -1, or LENGTH or LENGTH_OVER where an alarm begins or ends.

    Its usual length is the mean of the first window; while an alarm lasts, a whole window of one length makes that the usual one.
    """
    if bone["n"] == 0:
        bone["begun"], bone["sum"], bone["least"], bone["most"] = at, 0.0, length, length
    bone["sum"] += length
    bone["n"] += 1
    bone["least"], bone["most"] = min(bone["least"], length), max(bone["most"], length)
    full = 1e-9 * (at - bone["begun"]) >= limits["first_s"]
    if full:
        mean = bone["sum"] / bone["n"]
        even = bone["most"] - bone["least"] <= limits["stretch"] * mean
        bone["n"] = 0
        if bone["length"] == 0.0 or (bone["lasts"] and even):
            bone["length"] = mean
    if bone["length"] == 0.0:
        return -1
    other = abs(length / bone["length"] - 1.0) > limits["stretch"]
    if other:
        bone["right"] = NEVER
    elif bone["right"] == NEVER:
        bone["right"] = at
    if other == (bone["lasts"] == 1):
        bone["off"] = NEVER
        return -1
    if bone["off"] == NEVER:
        bone["off"] = at
    if 1e-9 * (at - bone["off"]) < (limits["lasts_s"] if other else limits["calm_s"]):
        return -1
    bone["lasts"] = 1 - bone["lasts"]
    return LENGTH if other else LENGTH_OVER


@kernel
def settled(k: int, bones: Array, ends: Times, at: int, calm_s: float) -> bool:
    """Whether marker `k` has segments, and all of them have had their length for so long."""
    calm = False
    for b in range(bones.shape[0]):
        if ends[b, 0] != k and ends[b, 1] != k:
            continue
        calm = True
        if bones[b]["lasts"] or bones[b]["right"] == NEVER or 1e-9 * (at - bones[b]["right"]) < calm_s:
            return False
    return calm


@kernel
def note(found: Array, made: int, kind: int, which: int, sample: int, since: int, value: float, other: int) -> int:
    """Write a row; returns how many there are."""
    row = found[made]
    row["kind"], row["which"], row["sample"], row["since"] = kind, which, sample, since
    row["value"], row["other"] = value, other
    return made + 1


@kernel
def nearest(place: Samples, k: int, was: Samples) -> int:
    """The other marker that was where marker `k` is now, or -1."""
    other, least = -1, NEAR_M
    for j in range(was.shape[0]):
        apart = between(place, was[j])
        if j != k and apart < least:
            other, least = j, apart
    return other


@kernel
def follow_markers(
    time: Times, place: Samples, tracks: Array, bones: Array, ends: Times, limits: Array, was: Samples, found: Array
) -> int:
    """Follow all markers, `place` (n, m, 3) m, and the segments between them; returns how many rows of `found` were written.

    ends    (s, 2)  the markers at a segment's ends
    was     (m, 3)  memory for where the markers were before
    """
    made, limit = 0, limits[0]
    for i in range(time.shape[0]):
        at = time[i]
        for k in range(tracks.shape[0]):
            for c in range(3):
                was[k, c] = tracks[k]["here"][c] if tracks[k]["known"] else np.nan
        for k in range(tracks.shape[0]):
            track = tracks[k]
            if not visible(place[i, k]) or at == track["at"]:
                continue
            far = leap(track, place[i, k], at, limit)
            step(track, place[i, k], at, far, limit)
            if far > 0.0:
                track["other"] = nearest(place[i, k], k, was)
            if track["leapt"] != NEVER and 1e-9 * (at - track["leapt"]) >= limit["pause_s"]:
                if not track["lasts"]:
                    made = note(found, made, JUMP, k, i, track["leapt"], track["size"], track["other"])
                track["lasts"], track["since"], track["leapt"] = 1, track["leapt"], NEVER
        for b in range(bones.shape[0]):
            one, two = place[i, ends[b, 0]], place[i, ends[b, 1]]
            if not visible(one) or not visible(two):
                continue
            length = between(one, two)
            kind = measure(bones[b], length, at, limit)
            if kind >= 0:
                made = note(found, made, kind, b, i, bones[b]["off"], length / bones[b]["length"], -1)
                bones[b]["off"] = NEVER
        for k in range(tracks.shape[0]):
            calm = tracks[k]["lasts"] and 1e-9 * (at - tracks[k]["since"]) >= limit["calm_s"]
            if calm and settled(k, bones, ends, at, limit["calm_s"]):
                tracks[k]["lasts"] = 0
                made = note(found, made, JUMP_OVER, k, i, at, 0.0, -1)
    return made
