"""When a walking person's muscles work, as textbooks have it: a coarse measure for the other leg's contacts and another muscle's leads."""

from __future__ import annotations

import re

import numpy as np

from operators.gait.cycle import POINTS
from stream.chunk import Array, Samples

WORKS_PCT: dict[str, tuple[int, int]] = {
    "TA": (56, 112), "SO": (7, 52), "GM": (9, 50), "GL": (9, 50), "VM": (90, 116), "VL": (90, 116), "RF": (90, 112),
    "BF": (82, 110), "ST": (82, 110), "MA": (94, 124), "ME": (94, 130),
}  # fmt: skip
"""From where to where a muscle works, in % of the cycle from its own leg's touch-down; beyond 100 it goes on at the cycle's beginning.
The main activity in level walking at a usual speed (Perry and Burnfield, "Gait Analysis"), rounded; what differs between books and persons
is left out (peroneus, tensor fasciae latae)."""

OTHER_NAMES = {
    "SOL": "SO", "MG": "GM", "LG": "GL", "GASM": "GM", "GASL": "GL", "SM": "ST", "TIBIALIS ANTERIOR": "TA", "SOLEUS": "SO",
    "GASTROCNEMIUS MEDIALIS": "GM", "GASTROCNEMIUS LATERALIS": "GL", "VASTUS MEDIALIS": "VM", "VASTUS LATERALIS": "VL",
    "RECTUS FEMORIS": "RF", "BICEPS FEMORIS": "BF", "SEMITENDINOSUS": "ST", "GLUTEUS MAXIMUS": "MA", "GLUTEUS MEDIUS": "ME",
}  # fmt: skip
SIDE = re.compile(r"^(?:LEFT|RIGHT|LT|RT|L|R)[ _.\-]?|[ _.\-](?:LEFT|RIGHT|LT|RT|L|R)$")
SOFT = 10
"""The edges of a pattern are this wide, in % of the cycle."""


def muscle_called(channel: str) -> str:
    """The textbook's muscle that a channel is named after, with or without its side; "" where it is none of them."""
    name = channel.upper().strip()
    for tried in (name, SIDE.sub("", name, count=1)):
        if (known := OTHER_NAMES.get(tried, tried)) in WORKS_PCT:
            return known
    return ""


def side_called(channel: str) -> str:
    """The side that a channel's name states, left or right; "" where it states none."""
    name = channel.upper().strip()
    found = None if OTHER_NAMES.get(name, name) in WORKS_PCT else SIDE.search(name)
    return "" if found is None else "left" if "L" in found[0].strip(" _.-")[:1] else "right"


def textbook_pattern(muscle: str) -> Samples:
    """(100,) between 0 and 1: when this muscle works, with soft edges; zeros for none."""
    pattern = np.zeros(POINTS)
    if muscle in WORKS_PCT:
        pattern[np.arange(*WORKS_PCT[muscle]) % POINTS] = 1.0
    return np.asarray(np.mean([np.roll(pattern, k - SOFT // 2) for k in range(SOFT)], axis=0))


def likeness(curves: Samples, patterns: Samples) -> Array:
    """The correlation of each curve (100, m) with each pattern (100, k): (m, k); 0 where one does not vary."""
    a, b = curves - curves.mean(axis=0), patterns - patterns.mean(axis=0)
    size = np.sqrt((a**2).sum(axis=0))[:, None] * np.sqrt((b**2).sum(axis=0))
    products = np.array([[(a[:, i] * b[:, k]).sum() for k in range(b.shape[1])] for i in range(a.shape[1])])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(size > 0, products / size, 0.0))
