"""The humanoid skeleton that avatars share: VRM's bones, a body of usual size at rest in T-pose, and other skeletons turned into it.

The bones are called as in VRM and Unity ("LeftUpperArm"). At rest the arms point sideways, palms down, the legs down, the feet forwards.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.domain.skeleton import JointTree, joints_of, local_poses
from kinegraph.stream.errors import KinegraphError, ParameterError

TRUNK = {"Hips": "", "Spine": "Hips", "Chest": "Spine", "UpperChest": "Chest", "Neck": "UpperChest", "Head": "Neck"}
ARM = {"Shoulder": "", "UpperArm": "Shoulder", "LowerArm": "UpperArm", "Hand": "LowerArm"}
LEG = {"UpperLeg": "", "LowerLeg": "UpperLeg", "Foot": "LowerLeg", "Toes": "Foot"}
PARENTS: dict[str, str] = {
    **TRUNK,
    **{f"{s}{b}": f"{s}{p}" if p else "UpperChest" for s in ("Left", "Right") for b, p in ARM.items()},
    **{f"{s}{b}": f"{s}{p}" if p else "Hips" for s in ("Left", "Right") for b, p in LEG.items()},
}
"""Every bone and its parent; parents come first."""
BONES = tuple(PARENTS)
NUMBERS: Times = np.array([BONES.index(p) if p else -1 for p in PARENTS.values()])
"""The parents as numbers."""

_HALF = {
    "Spine": (0.0, 0.088, -0.012),
    "Chest": (0.0, 0.132, -0.004),
    "UpperChest": (0.0, 0.137, -0.006),
    "Neck": (0.0, 0.206, 0.03),
    "Head": (0.0, 0.097, 0.025),
    "Shoulder": (0.023, 0.133, 0.03),
    "UpperArm": (0.165, -0.015, -0.006),
    "LowerArm": (0.255, 0.0, 0.0),
    "Hand": (0.262, 0.0, 0.0),
    "UpperLeg": (0.11, -0.006, -0.011),
    "LowerLeg": (0.0, -0.43, 0.0),
    "Foot": (0.0, -0.437, -0.01),
    "Toes": (0.0, -0.045, 0.143),
}
"""Offsets (m) at rest of a body 1.75 m tall; those of limbs on the left. Proportions as of a body of MakeHuman (CC0)."""

ALIASES: dict[str, tuple[str, ...]] = {
    "Hips": ("hips", "pelvis", "root", "spinebase", "hipcenter"),
    "Spine": ("lowerback", "spine", "abdomen", "spinemid", "spine01"),
    "Chest": ("chest", "spine", "spine1", "thorax", "spine02"),
    "UpperChest": ("upperchest", "spine2", "spine1", "spine3", "chest2", "spine03"),
    "Neck": ("neck", "upperneck", "lowerneck", "neck01", "neck1"),
    "Head": ("head",),
    "Shoulder": ("?clavicle", "?collar", "?shoulder"),
    "UpperArm": ("?upperarm", "?arm", "?shldr", "?humerus", "?shoulder"),
    "LowerArm": ("?lowerarm", "?forearm", "?radius", "?elbow"),
    "Hand": ("?hand", "?wrist"),
    "UpperLeg": ("?upperleg", "?upleg", "?thigh", "?femur", "?hip"),
    "LowerLeg": ("?lowerleg", "?leg", "?shin", "?calf", "?tibia", "?knee"),
    "Foot": ("?foot", "?ankle"),
    "Toes": ("?toes", "?toebase", "?toe", "?toe0", "?ball"),
}
"""What other skeletons call the bones, best first, without capitals, spaces and signs; "?" is a side. Some name each bone by the joint that
it begins at, so that beside a collar the shoulder is the upper arm."""
STANDS = 2.0
"""A trunk whose axes at rest are nearer to those of the T-pose than this (the trace of the rotation; 60 degrees) is taken as upright."""
FRONT = np.array([0.0, 0.0, 1.0])
NEEDED = ("Hips", "Neck", "Head", *(f"{s}{b}" for s in ("Left", "Right") for b in (*list(ARM)[1:], *list(LEG)[:3])))
"""Without these a skeleton is no humanoid; the others can be where their parents are."""


def usual_body() -> JointTree:
    """A body 1.75 m tall, in T-pose, standing on the floor."""
    offsets = [(0.0, 0.939, 0.007)]
    for bone in BONES[1:]:
        x, y, z = _HALF[_plain_bone(bone)]
        offsets.append((-x if bone.startswith("Right") else x, y, z))
    return JointTree(BONES, NUMBERS, np.array(offsets))


def find_bones(joints: Sequence[str], given: Mapping[str, str] | None = None) -> dict[str, str]:
    """Which joint of a skeleton is which bone, by name; `given` says it where names do not. Raises KinegraphError."""
    plain: dict[str, str] = {}
    for joint in joints:
        name = re.sub(r"[^a-z0-9]", "", joint.rpartition(":")[2].lower())
        plain.setdefault(re.sub(r"^bip\d+", "", name), joint)
    found = dict(given or {})
    for bone, joint in found.items():
        if bone not in PARENTS or joint not in joints:
            raise KinegraphError(
                f"bones: {bone}: {joint}: a bone is one of {', '.join(BONES)}, a joint one of {', '.join(joints)}"
            )
    for bone in BONES:
        if bone in found:
            continue
        sides = {"Left": ("left", "l"), "Right": ("right", "r")}.get(bone[: -len(_plain_bone(bone))] or "", ("",))
        aliases = ALIASES[_plain_bone(bone)]
        names = [name for a in aliases for s in sides for name in (a.replace("?", s), a.replace("?", "") + s)]
        free = (plain[name] for name in names if name in plain and plain[name] not in found.values())
        if first := next(free, None):
            found[bone] = first
    if missing := [bone for bone in NEEDED if bone not in found]:
        raise KinegraphError(
            f"this skeleton has no {missing[0]} that is known by its name: its joints are {', '.join(joints[:40])}"
        )
    return found


def humanoid_of(spec: StreamSpec, bones: Mapping[str, str] | None) -> JointTree:
    """The skeleton of a stream of poses, of which every bone that is needed is known. Raises InputError, or ParameterError for `bones`."""
    tree = JointTree.of(spec, "pose")
    if tree.joints != BONES or bones:
        try:
            find_bones(tree.joints, bones)
        except KinegraphError as error:
            raise ParameterError("bones", dict(bones or {}), f"a mapping of bones to joints: {error}") from None
    return tree


def to_humanoid(tree: JointTree, poses: Samples, bones: Mapping[str, str] | None = None) -> tuple[JointTree, Samples]:
    """The same motion (n, ...) on the humanoid skeleton with this body's bone lengths; its rest is the T-pose.

    World rotations are kept, but for the turn from this skeleton's rest to the T-pose. A bone that it does not have lies where its parent
    is and turns with it. Raises KinegraphError.
    """
    at, heads, change = body_in(tree, bones)
    turns, places = joints_of(tree, poses)
    world = np.empty((len(poses), len(BONES), 4))
    for b in range(len(BONES)):
        world[:, b] = turns[:, at[b]] if at[b] >= 0 else world[:, NUMBERS[b]]
    offsets = heads.copy()
    for b in range(1, len(BONES)):
        offsets[b] = _turned(change[NUMBERS[b]] * [1.0, -1.0, -1.0, -1.0], heads[b] - heads[NUMBERS[b]])
    made = JointTree(BONES, NUMBERS, offsets)
    for b in range(len(BONES)):
        world[:, b] = _times(world[:, b], change[b])
    return made, local_poses(made, places[:, at[0]], world)


def body_in(tree: JointTree, bones: Mapping[str, str] | None = None) -> tuple[list[int], Samples, Samples]:
    """Of every bone: its joint (-1: it moves with its parent), where it is at rest (22, 3), and the rotation (22, 4) that takes it from the
    T-pose to that rest. Raises KinegraphError where the skeleton is no humanoid."""
    found = find_bones(tree.joints, bones)
    at = [tree.joints.index(found[bone]) if bone in found else -1 for bone in BONES]
    rest, heads = tree.at_rest, np.empty((len(BONES), 3))
    for b in range(len(BONES)):
        heads[b] = rest[at[b]] if at[b] >= 0 else heads[NUMBERS[b]]
    return at, heads, _from_t_pose(heads)


def relative_to_parents(at: Sequence[int], change: Samples) -> Samples:
    """Rotations (22, 4) as `body_in` gives, but of each bone without a joint beside its parent's, with which it moves."""
    made = change.copy()
    for b, joint in enumerate(at):
        if joint < 0:
            made[b] = _times(change[NUMBERS[b]] * np.array([[1.0, -1.0, -1.0, -1.0]]), change[b])[0]
    return made


