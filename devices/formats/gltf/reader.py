"""Meshes of glTF files and their animations: morph targets, skins, moving nodes (glTF 2.0, 3.7 and 3.11).

Axes are those of our meshes: right-handed, y up; metres, seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.formats.gltf.document import Gltf
from kinegraph.devices.formats.gltf.moving_mesh import USUAL, Animation, Channel, MeshPrimitive, MovingMesh
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.errors import RecordingError

TRIANGLES, STRIP, FAN = 4, 5, 6
WAYS = {"LINEAR": 1, "STEP": 1, "CUBICSPLINE": 3}
"""How values between keys are found, and how many a key has."""
MAX_BYTES = 4 << 30
"""An animation that takes more memory than this is not read."""


def read_gltf(path: Path) -> MovingMesh:
    """All meshes of a file's scene, and its animations. Raises RecordingError, or what a damaged file brings up."""
    file = Gltf.open(path)
    nodes: list[dict[str, Any]] = file.json.get("nodes", [])
    parents, order = _tree(file.json, nodes)
    pieces: list[MeshPrimitive] = []
    faces: list[Array] = []
    for node in order:
        if "mesh" in nodes[node]:
            _add_mesh(file, node, pieces, faces)
    if not faces:
        raise RecordingError(f"{path}: holds no triangles")
    if stray := {joint for piece in pieces for joint in piece.joints} - set(order):
        raise ValueError(f"a skin refers to node {min(stray)}, which is not in the scene")
    mesh = MovingMesh(nodes, parents, order, pieces, np.concatenate(faces).astype(np.int32), [])
    if not np.isfinite(mesh.at(np.zeros(1))).all():
        raise RecordingError(f"{path}: holds vertices that are not finite")
    mesh.animations.extend(_animations(file, mesh))
    return mesh


def animated(mesh: MovingMesh, path: Path, rate_hz: float | None) -> Iterator[tuple[str, float, Samples]]:
    """Of each animation its name, its rate and its frames (n, v, 3). Raises RecordingError."""
    for animation in mesh.animations:
        rate, count = animation.frames(rate_hz)
        size = count * (24 * mesh.vertices + 128 * len(mesh.order))
        if size > MAX_BYTES:
            raise RecordingError(
                f"{path}: {count} frames of {mesh.vertices} vertices take {size / 1e9:.1f} GB; at most "
                f"{MAX_BYTES / 1e9:.1f} are read: say a lower --rate"
            )
        frames = mesh.at(animation.times(rate, count), animation)
        if not np.isfinite(frames).all():
            raise RecordingError(f"{path}: {animation.name!r} moves vertices to where nothing is finite")
        yield animation.name, rate, frames


def _tree(document: dict[str, Any], nodes: list[dict[str, Any]]) -> tuple[list[int], list[int]]:
    """The parent of each node, and the scene's nodes, parents first."""
    parents = [-1] * len(nodes)
    for number, node in enumerate(nodes):
        for child in node.get("children", ()):
            if not 0 <= child < len(nodes) or parents[child] >= 0:
                raise ValueError(f"node {child} has two parents, or is not there")
            parents[child] = number
    roots = [number for number, parent in enumerate(parents) if parent < 0]
    scenes = document.get("scenes") or [{"nodes": roots}]
    waiting = [int(node) for node in reversed(scenes[document.get("scene", 0)].get("nodes", ()))]
    if not set(waiting) <= set(roots) or len(set(waiting)) < len(waiting):
        raise ValueError("a scene begins with a node that has a parent, or names one twice")
    order: list[int] = []
    while waiting:
        order.append(waiting.pop())
        waiting += reversed(nodes[order[-1]].get("children", ()))
    return parents, order


def _add_mesh(file: Gltf, node: int, pieces: list[MeshPrimitive], faces: list[Array]) -> None:
    """The triangles of a node's mesh; primitives that share their vertices in the file share them here."""
    mesh = file.json["meshes"][file.json["nodes"][node]["mesh"]]
    known: dict[str, tuple[int, int]] = {}
    for primitive in mesh["primitives"]:
        mode = primitive.get("mode", TRIANGLES)
        if mode not in (TRIANGLES, STRIP, FAN):
            continue
        key = f"{sorted(primitive['attributes'].items())} {primitive.get('targets')}"
        if key not in known:
            first = sum(len(piece.places) for piece in pieces)
            pieces.append(_piece(file, node, mesh, primitive))
            known[key] = first, len(pieces[-1].places)
        first, count = known[key]
        corners = file.numbers(primitive["indices"])[:, 0] if "indices" in primitive else np.arange(count)
        if corners.dtype.kind not in "iu" or (len(corners) and corners.max() >= count):
            raise ValueError(f"its triangles refer to vertices that do not exist; there are {count}")
        faces.append(_triangles(corners.astype(np.int64), mode) + first)


