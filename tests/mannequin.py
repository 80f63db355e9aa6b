"""`python -m tests.mannequin`: make the mannequin that comes with the page; a test compares.

An artist's mannequin, out of nothing but the usual body's joints and the radii below: rounded cones along the bones, melted together where
they meet, as a surface net (Gibson 1998) that is pulled onto the surface; skinned by each bone's distance. VRM 1.0, T-pose, facing z.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.formats.gltf.writer import TRIANGLES, VERTICES, Glb
from kinegraph.devices.page.avatar_file import AVATAR
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.domain.fingers import FINGER_BONES, finger_offsets
from kinegraph.stream.domain.humanoid import BONES, NUMBERS, usual_body

STEP_M = 0.02
MELT_M = 0.02
"""How far parts melt into one another."""
SKIN_M = 0.03
"""How far from a joint two bones share the skin."""
Cone = tuple[str, Samples, Samples, float, float]
"""Bone, two ends (3,) and their radii; all in m."""
LICENCE = {
    "name": "kinegraph mannequin", "version": "1", "authors": ["kinegraph"],
    "licenseUrl": "https://vrm.dev/licenses/1.0/", "otherLicenseUrl": "https://www.apache.org/licenses/LICENSE-2.0",
    "avatarPermission": "everyone", "allowRedistribution": True, "modification": "allowModificationRedistribution",
    "commercialUsage": "corporation", "creditNotation": "unnecessary",
}  # fmt: skip
SIDES = {"Left": 1.0, "Right": -1.0}
EXPRESSIONS = (
    ("blinkLeft", 0, (1.0, 0.12)), ("blinkRight", 1, (1.0, 0.12)), ("aa", 2, (0.85, 4.2)), ("ih", 2, (1.3, 1.4)), ("ou", 2, (0.45, 2.2)),
    ("ee", 2, (1.25, 2.0)), ("oh", 2, (0.6, 3.6)),
)  # fmt: skip
"""VRM's names, which oval of the face each moves (left eye, right eye, mouth), and how many times as wide and tall that becomes."""
THUMBS = {"ThumbProximal": "ThumbMetacarpal", "ThumbIntermediate": "ThumbProximal"}
"""What VRM 1.0 calls bones of the thumb otherwise."""


def beside(place: Samples, x: float, y: float, z: float) -> Samples:
    return place + np.array([x, y, z])


