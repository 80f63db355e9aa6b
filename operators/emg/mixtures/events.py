"""The events that tell what is known of a muscle's activation peaks: its mixture, and each mode of it."""

from __future__ import annotations

import numpy as np

MOST_MODES = 16
WHEN = [("onset", "<i8"), ("end", "<i8"), ("number", "<i8"), ("muscle", "<i4"), ("name", "<U16")]

MIXTURE = np.dtype(
    [
        *WHEN,
        ("cycles", "<i4"),
        ("peaks", "<i4"),
        ("modes", "<i4"),
        ("likelihood", "<f8"),
        ("apart_pct", "<f8"),
        ("sweeps", "<i4"),
        ("settled", "<i4"),
        ("unknown", "<U16"),
        ("weight", "<f8", (MOST_MODES,)),
        ("mean", "<f8", (MOST_MODES, 2)),
        ("covariance", "<f8", (MOST_MODES, 3)),
    ]
)
"""One muscle's mixture after a cycle: from how many cycles and peaks; `likelihood` is the mean log-likelihood of a peak; `apart_pct` the
circular distance of the two highest modes (thesis eq. 6.7), NaN below two; `settled` 0: EM was still gaining when it was stopped.
`unknown` gives the reason where `modes` is 0. Modes beyond `modes` are NaN; means are (%, height), covariances (place, both,
height)."""
MIXTURE_UNITS = ("ns", "ns", "", "", "", "", "", "", "", "%", "", "", "", "", "", "")

MODE = np.dtype(
    [
        *WHEN,
        ("mode", "<i4"),
        ("modes", "<i4"),
        ("weight", "<f8"),
        ("place_pct", "<f8"),
        ("height", "<f8"),
        ("sd_pct", "<f8"),
        ("sd_height", "<f8"),
        ("correlation", "<f8"),
    ]
)
"""One mode, the highest first: the share of peaks in it, where on the cycle and how high its mean is, and how far its peaks spread."""


def mode_units(height: str) -> tuple[str, ...]:
    return ("ns", "ns", "", "", "", "", "", "", "%", height, "%", height, "")
