"""What a C3D file tells beside its streams: the program, the person's measures, and what is doubtful. Nobody's name is taken."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from devices.files.findings import Findings

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


def note(path: Path, parameters: Any, header: Mapping[str, Any], findings: Findings) -> None:
    """Add the file's kind, facts and doubts."""

    def doubt(words: str) -> None:
        findings.doubts.append(f"{path.name}: {words}")

    maker = parameters.get("MANUFACTURER", {})
    told = [_text(maker, name) for name in ("SOFTWARE", "Software", "COMPANY", "Company")]
    program = next(filter(None, told), "")
    findings.kinds[path] = f"C3D{f' ({program})' if program else ''}"
    if program:
        findings.facts.setdefault("software", program)
    for name, value in parameters.get("PROCESSING", {}).items():
        key = MEASURES.get(name.lower().replace("_", ""))
        number = _number(value) if key else None
        if key and number:
            findings.facts.setdefault(key, number)
    first = int(header["points"]["first_frame"])
    if first > 0:
        doubt(f"its first frame is number {first + 1}: time counts from frame 1, as that of its events does")
    units = parameters.get("ANALOG", {}).get("UNITS", {}).get("value", [])
    kinds = {str(unit).strip() for unit in units} - {""}
    if len(kinds) > 1:
        doubt(f"analogue channels in {', '.join(sorted(kinds))}: choose those of one kind with operators.Select")
    labels = [str(label).strip() for label in parameters.get("POINT", {}).get("LABELS", {}).get("value", [])]
    if len(set(labels)) < len(labels):
        doubt(f"{len(labels) - len(set(labels))} markers have a name that stands there already; they are numbered")


def _text(group: Any, name: str) -> str:
    value = group.get(name, {}).get("value", []) if name in group else []
    return str(value[0]).strip() if len(value) else ""


def _number(parameter: Any) -> float | None:
    try:
        number = float(parameter["value"][0])
    except (TypeError, ValueError, KeyError, IndexError):
        return None
    return number if isfinite(number) and number > 0 else None
