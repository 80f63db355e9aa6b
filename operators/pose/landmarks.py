"""The places on a body that markers show, whatever a stream calls them, and where they are on the skeleton."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from kinegraph.operators.features.skeleton import find_joints
from kinegraph.operators.inputs.marker_columns import marker_columns
from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.joint_names import FARTHER
from kinegraph.stream.errors import InputError, ParameterError

PLACES: dict[str, tuple[str, tuple[float, float, float]]] = {
    **{f"hip_{s[0].lower()}": (f"{s}UpperLeg", (0.0, 0.0, 0.0)) for s in ("Left", "Right")},
    **{f"knee_{s[0].lower()}": (f"{s}LowerLeg", (0.0, 0.0, 0.0)) for s in ("Left", "Right")},
    **{f"ankle_{s[0].lower()}": (f"{s}Foot", (0.0, 0.0, 0.0)) for s in ("Left", "Right")},
    **{f"shoulder_{s[0].lower()}": (f"{s}UpperArm", (0.0, 0.0, 0.0)) for s in ("Left", "Right")},
    **{f"elbow_{s[0].lower()}": (f"{s}LowerArm", (0.0, 0.0, 0.0)) for s in ("Left", "Right")},
    **{f"wrist_{s[0].lower()}": (f"{s}Hand", (0.0, 0.0, 0.0)) for s in ("Left", "Right")},
    "head": ("Head", (0.0, 0.15, 0.0)),
    "neck": ("Neck", (0.0, 0.0, 0.0)),
    "root": ("Hips", (0.0, 0.0, 0.0)),
    **{f"toe_{s[0].lower()}": (f"{s}Toes", (0.0, 0.0, 0.0)) for s in ("Left", "Right")},
    **{f"hand_{s[0].lower()}": (f"{s}Hand", (0.08 if s == "Left" else -0.08, 0.0, 0.0)) for s in ("Left", "Right")},
    "nose": ("Head", (0.0, 0.05, 0.11)),
    "ear_l": ("Head", (0.075, 0.06, 0.0)),
    "ear_r": ("Head", (-0.075, 0.06, 0.0)),
}
"""By landmark: the bone that it moves with, and where it is from that bone's joint at rest (m, for the usual body)."""
NAMES = tuple(PLACES)
BONE_OF: Times = np.array([BONES.index(bone) for bone, _ in PLACES.values()])
FROM_BONE: Samples = np.array([offset for _, offset in PLACES.values()])
USUAL = NAMES[:13]
"""What a model is trained for unless it is asked for others: head, shoulders, elbows, wrists, hips, knees, ankles."""


def find_landmarks(spec: StreamSpec, given: Mapping[str, tuple[str, ...]]) -> tuple[dict[str, tuple[str, ...]], Times]:
    """Which points of a stream of markers make up each landmark that it shows; and their columns.

    The columns (k, 4) are those of x, y and z of one point, and the landmark's number. Raises InputError where it shows fewer than five, or
    ParameterError for what is given and not there.
    """
    from kinegraph.operators.features.pose import point_names

    names = point_names(spec)
    for landmark in given:
        if landmark not in NAMES:
            raise ParameterError("landmarks", landmark, f"one of {', '.join(NAMES)}")
    found = find_joints(names, (), given)
    for landmark in NAMES:
        if landmark not in found and (parts := _find(landmark, names, found)):
            found[landmark] = parts
    if found.get("head") == found.get("nose"):
        found.pop("head", None)
    if len(found) < 5:
        raise InputError(
            "in",
            f"{spec.describe()}; its points that are known by their names are {', '.join(found) or 'missing'}",
            f"at least 5 points of a body, called as their joints, or named in `landmarks`: {', '.join(NAMES)}",
        )
    rows = [
        (*marker_columns(spec, part, "landmarks"), NAMES.index(landmark))
        for landmark, parts in found.items()
        for part in parts
    ]
    return found, np.array(rows, np.int64)


def _find(landmark: str, names: tuple[str, ...], found: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    joint, _, side = landmark.partition("_")
    if joint not in FARTHER:
        try:
            return find_joints(names, (landmark,), {})[landmark]
        except ParameterError:
            return ()
    used = {part for parts in found.values() for part in parts}
    plain = {re.sub(r"[^a-z0-9]", "", name.rpartition(":")[2].lower()): name for name in names}
    sides = {"l": ("l", "left"), "r": ("r", "right")}.get(side, ("",))
    choices = (choice.replace("?", s) for choice in FARTHER[joint] for s in sides)
    return next(((plain[c],) for c in choices if c in plain and plain[c] not in used), ())
