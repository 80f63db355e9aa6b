"""`python -m bench.steering FOLDER`: a mesh from nine markers, frames that were not trained on, beside what it could be done with instead.

FOLDER holds horse-gallop.npz (vertices (24, 8431, 3), faces): even frames train, odd ones test; and, for `--mesh samba`, samba.npz
(vertices (88, 9971, 3), faces): every fourth frame trains, thirteen markers far from one another. Errors are in percent of the diagonal.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from bench.steering_peers import canonical, global_pca, skinning
from kinegraph.operators.steering.model.choose import choose, regression_of
from kinegraph.operators.steering.model.fit import Layout, Steering, fit_steering
from kinegraph.operators.steering.model.parts import edges_of, near_rigid_parts
from kinegraph.operators.steering.model.pose_parameters import POSES
from kinegraph.operators.steering.model.regression import REGRESSIONS, learn
from kinegraph.operators.steering.model.stored import KIND, to_arrays
from kinegraph.operators.steering.operator import SteerMesh
from kinegraph.stream.chunk import Array, Chunk, Samples, StreamSpec
from kinegraph.stream.data.model_file import write_model
from kinegraph.stream.domain.mesh import Topology

REFERENCE = ("withers", "croup")
PARTS = 14
ENDS = ("m1", "m2", "m3", "m4")
"""The samba's first four: what lies farthest from the middle and from one another."""
HOOVES = ("hoof_fl", "hoof_fr", "hoof_hl", "hoof_hr")


def markers_of(rest: Samples) -> dict[str, int]:
    """The vertices of hooves, nose, tail, poll, withers and croup of the horse."""

    def near(place: tuple[float, float, float]) -> int:
        return int(((rest - np.array(place)) ** 2).sum(1).argmin())

    high = rest[rest[:, 1] > 0.8]
    return {
        "hoof_hr": near((-0.10, 0.15, -0.99)),
        "hoof_fr": near((-0.117, 0.015, 0.095)),
        "hoof_hl": near((0.117, 0.01, -0.73)),
        "hoof_fl": near((0.102, 0.11, 0.79)),
        "nose": near(tuple(high[high[:, 2].argmax()])),
        "tail": int(rest[:, 2].argmin()),
        "poll": int(rest[:, 1].argmax()),
        "withers": near((0.0, 1.0, 0.1)),
        "croup": near((0.0, 1.0, -0.6)),
    }


def spread_markers(rest: Samples, faces: Array, count: int = 12) -> dict[str, int]:
    """Vertices far from one another along the surface, in turn, the first farthest from the middle; and one in the middle."""
    edges = edges_of(faces)
    long = np.maximum(np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1), 1e-12)
    graph = csr_matrix((long, (edges[:, 0], edges[:, 1])), shape=(len(rest), len(rest)))
    found = [int(((rest - rest.mean(axis=0)) ** 2).sum(axis=1).argmin())]
    nearest = dijkstra(graph, directed=False, indices=found[0])
    while len(found) <= count:
        found.append(int(np.where(np.isfinite(nearest), nearest, 0.0).argmax()))
        nearest = np.minimum(nearest, dijkstra(graph, directed=False, indices=found[-1]))
    return {f"m{k}": vertex for k, vertex in enumerate(found)}


