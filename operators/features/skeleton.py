"""Where a body's joints are found among the points of a stream, whatever they are called there; and which points are mirror images."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from kinegraph.stream.domain.joint_names import CENTRAL, SIDED, SIDES
from kinegraph.stream.domain.joint_names import plain as _plain
from kinegraph.stream.errors import ParameterError, nearest

SETS: dict[str, tuple[str, ...]] = {
    "e15": ("ankle_l", "ankle_r", "head", "wrist_l", "wrist_r"),
    "e30": (
        "ankle_l", "ankle_r", "head", "wrist_l", "wrist_r",
        "knee_l", "knee_r", "elbow_l", "elbow_r", "neck",
    ),
}  # fmt: skip
"""Pose sets: five points (15 numbers), and these with knees, elbows and neck (30 numbers)."""
HIPS = {"root": ("hip_l", "hip_r")}
"""Where no point is called root, it is between the hips."""
HIPS_AND_SHOULDERS = {**HIPS, "neck": ("shoulder_l", "shoulder_r")}


def find_joints(
    points: Iterable[str],
    wanted: Iterable[str],
    given: Mapping[str, tuple[str, ...]],
    between: Mapping[str, tuple[str, ...]] = HIPS,
) -> dict[str, tuple[str, ...]]:
    """For each wanted joint, the points to average: the given ones, else those found by the joint's names.

    Joints are called "root", "neck", "head", and "ankle", "knee", "hip", "wrist", "elbow", "shoulder" with "_l" or "_r". One
    of `between` need not be found: it is then the middle of those two. Raises ParameterError for one that is not there.
    """
    names = list(points)
    plain: dict[str, str] = {}
    for name in names:
        plain.setdefault(_plain(name), name)
    found: dict[str, tuple[str, ...]] = {}
    for joint, parts in given.items():
        for part in parts:
            if part not in names:
                raise ParameterError(f"joints.{joint}", part, f"a point of the input; {nearest(part, names)}")
        if not parts:
            raise ParameterError(f"joints.{joint}", list(parts), "a list of at least one point")
        found[joint] = tuple(parts)
    for joint in wanted:
        if joint not in found:
            made = _first(joint, plain)
            if made is None and joint in between:
                sides = [found.get(side) or _first(side, plain) or () for side in between[joint]]
                made = tuple(part for side in sides for part in side) if all(sides) else None
            if not made:
                raise ParameterError(
                    "joints",
                    dict(given),
                    f"a mapping with the points of {joint!r}: the input has no point of this name "
                    f"({', '.join(names[:8])}{', ...' if len(names) > 8 else ''})",
                )
            found[joint] = made
    return found


def partner(name: str, names: Iterable[str]) -> str | None:
    """The name of the same thing on the other side of the body, if it is among `names`: "LANK" and "RANK", "hip_l" and "hip_r"."""
    known = set(names)
    for pattern, change in _CHANGES:
        if pattern.search(name):
            other = pattern.sub(change, name, count=1)
            if other != name and other in known:
                return other
    return None


def pairs(names: Iterable[str]) -> list[tuple[str, str]]:
    """(left, right) for all names that have a partner."""
    listed = list(names)
    found = [(name, partner(name, listed)) for name in listed if _is_left(name)]
    return [(left, right) for left, right in found if right is not None]


def _is_left(name: str) -> bool:
    return any(pattern.search(name) for pattern in _LEFT)


_LEFT = [re.compile(p) for p in (r"[Ll]eft", r"LEFT", r"(^|[:_ .])[Ll](?=[A-Za-z_])", r"[_ .][Ll](?=$|[_ .\[])")]
_WORDS = {"left": "right", "Left": "Right", "LEFT": "RIGHT", "l": "r", "L": "R"}
_SWAP = {**_WORDS, **{right: left for left, right in _WORDS.items()}}
_CHANGES = [
    (re.compile(r"[Ll]eft|[Rr]ight|LEFT|RIGHT"), lambda m: _SWAP[m[0]]),
    (re.compile(r"(?<=[_ .])[LlRr](?=$|[_ .\[])"), lambda m: _SWAP[m[0]]),
    (re.compile(r"(?:(?<=^)|(?<=[:_ .]))[LlRr](?=[A-Za-z_])"), lambda m: _SWAP[m[0]]),
]


def _first(joint: str, plain: Mapping[str, str]) -> tuple[str, ...] | None:
    """The points of the first of a joint's names that is there."""
    side = joint[-2:]
    choices = CENTRAL.get(joint, ())
    if side in SIDES:
        choices = tuple(c.replace("?", s) for c in SIDED.get(joint[:-2], ()) for s in SIDES[side])
    for choice in choices:
        parts = choice.split("+")
        if all(part in plain for part in parts):
            return tuple(plain[part] for part in parts)
    return None