def cones() -> list[Cone]:
    """All parts of the body."""
    at = dict(zip(BONES, usual_body().at_rest, strict=True))

    def part(bone: str, start: Samples, end: Samples, r0: float, r1: float) -> Cone:
        return bone, np.asarray(start, float), np.asarray(end, float), r0, r1

    head, neck = at["Head"], at["Neck"]
    made = [
        part("Head", beside(head, 0, 0.045, 0.035), beside(head, 0, 0.105, 0.01), 0.062, 0.088),
        part("Head", beside(head, 0, 0.015, 0.075), beside(head, 0, 0.03, 0.07), 0.032, 0.04),
        part("Head", beside(head, 0, 0.058, 0.103), beside(head, 0, 0.035, 0.117), 0.008, 0.013),
        part("Neck", neck - [0, 0.04, 0.0], beside(head, 0, 0.02, 0.0), 0.06, 0.048),
        part("UpperChest", at["UpperChest"] + [0, 0.09, 0.025], at["UpperChest"] + [0, 0.0, 0.032], 0.085, 0.102),
        part("Chest", at["UpperChest"] + [0, 0.0, 0.032], at["Chest"] + [0, 0.0, 0.017], 0.102, 0.094),
        part("Spine", at["Chest"] + [0, 0.0, 0.017], at["Hips"] + [0, 0.04, 0.0], 0.094, 0.098),
        part("Hips", at["Hips"] + [0, 0.04, 0.0], at["Hips"] + [0, -0.03, -0.006], 0.098, 0.088),
    ]
    for side, x in SIDES.items():
        a = {
            bone: at[side + bone]
            for bone in ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot", "Toes")
        }
        out, hand = np.array([x, 0.0, 0.0]), a["Hand"]
        top, chest, waist = (
            at["UpperChest"] + [0, 0.11, 0.02],
            at["UpperChest"] + [0, 0.0, 0.03],
            at["Chest"] + [0, -0.02, 0.015],
        )
        seat = at["Hips"] + [0, -0.03, -0.012]
        made += [
            part("UpperChest", top + 0.105 * out, chest + 0.07 * out, 0.075, 0.1),
            part("Chest", chest + 0.07 * out, waist + 0.045 * out, 0.1, 0.09),
            part("Spine", waist + 0.045 * out, (waist + seat) / 2 + 0.055 * out, 0.09, 0.095),
            part("Hips", (waist + seat) / 2 + 0.055 * out, seat + 0.065 * out, 0.095, 0.092),
            part(side + "Shoulder", a["Shoulder"] + 0.06 * out, a["UpperArm"] - 0.03 * out, 0.055, 0.062),
            part(side + "UpperArm", a["UpperArm"] + 0.01 * out, a["LowerArm"], 0.052, 0.036),
            part(side + "LowerArm", a["LowerArm"], a["LowerArm"] + 0.08 * out, 0.034, 0.038),
            part(side + "LowerArm", a["LowerArm"] + 0.08 * out, hand, 0.038, 0.024),
            part(side + "Hand", hand + 0.05 * out + [0, 0, 0.012], hand + 0.05 * out - [0, 0, 0.018], 0.026, 0.026),
            part(side + "Hand", hand + 0.01 * out, hand + 0.078 * out, 0.025, 0.016),
            part(side + "Hand", hand + 0.05 * out + [0, 0, 0.012], hand + 0.08 * out + [0, 0, 0.022], 0.022, 0.014),
            part(side + "Hand", hand + 0.05 * out - [0, 0, 0.012], hand + 0.072 * out - [0, 0, 0.028], 0.02, 0.012),
            part(side + "Hand", hand + 0.02 * out + [0, 0, 0.02], hand + 0.04 * out + [0, 0, 0.036], 0.016, 0.014),
            part(side + "UpperLeg", a["UpperLeg"] - [0, 0.03, 0], a["LowerLeg"], 0.084, 0.05),
            part(side + "LowerLeg", a["LowerLeg"], a["LowerLeg"] - [0, 0.13, 0.012], 0.046, 0.052),
            part(side + "LowerLeg", a["LowerLeg"] - [0, 0.13, 0.012], a["Foot"], 0.052, 0.034),
            part(side + "Foot", a["Foot"] - [0, 0.026, 0.035], a["Foot"] - [0, 0.024, 0.0], 0.04, 0.042),
            part(side + "Foot", a["Foot"] - [0, 0.024, 0.0], a["Toes"] + [0, 0.008, 0.0], 0.042, 0.03),
            part(side + "Foot", a["Toes"] + [-0.018, 0.005, 0.0], a["Toes"] + [0.018, 0.005, 0.0], 0.026, 0.026),
            part(side + "Toes", a["Toes"] + [-0.012, 0.004, 0.045], a["Toes"] + [0.012, 0.004, 0.045], 0.024, 0.024),
        ]  # fmt: skip
    return made


