"""What the inputs of a night's log say, as it is written: which fields they need, and the cells of a row."""

from __future__ import annotations

from typing import Any

import numpy as np

from kinegraph.devices.reports.night.archive import iso
from kinegraph.stream.chunk import Specs
from kinegraph.stream.errors import InputError

FIELDS = {
    "epochs": ("onset", "end", "state", "score", "activity", "final", "rescored"),
    "nights": ("onset", "end", "tib", "tst", "convention", "estimated"),
    "bed": ("onset", "sleeper", "state"),
    "seen": ("onset", "sleeper", "moved_s", "seen", "bed"),
    "breathing": ("onset", "sleeper", "rate", "confidence"),
    "lights": ("on",),
    "map": ("map",),
    "view": ("onset", "what", "down", "right"),
}


def check(specs: Specs) -> None:
    """Raises InputError where an input is not what the log needs."""
    for port, needed in FIELDS.items():
        if port in specs and not set(needed) <= set(specs[port].dtype.names or ()):
            raise InputError(port, specs[port].describe(), f"events with the fields {', '.join(needed)}")
    if not float(specs["epochs"].meta.get("epoch_s", 0.0)) > 0:
        raise InputError("epochs", "without epoch_s in its meta", "scored epochs of a known length")
    length = float(specs["epochs"].meta["epoch_s"])
    for port in ("seen", "breathing"):
        if port in specs and (other := float(specs[port].meta.get("epoch_s", length))) != length:
            raise InputError(port, f"epochs of {other:g} s", f"epochs of {length:g} s, as the scored ones are")
    if "wave" in specs and (specs["wave"].is_event or not specs["wave"].rate_hz or not specs["wave"].channels):
        raise InputError("wave", specs["wave"].describe(), "the output wave of operators.bed.breathing.Breathing")
    if "map" in specs and len(specs["map"].dtype["map"].shape) != 2:
        raise InputError("map", specs["map"].describe(), "events with a table (rows, columns) in the field `map`")


def final(row: Any) -> dict[str, Any]:
    """What a final epoch says."""
    facts = {
        "onset": iso(int(row["onset"])), "end": iso(int(row["end"])), "state": str(row["state"]), "rescored": int(row["rescored"]),
        "score": number(row["score"]), "activity": number(row["activity"]),
    }  # fmt: skip
    return facts | reason(row) if "cause" in row.dtype.names else facts


def reason(row: Any) -> dict[str, Any]:
    """Why a final epoch has its state."""
    mover = int(row["mover"])
    moved = {"mover": iso(mover), "weight": number(row["weight"]), "adds": number(row["adds"])} if mover else {}
    return {"cause": str(row["cause"]), "rule": str(row["rule"]), **moved}


def withdrawn(facts: dict[str, Any]) -> bool:
    """Whether an epoch was seen and judged, and its movement then withdrawn: a second body was noticed in the epoch after it."""
    return facts.get("why") == "" and facts.get("moved_s", "") != "" and facts["activity"] == ""


def seen(row: Any) -> dict[str, Any]:
    crosstalk = row["crosstalk"] if "crosstalk" in row.dtype.names else np.nan
    facts = {"moved_s": row["moved_s"], "seen": row["seen"], "crosstalk": crosstalk}
    why = str(row["why"]) if "why" in row.dtype.names else ""
    return {"bed": str(row["bed"]), "why": why, **{name: number(value) for name, value in facts.items()}}


def breathing(row: Any) -> dict[str, Any]:
    more = {
        "rate_error": "error",
        "lift_mm": "amplitude",
        "regularity": "regularity",
        "pauses": "pauses",
        "paused_s": "paused_s",
    }
    known = {name: number(row[field]) for name, field in more.items() if field in row.dtype.names}
    return {"breaths_per_min": number(row["rate"]), "confidence": number(row["confidence"]), **known}


def risen(value: Any) -> str:
    """How far the chest has risen, in hundredths of a mm."""
    return str(round(100 * float(value))) if np.isfinite(value) else "x"


def number(value: Any) -> str:
    return f"{float(value):.4g}" if np.isfinite(value) else ""
