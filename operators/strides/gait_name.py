"""What a gait is called, by when in the stride each foot comes down and for how long it stands (Hildebrand, Science 150, 1965)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinegraph.stream.chunk import Samples

UNKNOWN = ("unknown", 0.0)
FOUR = ("left hind", "right hind", "left fore", "right fore")
SURE_PCT = 2.0
"""Nearer than this to a limit, a gait is not named."""
LATERAL = 25.0


def gait_name(
    limbs: Sequence[str], phase: Samples, duty: Samples, flight_pct: float, tolerance: float
) -> tuple[str, float]:
    """The gait of one stride and how far, in % of it, the nearest limit is; "unknown" where no name fits for sure.

    phase, duty  (l,) in % of the stride, of the limbs in their order
    """
    if not np.isfinite(phase).all():
        return UNKNOWN
    if set(limbs) == {"left", "right"}:
        return _two(phase, duty, flight_pct, tolerance)
    if set(limbs) == set(FOUR):
        order = [list(limbs).index(limb) for limb in FOUR]
        return _four(phase[order], duty[order], tolerance)
    return UNKNOWN


def _two(phase: Samples, duty: Samples, flight_pct: float, tolerance: float) -> tuple[str, float]:
    sure = 2 * tolerance - abs(_apart(phase[0], phase[1]) - 50)
    if sure < SURE_PCT:
        return UNKNOWN
    off = float(duty.mean()) - 50
    if abs(off) < SURE_PCT or (off > 0) == (flight_pct > SURE_PCT):
        return UNKNOWN
    return ("walk" if off > 0 else "run"), float(min(sure, abs(off)))


def _four(phase: Samples, duty: Samples, tolerance: float) -> tuple[str, float]:
    hind, fore = _apart(phase[0], phase[1]), _apart(phase[2], phase[3])
    off, stands = max(50 - hind, 50 - fore), float(duty.mean()) - 50
    if off > tolerance + SURE_PCT:
        apart = LATERAL + tolerance - max(hind, fore)
        sure = min(apart, -stands, off - tolerance)
        return ("gallop", float(sure)) if sure >= SURE_PCT else UNKNOWN
    if off > tolerance - SURE_PCT:
        return UNKNOWN
    lag = float(_circular_mean(np.array([phase[2] - phase[0], phase[3] - phase[1]])))
    for name, centre in (("pace", 0.0), ("walk", 25.0), ("trot", 50.0), ("walk", 75.0)):
        near = tolerance - _apart(lag, centre)
        if near >= 0:
            sure = min(near, tolerance - off, stands if name == "walk" else np.inf)
            return (name, float(sure)) if sure >= SURE_PCT else UNKNOWN
    return UNKNOWN


def _apart(a: float, b: float) -> float:
    """How far two places of a circle of 100 lie apart: 0..50."""
    off = abs(float(a) - float(b)) % 100
    return min(off, 100 - off)


def _circular_mean(values: Samples) -> float:
    angle = 2 * np.pi * values / 100
    return float(np.arctan2(np.sin(angle).sum(), np.cos(angle).sum()) * 100 / (2 * np.pi) % 100)
