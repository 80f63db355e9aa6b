"""Bodies for bench/body.py: the meshes and motions of a folder of recordings, seen by a simulated depth camera from any side.

The noise is that of the clips there: disparity steps of an eighth of a pixel, jitter at edges, no return at grazing angles and at a third
of the pixels along edges. The infrared image is the body's surface under flood light, dark, with noise. Rendered: no hair, no cloth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.kernel import kernel

HEIGHT, WIDTH = 240, 320
CAMERA = np.array([285.63, 285.63, 159.5, 119.5])
BASELINE = 42.6
"""Focal length times baseline, in pixels times m."""
JOINTS = (
    "Head", "LeftArm", "RightArm", "LeftForeArm", "RightForeArm", "LeftHand", "RightHand",
    "LeftUpLeg", "RightUpLeg", "LeftLeg", "RightLeg", "LeftFoot", "RightFoot",
)  # fmt: skip
"""The skeleton's joints that the bench's 13 markers are held against; of the head the middle."""


@dataclass(frozen=True, slots=True)
class Clip:
    """depth (n, h, w) uint16 mm, infrared (n, h, w) uint8, the background before (m, h, w) uint16, and the truth (n, 13, 3) in m."""

    depth: NDArray[np.uint16]
    infrared: NDArray[np.uint8]
    empty: NDArray[np.uint16]
    truth: NDArray[np.float64]


def truth_of(names: list[str], joints: Any, tails: Any) -> NDArray[np.float64]:
    """The places (n, 13, 3) of JOINTS, of the ends of all bones."""
    at = [names.index(name) for name in JOINTS]
    truth = np.asarray(joints, float)[:, at]
    truth[:, 0] = (truth[:, 0] + np.asarray(tails, float)[:, at[0]]) / 2
    return truth


@kernel(nogil=True)
def cover(v: Any, faces: Any, camera: Any, depth: Any, which: Any, share: Any) -> None:
    """Triangles `faces` (f, 3) of points `v` (n, 3) into `depth` (h, w; inf: nothing), the face's number and two barycentric shares."""
    h, w = depth.shape
    for t in range(len(faces)):
        a, b, c = v[faces[t, 0]], v[faces[t, 1]], v[faces[t, 2]]
        if min(a[2], b[2], c[2]) < 0.05:
            continue
        ax, ay = camera[0] * a[0] / a[2] + camera[2], camera[1] * a[1] / a[2] + camera[3]
        bx, by = camera[0] * b[0] / b[2] + camera[2], camera[1] * b[1] / b[2] + camera[3]
        cx, cy = camera[0] * c[0] / c[2] + camera[2], camera[1] * c[1] / c[2] + camera[3]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0.0:
            continue
        for y in range(max(0, int(np.ceil(min(ay, by, cy)))), min(h - 1, int(np.floor(max(ay, by, cy)))) + 1):
            for x in range(max(0, int(np.ceil(min(ax, bx, cx)))), min(w - 1, int(np.floor(max(ax, bx, cx)))) + 1):
                p = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / area
                q = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / area
                if p < 0.0 or q < 0.0 or p + q > 1.0:
                    continue
                z = 1.0 / ((1.0 - p - q) / a[2] + p / b[2] + q / c[2])
                if z < depth[y, x]:
                    depth[y, x], which[y, x] = z, t
                    share[y, x, 0], share[y, x, 1] = p * z / b[2], q * z / c[2]


class Cells(NamedTuple):
    """Of each cell of a picture how far away what it shows is, the triangle's number (-1: nothing), and two barycentric shares."""

    depth: NDArray[np.float64]
    which: NDArray[np.int64]
    share: NDArray[np.float64]

    @classmethod
    def empty(cls, height: int, width: int) -> Cells:
        return cls(
            np.full((height, width), np.inf), np.full((height, width), -1, np.int64), np.zeros((height, width, 2))
        )