def report(name: str, made: Samples, truth: Samples, diagonal: float) -> None:
    error = 100.0 * np.linalg.norm(made - truth, axis=-1) / diagonal
    print(f"{name} | {error.mean():.3f} | {np.percentile(error, 95):.2f} | {error.max():.2f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.steering", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--mesh", choices=("horse-gallop", "samba"), default="horse-gallop")
    parser.add_argument("--assemblies", action="store_true", help="only how parts come to fit one another")
    parser.add_argument("--every", type=int, help="which frames train: every second, third, ...")
    given = parser.parse_args()
    held = np.load(given.folder / f"{given.mesh}.npz")
    frames, faces = held["vertices"].astype(float), held["faces"]
    every = given.every or (2 if given.mesh == "horse-gallop" else 4)
    train, test = frames[::every], frames[np.arange(len(frames)) % every > 0]
    diagonal = float(np.linalg.norm(np.ptp(train[0], axis=0)))
    markers = markers_of(train[0]) if given.mesh == "horse-gallop" else spread_markers(train[0], faces)
    reference = REFERENCE if given.mesh == "horse-gallop" else tuple(markers)
    limbs = HOOVES if given.mesh == "horse-gallop" else ENDS
    if given.assemblies:
        for some in ((), limbs):
            assemblies(train, test, (faces, markers, reference, some), diagonal)
        return
    began = time.perf_counter()
    chosen, way, off, pull = choose(train, faces, markers, reference)
    print(
        f"training frames left out: {', '.join(f'{name} {error:.3f} %' for name, error in off.items())}; chosen: {way}"
    )
    print(f"how markers pull: {pull}")
    print(f"chosen and trained in {time.perf_counter() - began:.1f} s")
    began = time.perf_counter()
    model = fit_steering(train, faces, markers, reference)
    print(f"trained in {time.perf_counter() - began:.1f} s, {len(model.parts)} parts")
    for name, one in (("parts", model), (f"chosen, {way}", chosen)):
        print(f"live: {live(one, frames, faces):.0f} us a frame of {frames.shape[1]} vertices, median ({name})")
    print("method | mean % | p95 % | max %")
    marks = test[:, model.vertices]
    report(f"chosen: {way}", chosen(marks, frames.shape[1]), test, diagonal)
    report(
        "the same, markers that do not pull",
        replace(chosen, soft=np.zeros((0, 0)))(marks, frames.shape[1]),
        test,
        diagonal,
    )
    by_parts = choose(train, faces, markers, reference, method="parts")[0]
    report("parts, markers pull", by_parts(marks, frames.shape[1]), test, diagonal)
    report("part model, kernel ridge", model(marks, frames.shape[1]), test, diagonal)
    local = choose(train, faces, markers, reference, method="local")[0]
    report("local, markers pull", local(marks, frames.shape[1]), test, diagonal)
    report("local", replace(local, soft=np.zeros((0, 0)))(marks, frames.shape[1]), test, diagonal)
    earlier = frames[np.flatnonzero(np.arange(len(frames)) % every) - 1][:, model.vertices]
    as_the_thesis(train, test, earlier, (faces, markers, reference), diagonal)
    for some in ((), limbs):
        assemblies(train, test, (faces, markers, reference, some), diagonal)
    peers(model, train, test, diagonal, faces)


def as_the_thesis(
    train: Samples, test: Samples, earlier: Samples, mesh: tuple[Array, dict[str, int], Sequence[str]], diagonal: float
) -> None:
    """The part model with what the thesis has in other places: table 9.1's parameters, linear regression, the virtual skeleton.

    earlier  (f, m, 3)  where the markers were a frame before each that is tested
    """
    layout = Layout.of(train, mesh[0], np.array(list(mesh[1].values())), PARTS)
    for pose, regression, skeleton in product(POSES, REGRESSIONS, (False, True)):
        how = regression_of(train, *mesh, pose=pose, regression=regression, skeleton=skeleton)
        model = fit_steering(train, *mesh, layout=layout, how=how)
        name = f"parts, {pose}, {regression}{', virtual skeleton' if skeleton else ''}"
        report(name, model(test[:, model.vertices], test.shape[1], earlier), test, diagonal)


def assemblies(
    train: Samples, test: Samples, mesh: tuple[Array, dict[str, int], Sequence[str], Sequence[str]], diagonal: float
) -> None:
    """How parts come to fit one another, with and without limbs: greedy alignment, shapes by 9.14, shared clusters by 9.16; no pull."""
    for greedy, optimised, shared in product((False, True), repeat=3):
        if shared and not mesh[3]:
            continue
        how = regression_of(train, *mesh, greedy=greedy, optimised=optimised, shared=shared)
        model = replace(choose(train, *mesh, method="parts", how=how)[0], soft=np.zeros((0, 0)))
        words = (greedy and "greedy", optimised and "optimised", shared and "shared")
        name = f"parts, {'limbs' if mesh[3] else 'no limbs'}, {', '.join(word for word in words if word) or 'as predicted'}"
        report(name, model(test[:, model.vertices], test.shape[1]), test, diagonal)
        if model.settling:
            print(f"  {live(model, test, mesh[0]):.0f} us a frame; {model.settling.shapes}")


def live(model: Steering, frames: Samples, faces: Array) -> float:
    """What the operator takes for a frame (us, median), one frame a chunk."""
    mesh = Topology(frames.shape[1], faces.astype(np.int32), "horse")
    header, arrays = to_arrays(model, mesh, ())
    marks = np.ascontiguousarray(frames[:, model.vertices].reshape(len(frames), -1))
    with tempfile.TemporaryDirectory() as folder:
        write_model(Path(folder) / "mesh.npz", KIND, header, arrays)
        operator = SteerMesh(model=Path(folder) / "mesh.npz")
        operator.open({"in": StreamSpec((len(model.markers), 3), rate_hz=30.0, channels=model.markers, units=("m",))})
    took = np.empty(600)
    for i in range(len(took)):
        row = marks[i % len(marks)][None]
        began = time.perf_counter()
        operator.process("in", Chunk(np.array([i * 33_000_000 + 1]), row, 0))
        took[i] = time.perf_counter() - began
    return 1e6 * float(np.median(took[1:]))


def peers(model: Steering, train: Samples, test: Samples, diagonal: float, faces: Array) -> None:
    """The nearest training frame, regressions straight to the vertices, and those of bench/steering_peers.py."""
    x, centre, _ = model.features(train[:, model.vertices])
    query, moved, _ = model.features(test[:, model.vertices])
    shapes = (train - centre).reshape(len(train), -1)
    nearest = ((query[:, None] - x[None]) ** 2).sum(-1).argmin(axis=1)
    report("nearest training frame", shapes[nearest].reshape(test.shape) + moved, test, diagonal)
    straight = learn(x, shapes)
    report("kernel ridge straight to vertices", straight(query).reshape(test.shape) + moved, test, diagonal)
    mean, ones = shapes.mean(axis=0), x.mean(axis=0)
    left = (x - ones).T @ (x - ones)
    weights = np.linalg.solve(
        left + 1e-2 * np.trace(left) / len(left) * np.eye(len(left)), (x - ones).T @ (shapes - mean)
    )
    report("linear ridge to vertices", ((query - ones) @ weights + mean).reshape(test.shape) + moved, test, diagonal)
    part = near_rigid_parts(train, edges_of(faces), PARTS)
    others = {
        "linear blend skinning, regressed motions": skinning(x, shapes, part),
        "global PCA, ridge": global_pca(x, shapes),
        "linear CCA": canonical(x, shapes, kernel=False),
        "kernel CCA": canonical(x, shapes, kernel=True),
    }
    for name, peer in others.items():
        report(name, peer(x, shapes, query).reshape(test.shape) + moved, test, diagonal)
    report(
        "the truth, as near as sums of training frames come", nearest_sum(shapes, test - moved), test - moved, diagonal
    )
    apart = np.sqrt(((query[:, None] - x[None]) ** 2).sum(-1).min(axis=1))
    among = np.sqrt(((x[:, None] - x[None]) ** 2).sum(-1) + np.diag(np.full(len(x), np.inf))).min(axis=1)
    print(
        f"nearest training pose, markers: {np.median(apart):.3f} from test frames, {np.median(among):.3f} among themselves"
    )


def nearest_sum(train: Samples, truth: Samples) -> Samples:
    """Of `truth` (f, v, 3) what the affine sums of the training's frames (n, 3 v) come nearest to, in the mean of squares.

    No regression that weighs whole frames can do better than that; one that weighs them differently in every region can.
    """
    mean = train.mean(axis=0)
    directions = np.linalg.svd(train - mean, full_matrices=False)[2][: len(train) - 1]
    off = truth.reshape(len(truth), -1) - mean
    return np.asarray(off @ directions.T @ directions + mean).reshape(truth.shape)


if __name__ == "__main__":
    main()
