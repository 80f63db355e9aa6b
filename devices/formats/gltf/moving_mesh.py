"""Meshes that morph targets, skins and moving nodes move: where their vertices are at any time (glTF 2.0, 3.7 and 3.11)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from kinegraph.devices.formats.gltf.document import matrix_of
from kinegraph.devices.formats.timing import regular
from kinegraph.stream.chunk import NS, Array, Samples

RATE_HZ = 30.0
MIN_HZ = 10.0
"""Keys that are farther apart are poses, not frames."""
USUAL = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}


@dataclass(frozen=True, slots=True)
class MeshPrimitive:
    """Part of a mesh: vertices (v, 3) that a node moves, the targets (k, v, 3) they morph to, and the joints they are skinned to.

    joints  nodes; binds (joints, 4, 4) undo their rest; bones (v, j) are numbers into `joints`, shares (v, j) how much each moves
    """

    node: int
    places: Samples
    targets: Samples
    weights: Samples
    joints: tuple[int, ...]
    binds: Samples
    bones: Array
    shares: Samples


@dataclass(frozen=True, slots=True)
class Channel:
    """What an animation does to a node: `path` is translation, rotation, scale or weights; values (n, width) at times (n,) s.

    way  LINEAR, STEP or CUBICSPLINE; the last has values (n, 3, width): in-tangent, value, out-tangent
    """

    node: int
    path: str
    way: str
    times: Samples
    values: Samples


@dataclass(frozen=True, slots=True)
class Animation:
    """Its name, and its channels: one at least, each with a key at least."""

    name: str
    channels: tuple[Channel, ...]

    @property
    def keys(self) -> Samples:
        """The key times (n,) s, each once."""
        return np.unique(np.concatenate([one.times for one in self.channels]))

    def frames(self, rate_hz: float | None) -> tuple[float, int]:
        """A rate and how many frames: the given rate, else that of the keys where they are regular and dense, else 30 Hz."""
        keys = self.keys
        on_grid = regular(np.round((keys - keys[0]) * NS).astype(np.int64), None) if rate_hz is None else None
        rate = rate_hz or (on_grid[0] if on_grid and on_grid[0] >= MIN_HZ else RATE_HZ)
        return rate, int((keys[-1] - keys[0]) * rate + 1e-3) + 1

    def times(self, rate_hz: float, count: int) -> Samples:
        """When its frames are, (count,) s."""
        keys = self.keys
        return np.asarray(np.minimum(keys[0] + np.arange(count) / rate_hz, keys[-1]))


@dataclass(frozen=True, slots=True)
class MovingMesh:
    """The meshes of a scene, one after the other: `parents` of all nodes (-1: empty), those of the scene in `order`, parents first."""

    nodes: list[dict[str, Any]]
    parents: list[int]
    order: list[int]
    pieces: list[MeshPrimitive]
    faces: Array
    animations: list[Animation]

    @property
    def vertices(self) -> int:
        return sum(len(piece.places) for piece in self.pieces)

    def at(self, times: Samples, animation: Animation | None = None) -> Samples:
        """The vertices (n, v, 3) at `times` (n,); without an animation at rest."""
        n = len(times)
        moved = {(one.node, one.path): value_at(one, times) for one in (animation.channels if animation else ())}
        world: dict[int, Samples] = {}
        for node in self.order:
            own, above = self._own(node, moved, n), self.parents[node]
            world[node] = world[above] @ own if above >= 0 else own
        made, first = np.empty((n, self.vertices, 3)), 0
        for piece in self.pieces:
            weights = moved.get((piece.node, "weights"), np.broadcast_to(piece.weights, (n, len(piece.weights))))
            last = first + len(piece.places)
            for f in range(n):
                shape = piece.places + np.tensordot(weights[f], piece.targets, 1)
                made[f, first:last] = _placed(piece, shape, f, world)
            first = last
        return made

    def _own(self, node: int, moved: dict[tuple[int, str], Samples], n: int) -> Samples:
        """Where a node is in its parent, (n, 4, 4)."""
        if not any((node, path) in moved for path in USUAL):
            return np.broadcast_to(matrix_of(self.nodes[node]), (n, 4, 4))
        entry = self.nodes[node]
        move, turn, scale = (
            moved.get((node, path), np.tile(np.array(entry.get(path, usual), float), (n, 1)))
            for path, usual in USUAL.items()
        )
        made = np.tile(np.eye(4), (n, 1, 1))
        made[:, :3, :3] = Rotation.from_quat(turn).as_matrix() * scale[:, None]
        made[:, :3, 3] = move
        return made


def _placed(piece: MeshPrimitive, shape: Samples, f: int, world: dict[int, Samples]) -> Samples:
    """A piece's vertices (v, 3) in the world, in frame `f`: with its node, or with the joints that it is skinned to."""
    if not piece.joints:
        matrix = world[piece.node][f]
        return np.asarray(shape @ matrix[:3, :3].T + matrix[:3, 3])
    joints = np.array([world[joint][f] for joint in piece.joints]) @ piece.binds
    each = np.einsum("vj,vjab->vab", piece.shares, joints[piece.bones][:, :, :3])
    return np.asarray(np.einsum("vab,vb->va", each[:, :, :3], shape) + each[:, :, 3])


def value_at(channel: Channel, times: Samples) -> Samples:
    """A channel's values (n, width) at `times` (n,); before its first key and after its last it stays."""
    keys, values = channel.times, channel.values
    at = np.clip(np.searchsorted(keys, times, side="right") - 1, 0, max(len(keys) - 2, 0))
    after = np.minimum(at + 1, len(keys) - 1)
    span = np.where(after > at, keys[after] - keys[at], 1.0)
    share = np.clip((times - keys[at]) / span, 0.0, 1.0)[:, None]
    if channel.way == "CUBICSPLINE":
        s, d = share, span[:, None]
        made = (2 * s**3 - 3 * s**2 + 1) * values[at, 1] + d * (s**3 - 2 * s**2 + s) * values[at, 2]
        made = made + (3 * s**2 - 2 * s**3) * values[after, 1] + d * (s**3 - s**2) * values[after, 0]
    elif channel.way == "STEP":
        made = np.where(share >= 1.0, values[after], values[at])
    elif channel.path == "rotation":
        made = _between(values[at], values[after], share)
    else:
        made = values[at] + share * (values[after] - values[at])
    if channel.path == "rotation":
        size = np.linalg.norm(made, axis=1, keepdims=True)
        made = np.where(size > 1e-9, made / np.maximum(size, 1e-9), USUAL["rotation"])
    return np.asarray(made)


def _between(a: Samples, b: Samples, share: Samples) -> Samples:
    """Rotations (n, 4) part of the way from `a` to `b`, the short way round."""
    cosine = (a * b).sum(axis=1, keepdims=True)
    b, cosine = np.where(cosine < 0, -b, b), np.minimum(np.abs(cosine), 1.0)
    angle = np.arccos(cosine)
    near = angle < 1e-4
    sine = np.where(near, 1.0, np.sin(angle))
    left = np.where(near, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    right = np.where(near, share, np.sin(share * angle) / sine)
    return np.asarray(left * a + right * b)
