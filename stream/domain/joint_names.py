"""One name per joint: `ankle_l` is left_ankle, LeftAnkle or LANK elsewhere. Names are accepted in all these spellings."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

SIDED: dict[str, tuple[str, ...]] = {
    "ankle": ("ankle?", "?ankle", "?ank", "?tibia", "?foot"),
    "knee": ("knee?", "?knee", "?kne", "?femur", "?leg"),
    "hip": ("hip?", "?hip", "?hipjoint", "?upleg", "?thigh", "?asi+?psi", "?fwt+?bwt"),
    "wrist": ("wrist?", "?wrist", "?wra+?wrb", "?wri", "?hand"),
    "elbow": ("elbow?", "?elbow", "?elb", "?humerus", "?forearm"),
    "shoulder": ("shoulder?", "?arm", "?shoulder", "?sho", "?clavicle"),
}
"""By joint: its names, best first; "?" is a side, "+" the middle of two points. Written without capitals, spaces and signs."""
CENTRAL: dict[str, tuple[str, ...]] = {
    "root": ("hipcenter", "spinebase", "hips", "pelvis", "root", "lfwt+rfwt+lbwt+rbwt", "lasi+rasi+lpsi+rpsi"),
    "neck": ("shouldercenter", "spineshoulder", "neck", "thorax", "c7", "upperneck"),
    "head": ("headtop", "headend", "lfhd+rfhd+lbhd+rbhd", "head", "nose"),
}
"""The same for joints in the middle."""
FARTHER: dict[str, tuple[str, ...]] = {
    "toe": ("?toe", "toe?", "?footindex", "?bigtoe", "?foot", "foot?", "?mt5"),
    "hand": ("?index", "?handtip", "handtip?", "?fin", "?fingers", "hand?"),
    "ear": ("?ear", "ear?"),
    "nose": ("nose",),
    "heel": ("?heel", "heel?", "?hee"),
}
"""What lies beyond the joints of a skeleton."""
SIDES = {"_l": ("l", "left"), "_r": ("r", "right")}
_ALSO = {"ankle": ("foot?",), "wrist": ("hand?",), "shoulder": ("arm?", "?upperarm"), "hip": ("thigh?", "?upperleg"),
         "knee": ("?lowerleg",),
         "elbow": ("?lowerarm",)}  # fmt: skip
"""Spellings that are accepted where somebody asks for a marker by name, but are not looked for in a skeleton."""


def plain(name: str) -> str:
    """Without what stands before a colon, capitals, spaces and signs."""
    return re.sub(r"[^a-z0-9]", "", name.rpartition(":")[2].lower())


def spellings(joint: str) -> tuple[str, ...]:
    """What `ankle_l`, `head` or `toe_r` may be called, best first, as `plain` gives it; "+" the middle of two points."""
    part, sides = (joint[:-2], SIDES[joint[-2:]]) if joint[-2:] in SIDES else (joint, ("",))
    choices = CENTRAL.get(part, ()) if sides == ("",) else SIDED.get(part, ())
    return tuple(c.replace("?", s) for c in (*choices, *FARTHER.get(part, ()), *_ALSO.get(part, ())) for s in sides)


JOINTS = (
    *(f"{part}{side}" for part in SIDED for side in SIDES),
    *CENTRAL,
    *(f"{part}{side}" for part in FARTHER if part != "nose" for side in SIDES),
)
"""Every joint by our name."""
_JOINT_OF: Mapping[str, str] = {
    spelling: joint for joint in reversed(JOINTS) for spelling in reversed(spellings(joint)) if "+" not in spelling
} | {plain(joint): joint for joint in JOINTS}


def joint_name(name: str) -> str:
    """Our name of a joint or marker; the name itself where it is not a body's.

    >>> [joint_name(name) for name in ("left_ankle", "LANK", "foot_l", "LeftFoot", "ankle_l", "withers")]
    ['ankle_l', 'ankle_l', 'ankle_l', 'ankle_l', 'ankle_l', 'withers']
    """
    return _JOINT_OF.get(plain(name), name)


def find_point(name: str, points: Iterable[str]) -> str | None:
    """Which of the points is meant by `name`: the one of that very name, else the best spelling of the same joint.

    >>> find_point("hip_l", ["left_hip", "right_hip"]), find_point("foot_l", ["LANK", "LTOE"]), find_point("tail", ["LANK"])
    ('left_hip', 'LANK', None)
    """
    names = list(points)
    if name in names:
        return name
    known: dict[str, str] = {}
    for point in names:
        known.setdefault(plain(point), point)
    return next((known[spelling] for spelling in spellings(joint_name(name)) if spelling in known), None)
