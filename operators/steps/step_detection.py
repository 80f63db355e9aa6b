"""Where a step is: the peaks of acceleration's norm, found sample by sample (thesis, chapter 7: peaks and valleys)."""

from __future__ import annotations

import numpy as np

from kinegraph.operators.filters.iir import one_value
from kinegraph.stream.chunk import NEVER, NS, Array, Samples, Times
from kinegraph.stream.kernel import kernel

CUTOFF_HZ, ORDER = 5.0, 2
LEAST_M_S2 = 0.7
APART_S = 0.36
GRAVITY_M_S2 = 9.81

RULE = np.dtype([("least", "<f8"), ("apart", "<i8"), ("wait", "<i8"), ("gap", "<i8")])
"""What makes a step: how far the value must rise and fall, in m/s2; in ns how far apart steps are, how long a peak must stand, and after
what gap the search begins again."""

TRACK = np.dtype(
    [
        ("rising", "<i8"),
        ("high", "<f8"),
        ("high_at", "<i8"),
        ("low", "<f8"),
        ("since", "<f8"),
        ("found_at", "<i8"),
        ("last", "<i8"),
    ]
)
"""Whether a peak is sought; the highest value and when; the valley before it, and the lowest value since; the latest step's peak, and
the newest stamp."""


def rule_of(wait_s: float = 0.0, gap_s: float = 0.3, apart_s: float = APART_S, least: float = LEAST_M_S2) -> Array:
    """The rule (1,); docs/lab/steps.md has what its neighbours find."""
    return np.array([(least, *(round(s * NS) for s in (apart_s, wait_s, gap_s)))], RULE)


def fresh_track() -> Array:
    track = np.zeros(1, TRACK)
    restart(track)
    return track


def restart(track: Array) -> None:
    """Forget the peak under way: at the start, and after a gap."""
    track["rising"], track["high"], track["since"], track["low"] = 1, -np.inf, np.inf, np.inf
    track["found_at"] = track["last"] = NEVER


@kernel
def seek(track: np.void, rule: np.void, at: int, v: float) -> bool:
    """Take the smoothed acceleration `v` at `at`; whether a peak is now certain: `high_at`.

    It is when the value has fallen from it by more than `least`, and it has stood for `wait`. Peaks that rise less, and those
    within `apart` of the latest step, do not count.
    """
    if not track["rising"]:
        track["low"] = min(track["low"], v)
        if v - track["low"] > rule["least"]:
            track["rising"], track["high"], track["high_at"], track["since"] = 1, v, at, v
        return False
    if v > track["high"]:
        track["high"], track["high_at"], track["since"] = v, at, v
    track["since"] = min(track["since"], v)
    if track["high"] - track["since"] <= rule["least"] or at - track["high_at"] < rule["wait"]:
        return False
    height = track["high"] - track["low"]
    far = track["found_at"] == NEVER or track["high_at"] - track["found_at"] > rule["apart"]
    track["rising"], track["low"] = 0, track["since"]
    if not far or not rule["least"] < height < np.inf:
        return False
    track["found_at"] = track["high_at"]
    return True


@kernel
def find_steps(time: Times, data: Samples, sos: Samples, z: Samples, track: Array, rules: Array, found: Times) -> int:
    """Finds steps in `data` (n, 6), first acceleration in m/s2; rows of `found` (n, 3): which sample made it certain, the peak's
    stamp, and the peak before (or NEVER). Returns how many. A sample with NaN is passed over; `track["found_at"]` goes after a gap.
    """
    steps, state, rule = 0, track[0], rules[0]
    for i in range(time.shape[0]):
        a = data[i, 0] * data[i, 0] + data[i, 1] * data[i, 1] + data[i, 2] * data[i, 2]
        if not np.isfinite(a):
            continue
        if state["last"] != NEVER and time[i] - state["last"] > rule["gap"]:
            state["rising"], state["high"], state["since"], state["low"] = 1, -np.inf, np.inf, np.inf
            state["found_at"] = NEVER
            z[:] = 0.0
        state["last"] = time[i]
        v = one_value(np.sqrt(a) - GRAVITY_M_S2, sos, z)
        before = state["found_at"]
        if seek(state, rule, time[i], v):
            found[steps, 0], found[steps, 1], found[steps, 2] = i, state["high_at"], before
            steps += 1
    return steps