def distance(points: Samples, cone: Cone) -> Samples:
    """How far points (n, 3) lie outside a rounded cone (m)."""
    _, start, end, r0, r1 = cone
    along, offset = end - start, points - start
    share = np.clip(offset @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    return np.asarray(np.linalg.norm(offset - share[:, None] * along, axis=1) - r0 - share * (r1 - r0))


def whole(points: Samples, parts: list[Cone]) -> Samples:
    """How far points (n, 3) lie outside the body, parts melted together (m)."""
    near = np.full(len(points), 1.0)
    for part in parts:
        one = distance(points, part)
        melt = np.maximum(MELT_M - np.abs(near - one), 0.0) / MELT_M
        near = np.minimum(near, one) - melt**2 * MELT_M / 4
    return near


def skin(parts: list[Cone]) -> tuple[Samples, Samples, Array]:
    """Vertices (v, 3) m of the body's surface, their normals, and triangles (t, 3), anticlockwise seen from outside."""
    ends = np.array([end for part in parts for end in (part[1] - 0.2, part[2] - 0.2, part[1] + 0.2, part[2] + 0.2)])
    low = np.floor(ends.min(axis=0) / STEP_M) * STEP_M + STEP_M / 2
    shape = tuple(np.ceil((ends.max(axis=0) - low) / STEP_M).astype(int))
    lattice = low + STEP_M * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    inside = (whole(lattice, parts) < 0).reshape(shape)
    eight = [inside[tuple(slice(d, d - 1 or None) for d in corner)] for corner in np.ndindex(2, 2, 2)]
    crossed = np.any(eight, axis=0) & ~np.all(eight, axis=0)
    number = np.full(crossed.shape, -1)
    number[crossed] = np.arange(int(crossed.sum()))
    points = low + STEP_M * (np.argwhere(crossed) + 0.5)
    faces = list[Samples]()
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        first = np.moveaxis(inside, (axis, b, c), (0, 1, 2))
        cells = np.moveaxis(number, (axis, b, c), (0, 1, 2))
        for out in (False, True):
            edge = np.argwhere((first[:-1] == out) & (first[1:] != out))
            edge = edge[(edge[:, 1:] > 0).all(axis=1)]
            i, j, k = edge.T
            quad = np.stack([cells[i, j - 1, k - 1], cells[i, j, k - 1], cells[i, j, k], cells[i, j - 1, k]], axis=1)
            quad = quad if out else quad[:, ::-1]
            faces += [quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]
    for _ in range(6):
        points, normals = pulled(points, parts)
    return points, normals, np.concatenate(faces)


def pulled(points: Samples, parts: list[Cone]) -> tuple[Samples, Samples]:
    """Points (n, 3) one step nearer to the body's surface, and the directions outwards there."""
    reach = 1e-4
    slope = np.stack(
        [whole(points + reach * axis, parts) - whole(points - reach * axis, parts) for axis in np.eye(3)], 1
    )
    slope /= 2 * reach
    steep = np.linalg.norm(slope, axis=1, keepdims=True)
    step = np.clip(whole(points, parts)[:, None] / np.maximum(steep, 0.3), -0.5 * STEP_M, 0.5 * STEP_M)
    outwards = slope / np.maximum(steep, 1e-9)
    return points - step * outwards, outwards


def weights(points: Samples, parts: list[Cone]) -> tuple[Array, Samples]:
    """The four bones that move each point (n, 4), and their shares (n, 4): the nearest, its parent and its children, by distance."""
    near = np.full((len(points), len(BONES)), 1.0)
    for part in parts:
        b = BONES.index(part[0])
        near[:, b] = np.minimum(near[:, b], distance(points, part))
    nearest = near.argmin(axis=1)
    kin = np.eye(len(BONES), dtype=bool)
    kin[np.arange(1, len(BONES)), NUMBERS[1:]] = kin[NUMBERS[1:], np.arange(1, len(BONES))] = True
    near -= near.min(axis=1, keepdims=True)
    share = np.where(kin[nearest], np.exp(-((near / SKIN_M) ** 2)), 0.0)
    most = np.argsort(-share, axis=1, kind="stable")[:, :4]
    kept = np.take_along_axis(share, most, axis=1)
    kept[kept < 0.01] = 0.0
    return np.where(kept > 0, most, 0).astype("<u2"), kept / kept.sum(axis=1, keepdims=True)


def ball() -> tuple[Samples, Array]:
    """A sphere of radius 1 about the z axis: vertices, triangles."""
    rings, around = 6, 10
    angle, turn = np.meshgrid(np.linspace(0, np.pi, rings), 2 * np.pi * np.arange(around) / around, indexing="ij")
    made = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], -1).reshape(-1, 3)
    faces = list[list[int]]()
    for r in range(rings - 1):
        for k in range(around):
            a, b = r * around + k, r * around + (k + 1) % around
            faces += [[a, a + around, b], [b, a + around, b + around]]
    return made, np.array([f for f in faces if not degenerate(made[f])])


