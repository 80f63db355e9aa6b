"""`python -m bench.steering_dog`: make the dog of `operators/steering/dog.npz`, which two people steer in `steer_horse`.

The skin, its weights and the joints are those of the dog of dm_control (Apache-2.0, DeepMind; `pip install dm_control mujoco
fast_simplification`, into an environment of its own). The rest is the skin's own; the gaits are ours: every paw goes along a path, its leg
follows by least squares over the joints' limits. `--frames FILE` keeps vertices, triangles and marked vertices.
"""

from __future__ import annotations

import argparse
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.operators.steering.model.fit import fit_steering
from kinegraph.operators.steering.model.stored import KIND, to_arrays
from kinegraph.operators.steering.operator import MODELS
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.data.model_file import write_model
from kinegraph.stream.domain.axes import BODY
from kinegraph.stream.domain.mesh import Topology

LEGS = {
    "fl": ("finger_L", ("scapula_L_extend", "scapula_L_abduct", "shoulder_L_extend", "elbow_L", "wrist_L")),
    "fr": ("finger_R", ("scapula_R_extend", "scapula_R_abduct", "shoulder_R_extend", "elbow_R", "wrist_R")),
    "hl": ("toe_L", ("hip_L_extend", "hip_L_abduct", "knee_L", "ankle_L")),
    "hr": ("toe_R", ("hip_R_extend", "hip_R_abduct", "knee_R", "ankle_R")),
}
"""By leg: the body of its paw, and the joints that swing it."""
WALK = {"fl": 0.0, "fr": 0.5, "hl": 0.75, "hr": 0.25}
LIMBS = ("hoof_fl", "hoof_fr", "hoof_hl", "hoof_hr")
STRIDES, STANDS = ((0.12, 0.05), (0.18, 0.07), (0.24, 0.1)), 0.62
"""How far a paw goes in a stride and how high it is lifted (m), and what share of the stride it stands."""
ABOUT_M, ABOUT = (0.14, 0.04, 0.14), 96
"""Paws also go anywhere so far to the front, to the side and up, in so many frames: what people do is on no dog's path."""
TRIANGLES = 7000
FRAMES = 24


@dataclass(frozen=True, slots=True)
class Skin:
    """vertices (v, 3), faces (f, 3), and of each bone its name, place, rotation (w, x, y, z), and weights (v,)."""

    vertices: Samples
    faces: Array
    names: list[str]
    places: Samples
    turns: Samples
    weights: Samples


def read_skin(path: Path) -> Skin:
    """MuJoCo's binary skin (skn)."""
    data = path.read_bytes()
    v, t, f, b = struct.unpack_from("<4i", data)
    at = 16
    vertices = np.frombuffer(data, "<f4", 3 * v, at).reshape(v, 3).astype(float)
    at += 12 * v + 8 * t
    faces = np.frombuffer(data, "<i4", 3 * f, at).reshape(f, 3)
    at += 12 * f
    names, places, turns, weights = [], np.empty((b, 3)), np.empty((b, 4)), np.zeros((v, b))
    for k in range(b):
        names.append(data[at : at + 40].split(b"\0")[0].decode())
        places[k], turns[k] = np.frombuffer(data, "<f4", 3, at + 40), np.frombuffer(data, "<f4", 4, at + 52)
        (n,) = struct.unpack_from("<i", data, at + 68)
        at += 72
        weights[np.frombuffer(data, "<i4", n, at), k] = np.frombuffer(data, "<f4", n, at + 4 * n)
        at += 8 * n
    return Skin(vertices, faces, names, places, turns, weights / weights.sum(axis=1, keepdims=True))


def simpler(skin: Skin, triangles: int) -> Skin:
    """The skin with so many triangles; a vertex has the weights of the nearest of the old ones."""
    import fast_simplification
    from scipy.spatial import cKDTree

    welded, which = np.unique(
        skin.vertices.round(6), axis=0, return_inverse=True
    )  # they are apart along the texture's seams
    share = 1.0 - triangles / len(skin.faces)
    vertices, faces = fast_simplification.simplify(welded.astype("f4"), which.ravel()[skin.faces].astype("i4"), share)
    used = np.unique(faces)
    faces, vertices = np.searchsorted(used, faces), np.asarray(vertices, float)[used]
    _, nearest = cKDTree(skin.vertices).query(vertices)
    return Skin(vertices, faces, skin.names, skin.places, skin.turns, skin.weights[nearest])


