"""A laboratory's normative bands, from a table of its own."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from kinegraph.operators.cycles.cycle import POINTS
from kinegraph.stream.chunk import Samples
from kinegraph.stream.data.csv_rows import csv_rows
from kinegraph.stream.errors import KinegraphError

NAMED = re.compile(r"(?P<name>[^\[(]*?)\s*(?:[\[(](?P<unit>[^\])]*)[\])])?\s*")
ACCEPTED = "the columns muscle, cycle_pct, and low [unit] and high [unit], or mean [unit] and sd [unit]"


class NormError(KinegraphError):
    """Bands that cannot be read."""


def read_bands(path: Path, sds: float) -> tuple[str, dict[str, Samples]]:
    """The unit, and per muscle its band (2, 100): low and high at 0, 1, ... 99 % of the cycle.

    Between the table's points it is interpolated, linearly and across the touch-down. Of mean and sd the band is mean -+ `sds` sd; so the
    curves that a session report wrote (NAME-curves.csv, of one stage) are such a table. Raises NormError with file and line.
    """
    rows = csv_rows(path, "normative bands")
    if not rows:
        raise NormError(f"{path}: is empty; it needs {ACCEPTED}")
    start, heads = rows[0]
    names, units = zip(*(_named(head) for head in heads), strict=True)
    pair = next((two for two in (("low", "high"), ("mean", "sd")) if set(two) <= set(names)), None)
    if pair is None or not {"muscle", "cycle_pct"} <= set(names):
        raise NormError(
            f"{path}: line {start}: has {', '.join(filter(None, names)) or 'no columns'}; it needs {ACCEPTED}"
        )
    columns = [names.index(name) for name in ("cycle_pct", *pair)]
    found = {units[i] for i in columns[1:]}
    if len(found) > 1:
        raise NormError(
            f"{path}: line {start}: {' and '.join(pair)} have the units {', '.join(sorted(found))}; one is needed"
        )
    points: dict[str, dict[float, tuple[float, float]]] = {}
    for number, row in rows[1:]:
        if any(cell.strip() for cell in row):
            _take(points, row, (names.index("muscle"), *columns), f"{path}: line {number}")
    bands = {muscle: _band(known, sds if pair == ("mean", "sd") else 0.0) for muscle, known in points.items()}
    if not bands:
        raise NormError(f"{path}: there are no muscles in it")
    wrong = next((muscle for muscle, (low, high) in bands.items() if not (low <= high).all()), "")
    if wrong:
        raise NormError(f"{path}: the band of {wrong} has a low above its high")
    return found.pop(), bands


def _named(head: str) -> tuple[str, str]:
    found = NAMED.fullmatch(head.strip())
    return (found["name"].lower(), found["unit"] or "") if found else (head.strip().lower(), "")


def _take(
    points: dict[str, dict[float, tuple[float, float]]], row: list[str], columns: tuple[int, ...], where: str
) -> None:
    try:
        muscle = row[columns[0]].strip()
        at, one, two = (float(row[i]) for i in columns[1:])
    except (IndexError, ValueError):
        raise NormError(f"{where}: {','.join(row)!r} is not a muscle with three numbers") from None
    if not (muscle and 0 <= at <= 100 and np.isfinite([one, two]).all()):
        raise NormError(f"{where}: needs a muscle, 0 to 100 % of the cycle, and finite numbers")
    if at in points.setdefault(muscle, {}):
        raise NormError(f"{where}: {muscle} at {at:g} % stands twice; leave the rows of one stage and one limb")
    points[muscle][at] = one, two


def _band(known: dict[float, tuple[float, float]], sds: float) -> Samples:
    """One muscle's band (2, 100); with `sds`, of mean and standard deviation."""
    at = np.array(sorted(known))
    one, two = np.array([known[a] for a in at.tolist()]).T
    ends = (one - sds * two, one + sds * two) if sds else (one, two)
    points = np.arange(POINTS) * (100 / POINTS)
    return np.array([np.interp(points, at, end, period=None if at[-1] == 100 else 100) for end in ends])