def face() -> tuple[Samples, Samples, Array, dict[str, Samples]]:
    """Two eyes and a mouth, dark ovals on the face: vertices, normals, triangles, and how far expressions move each vertex."""
    head = usual_body().at_rest[BONES.index("Head")]
    round_, faces = ball()
    ovals = [(np.array([0.011, 0.015, 0.008]), beside(head, x * 0.034, 0.085, 0.093)) for x in SIDES.values()]
    ovals.append((np.array([0.020, 0.0035, 0.006]), beside(head, 0.0, 0.024, 0.107)))
    points = np.concatenate([round_ * size + middle for size, middle in ovals])
    normals = np.concatenate(
        [round_ / size / np.linalg.norm(round_ / size, axis=1, keepdims=True) for size, _ in ovals]
    )
    moves = {}
    for name, oval, (x, y) in EXPRESSIONS:
        size, _ = ovals[oval]
        moves[name] = np.zeros_like(points)
        moves[name][oval * len(round_) : (oval + 1) * len(round_)] = round_ * size * (x - 1.0, y - 1.0, 0.0)
    return points, normals, np.concatenate([faces + k * len(round_) for k in range(len(ovals))]), moves


def fingers() -> tuple[Samples, Samples, Array, Array]:
    """A rounded stick for every finger's bone: vertices, normals, triangles, and the number of the bone that moves each vertex."""
    round_, faces = ball()
    offsets, made = finger_offsets(), list[tuple[Samples, Samples, Array, int]]()
    places = finger_places()
    for k, bone in enumerate(FINGER_BONES):
        last = bone.endswith("Distal")
        reach = 0.7 * offsets[k] if last else offsets[k + 1]
        along = reach / np.linalg.norm(reach)
        aside = np.cross([0.0, 1.0, 0.0], along)
        axes = np.stack([aside, [0.0, 1.0, 0.0], along])
        radius = 0.0085 if "Thumb" in bone else 0.0075
        stick = round_ * radius
        stick[round_[:, 2] > 0, 2] += np.linalg.norm(reach)
        made.append((stick @ axes + places[k], round_ @ axes, faces + len(round_) * k, len(BONES) + k))
    owner = np.concatenate([np.full(len(round_), one[3]) for one in made])
    points, normals, triangles = (np.concatenate([one[i] for one in made]) for i in range(3))
    return points, normals, triangles, owner


def finger_places() -> Samples:
    """Where FINGER_BONES begin (30, 3) at rest (m)."""
    at = dict(zip(BONES, usual_body().at_rest, strict=True))
    made = np.empty((len(FINGER_BONES), 3))
    for k, (bone, offset) in enumerate(zip(FINGER_BONES, finger_offsets(), strict=True)):
        side = "Left" if bone.startswith("Left") else "Right"
        made[k] = offset + (at[f"{side}Hand"] if bone.endswith("Proximal") else made[k - 1])
    return made


def degenerate(corners: Samples) -> bool:
    return float(np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))) < 1e-9


