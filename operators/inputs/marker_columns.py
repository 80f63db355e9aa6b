"""Where one marker's x, y and z stand in a stream of markers, or of their coordinates side by side, and in what unit they are."""

from __future__ import annotations

import re
from collections.abc import Iterable

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.domain.joint_names import find_point
from kinegraph.stream.errors import InputError, ParameterError, nearest

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
COORDINATE = re.compile(r"(.+?)[ _.:/-]?([xyz])", re.IGNORECASE)


def marker_columns(spec: StreamSpec, marker: str, parameter: str) -> tuple[int, int, int]:
    """The columns of a sample laid flat that hold x, y and z of `marker`: its name, another name of the same joint, or its number from 0.

    Takes markers (points, 3) with the markers' names as channels, or a signal (3 points,) with channels named after
    marker and coordinate: LANK_x, LANK.x, LANKx.
    """
    if spec.is_event or spec.dtype.kind not in "iuf" or not _is_markers(spec):
        raise InputError("in", spec.describe(), "markers (points, 3), or a signal with x, y and z of each marker")
    named = _names(spec)
    if point := find_point(marker, named):
        return named[point]
    points = spec.shape[0] if len(spec.shape) == 2 else spec.shape[0] // 3
    if marker.isdecimal() and int(marker) < points:
        first = 3 * int(marker)
        return first, first + 1, first + 2
    accepts = f"a marker of the input; {nearest(marker, named)}" if named else f"a number from 0 to {points - 1}"
    raise ParameterError(parameter, marker, accepts)


def marker_names(spec: StreamSpec) -> list[str]:
    """The markers that are named, in the input's order."""
    return list(_names(spec)) if _is_markers(spec) else []


def marker_metres(spec: StreamSpec, columns: Iterable[int], unit: str) -> float:
    """How many metres one is in these columns; `unit` says it where the input does not, or is wrong. Raises InputError."""
    units = {unit} if unit else {*spec.units}
    if not unit and len(spec.units) > 1 and len(spec.shape) == 1:
        units = {spec.unit_of(spec.channels[i]) for i in columns}
    if len(units) != 1 or not units <= set(METRES):
        given = f"in {', '.join(sorted(units)) or 'no unit'}"
        raise InputError("in", given, f"in {', '.join(METRES)}, or unit must say it")
    return METRES[units.pop()]


def _is_markers(spec: StreamSpec) -> bool:
    return spec.is_signal or (len(spec.shape) == 2 and spec.shape[1] == 3)


def _names(spec: StreamSpec) -> dict[str, tuple[int, int, int]]:
    """Every marker that is named, with the columns of its coordinates."""
    if len(spec.shape) == 2:
        named = spec.channels if spec.channel_axis == 0 else ()
        return {name: (3 * i, 3 * i + 1, 3 * i + 2) for i, name in enumerate(named)}
    found: dict[str, dict[str, int]] = {}
    for i, channel in enumerate(spec.channels):
        if part := COORDINATE.fullmatch(channel):
            found.setdefault(part[1], {})[part[2].lower()] = i
    return {name: (at["x"], at["y"], at["z"]) for name, at in found.items() if len(at) == 3}
