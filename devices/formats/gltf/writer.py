"""Recorded motion as a GLB file (glTF 2.0, binary): a skeleton's with a body of sticks, or a mesh's by morph targets.

Source: Khronos, glTF 2.0 specification. Axes are those of our poses: right-handed, y up, facing z; metres, seconds.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.domain.performance import PRESETS, Performance
from kinegraph.stream.domain.skeleton import JointTree

FLOAT, SHORT, INT = 5126, 5123, 5125
KINDS = {(np.dtype("<f4")): FLOAT, np.dtype("<u2"): SHORT, np.dtype("<u4"): INT}
VERTICES, TRIANGLES = 34962, 34963
TOLERANCE_M = 0.0005
"""Morph targets are the motion's principal directions; as many as keep every vertex within this distance of where it was."""
MAX_TARGETS = 64
VRM_ANIMATION = "VRMC_vrm_animation"
THUMBS = {
    f"{side}Thumb{old}": f"{side.lower()}Thumb{new}"
    for side in ("Left", "Right")
    for old, new in (("Proximal", "Metacarpal"), ("Intermediate", "Proximal"))
}
"""What VRM 1 calls the bones of thumbs; all others are called as in VRM 0."""
THICK = 0.08
"""A stick's thickness in shares of its length."""


class Glb:
    """A glTF document and its bytes, as they grow."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "kinegraph"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [],
            "accessors": [], "bufferViews": [], "buffers": [{"byteLength": 0}],
        }  # fmt: skip
        self._bytes = bytearray()

    def add(self, data: Array, kind: str, *, target: int = 0, bounds: bool = False) -> int:
        """Numbers as an accessor of `kind` (SCALAR, VEC3, ...); returns its number."""
        data = np.ascontiguousarray(data)
        view = {"buffer": 0, "byteOffset": len(self._bytes), "byteLength": data.nbytes}
        accessor: dict[str, Any] = {
            "bufferView": len(self.json["bufferViews"]), "componentType": KINDS[data.dtype], "count": len(data), "type": kind,
        }  # fmt: skip
        if target:
            view["target"] = target
        if bounds:
            flat = data.reshape(len(data), -1)
            accessor |= {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()}
        self._bytes += data.tobytes() + bytes(-data.nbytes % 4)
        self.json["bufferViews"].append(view)
        self.json["accessors"].append(accessor)
        return len(self.json["accessors"]) - 1

    def zeros(self, count: int) -> int:
        """`count` vectors of zeros, which take no bytes, as an accessor; returns its number."""
        zero = {"componentType": FLOAT, "count": count, "type": "VEC3", "min": [0.0] * 3, "max": [0.0] * 3}
        self.json["accessors"].append(zero)
        return len(self.json["accessors"]) - 1

    def animation(self, times: Samples, channels: list[tuple[int, str, Array]]) -> None:
        """What moves: (node, path, values) for each channel, at `times` (n,) in s."""
        at = self.add(times.astype("<f4"), "SCALAR", bounds=True)
        samplers, moved = list[dict[str, Any]](), list[dict[str, Any]]()
        for node, path, values in channels:
            kind = {"rotation": "VEC4", "translation": "VEC3", "weights": "SCALAR"}[path]
            moved.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
            samplers.append({"input": at, "output": self.add(values, kind), "interpolation": "LINEAR"})
        self.json["animations"] = [{"name": "motion", "samplers": samplers, "channels": moved}]

    def write(self, path: Path) -> None:
        """The file."""
        self.json["buffers"][0]["byteLength"] = len(self._bytes)
        text = json.dumps(self.json, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + len(self._bytes)
        with path.open("wb") as file:
            file.write(struct.pack("<4sII", b"glTF", 2, size))
            file.write(struct.pack("<I4s", len(text), b"JSON") + text)
            file.write(struct.pack("<I4s", len(self._bytes), b"BIN\x00"))
            file.write(self._bytes)


def write_skeleton(path: Path, played: Performance, name: str = "body") -> None:
    """An animated skeleton with a stick for every bone; expressions are morph targets of that name, which move no vertex.

    Such targets carry the weights into animation programs, as shape keys with their curves: the sticks have no face.
    """
    tree, poses = played.tree, played.poses
    glb, j = Glb(), len(tree.joints)
    children = [[k for k in range(j) if tree.parents[k] == p] for p in range(j)]
    for k in range(j):
        node: dict[str, Any] = {"name": tree.joints[k], "translation": tree.offsets[k].tolist()}
        glb.json["nodes"].append(node | ({"children": children[k]} if children[k] else {}))
    glb.json["nodes"].append({"name": name, "mesh": 0, "skin": 0})
    glb.json["scenes"][0]["nodes"] = [0, j]
    binds = np.tile(np.eye(4, dtype="<f4"), (j, 1, 1))
    binds[:, 3, :3] = -tree.at_rest  # column by column
    glb.json["skins"] = [
        {"joints": list(range(j)), "skeleton": 0, "inverseBindMatrices": glb.add(binds.reshape(j, 16), "MAT4")}
    ]
    places, faces, owners = _sticks(tree)
    bones, weights = np.zeros((len(places), 4), "<u2"), np.zeros((len(places), 4), "<f4")
    bones[:, 0], weights[:, 0] = owners, 1.0
    attributes = {
        "POSITION": glb.add(places, "VEC3", target=VERTICES, bounds=True),
        "JOINTS_0": glb.add(bones, "VEC4", target=VERTICES),
        "WEIGHTS_0": glb.add(weights, "VEC4", target=VERTICES),
    }
    primitive: dict[str, Any] = {"attributes": attributes, "indices": glb.add(faces, "SCALAR", target=TRIANGLES)}
    mesh: dict[str, Any] = {"name": name, "primitives": [primitive]}
    moved = _moved(poses, j)
    if played.weights is not None and played.expressions:
        still = glb.zeros(len(places))
        primitive["targets"] = [{"POSITION": still}] * len(played.expressions)
        mesh |= {"weights": [0.0] * len(played.expressions), "extras": {"targetNames": list(played.expressions)}}
        moved.append((j, "weights", played.weights.astype("<f4").reshape(-1)))
    glb.json["meshes"] = [mesh]
    glb.animation(played.seconds, moved)
    glb.write(path)


def write_vrm_animation(path: Path, played: Performance) -> None:
    """A humanoid's poses (stream/domain/humanoid.py), fingers and expressions as a VRM animation, for avatars of any size.

    Source: VRMC_vrm_animation-1.0 of the VRM consortium: the rest is the T-pose, hips move, every other bone turns, and an expression's
    weight is how far its node is along x.
    """
    body, poses = played.tree, played.poses
    glb, j = Glb(), len(body.joints)
    for k, joint in enumerate(body.joints):
        children = [c for c in range(j) if body.parents[c] == k]
        node: dict[str, Any] = {"name": joint, "translation": body.offsets[k].tolist()}
        glb.json["nodes"].append(node | ({"children": children} if children else {}))
    moved = _moved(poses, j)
    preset, custom = dict[str, Any](), dict[str, Any]()
    for k, name in enumerate(played.expressions if played.weights is not None else ()):
        glb.json["nodes"].append({"name": name})
        glb.json["scenes"][0]["nodes"].append(j + k)
        (preset if name in PRESETS else custom)[PRESETS.get(name, name)] = {"node": j + k}
        along = np.zeros((len(poses), 3), "<f4")
        along[:, 0] = played.weights[:, k] if played.weights is not None else 0.0
        moved.append((j + k, "translation", along))
    glb.animation(played.seconds, moved)
    named = {THUMBS.get(joint, joint[0].lower() + joint[1:]): {"node": k} for k, joint in enumerate(body.joints)}
    facts: dict[str, Any] = {"specVersion": "1.0", "humanoid": {"humanBones": named}}
    if preset or custom:
        facts["expressions"] = {kind: some for kind, some in (("preset", preset), ("custom", custom)) if some}
    glb.json["extensionsUsed"] = [VRM_ANIMATION]
    glb.json["extensions"] = {VRM_ANIMATION: facts}
    glb.write(path)


def _moved(poses: Samples, joints: int) -> list[tuple[int, str, Array]]:
    """What moves of poses (n, 3 + 4 j): the first joint's place, and every joint's rotation."""
    turns = np.asarray(poses[:, 3:], np.float64).reshape(len(poses), joints, 4)[..., [1, 2, 3, 0]]
    turns = turns / np.linalg.norm(turns, axis=-1, keepdims=True)
    moved: list[tuple[int, str, Array]] = [(0, "translation", poses[:, :3].astype("<f4"))]
    return moved + [(k, "rotation", np.ascontiguousarray(turns[:, k]).astype("<f4")) for k in range(joints)]


def _sticks(tree: JointTree) -> tuple[Array, Array, NDArray[np.uint16]]:
    """A thin double pyramid from each joint to its parent: vertices (v, 3), triangles' corners (t,), and the bone of each vertex."""
    rest, places, faces, owners = tree.at_rest, list[Samples](), list[int](), list[int]()
    for k in range(1, len(tree.joints)):
        start, end = rest[tree.parents[k]], rest[k]
        along = end - start
        length = float(np.linalg.norm(along))
        if length < 1e-6:
            continue
        aside = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 * length else [1.0, 0.0, 0.0])
        aside *= THICK * length / np.linalg.norm(aside)
        other = np.cross(along / length, aside)
        ring = [start + 0.2 * along + c * aside + s * other for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
        first = len(places)
        places += [start, *ring, end]
        owners += 6 * [int(tree.parents[k])]
        for a, b in ((1, 2), (2, 3), (3, 4), (4, 1)):
            faces += [first, first + b, first + a, first + 5, first + a, first + b]
    return np.array(places, "<f4"), np.array(faces, "<u4"), np.array(owners, np.uint16)


def write_mesh(path: Path, faces: Array, times: Samples, vertices: Samples, name: str = "mesh") -> int:
    """Vertices (n, v, 3) m at `times` (n,) s, which rise, as a mesh with morph targets; how many targets were needed."""
    glb, n = Glb(), len(vertices)
    mean = vertices.mean(axis=0)
    weights, targets = _targets(vertices - mean)
    k = len(targets)
    primitive: dict[str, Any] = {
        "attributes": {"POSITION": glb.add(mean.astype("<f4"), "VEC3", target=VERTICES, bounds=True)},
        "indices": glb.add(np.asarray(faces, "<u4").reshape(-1), "SCALAR", target=TRIANGLES),
    }
    glb.json["nodes"].append({"name": name, "mesh": 0})
    mesh: dict[str, Any] = {"name": name, "primitives": [primitive]}
    if k:
        views = [glb.add(one.astype("<f4"), "VEC3", target=VERTICES, bounds=True) for one in targets]
        primitive["targets"] = [{"POSITION": view} for view in views]
        mesh["weights"] = weights[0].astype("<f4").tolist()
        glb.json["meshes"] = [mesh]
        glb.animation(times, [(0, "weights", weights.astype("<f4").reshape(n * k))])
    glb.json["meshes"] = [mesh]
    glb.write(path)
    return k


def _targets(moved: Samples) -> tuple[Samples, Samples]:
    """Weights (n, k) and targets (k, v, 3) with the product `moved` (n, v, 3), to within `TOLERANCE_M` if `MAX_TARGETS` can do it."""
    n, v = moved.shape[:2]
    flat = moved.reshape(n, -1)
    if np.abs(flat).max() < TOLERANCE_M / 100:
        return np.zeros((n, 0)), np.zeros((0, v, 3))
    size, directions = np.linalg.eigh(flat @ flat.T)
    directions = directions[:, ::-1][:, : int((size > 1e-12 * size[-1]).sum())]
    left = flat.copy()
    for k in range(min(directions.shape[1], MAX_TARGETS)):
        weight = directions[:, k : k + 1]
        left -= weight @ (weight.T @ left)
        if np.linalg.norm(left.reshape(n, v, 3), axis=2).max() < TOLERANCE_M:
            break
    kept = directions[:, : k + 1]
    return kept, (kept.T @ flat).reshape(k + 1, v, 3)