def _piece(file: Gltf, node: int, mesh: dict[str, Any], primitive: dict[str, Any]) -> MeshPrimitive:
    attributes, targets = primitive["attributes"], primitive.get("targets", [])
    weights = np.array(file.json["nodes"][node].get("weights", mesh.get("weights", [0.0] * len(targets))), float)
    places = file.numbers(attributes["POSITION"]).astype(float)
    moved = np.zeros((len(weights), len(places), 3))
    for k, target in enumerate(targets):
        if "POSITION" in target:
            moved[k] = file.numbers(target["POSITION"])
    if places.shape[1] != 3 or not np.isfinite(moved).all():
        raise ValueError("its vertices are not finite (x, y, z)")
    joints, binds = _skin(file, node)
    bones, shares = np.zeros((len(places), 0), np.int64), np.zeros((len(places), 0))
    if joints:
        sets = [k for k in range(8) if f"JOINTS_{k}" in attributes]
        bones = np.hstack([file.numbers(attributes[f"JOINTS_{k}"]) for k in sets]).astype(np.int64)
        shares = np.hstack([file.numbers(attributes[f"WEIGHTS_{k}"]) for k in sets]).astype(float)
        if bones.shape != shares.shape or len(bones) != len(places) or bones.max() >= len(joints):
            raise ValueError(f"vertices refer to joints that do not exist; there are {len(joints)}")
        shares = shares / np.maximum(shares.sum(axis=1, keepdims=True), 1e-12)
    return MeshPrimitive(node, places, moved, weights, joints, binds, bones, shares)


def _skin(file: Gltf, node: int) -> tuple[tuple[int, ...], Samples]:
    """The joints of a node's skin and the matrices (joints, 4, 4) that undo their rest; empty without a skin."""
    number = file.json["nodes"][node].get("skin")
    if number is None:
        return (), np.zeros((0, 4, 4))
    skin = file.json["skins"][number]
    joints = tuple(int(joint) for joint in skin["joints"])
    if "inverseBindMatrices" not in skin:
        return joints, np.tile(np.eye(4), (len(joints), 1, 1))
    binds = file.numbers(skin["inverseBindMatrices"]).astype(float).reshape(-1, 4, 4).transpose(0, 2, 1)
    if len(binds) < len(joints):
        raise ValueError(f"a skin has {len(joints)} joints and {len(binds)} matrices")
    return joints, binds[: len(joints)]


def _triangles(corners: Array, mode: int) -> Array:
    """(t, 3) of a list, a strip or a fan of triangles."""
    if mode == TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    k = np.arange(max(len(corners) - 2, 0))
    if mode == FAN:
        return np.stack([corners[k + 1], corners[k + 2], corners[0 * k]], axis=1)
    odd = k % 2
    return np.stack([corners[k], corners[k + 1 + odd], corners[k + 2 - odd]], axis=1)


def _animations(file: Gltf, mesh: MovingMesh) -> Iterator[Animation]:
    """Those animations that move anything of the scene."""
    morphs = {piece.node: len(piece.weights) for piece in mesh.pieces}
    for number, one in enumerate(file.json.get("animations", ())):
        channels = []
        for channel in one["channels"]:
            node, path = channel["target"].get("node"), channel["target"]["path"]
            width = morphs.get(node, 0) if path == "weights" else len(USUAL.get(path, ()))
            if width and node in mesh.order:
                channels.append(_channel(file, one["samplers"][channel["sampler"]], node, path, width))
        if channels:
            yield Animation(str(one.get("name") or number), tuple(channels))


def _channel(file: Gltf, sampler: dict[str, Any], node: int, path: str, width: int) -> Channel:
    way = sampler.get("interpolation", "LINEAR")
    times = file.numbers(sampler["input"])[:, 0].astype(float)
    values = file.numbers(sampler["output"]).astype(float).ravel()
    if not len(times) or len(values) != len(times) * WAYS[way] * width:
        raise ValueError(f"{len(values)} numbers for {len(times)} keys of {path}")
    if not (np.isfinite(times).all() and np.isfinite(values).all() and (np.diff(times) > 0).all()):
        raise ValueError(f"the keys of {path} do not rise, or its values are not finite")
    shape = (len(times), 3, width) if WAYS[way] == 3 else (len(times), width)
    return Channel(node, path, way, times, values.reshape(shape))
