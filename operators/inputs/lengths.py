"""Positions of markers come in metres, centimetres or millimetres; operators work in one of them."""

from __future__ import annotations

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.data.require import numeric
from kinegraph.stream.errors import InputError

CM = {"m": 100.0, "cm": 1.0, "mm": 0.1, "": 1.0}
"""How long a unit is in cm; positions without a unit are taken to be cm by what scales bodies, else as they are."""


def length_of(spec: StreamSpec, port: str = "in") -> str:
    """The one unit of a stream of positions; "" if it has no unit. Raises InputError."""
    numeric(spec, port)
    unit = spec.units[0] if len(set(spec.units)) == 1 else "?"
    if unit not in CM:
        raise InputError(port, spec.describe(), "markers in m, cm or mm")
    return unit


def metres(unit: str) -> float:
    """The factor from this unit to metres; 1 without a unit."""
    return CM[unit or "m"] / 100.0
