"""Facts in a C3D file beside its streams: the program, the person's measures, and doubts. Names are left out."""

from __future__ import annotations

from math import isfinite
from pathlib import Path

from kinegraph.devices.formats.c3d.data import C3dFrames
from kinegraph.devices.formats.c3d.parameters import Parameters
from kinegraph.devices.formats.findings import Findings

MEASURES = {
    "bodymass": "mass_kg",
    "weight": "mass_kg",
    "mass": "mass_kg",
    "height": "height_mm",
    "leftleglength": "left_leg_mm",
    "rightleglength": "right_leg_mm",
    "llleglength": "left_leg_mm",
    "rlleglength": "right_leg_mm",
    "lleglength": "left_leg_mm",
    "rleglength": "right_leg_mm",
}
"""Parameters of the group PROCESSING, in small letters, and what we call them."""


def note(path: Path, parameters: Parameters, frames: C3dFrames, findings: Findings) -> None:
    """Add the file's kind, facts and doubts."""

    def doubt(words: str) -> None:
        findings.doubts.append(f"{path.name}: {words}")

    lines = [next(iter(parameters.texts("MANUFACTURER", name)), "") for name in ("SOFTWARE", "COMPANY")]
    program = next(filter(None, lines), "")
    findings.kinds[path] = f"C3D{f' ({program})' if program else ''}"
    if program:
        findings.facts.setdefault("software", program)
    for name in parameters.groups.get("PROCESSING", {}):
        key, number = MEASURES.get(name.lower().replace("_", "")), parameters.number("PROCESSING", name)
        if key and isfinite(number) and number > 0:
            findings.facts.setdefault(key, number)
    if frames.first > 0:
        doubt(f"its first frame is number {frames.first + 1}: time counts from frame 1, as that of its events does")
    if frames.doubt:
        doubt(frames.doubt)
    if (factors := len(parameters.numbers("ANALOG", "SCALE"))) < frames.channels:
        doubt(f"{frames.channels} analogue channels, but factors of {factors}: 1 is taken for the others")
    kinds = set(parameters.texts("ANALOG", "UNITS")) - {""}
    if len(kinds) > 1:
        doubt(f"analogue channels in {', '.join(sorted(kinds))}: choose those of one kind with operators.Select")
    labels = parameters.texts("POINT", "LABELS")
    if len(set(labels)) < len(labels):
        doubt(f"{len(labels) - len(set(labels))} markers have a name that stands there already; they are numbered")
