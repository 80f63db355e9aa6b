"""`python -m bench.steering_meshes DATA [MESH]`: what `motion train steering` chooses, beside three baselines, on every mesh.

DATA holds steering/horse-gallop.npz, steering/samba.npz, body/human_*.npz and body/cmu_mocap_30hz.npz. Humans are skinned meshes that
motion capture moves (60 frames, every third of six seconds), the quadruped is the simulated one. Errors are of the frames that were not
trained on, mean, in percent of the diagonal. Baselines choose by leaving training frames out, as in bench/steering_peers.py.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.body_render import studio
from bench.steering import PARTS, REFERENCE, markers_of, spread_markers
from bench.steering_peers import components, global_pca, skinning
from kinegraph.devices.people.quadruped import marked, topology, walking
from kinegraph.operators.steering.model.choose import choose
from kinegraph.operators.steering.model.parts import edges_of, near_rigid_parts
from kinegraph.stream.chunk import Array, Samples

HUMANS = {"human male": ("male", "13_29"), "human female": ("female", "01_02")}


@dataclass(frozen=True, slots=True)
class MovingMesh:
    """Frames (f, vertices, 3), faces, and the vertices of markers; every how many frames train, in turn."""

    frames: Samples
    faces: Array
    markers: Mapping[str, int]
    reference: Sequence[str]
    densities: tuple[int, ...]


def meshes(data: Path) -> Iterator[tuple[str, MovingMesh]]:
    horse = np.load(data / "steering" / "horse-gallop.npz")
    frames = horse["vertices"].astype(float)
    yield "horse", MovingMesh(frames, horse["faces"], markers_of(frames[0]), REFERENCE, (2, 3))
    samba = np.load(data / "steering" / "samba.npz")
    yield "samba", spread(samba["vertices"].astype(float), samba["faces"], (2, 4, 8))
    for name, (mesh, sequence) in HUMANS.items():
        place = studio(data / "body", mesh)
        turns, joints = place.poses(sequence, 60, 240, 0.0)
        posed = [place.skin(turn, joint) for turn, joint in zip(turns[::3], joints[::3], strict=True)]
        yield name, spread(np.array(posed), place.body["faces"], (2, 4, 6))
    stride = np.array([walking(k / 48) for k in range(48)])
    yield "quadruped", MovingMesh(stride, topology().faces, marked(), REFERENCE, (2, 4))


def spread(frames: Samples, faces: Array, densities: tuple[int, ...]) -> MovingMesh:
    markers = spread_markers(frames[0], faces)
    return MovingMesh(frames, faces, markers, tuple(markers), densities)


def compared(mesh: MovingMesh, every: int) -> tuple[str, dict[str, float]]:
    """What was chosen, and by what each way is off in the mean."""
    rows = np.arange(len(mesh.frames)) % every == 0
    train, test = mesh.frames[rows], mesh.frames[~rows]
    diagonal = float(np.linalg.norm(np.ptp(train[0], axis=0)))
    model, way, _, _ = choose(train, mesh.faces, mesh.markers, mesh.reference)
    x, centre, _ = model.features(train[:, model.vertices])
    query, moved, _ = model.features(test[:, model.vertices])
    shapes = (train - centre).reshape(len(train), -1)
    mean, scores, directions = components(
        shapes, len(train)
    )  # nothing is lost; principal components of the scores are as many fewer numbers
    made = {
        f"chosen ({way})": model(test[:, model.vertices], test.shape[1]),
        "skinning": _skinned(x, shapes, query, near_rigid_parts(train, edges_of(mesh.faces), PARTS)) + moved,
        "global PCA": (global_pca(x, scores)(x, scores, query) @ directions + mean).reshape(test.shape) + moved,
        "nearest": shapes[((query[:, None] - x[None]) ** 2).sum(-1).argmin(axis=1)].reshape(test.shape) + moved,
    }
    return way, {name: 100 * float(np.linalg.norm(one - test, axis=-1).mean()) / diagonal for name, one in made.items()}


def _skinned(x: Samples, shapes: Samples, query: Samples, part: Array) -> Samples:
    return skinning(x, shapes, part)(x, shapes, query).reshape(len(query), -1, 3)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.steering_meshes", description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("only", nargs="?", help="one mesh, by the beginning of its name")
    given = parser.parse_args()
    print("mesh | frames trained | chosen | skinning | global PCA | nearest")
    for name, mesh in meshes(given.data):
        if not name.startswith(given.only or ""):
            continue
        for every in mesh.densities:
            way, off = compared(mesh, every)
            count = len(mesh.frames[::every])
            print(f"{name} | {count} | {way} | {' | '.join(f'{error:.3f}' for error in off.values())}", flush=True)


if __name__ == "__main__":
    main()