def write(path: Path) -> None:
    """The avatar as a file."""
    glb, body, parts = Glb(), usual_body(), cones()
    bones = (*BONES, *FINGER_BONES)
    above = [*NUMBERS.tolist(), *(
        BONES.index(bone[: bone.index("t") + 1] + "Hand") if bone.endswith("Proximal") else len(BONES) + k - 1
        for k, bone in enumerate(FINGER_BONES)
    )]  # fmt: skip
    offsets, rest = np.concatenate([body.offsets, finger_offsets()]), np.concatenate([body.at_rest, finger_places()])
    for b, bone in enumerate(bones):
        children = [k for k, parent in enumerate(above) if parent == b]
        node: dict[str, Any] = {"name": bone, "translation": offsets[b].tolist()}
        glb.json["nodes"].append(node | ({"children": children} if children else {}))
    glb.json["nodes"] += [{"name": "mannequin", "mesh": 0, "skin": 0}, {"name": "face", "mesh": 1, "skin": 0}]
    glb.json["scenes"][0]["nodes"] = [0, len(bones), len(bones) + 1]
    binds = np.tile(np.eye(4, dtype="<f4"), (len(bones), 1, 1))
    binds[:, 3, :3] = -rest  # column by column
    glb.json["skins"] = [
        {
            "joints": list(range(len(bones))),
            "skeleton": 0,
            "inverseBindMatrices": glb.add(binds.reshape(-1, 16), "MAT4"),
        }
    ]
    surface, (points, normals, faces, moves), (tips, tip_normals, sticks, owner) = skin(parts), face(), fingers()
    drawn = [
        primitive(glb, 0, *surface, *weights(surface[0], parts)),
        primitive(glb, 0, tips, tip_normals, sticks, *rigid(owner)),
    ]
    ovals = primitive(glb, 1, points, normals, faces, *rigid(np.full(len(points), BONES.index("Head"))))
    ovals["targets"] = [{"POSITION": glb.add(move.astype("<f4"), "VEC3", bounds=True)} for move in moves.values()]
    glb.json["meshes"] = [
        {"name": "mannequin", "primitives": drawn},
        {"name": "face", "primitives": [ovals], "weights": [0.0] * len(moves), "extras": {"targetNames": list(moves)}},
    ]
    glb.json["materials"] = [
        {"name": name, "pbrMetallicRoughness": {"baseColorFactor": colour, "metallicFactor": 0, "roughnessFactor": 0.8}}
        for name, colour in (("body", [0.72, 0.6, 0.45, 1]), ("eyes", [0.05, 0.05, 0.06, 1]))
    ]
    named = {bone: next((bone.replace(k, v) for k, v in THUMBS.items() if k in bone), bone) for bone in bones}
    human = {name[0].lower() + name[1:]: {"node": b} for b, name in enumerate(named.values())}
    shown = {
        name: {"morphTargetBinds": [{"node": len(bones) + 1, "index": k, "weight": 1.0}], "isBinary": False}
        for k, name in enumerate(moves)
    }
    vrm = {"specVersion": "1.0", "meta": LICENCE, "humanoid": {"humanBones": human}, "expressions": {"preset": shown}}
    glb.json["extensionsUsed"], glb.json["extensions"] = ["VRMC_vrm"], {"VRMC_vrm": vrm}
    glb.write(path)


def rigid(owner: Array) -> tuple[Array, Samples]:
    """The bones (n, 4) and shares (n, 4) of vertices that one bone moves."""
    bones, shares = np.zeros((len(owner), 4), "<u2"), np.zeros((len(owner), 4))
    bones[:, 0], shares[:, 0] = owner, 1.0
    return bones, shares


def primitive(
    glb: Glb, material: int, points: Samples, normals: Samples, faces: Array, bones: Array, shares: Samples
) -> dict[str, Any]:
    """Part of a mesh: its numbers in the file."""
    return {
        "material": material,
        "indices": glb.add(faces.astype("<u2").reshape(-1), "SCALAR", target=TRIANGLES),
        "attributes": {
            "POSITION": glb.add(points.astype("<f4"), "VEC3", target=VERTICES, bounds=True),
            "NORMAL": glb.add(normals.astype("<f4"), "VEC3", target=VERTICES),
            "JOINTS_0": glb.add(bones.astype("<u2"), "VEC4", target=VERTICES),
            "WEIGHTS_0": glb.add(shares.astype("<f4"), "VEC4", target=VERTICES),
        },
    }


if __name__ == "__main__":
    write(AVATAR)