def _from_t_pose(heads: Samples) -> Samples:
    """For each bone the rotation that takes it from the T-pose to the rest at which joints are at `heads` (22, 3)."""
    made = _trunk_from_t_pose(heads)
    stands = made[0, 0] == 1.0
    children = {"UpperArm": "LowerArm", "LowerArm": "Hand", "UpperLeg": "LowerLeg", "LowerLeg": "Foot"}
    if not stands:
        children["Shoulder"] = "UpperArm"
    for b, bone in enumerate(BONES):
        name = _plain_bone(bone)
        if name in ("Hand", "Toes") or (name == "Foot" and not stands):  # the feet of a rest that stands are level
            made[b] = made[NUMBERS[b]]
        elif wanted := children.get(name):
            side = 1.0 if bone.startswith("Left") else -1.0
            straight = np.array([0.0, -1.0, 0.0]) if name.endswith("Leg") else np.array([side, 0.0, 0.0])
            is_now = heads[BONES.index(bone.replace(name, wanted))] - heads[b]
            before = made[NUMBERS[b]]
            made[b] = _times(_between(_turned(before, straight), is_now, _turned(before, FRONT))[None], before)[0]
    return made


def _trunk_from_t_pose(heads: Samples) -> Samples:
    """The same of the trunk, for every bone (22, 4): as its hips and shoulders lie across it; no rotation where it stands as in the T-pose.

    Raises KinegraphError where there is no trunk: neck and hips at one place, or in one line with legs and arms.
    """
    place = dict(zip(BONES, heads, strict=True))
    up = place["Neck"] - place["Hips"]
    long = float(np.linalg.norm(up))
    legs = max(float(np.linalg.norm(place[f"{s}Foot"] - place[f"{s}UpperLeg"])) for s in ("Left", "Right"))
    if long < 0.1 * legs:
        raise KinegraphError("this skeleton has no trunk: at rest its neck is where its hips are")
    up = up / long
    frames = list[Samples | None]()
    for bone in ("UpperLeg", "UpperArm"):
        left = place[f"Left{bone}"] - place[f"Right{bone}"]
        left = left - (left @ up) * up
        wide = float(np.linalg.norm(left))
        frames.append(np.array([left / wide, up, np.cross(left / wide, up)]).T if wide > 0.05 * long else None)
    low, high = (one if one is not None else other for one, other in (frames, frames[::-1]))
    if low is None or high is None:
        raise KinegraphError("this skeleton has no trunk: at rest its hips and shoulders are not across it")
    made = np.tile([1.0, 0.0, 0.0, 0.0], (len(BONES), 1))
    if min(np.trace(low), np.trace(high)) > STANDS:
        return made
    for b, bone in enumerate(BONES):
        made[b] = _rotation(low if bone in ("Hips", "Spine") or _plain_bone(bone) in LEG else high)
    return made


