"""The events that tell what many cycles have in common: per muscle, per pair of muscles, and of the session."""

from __future__ import annotations

import numpy as np

from kinegraph.operators.cycles.cycle import REASONS
from kinegraph.stream.chunk import Array

WHEN = [("onset", "<i8"), ("end", "<i8"), ("number", "<i8")]
MUSCLE = np.dtype(
    [
        *WHEN,
        ("muscle", "<i4"),
        ("name", "<U16"),
        ("cycles", "<i8"),
        ("left_out", "<i8"),
        ("peak", "<f8"),
        ("peak_pct", "<f8"),
        ("cv_pct", "<f8"),
        ("variance_ratio", "<f8"),
        ("verdict", "<U16"),
        ("deviation", "<f8"),
        ("mad", "<f8"),
    ]
)
PAIR = np.dtype(
    [
        *WHEN,
        ("first", "<U16"),
        ("second", "<U16"),
        ("co_contraction_pct", "<f8"),
        ("mean_pct", "<f8"),
        ("cycles", "<i8"),
    ]
)
SESSION = np.dtype(
    [
        *WHEN,
        ("cadence", "<f8"),
        ("stance_pct", "<f8"),
        ("accepted", "<i8"),
        ("rejected", "<i8"),
        *((reason.replace(" ", "_"), "<i8") for reason in REASONS),
    ]
)


def rows_of(kind: np.dtype[np.void], closed: Array, count: int) -> Array:
    """`count` events about the cycle `closed` (1,)."""
    rows = np.zeros(count, kind)
    for name, _ in WHEN:
        rows[name] = closed[name][0]
    return rows
