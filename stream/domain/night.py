"""The numbers of one night, from its epochs: how long in bed, asleep, awake, how often and how long; by three conventions.

Every number is in minutes, a count, or a percentage; nothing here knows streams. Unknown epochs enter no numerator; what they leave open
is given as bounds beside the number: `low` were all of them such that it is smallest, `high` the largest.

It is here because both count by it: the statistics of scored streams, and a night's log.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples

States = NDArray[np.int8]
Convention = Literal["AASM", "ActiLife", "Actiware"]

UNKNOWN, WAKE, SLEEP = 0, 1, 2
NAMES = np.array(["unknown", "wake", "sleep"], "U7")

IMMOBILE_MIN = 10.0
"""Actiware: sleep begins and ends with so long a stretch that has at most one epoch with movement."""


@dataclass(frozen=True, slots=True)
class Night:
    """
    first, stop          places of the sleep interval among the epochs of the time in bed: first epoch, one past the last
    tib, tst, sol, waso  minutes in bed, asleep, before sleep, awake after it; with bounds; NaN where there was no sleep
    se                   tst / tib in %
    awakenings, mean_awakening, longest_bout
    movement, fragmentation, total_fragmentation, counts
    """

    first: int
    stop: int
    epochs: int
    unknown: float
    tib: float
    tst: float
    tst_low: float
    tst_high: float
    se: float
    se_low: float
    se_high: float
    sol: float
    sol_low: float
    sol_high: float
    waso: float
    waso_low: float
    waso_high: float
    awakenings: int
    mean_awakening: float
    longest_bout: float
    movement: float
    fragmentation: float
    total_fragmentation: float
    counts: float


def runs(states: States) -> list[tuple[int, int, int]]:
    """(state, first, one past the last) of every stretch of equal states."""
    edges = [0, *(np.flatnonzero(np.diff(states)) + 1).tolist(), len(states)] if len(states) else []
    return [(int(states[a]), a, b) for a, b in pairwise(edges)]


def night(states: States, activity: Samples, epoch_min: float, convention: Convention) -> Night:
    """The numbers of the epochs (n,) in bed. `activity` (n,): counts or motion, NaN where not seen; above 0 is movement.

    AASM      sleep begins with the first epoch of sleep; WASO is all wake from there to the end of the time in bed, the last waking
              included; awakenings are stretches of wake that sleep follows. Movement index: share of epochs with movement between the
              first and the last epoch of sleep; fragmentation index: that, plus the share of still stretches of at most one minute
    ActiLife  WASO as above; awakenings are all stretches of wake. Movement index: epochs with counts, over the time in bed; fragmentation
              index: sleep stretches of at most one minute among all sleep stretches; total: both added
    Actiware  the sleep interval reaches from the first to the last 10 min in bed that have at most one epoch with counts; it ends with the
              beginning of their last epoch, as Actiware reports it. TST, WASO and awakenings are counted within it, SOL is what
              lies before it, SE is TST over the time in bed; fragmentation index: mobile epochs in %, plus still stretches of at
              most one minute among all still stretches in %
    """
    n = len(states)
    first, stop = _sleep_interval(states, activity, epoch_min, convention)
    inside = states[first:stop]
    unknown, lost = int((states == UNKNOWN).sum()), int((inside == UNKNOWN).sum())
    slept = bool((inside == SLEEP).any())
    tst = float((inside == SLEEP).sum())
    gained = lost if convention == "Actiware" else unknown
    sol = float((states[:first] == WAKE).sum()) if convention != "Actiware" else float(first)
    early = int(np.argmax(states != WAKE)) if (states != WAKE).any() else n
    waso = float((inside == WAKE).sum())
    most = float((states[early:] != SLEEP).sum()) if convention != "Actiware" and early < first else waso + lost
    wakes = [b - a for state, a, b in runs(inside) if state == WAKE]
    if convention == "AASM":
        kept = runs(inside)
        wakes = [b - a for state, a, b in kept if state == WAKE and (inside[b:] == SLEEP).any()]
    bouts = [b - a for state, a, b in runs(inside) if state == SLEEP]
    movement, fragmentation, total = _indices(states, activity, epoch_min, convention, first, stop)
    missing = np.nan
    return Night(
        first=first,
        stop=stop,
        epochs=n,
        unknown=unknown * epoch_min,
        tib=n * epoch_min,
        tst=tst * epoch_min,
        tst_low=tst * epoch_min,
        tst_high=(tst + gained) * epoch_min,
        se=100 * tst / n if n else missing,
        se_low=100 * tst / n if n else missing,
        se_high=100 * (tst + gained) / n if n else missing,
        sol=sol * epoch_min if slept else missing,
        sol_low=(min(early, first) if convention != "Actiware" else first) * epoch_min if slept else missing,
        sol_high=first * epoch_min if slept else missing,
        waso=waso * epoch_min if slept else missing,
        waso_low=waso * epoch_min if slept else missing,
        waso_high=max(most, waso + lost) * epoch_min if slept else missing,
        awakenings=len(wakes),
        mean_awakening=sum(wakes) * epoch_min / len(wakes) if wakes else 0.0,
        longest_bout=max(bouts, default=0) * epoch_min,
        movement=movement,
        fragmentation=fragmentation,
        total_fragmentation=total,
        counts=float(np.nansum(activity)),
    )


def _sleep_interval(states: States, activity: Samples, epoch_min: float, convention: Convention) -> tuple[int, int]:
    """Where sleep begins, and where it ends (AASM, ActiLife: with the time in bed)."""
    n = len(states)
    if convention != "Actiware":
        asleep = np.flatnonzero(states == SLEEP)
        return (int(asleep[0]) if len(asleep) else n), n
    long = round(IMMOBILE_MIN / epoch_min)
    if n < long:
        return n, n
    mobile = np.cumsum(np.r_[0, ~(activity <= 0)])
    still = np.flatnonzero(mobile[long:] - mobile[:-long] <= 1)
    return (int(still[0]), int(still[-1]) + long - 1) if len(still) else (n, n)


def _indices(
    states: States, activity: Samples, epoch_min: float, convention: Convention, first: int, stop: int
) -> tuple[float, float, float]:
    """Movement index, fragmentation index and their total in %; NaN where nothing was seen to speak of."""
    if convention == "ActiLife":
        moving = _share(activity > 0, ~np.isnan(activity))
        fragmentation = _short(states == SLEEP, epoch_min)
        return moving, fragmentation, moving + fragmentation
    if convention == "AASM":
        asleep = np.flatnonzero(states == SLEEP)
        stop = int(asleep[-1]) + 1 if len(asleep) else stop
    part = activity[first:stop]
    moving = _share(part > 0, ~np.isnan(part))
    fragmentation = moving + _short(part == 0, epoch_min)
    return moving, fragmentation, fragmentation


def _share(which: NDArray[np.bool_], among: NDArray[np.bool_]) -> float:
    return 100 * float(which.sum()) / float(among.sum()) if among.any() else np.nan


def _short(which: NDArray[np.bool_], epoch_min: float) -> float:
    """Stretches of at most one minute among all stretches, in %."""
    lengths = [b - a for state, a, b in runs(which.astype(np.int8)) if state]
    return 100 * sum(length * epoch_min <= 1.0 for length in lengths) / len(lengths) if lengths else 0.0