def turned(q: Any) -> NDArray[np.float64]:
    """Rotations (..., 3, 3) of quaternions (..., 4) xyzw."""
    x, y, z, w = np.moveaxis(np.asarray(q, float) / np.linalg.norm(np.asarray(q, float), axis=-1, keepdims=True), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def about_y(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


class Studio:
    """A room with a camera 1.1 m above the floor, 2.9 m before a body of this mesh."""

    def __init__(self, folder: Path, mesh: str) -> None:
        self.body: dict[str, Any] = dict(np.load(folder / f"human_{mesh}.npz"))
        self.names = [str(name) for name in self.body["joint_names"]]
        self.motion = np.load(folder / "cmu_mocap_30hz.npz")
        self.place, self.axes = np.array([0.0, 1.1, 2.9]), np.diag([1.0, -1.0, -1.0])
        y = (np.arange(HEIGHT)[:, None] - CAMERA[3]) / CAMERA[1]
        self.room = np.broadcast_to(np.minimum(4.2, 1.1 / np.maximum(y, 1e-6)), (HEIGHT, WIDTH))

    def poses(self, sequence: str, first: int, last: int, degrees: float) -> tuple[Any, Any]:
        """Rotations (n, 31, 3, 3) and joints (n, 31, 3), with the first frame's heading turned to the camera and then by `degrees`."""
        body, root = self.body, self.motion[f"root_{sequence}"].astype(float)
        padded = np.pad(root, ((30, 29), (0, 0)), "edge")
        drift = np.stack([np.convolve(padded[:, i], np.ones(60) / 60, "valid") for i in range(3)], 1)
        root = (root - drift * [1, 0, 1])[first:last]
        rotations, hips = turned(self.motion[f"rot_{sequence}"][first:last]), self.names.index("Hips")
        ahead = rotations[0, hips, :, 2]
        turn = about_y(np.radians(degrees) - np.arctan2(ahead[0], ahead[2]))
        rotations, head = turn @ rotations, body["head"].astype(float)
        joints = np.full((len(root), 31, 3), np.nan)
        joints[:, hips] = (root @ turn.T) * [1, head[hips, 1] / 0.94, 1]
        while np.isnan(joints).any():
            for j, p in enumerate(body["parents"]):
                if j != hips and not np.isnan(joints[0, p]).any():
                    joints[:, j] = joints[:, p] + rotations[:, p] @ (head[j] - head[p])
        return rotations, joints

    def clip(self, sequence: str, first: int, last: int, degrees: float, seed: int = 0) -> Clip:
        """A part of a motion sequence, after a second of the empty room."""
        rotations, joints = self.poses(sequence, first, last, degrees)
        random = np.random.default_rng(seed)
        frames = [self.frame(r, j, random) for r, j in zip(rotations, joints, strict=True)]
        empty = np.stack([self._seen(self.room, np.zeros_like(self.room), random) for _ in range(40)])
        tails = joints + np.einsum("nkij,kj->nki", rotations, (self.body["tail"] - self.body["head"]).astype(float))
        seen = [(x - self.place) @ self.axes.T for x in (joints, tails)]
        return Clip(
            np.stack([f[0] for f in frames]), np.stack([f[1] for f in frames]), empty, truth_of(self.names, *seen)
        )

    def skin(self, rotations: Any, joints: Any) -> NDArray[np.float64]:
        """The mesh (13380, 3) in one pose."""
        body = self.body
        skin, weights = body["vertices"].astype(float), body["weight"].astype(float)
        moved = np.zeros_like(skin)
        for k in range(4):
            j = body["weight_index"][:, k]
            here = np.einsum("nij,nj->ni", rotations[j], skin - body["head"][j]) + joints[j]
            moved += weights[:, k : k + 1] / weights.sum(1, keepdims=True) * here
        return moved

    def frame(self, rotations: Any, joints: Any, random: np.random.Generator) -> tuple[Any, Any]:
        """Depth and infrared of one pose."""
        body, moved = self.body, self.skin(rotations, joints)
        corners, cells = (moved - self.place) @ self.axes.T, Cells.empty(HEIGHT, WIDTH)
        cover(corners, body["faces"], CAMERA, *cells)
        a, b, c = corners[body["faces"].T]
        normal, middle = np.cross(b - a, c - a), (a + b + c) / 3.0
        sizes = np.linalg.norm(normal, axis=1) * np.linalg.norm(middle, axis=1)
        cosines = np.abs((normal * middle).sum(axis=1)) / np.maximum(sizes, 1e-12)
        depth, light = cells.depth, cosines[cells.which]
        there = depth < self.room
        image = np.where(there, light * 115 * (2 / np.maximum(depth, 0.3)) ** 2, 18.0) + random.normal(
            0, 4, depth.shape
        )
        return self._seen(np.where(there, depth, self.room), np.where(there, light, 1.0), random), np.clip(
            image, 0, 255
        ).astype(np.uint8)

    def _seen(self, depth: Any, light: Any, random: np.random.Generator) -> NDArray[np.uint16]:
        """Depth (m) as the camera measures it."""
        y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
        y = np.clip(np.rint(y + random.normal(0, 0.4, y.shape)), 0, HEIGHT - 1).astype(int)
        x = np.clip(np.rint(x + random.normal(0, 0.4, x.shape)), 0, WIDTH - 1).astype(int)
        steps = np.rint((BASELINE / depth[y, x] + random.normal(0, 0.035, depth.shape)) * 8) / 8
        edge = np.maximum(*(np.abs(np.diff(depth, axis=a, prepend=np.take(depth, [0], a))) for a in (0, 1))) > 0.15
        gone = (edge & (random.random(depth.shape) < 0.35)) | ((light > 0) & (light[y, x] < 0.12))
        return np.where(gone, 0, BASELINE / steps * 1000).astype(np.uint16)


@cache
def studio(folder: Path, mesh: str) -> Studio:
    return Studio(folder, mesh)