class Dog:
    """The dog's joints in MuJoCo, and the skin that they move."""

    def __init__(self, assets: Path) -> None:
        import mujoco

        self.mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_path(str(assets / "dog.xml"))
        self.data = mujoco.MjData(self.model)
        self.skin = simpler(read_skin(assets / "dog_assets" / "dog_skin.skn"), TRIANGLES)
        self.bodies = [self.model.body(name).id for name in self.skin.names]
        self.rest = self.model.qpos0.copy()

    def joint(self, name: str) -> Any:
        return self.model.joint(name)

    def paw(self, leg: str) -> Samples:
        return np.array(self.data.body(LEGS[leg][0]).xpos)

    def place(self, qpos: Samples) -> None:
        self.data.qpos[:] = qpos
        self.mujoco.mj_kinematics(self.model, self.data)

    def reach(self, qpos: Samples, leg: str, wanted: Samples) -> None:
        """Put angles into `qpos` that bring a paw to `wanted`, level as at rest, as near to those at rest as can be."""
        from scipy.optimize import least_squares

        body, joints = LEGS[leg]
        at = [int(self.joint(name).qposadr[0]) for name in joints]
        low, high = np.array([self.joint(name).range for name in joints]).T

        def off(angles: Samples) -> Samples:
            qpos[at] = angles
            self.place(qpos)
            level = np.array(self.data.body(body).xmat).reshape(3, 3) - self.level[leg]
            return np.concatenate([self.paw(leg) - wanted, 0.02 * level.ravel(), 0.002 * (angles - self.rest[at])])

        start = np.clip(self.rest[at], low + 1e-3, high - 1e-3)
        qpos[at] = least_squares(off, start, bounds=(low, high)).x

    def frames(self) -> Samples:
        """Vertices (n, v, 3), y up, facing z: strides, and paws anywhere about their places."""
        self.place(self.rest)
        stands = {leg: self.paw(leg) for leg in LEGS}
        self.level = {leg: np.array(self.data.body(body).xmat).reshape(3, 3) for leg, (body, _) in LEGS.items()}
        made, random = [], np.random.default_rng(9)
        for k in range(len(STRIDES) * FRAMES + ABOUT):
            phase, qpos = k / FRAMES % 1.0, self.rest.copy()
            qpos[2] += 0.006 * np.cos(4 * np.pi * phase) - 0.012
            for name, size, when in (("C_5_extend", 0.10, 0.1), ("C_3_extend", 0.06, 0.1), ("C_1_extend", -0.08, 0.1)):
                qpos[self.joint(name).qposadr[0]] += size * np.cos(4 * np.pi * (phase - when))
            for number in range(2, 21, 2):
                qpos[self.joint(f"Ca_{number}_bend").qposadr[0]] += 0.12 * np.sin(2 * np.pi * (phase - 0.03 * number))
            for leg in LEGS:
                if k < len(STRIDES) * FRAMES:
                    way = path((phase - WALK[leg]) % 1.0, *STRIDES[k // FRAMES])
                else:
                    way = random.uniform((-1, -1, 0), 1) * ABOUT_M
                self.reach(qpos, leg, stands[leg] + way)
            self.place(qpos)
            made.append(self.skinned())
        return np.array(made)

    def skinned(self) -> Samples:
        """The vertices, y up, facing z."""
        skin, made = self.skin, np.zeros_like(self.skin.vertices)
        for k, body in enumerate(self.bodies):
            turn = np.empty(9)
            self.mujoco.mju_quat2Mat(turn, skin.turns[k])
            change = np.array(self.data.xmat[body]).reshape(3, 3) @ turn.reshape(3, 3).T
            made += skin.weights[:, k : k + 1] * ((skin.vertices - skin.places[k]) @ change.T + self.data.xpos[body])
        return made[:, [1, 2, 0]]


def path(phase: float, stride: float, lift: float) -> Samples:
    """Where a paw is from its place at rest (m; x to the front, z up): back along the floor, then forward in the air."""
    if phase < STANDS:
        return np.array([stride * (0.5 - phase / STANDS), 0.0, 0.0])
    swing = (phase - STANDS) / (1.0 - STANDS)
    return np.array([stride * (-0.5 * np.cos(np.pi * swing)), 0.0, lift * np.sin(np.pi * swing) ** 2])


def marked(vertices: Samples, skin: Skin) -> dict[str, int]:
    """The vertices (in y up) that markers stand for: under each paw, on the withers, on the croup."""

    def nearest(bone: str, low: bool) -> int:
        of = np.flatnonzero(skin.weights[:, skin.names.index(bone)] > 0.5)
        middle = vertices[of].mean(axis=0)
        wanted = [middle[0], vertices[of, 1].min() if low else vertices[of, 1].max(), middle[2]]
        return int(of[np.linalg.norm(vertices[of] - wanted, axis=1).argmin()])

    made = {f"hoof_{leg}": nearest(body, True) for leg, (body, _) in LEGS.items()}
    return {**made, "withers": nearest("torso", False), "croup": nearest("pelvis", False)}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.steering_dog", description=__doc__)
    parser.add_argument("--assets", type=Path, help="dm_control/suite; left out: of the package that is installed")
    parser.add_argument("--keep", type=Path, help="an .npz for the frames")
    given = parser.parse_args()
    if given.assets is None:
        from importlib.util import find_spec

        spec = find_spec("dm_control")
        assert spec and spec.submodule_search_locations, "pip install dm_control"
        given.assets = Path(spec.submodule_search_locations[0]) / "suite"
    dog = Dog(given.assets)
    frames = dog.frames()
    faces = dog.skin.faces
    names = marked(frames[0], dog.skin)
    if given.keep:
        np.savez_compressed(given.keep, frames=frames, faces=faces, **{f"at.{name}": v for name, v in names.items()})
    mesh = Topology(frames.shape[1], faces.astype(np.int32), "dog")
    model = fit_steering(frames, mesh.faces, names, ("withers", "croup"), LIMBS, count=26, modes=3)
    header, arrays = to_arrays(model, mesh, LIMBS)
    origin = "skin of dm_control's dog (Apache-2.0), gait by bench/steering_dog.py"
    small = {name: a.astype(np.float32) if a.dtype == np.float64 else a for name, a in arrays.items()}
    write_model(MODELS["dog"], KIND, {**header, "axes": BODY.facts(), "origin": origin}, small)


if __name__ == "__main__":
    main()
