"""`python -m bench.steering_figures DATA docs/pictures`: two people steer a horse, a dog's gaits on a galloping horse (thesis, 9.1, 9.6).

DATA holds steering/horse-gallop.npz, steering/dog_mocap_joints.npz, body/cmu_mocap_30hz.npz and body/human_male.npz. Writes
steering-actors.png and steering-transfer.png, and prints what they show in numbers: how well each hoof follows its foot.
"""

from __future__ import annotations

import argparse
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np

from bench.pose import sequences
from bench.steering import HOOVES, markers_of
from kinegraph.operators.steering.actors import Actors
from kinegraph.operators.steering.model.adapt import PAIRINGS, RANGES, Pairing, Ranges, about, adapt
from kinegraph.operators.steering.model.choose import regression_of
from kinegraph.operators.steering.model.fit import Steering, fit_steering, headings, turned
from kinegraph.operators.steering.model.pose_parameters import MarkerGraph
from kinegraph.stream.chunk import Array, Chunk, Samples, StreamSpec
from kinegraph.stream.data.model_file import write_model
from kinegraph.stream.domain.humanoid import BONES, PARENTS
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.operator import grid

MARKERS = (*HOOVES, "nose", "withers", "croup")
REFERENCE, HEADING = ("withers", "croup"), ("croup", "withers")
DOG = {"hoof_fl": 10, "hoof_fr": 15, "hoof_hl": 19, "hoof_hr": 23, "nose": 5, "withers": 3, "croup": 1}
"""Joints of the dog: paws, head, the neck's root, the hips."""
DOG_BONES = (*pairwise((5, 4, 3, 2, 1, 24, 25, 26)), *pairwise((3, 7, 8, 9, 10)), *pairwise((3, 12, 13, 14, 15)),
             *pairwise((1, 16, 17, 18, 19)), *pairwise((1, 20, 21, 22, 23)))  # fmt: skip
GAITS = ("dog_walk00", "dog_run04")
LEARNED, PLAYED = 100, 50
"""Frames at 30 Hz, one after the other, where the dog goes fastest: what the model is fitted to, and what is shown."""
ACTORS = (("02_01", "first"), ("02_02", "second"))
SHOWN = 6


def fitted(frames: Samples, faces: Array) -> Steering:
    """The horse, each leg by its own hoof."""
    return fit_steering(frames, faces, marked(frames), REFERENCE, HOOVES, heading=HEADING)


def marked(frames: Samples) -> dict[str, int]:
    every = markers_of(frames[0])
    return {name: every[name] for name in MARKERS}


def follows(made: Samples, meant: Samples) -> float:
    """The correlation of two movements (n,)."""
    return float(np.corrcoef(made, meant)[0, 1])


