"""Where a step is: the peaks of acceleration's norm, found sample by sample (thesis, chapter 7: peaks and valleys)."""

from __future__ import annotations

import numpy as np

from stream.chunk import NEVER, Array, Samples, Times
from stream.kernel import kernel

CUTOFF_HZ, ORDER = 5.0, 2
LEAST_M_S2 = 0.6
FALL = 0.1
APART_NS = 320_000_000
GRAVITY_M_S2 = 9.81

TRACK = np.dtype(
    [
        ("rising", "<i8"),
        ("high", "<f8"),
        ("high_at", "<i8"),
        ("low", "<f8"),
        ("since", "<f8"),
        ("size", "<f8"),
        ("found_at", "<i8"),
        ("last", "<i8"),
    ]
)
"""Whether a peak is sought; the highest value and when; the valley before it, and the lowest value since; the usual height of a peak over
its valley; the latest step's peak, and the newest stamp."""


def fresh_track() -> Array:
    track = np.zeros(1, TRACK)
    restart(track)
    track["size"] = 2.0
    return track


def restart(track: Array) -> None:
    """Forget the peak under way: at the start, and after a gap."""
    track["rising"], track["high"], track["since"], track["low"] = 1, -np.inf, np.inf, np.inf
    track["found_at"] = track["last"] = NEVER


@kernel
def seek(track: np.void, at: int, v: float, wait_ns: int) -> bool:
    """Take the smoothed acceleration `v` at `at`; whether a peak is now certain: `high_at`.

    It is when the value has fallen from it by a tenth of the usual height, at least 0.6 m/s2, and it has stood for `wait_ns`. Peaks less
    than 0.32 s after the latest step do not count; nor do those that rise less than 0.6 m/s2.
    """
    enough = max(FALL * track["size"], LEAST_M_S2)
    if not track["rising"]:
        track["low"] = min(track["low"], v)
        if v - track["low"] > enough:
            track["rising"], track["high"], track["high_at"], track["since"] = 1, v, at, v
        return False
    if v > track["high"]:
        track["high"], track["high_at"], track["since"] = v, at, v
    track["since"] = min(track["since"], v)
    if track["high"] - track["since"] <= enough or at - track["high_at"] < wait_ns:
        return False
    height = track["high"] - track["low"]
    far = track["found_at"] == NEVER or track["high_at"] - track["found_at"] > APART_NS
    track["rising"], track["low"] = 0, track["since"]
    if not far or not LEAST_M_S2 < height < np.inf:
        return False
    track["size"] += 0.2 * (height - track["size"])
    track["found_at"] = track["high_at"]
    return True


@kernel
def find_steps(
    time: Times, data: Samples, sos: Samples, z: Samples, track: Array, wait_ns: int, gap_ns: int, found: Times
) -> int:
    """Steps in `data` (n, 6) whose first three are acceleration in m/s2; rows of `found` (n, 3): which sample made it certain, the peak's
    stamp, and the peak before (NEVER: none). Returns how many. A sample with NaN is passed over; `track["found_at"]` goes after a gap.
    """
    steps, state = 0, track[0]
    for i in range(time.shape[0]):
        a = data[i, 0] * data[i, 0] + data[i, 1] * data[i, 1] + data[i, 2] * data[i, 2]
        if not np.isfinite(a):
            continue
        if state["last"] != NEVER and time[i] - state["last"] > gap_ns:
            state["rising"], state["high"], state["since"], state["low"] = 1, -np.inf, np.inf, np.inf
            state["found_at"] = NEVER
            z[:] = 0.0
        state["last"] = time[i]
        v = np.sqrt(a) - GRAVITY_M_S2
        for s in range(sos.shape[0]):
            y = sos[s, 0] * v + z[s, 0]
            z[s, 0] = sos[s, 1] * v - sos[s, 4] * y + z[s, 1]
            z[s, 1] = sos[s, 2] * v - sos[s, 5] * y
            v = y
        before = state["found_at"]
        if seek(state, time[i], v, wait_ns):
            found[steps, 0], found[steps, 1], found[steps, 2] = i, state["high_at"], before
            steps += 1
    return steps
