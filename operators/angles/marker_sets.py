"""Places on the body that angles are computed from, and what laboratories call the markers there."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from kinegraph.stream.errors import ParameterError, nearest

TRUNK = ("LASI", "RASI", "LPSI", "RPSI", "SACR", "C7", "T10", "CLAV", "STRN")
SIDED = ("HIP", "THI", "KNE", "KNM", "TIB", "ANK", "ANM", "HEE", "TOE", "SHO", "ELB", "ELM", "WRA", "WRB")
PLACES = (*TRUNK, *(f"L{name}" for name in SIDED), *(f"R{name}" for name in SIDED))
"""Plug-in-Gait's names, and HIP (the joint itself), KNM, ANM and ELM (the inner side of knee, ankle and elbow) beside these."""
PLACE = {name: k for k, name in enumerate(PLACES)}

ALIASES: dict[str, tuple[str, ...]] = {
    "ASI": ("asis", "ias", "iliacanterior"),
    "PSI": ("psis", "ips"),
    "SACR": ("sacral", "vsacral", "vsac", "sacrum"),
    "C7": ("cv7",),
    "T10": ("tv10", "t8", "tv8"),
    "CLAV": ("ij", "sjn", "sternalnotch"),
    "STRN": ("px", "xiphoid", "sxs", "sternum"),
    "HIP": ("hjc", "hip", "hipjoint"),
    "THI": ("thigh", "thighupper", "thighlateral"),
    "KNE": ("knee", "kneelat", "kneelateral", "lfc", "fle", "lfe", "lepi"),
    "KNM": ("mkne", "mknee", "kneemed", "kneemedial", "mfc", "fme", "mfe", "mepi"),
    "TIB": ("shank", "shankupper", "shanklateral"),
    "ANK": ("ankle", "anklelat", "anklelateral", "lmal", "fal", "lm"),
    "ANM": ("med", "mank", "mankle", "anklemed", "anklemedial", "mmal", "tam", "mm"),
    "HEE": ("heel", "cal", "calc", "fcc"),
    "TOE": ("toe", "toetip", "toelat", "mt2", "fm2", "mtp"),
    "SHO": ("sh", "shoulder", "acromium", "acromion", "acr", "cac"),
    "ELB": ("elbow", "elbowlat", "elblat", "hle", "lhe"),
    "ELM": ("elbowmed", "elbmed", "hme", "mhe"),
    "WRA": ("wri", "wr", "wrist", "wrista", "wristlat", "wristrad", "rsp"),
    "WRB": ("wristb", "wristmed", "wristuln", "usp"),
}
"""Other names of the same places, without side, signs and capitals."""


def find_places(markers: Sequence[str], given: Mapping[str, str] | None = None) -> dict[str, str]:
    """Which marker lies at which of PLACES, by name; `given` says it where names do not. Raises ParameterError.

    >>> find_places(["R.ASIS", "L.ASIS", "V.Sacral", "R.Knee.Lat"])
    {'LASI': 'L.ASIS', 'RASI': 'R.ASIS', 'SACR': 'V.Sacral', 'RKNE': 'R.Knee.Lat'}
    """
    given = dict(given or {})
    for place, marker in given.items():
        if place not in PLACE:
            raise ParameterError("markers", place, f"a place on the body: {nearest(place, PLACES)}")
        if marker not in markers:
            raise ParameterError("markers", marker, f"a marker of the input; {nearest(marker, markers)}")
    plain = {re.sub(r"[^a-z0-9]|study", "", name.rpartition(":")[2].lower()): name for name in reversed(markers)}
    found = {}
    for place in PLACES:
        if place in given:
            found[place] = given[place]
            continue
        for name in _spellings(place):
            if name in plain:
                found[place] = plain[name]
                break
    return found


def _spellings(place: str) -> list[str]:
    """How a place may be spelt, the likeliest first."""
    if place in ("SACR", "C7", "T10", "CLAV", "STRN"):
        return [place.lower(), *ALIASES[place]]
    side, name = place[0].lower(), place[1:]
    word = {"l": "left", "r": "right"}[side]
    return [
        spelt
        for alias in (name.lower(), *ALIASES[name])
        for spelt in (side + alias, word + alias, alias + side, alias + word)
    ]