def draw(axis: Any, points: Samples, faces: Array, skin: str = "#8fa8c8") -> None:
    """A mesh from its left side, lit from above, far triangles first."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb

    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    towards = normals[:, 0] > 0
    light = np.clip(0.45 + 0.55 * normals[:, 1] * 0.6 + 0.35 * normals[:, 0], 0.15, 1.0)
    order = np.argsort(corners[..., 0].mean(axis=1))
    order = order[towards[order]]
    colours = light[order, None] * np.array(to_rgb(skin))
    axis.add_collection(
        PolyCollection(
            corners[order][..., [2, 1]] * [-1.0, 1.0], facecolors=colours, edgecolors=colours, linewidths=0.4
        )
    )


def frame_axes(axis: Any, low: float, high: float, wide: float) -> None:
    axis.set_xlim(-wide, wide)
    axis.set_ylim(low, high)
    axis.set_aspect("equal")
    axis.set_axis_off()


def sticks(axis: Any, points: Samples, bones: Any, colour: str, marked: Any = ()) -> None:
    for a, b in bones:
        axis.plot(-points[[a, b], 2], points[[a, b], 1], color=colour, linewidth=1.6, solid_capstyle="round")
    for k in marked:
        axis.plot(-points[k, 2], points[k, 1], "o", color="#d62728", markersize=4)


def actors(
    tree: JointTree, motion: dict[str, Samples], model: Steering, count: int, folder: Path
) -> tuple[list[Samples], Samples]:
    """Two people's joints (n, 22, 3), walking on the spot side by side, and the horse that their three markers each steer."""
    body = [BONES.index(name) for name in ("Hips", "LeftFoot", "RightFoot")]
    people = []
    for sequence, _ in ACTORS:
        joints = joints_of(tree, motion[sequence])[1]
        on_the_spot = joints - joints[:, :1] * [1.0, 0.0, 1.0]
        people.append(np.concatenate([on_the_spot, on_the_spot[::-1]] * 2)[:240])
    n = min(map(len, people))
    people = [joints[:n] for joints in people]
    marks = np.concatenate([joints[:, body] for joints in people], axis=1)
    names = tuple(f"{who}.{part}" for _, who in ACTORS for part in ("hip", "foot_l", "foot_r"))
    limbs = {
        f"hoof_{end}{side}": (f"{who}.foot_{side}", f"{who}.hip")
        for end, who in (("f", "first"), ("h", "second"))
        for side in "lr"
    }
    operator = Actors(limbs=limbs, model=folder / "horse.npz", learn_s=2.0)
    operator.open({"in": StreamSpec((6, 3), rate_hz=30.0, channels=names, units=("m",))})
    made = operator.process("in", Chunk(grid(30.0, n), marks.reshape(n, -1), 0)).data
    horse = model(made, count)
    for leg, (foot, hip) in limbs.items():
        moved = marks[60:, names.index(foot), 2] - marks[60:, names.index(hip), 2]
        hoof = horse[60:, model.vertices[model.markers.index(leg)], 2]
        print(f"{leg} follows {foot}: correlation {follows(hoof, moved):.2f}")
    return people, horse


def picture_actors(path: Path, people: list[Samples], horse: Samples, faces: Array) -> None:
    from matplotlib import pyplot

    bones = [(BONES.index(parent), BONES.index(bone)) for bone, parent in PARENTS.items() if parent]
    marked = [BONES.index(name) for name in ("Hips", "LeftFoot", "RightFoot")]
    figure, axes = pyplot.subplots(2, SHOWN, figsize=(11, 4.2), gridspec_kw={"height_ratios": (1, 1.15)})
    for column, k in enumerate(np.linspace(70, 70 + 34, SHOWN).astype(int)):
        for joints, colour, aside in ((people[0], "#1f4e79", -0.55), (people[1], "#a05a00", 0.55)):
            sticks(axes[0, column], joints[k] - [0.0, 0.0, aside], bones, colour, marked)
        frame_axes(axes[0, column], -0.1, 1.9, 1.25)
        draw(axes[1, column], horse[k] - horse[k].mean(axis=0) * [1, 0, 1], faces)
        frame_axes(axes[1, column], -0.1, 2.0, 1.4)
    figure.subplots_adjust(0, 0, 1, 1, 0, 0)
    figure.savefig(path, dpi=80)
    pyplot.close(figure)


def picture_transfer(
    path: Path, frames: Samples, faces: Array, rows: list[tuple[str, Samples, Samples, Samples]]
) -> None:
    """The gallop, and below it each gait: the dog and the horse, in frames with the same right fore leg in each column."""
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1 + 2 * len(rows), SHOWN, figsize=(11, 2.0 + 3.2 * len(rows)))
    columns = np.linspace(0, len(frames) - 1, SHOWN).astype(int)
    hoof = markers_of(frames[0])["hoof_fr"]
    for column, k in enumerate(columns):
        draw(axes[0, column], frames[k] - frames[k].mean(axis=0) * [1, 0, 1], faces, "#b0a090")
        frame_axes(axes[0, column], -0.1, 2.0, 1.4)
        for r, (_, joints, marks, horse) in enumerate(rows):
            leg = horse[:, hoof] - horse.mean(axis=1)
            meant = frames[k, hoof] - frames[k].mean(axis=0)
            at = int(((leg - meant) ** 2).sum(axis=1).argmin())
            sticks(axes[1 + 2 * r, column], joints[at], DOG_BONES, "#1f4e79")
            axes[1 + 2 * r, column].plot(-marks[at, :, 2], marks[at, :, 1], "o", color="#d62728", markersize=4)
            frame_axes(axes[1 + 2 * r, column], -0.1, 0.85, 0.6)
            draw(axes[2 + 2 * r, column], horse[at] - horse[at].mean(axis=0) * [1, 0, 1], faces)
            frame_axes(axes[2 + 2 * r, column], -0.1, 2.0, 1.4)
    for k, title in enumerate(["gallop", *(title for title, *_ in rows)]):
        axes[max(0, 2 * k - 1), 0].set_title(title, loc="left", fontsize=9)
    figure.subplots_adjust(0, 0, 1, 0.97, 0, 0.06)
    figure.savefig(path, dpi=80)
    pyplot.close(figure)


