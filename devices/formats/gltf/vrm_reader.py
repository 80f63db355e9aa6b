"""The skeleton of an avatar: VRM 0.x and 1.0 files, which are glTF binaries with a humanoid extension."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.formats.gltf.document import glb_chunks, matrix_of
from kinegraph.stream.chunk import Samples
from kinegraph.stream.data.bounded import reading
from kinegraph.stream.domain.humanoid import BONES, NUMBERS
from kinegraph.stream.domain.skeleton import JointTree
from kinegraph.stream.errors import RecordingError


def read_vrm(path: Path) -> JointTree:
    """The humanoid bones of an avatar at rest, as `stream.domain.humanoid` has them: metres, y up, facing z.

    A bone that the avatar lacks lies where its parent does. Raises RecordingError.
    """
    with reading(path, "a VRM avatar"):
        document, _ = glb_chunks(path.read_bytes(), path, "VRM avatar")
        found, turned = _bones(document, path)
        places = _places(document["nodes"])
        heads = np.zeros((len(BONES), 3))
        for b, bone in enumerate(BONES):
            name = bone[0].lower() + bone[1:]
            heads[b] = places[found[name]] if name in found else heads[NUMBERS[b]]
    if turned:
        heads *= [-1.0, 1.0, -1.0]
    offsets = heads.copy()
    offsets[1:] -= heads[NUMBERS[1:]]
    return JointTree(BONES, NUMBERS, offsets)


def _bones(document: dict[str, Any], path: Path) -> tuple[dict[str, int], bool]:
    """The node of each humanoid bone, and whether the avatar faces -z (VRM 0.x)."""
    extensions = document.get("extensions", {})
    if "VRMC_vrm" in extensions:
        bones = extensions["VRMC_vrm"]["humanoid"]["humanBones"]
        found = {str(name): int(entry["node"]) for name, entry in bones.items()}
    elif "VRM" in extensions:
        found = {str(entry["bone"]): int(entry["node"]) for entry in extensions["VRM"]["humanoid"]["humanBones"]}
    else:
        raise RecordingError(f"{path}: a glTF file without a VRM humanoid; export it as VRM")
    if "hips" not in found or not all(0 <= node < len(document["nodes"]) for node in found.values()):
        raise RecordingError(f"{path}: its humanoid has no hips, or names nodes that are not there")
    return found, "VRMC_vrm" not in extensions


def _places(nodes: list[dict[str, Any]]) -> Samples:
    """Where every node is at rest, (nodes, 3)."""
    parents = {int(child): n for n, node in enumerate(nodes) for child in node.get("children", ())}

    def world(n: int, depth: int = 0) -> tuple[Samples, Samples]:
        if depth > len(nodes):
            raise ValueError("nodes are their own ancestors")
        above = world(parents[n], depth + 1)[0] if n in parents else np.eye(4)
        whole = above @ matrix_of(nodes[n])
        return whole, whole[:3, 3]

    return np.array([world(n)[1] for n in range(len(nodes))])
