"""When a walking person's muscles work, as textbooks have it: a coarse measure for the other leg's contacts and another muscle's leads."""

from __future__ import annotations

import re

import numpy as np

from kinegraph.operators.cycles.cycle import POINTS
from kinegraph.stream.chunk import Array, Samples

WORKS_PCT: dict[str, tuple[int, int]] = {
    "TA": (56, 112), "SO": (7, 52), "GM": (9, 50), "GL": (9, 50), "VM": (90, 116), "VL": (90, 116), "RF": (90, 112),
    "BF": (82, 110), "ST": (82, 110), "MA": (94, 124), "ME": (94, 130),
}  # fmt: skip
"""From where to where a muscle works, in % of the cycle from its own leg's touch-down; beyond 100 it goes on at the cycle's beginning.
The main activity in level walking at a usual speed (Perry and Burnfield, "Gait Analysis"), rounded; what differs between books and persons
is left out (peroneus, tensor fasciae latae)."""

OTHER_NAMES = {
    "TA": "TIB(IALIS)?A(NT(ERIOR)?)?|ANT(ERIOR)?TIB(IALIS)?",
    "SO": "SOL(EUS)?",
    "GM": "MG|GASM|GAS(T(RO?C?)?(NEMIUS)?)?MED(IAL(IS)?)?|MED(IAL(IS)?)?GAS(T(RO?C?)?(NEMIUS)?)?",
    "GL": "LG|GASL|GAS(T(RO?C?)?(NEMIUS)?)?LAT(ERAL(IS)?)?|LAT(ERAL(IS)?)?GAS(T(RO?C?)?(NEMIUS)?)?",
    "VM": "VMO|VAS(T(US)?)?MED(IAL(IS)?)?(OBLIQ(UUS)?)?",
    "VL": "VAS(T(US)?)?LAT(ERAL(IS)?)?",
    "RF": "REC(T(US)?)?FEM(ORIS)?",
    "BF": "BFLH|BIC(EPS)?FEM(ORIS)?(LONGHEAD|CAPUTLONGUM|LH)?|LAT(ERAL)?HAM(STRINGS?|S)?",
    "ST": "SM|SEMI?T(END(INOSUS)?)?|SEMI?M(EM(BRANOSUS)?)?|MED(IAL)?HAM(STRINGS?|S)?",
    "MA": "GMAX|GLUT(EUS)?MAX(IMUS)?",
    "ME": "GMED|GLUT(EUS)?MED(IUS)?",
}
"""What else laboratories call them, as expressions that fit the name's letters without blanks and points. "GM" is the gastrocnemius."""
SENSOR = re.compile(r"[:,(\[].*$|\bEMG\b.*$|\d+$")
"""What follows the muscle in a recorder's names: "TIBIALIS ANTERIOR: EMG 1 [V]"."""
_SIDES = "LEFT|RIGHT|LT|RT|L|R"
SIDES = [re.compile(f"^({_SIDES})[ _.\\-]+"), re.compile(f"[ _.\\-]+({_SIDES})$"), re.compile(f"^({_SIDES})")]
"""Where a name states the side: before or behind the muscle, or right before it."""
SOFT = 10
"""The edges of a pattern are this wide, in % of the cycle."""


def muscle_called(channel: str) -> str:
    """The textbook's muscle that a channel is named after, with or without its side; "" for other channels."""
    return _parts(channel)[0]


def side_called(channel: str) -> str:
    """The side that a channel's name states, left or right; "" without one."""
    side = _parts(channel)[1]
    return {"L": "left", "R": "right", "": ""}[side[:1]]


def _parts(channel: str) -> tuple[str, str]:
    """Muscle and side of a name, each "" where it is not known."""
    name = _bare(channel)
    if muscle := _known(name):
        return muscle, ""
    stated = [(found[1], _known(side.sub("", name))) for side in SIDES if (found := side.search(name))]
    known = next(((muscle, side) for side, muscle in stated if muscle), None)
    apart = next((found[1] for side in SIDES[:2] if (found := side.search(name))), "")
    return known or ("", apart)


def _bare(channel: str) -> str:
    return SENSOR.sub("", channel.upper()).strip(" _.-")


def _known(name: str) -> str:
    letters = re.sub("[^A-Z]", "", name)
    if letters in WORKS_PCT:
        return letters
    return next((muscle for muscle, names in OTHER_NAMES.items() if re.fullmatch(names, letters)), "")


def textbook_pattern(muscle: str) -> Samples:
    """(100,) between 0 and 1: when this muscle works, with soft edges; zeros for an unknown one."""
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