def height(model: Steering, frames: Samples) -> float:
    """How high the reference of the mesh is in its own frames, in the mean."""
    return float(frames[:, model.vertices[model.reference], 1].mean())


def transferred(
    model: Steering,
    frames: Samples,
    dog: Samples,
    ranges: Ranges = "positions",
    pairing: Pairing = "nearest",
    graph: MarkerGraph | None = None,
) -> tuple[Samples, Samples, Samples]:
    """Joints, markers and horse (n, ..., 3) of a gait, on the spot and facing as the horse, in frames that the model was not fitted to."""
    every = dog[::2].astype(float)
    marks = every[:, list(DOG.values())]
    hips = marks[:, model.markers.index("croup"), [0, 2]]
    went = np.linalg.norm(hips[LEARNED + PLAYED :] - hips[: -LEARNED - PLAYED], axis=1)
    begin = int(went.argmax())
    adapted = adapt(model, frames[:, model.vertices], marks[begin : begin + LEARNED], (), ranges, pairing, graph)
    shown = slice(begin + LEARNED, begin + LEARNED + PLAYED)
    horse = adapted(marks[shown], frames.shape[1])
    spot = about(adapted, horse[:, model.vertices], adapted.facing)
    feet = about(adapted, marks[shown], adapted.facing)
    for name in HOOVES:
        k = model.markers.index(name)
        print(f"{name} follows its paw: correlation {follows(spot[:, k, 2], feet[:, k, 2]):.2f}")
    centre = marks[shown][:, model.reference].mean(axis=1, keepdims=True)
    both = np.concatenate([every[shown], marks[shown]], axis=1) - centre
    back = headings(marks[shown], adapted.facing) * [1.0, -1.0]
    both = turned(both, back) + np.array([0.0, float(centre[:, 0, 1].mean()), 0.0])
    still = turned(horse - centre * adapted.reach, back) + np.array([0.0, height(model, frames), 0.0])
    return both[:, : every.shape[1]], both[:, every.shape[1] :], still


def main() -> None:
    import matplotlib

    matplotlib.use("Agg")
    parser = argparse.ArgumentParser(prog="python -m bench.steering_figures", description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("docs", type=Path)
    given = parser.parse_args()
    horse = np.load(given.data / "steering" / "horse-gallop.npz")
    frames, faces = horse["vertices"].astype(float), horse["faces"]
    model = fitted(frames, faces)
    saved(model, frames.shape[1], faces, given.docs)
    try:
        people, steered = actors(*sequences(given.data / "body"), model, frames.shape[1], given.docs)
    finally:
        (given.docs / "horse.npz").unlink()
    picture_actors(
        given.docs / "steering-actors.png", people, steered + np.array([0.0, height(model, frames), 0.0]), faces
    )
    dog = np.load(given.data / "steering" / "dog_mocap_joints.npz")
    graph = regression_of(frames, faces, marked(frames), REFERENCE, HOOVES, HEADING, "angles").graph
    for ranges, pairing in product(RANGES, PAIRINGS):
        for name in GAITS:
            print(f"{name}, ranges of {ranges}, pairing by {pairing}:")
            transferred(model, frames, dog[name], ranges, pairing, graph)
    rows = [(name.replace("_", ": "), *transferred(model, frames, dog[name])) for name in GAITS]
    picture_transfer(given.docs / "steering-transfer.png", frames, faces, rows)


def saved(model: Steering, count: int, faces: Array, folder: Path) -> None:
    from kinegraph.operators.steering.model.stored import KIND, to_arrays
    from kinegraph.stream.domain.mesh import Topology

    header, arrays = to_arrays(model, Topology(count, faces.astype(np.int32), "horse"), HOOVES)
    write_model(folder / "horse.npz", KIND, header, arrays)


if __name__ == "__main__":
    main()
