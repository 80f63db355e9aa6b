"""Every burst of each muscle in numbers, not only that with the peak."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinegraph.devices.reports.session.contents.cycle_store import CycleStore, circular
from kinegraph.devices.reports.session.contents.data import Grid
from kinegraph.stream.chunk import Array, Samples

VALUES = ("on_pct", "duration_pct", "peak")
ON, DURATION, PEAK = range(2, 5)
SELDOM = 0.1
"""A burst in a smaller share of the cycles has no row of its own."""
NOTE = (
    "Every burst of a muscle, by its place in the cycle: in which share of the cycles there is one, and mean ± standard deviation of its"
    " onset, offset (both around the circle), duration and peak. Places active in fewer than one cycle of ten are left out."
)


def grid(store: CycleStore, channels: Sequence[str], unit: str) -> Grid:
    columns = [
        ("Muscle", ""), ("Cycles", "%"), ("Onset", "% of cycle"), ("Offset", "% of cycle"), ("Duration", "% of cycle"), ("Peak", unit),
    ]  # fmt: skip
    rows = []
    for i, name in enumerate(channels):
        found = store.of(i)
        cycles = len(np.unique(found[:, 0]))
        for burst in bursts(found):
            share = 100 * len(np.unique(burst[:, 0])) / cycles
            ends = circular(burst[:, ON]), circular((burst[:, ON] + burst[:, DURATION]) % 100)
            plain = [(float(burst[:, k].mean()), float(burst[:, k].std(ddof=1))) for k in (DURATION, PEAK)]
            cells = [f"{mean:z.0f} ± {sd:z.0f}" for mean, sd in (*ends, plain[0])]
            rows.append([name, f"{share:.0f}", *cells, f"{plain[1][0]:.3g} ± {plain[1][1]:.2g}"])
    return Grid("Every burst", NOTE, columns, rows)


def bursts(rows: Array) -> list[Array]:
    """A muscle's bursts (n, 5), those at one place of the cycle together: places that are active in a tenth of the cycles or more."""
    share = np.zeros(100)
    for row in rows:
        share[(int(row[ON]) + np.arange(int(row[DURATION]))) % 100] += 1
    share /= max(len(np.unique(rows[:, 0])), 1)
    place = _stretches(share)
    middle = ((rows[:, ON] + rows[:, DURATION] / 2) % 100).astype(np.int64)
    groups = [rows[place[middle] == k] for k in range(int(place.max(initial=-1)) + 1)]
    return [group for group in groups if len(group) > 1]


def _stretches(share: Samples) -> Array:
    """The number of the active stretch that each place (100,) lies in, around the circle, or -1; a stretch with a deep valley is two.

    A valley is deep where the share falls below half of the lower of its two hills.
    """
    n = len(share)
    active = share >= SELDOM
    place = np.full(n, -1)
    if not active.any():
        return place
    start = int(share.argmin())
    order = (np.arange(n) + start) % n
    count, top, low = -1, 0.0, 0.0
    lowest = 0
    for k, p in enumerate(order):
        if not active[p]:
            top = 0.0
            continue
        if top == 0.0:
            count, top, low, lowest = count + 1, share[p], share[p], k
        elif share[p] < low:
            low, lowest = share[p], k
        elif low < 0.5 * min(top, share[p]):
            count += 1
            place[order[lowest:k]] = count
            top, low = share[p], share[p]
        elif share[p] > top:
            top, low, lowest = share[p], share[p], k
        place[p] = count
    return place