def _rotation(m: Samples) -> Samples:
    """The quaternion (4,) of a rotation matrix."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(m).as_quat(scalar_first=True))


def _plain_bone(bone: str) -> str:
    """A bone's name without its side."""
    return bone.removeprefix("Left").removeprefix("Right")


def _times(p: Samples, q: Samples) -> Samples:
    """Quaternion products of `p` (n, 4) with `q` (4,)."""
    w, x, y, z = q
    return np.asarray(p @ np.array([[w, x, y, z], [-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]]))


def _turned(q: Samples, v: Samples) -> Samples:
    """`v` (3,) turned by the quaternion `q` (4,)."""
    u = 2.0 * np.cross(q[1:], v)
    return np.asarray(v + q[0] * u + np.cross(q[1:], u))


def _between(a: Samples, b: Samples, about: Samples) -> Samples:
    """The shortest rotation (4,) from the direction of `a` to that of `b`; `about` an axis (3,) where they are opposite."""
    norm = float(np.linalg.norm(a) * np.linalg.norm(b))
    q = np.array([norm + a @ b, *np.cross(a, b)])
    if norm == 0.0:
        return np.array([1.0, 0.0, 0.0, 0.0])
    if q[0] <= 1e-9 * norm:
        q = np.array([0.0, *about])
    return np.asarray(q / np.linalg.norm(q))
