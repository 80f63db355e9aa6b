"""A table of markers: what a map's markers are called in recordings of different set-ups (thesis, 5.3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinegraph.operators.commands.marker_file import marker_file
from kinegraph.stream.domain.axes import WAYS, Up
from kinegraph.stream.domain.pose_map import MAX_MARKERS
from kinegraph.stream.errors import KinegraphError, nearest

KEYS = ("origin", "ahead", "up", "markers", "bones")


@dataclass(frozen=True, slots=True)
class MarkerTable:
    """
    origin, ahead   markers of the set: positions are relative to the first; the second is turned into the x-y plane
    up              the recordings' axis that points up; None: as they declare, else y
    markers         per marker of the set, its possible names, each with the markers to average; the first that exists counts
    bones           pairs of markers that are joined by a line
    """

    origin: str
    ahead: str
    up: Up | None
    markers: dict[str, tuple[tuple[str, ...], ...]]
    bones: tuple[tuple[str, str], ...]

    def found(self, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
        """Which markers of a recording make up each of the set's; those that it lacks are left out."""
        there = set(names)
        made = {}
        for marker, ways in self.markers.items():
            if way := next((w for w in ways if there.issuperset(w)), None):
                made[marker] = way
        return made


def read_table(path: Path) -> MarkerTable:
    """A table from a YAML file. Raises KinegraphError, with the file and what is wrong."""
    table = marker_file(path, "each marker to its names in recordings")
    for key in table:
        if key not in KEYS:
            raise KinegraphError(f"{path}: {key!r} is not known; {nearest(str(key), KEYS)}")
    markers = {str(name): _ways(path, name, given) for name, given in table["markers"].items()}
    if len(markers) > MAX_MARKERS:
        raise KinegraphError(f"{path}: {len(markers)} markers; a map holds {MAX_MARKERS} at most")
    for key in ("origin", "ahead"):
        if table.get(key) not in markers:
            raise KinegraphError(f"{path}: {key} is {table.get(key)!r}; {nearest(str(table.get(key)), markers)}")
    if table["origin"] == table["ahead"]:
        raise KinegraphError(f"{path}: ahead must be another marker than origin")
    if (up := table.get("up")) not in (None, *WAYS):
        raise KinegraphError(f"{path}: up is {up!r}; it must be one of {', '.join(WAYS)}")
    return MarkerTable(table["origin"], table["ahead"], up, markers, _bones(path, table.get("bones") or [], markers))


def _ways(path: Path, name: Any, given: Any) -> tuple[tuple[str, ...], ...]:
    """`poll`, `[poll, head]` (one or the other) or `S1 + S2` (their mean)."""
    ways = given if isinstance(given, list) else [name if given is None else given]
    if not ways or not all(isinstance(way, (str, int)) and str(way).strip() for way in ways):
        raise KinegraphError(f"{path}: markers.{name}: must be a name, or several: [poll, S1 + S2]")
    return tuple(tuple(part.strip() for part in str(way).split(" + ")) for way in ways)


def _bones(path: Path, given: Any, markers: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    for bone in given:
        if not (isinstance(bone, list) and len(bone) == 2 and all(end in markers for end in bone)):
            raise KinegraphError(f"{path}: bones: {bone!r} is not a pair of markers of the set")
    return tuple((str(a), str(b)) for a, b in given)


def own_table(names: Sequence[str], parents: Sequence[int] | None, origin: str, ahead: str) -> MarkerTable:
    """The table of a recording's own markers. Raises KinegraphError where it cannot be known which way the body faces."""
    left = next((n for n in ("LeftUpperLeg", "LeftUpLeg", "hip_l", "lhipjoint") if n in names), "")
    centre = names[0] if parents is not None else ""
    origin, ahead = origin or centre, ahead or left
    for key, marker in (("origin", origin), ("ahead", ahead)):
        if marker not in names:
            known = nearest(marker, names) if marker else f"the markers are {', '.join(names[:20])}"
            raise KinegraphError(f"--{key} {marker or 'is needed'}: poses are turned by two markers; {known}")
    if len(names) > MAX_MARKERS:
        raise KinegraphError(
            f"{len(names)} markers; a map holds {MAX_MARKERS} at most: name those that matter by --markers"
        )
    bones = tuple((names[p], names[j]) for j, p in enumerate(parents or ()) if p >= 0)
    return MarkerTable(origin, ahead, None, {name: ((name,),) for name in names}, bones)
