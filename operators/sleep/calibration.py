"""A named calibration: what turns another sensor's motion into wrist counts of a device, so that a scorer of counts may be used on it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

from kinegraph.stream.data.json_file import read_json
from kinegraph.stream.errors import KinegraphError


@dataclass(frozen=True, slots=True)
class Calibration:
    """Counts per epoch = gain x (motion - offset), at least 0.

    name     what it is called in every result that was made with it
    unit     of the motion that it is for
    device   that it imitates: ami, actigraph or actiwatch
    epoch_s  at which epoch length it holds
    source   who made it, from what
    """

    name: str
    unit: str
    device: str
    epoch_s: float
    gain: float
    source: str
    offset: float = 0.0

    @classmethod
    def read(cls, path: Path) -> Calibration:
        """A JSON file with these fields. Raises KinegraphError, which says what is wrong with it."""
        found = read_json(path, "a calibration")
        known = [f.name for f in fields(cls)]
        if not set(found) <= set(known) or not {*known} - {"offset"} <= set(found):
            raise KinegraphError(f"{path}: a calibration has the fields {', '.join(known)} (offset may be left out)")
        for name in known:
            given = found.get(name, 0.0)
            number = name in ("epoch_s", "gain", "offset")
            if number and (isinstance(given, bool) or not isinstance(given, int | float) or given != given):
                raise KinegraphError(f"{path}: {name} is {given!r}; it must be a number")
            if not number and (not isinstance(given, str) or not given):
                raise KinegraphError(f"{path}: {name} is {given!r}; it must be a text, and not empty")
        if not (found["gain"] > 0 and found["epoch_s"] > 0):
            raise KinegraphError(f"{path}: gain and epoch_s must be above 0")
        return cls(**{**found, "gain": float(found["gain"]), "epoch_s": float(found["epoch_s"])})
