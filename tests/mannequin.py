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
            part(side + "Hand", beside(hand, 0, 0, 0.0), hand + 0.15 * out, 0.025, 0.02),
            part(side + "Hand", hand + 0.05 * out + [0, 0, 0.012], hand + 0.14 * out + [0, 0, 0.015], 0.022, 0.017),
            part(side + "Hand", hand + 0.03 * out + [0, 0, 0.02], hand + 0.09 * out + [0, -0.005, 0.065], 0.018, 0.014),
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


def eyes() -> tuple[Samples, Samples, Array]:
    """Two dark ovals on the face: vertices, normals, triangles."""
    head = usual_body().at_rest[BONES.index("Head")]
    rings, around = 6, 10
    angle, turn = np.meshgrid(np.linspace(0, np.pi, rings), 2 * np.pi * np.arange(around) / around, indexing="ij")
    ball = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], -1).reshape(-1, 3)
    faces = list[list[int]]()
    for r in range(rings - 1):
        for k in range(around):
            a, b = r * around + k, r * around + (k + 1) % around
            faces += [[a, a + around, b], [b, a + around, b + around]]
    size = np.array([0.011, 0.015, 0.008])
    sides = [ball * size + beside(head, x * 0.034, 0.085, 0.093) for x in SIDES.values()]
    pointing = ball / size / np.linalg.norm(ball / size, axis=1, keepdims=True)
    tri = np.array([f for f in faces if not degenerate(ball[f])])
    return np.concatenate(sides), np.tile(pointing, (2, 1)), np.concatenate([tri, tri + len(ball)])


def degenerate(corners: Samples) -> bool:
    return float(np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))) < 1e-9


def write(path: Path) -> None:
    """The avatar as a file."""
    glb, body, parts = Glb(), usual_body(), cones()
    children = [[int(k) for k in np.flatnonzero(b == NUMBERS)] for b in range(len(BONES))]
    for b, bone in enumerate(BONES):
        node: dict[str, Any] = {"name": bone, "translation": body.offsets[b].tolist()}
        glb.json["nodes"].append(node | ({"children": children[b]} if children[b] else {}))
    glb.json["nodes"].append({"name": "mannequin", "mesh": 0, "skin": 0})
    glb.json["scenes"][0]["nodes"] = [0, len(BONES)]
    binds = np.tile(np.eye(4, dtype="<f4"), (len(BONES), 1, 1))
    binds[:, 3, :3] = -body.at_rest  # column by column
    glb.json["skins"] = [
        {
            "joints": list(range(len(BONES))),
            "skeleton": 0,
            "inverseBindMatrices": glb.add(binds.reshape(-1, 16), "MAT4"),
        }
    ]
    surface, face = skin(parts), eyes()
    on_head = np.tile(np.array([[BONES.index("Head"), 0, 0, 0]], "<u2"), (len(face[0]), 1))
    rigid = np.tile(np.array([[1.0, 0, 0, 0]]), (len(face[0]), 1))
    drawn = [primitive(glb, 0, *surface, *weights(surface[0], parts)), primitive(glb, 1, *face, on_head, rigid)]
    glb.json["meshes"] = [{"name": "mannequin", "primitives": drawn}]
    glb.json["materials"] = [
        {"name": name, "pbrMetallicRoughness": {"baseColorFactor": colour, "metallicFactor": 0, "roughnessFactor": 0.8}}
        for name, colour in (("body", [0.72, 0.6, 0.45, 1]), ("eyes", [0.05, 0.05, 0.06, 1]))
    ]
    bones = {bone[0].lower() + bone[1:]: {"node": b} for b, bone in enumerate(BONES)}
    glb.json["extensionsUsed"] = ["VRMC_vrm"]
    glb.json["extensions"] = {"VRMC_vrm": {"specVersion": "1.0", "meta": LICENCE, "humanoid": {"humanBones": bones}}}
    glb.write(path)


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
