"""`python -m bench.steering FOLDER`: a mesh from nine markers, frames that were not trained on, beside what it could be done with instead.

FOLDER holds horse-gallop.npz (vertices (24, 8431, 3), faces): even frames train, odd ones test. Errors are in percent of the diagonal.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from bench.steering_peers import canonical, global_pca, skinning
from operators.steering.fit import Steering, fit_steering
from operators.steering.operator import SteerMesh
from operators.steering.parts import edges_of, near_rigid_parts
from operators.steering.regression import learn
from operators.steering.stored import KIND, to_arrays
from stream.chunk import Array, Chunk, Samples, StreamSpec
from stream.mesh import Topology
from stream.model import write_model

REFERENCE = ("withers", "croup")
PARTS = 14
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


def told(name: str, made: Samples, truth: Samples, diagonal: float) -> None:
    error = 100.0 * np.linalg.norm(made - truth, axis=-1) / diagonal
    print(f"{name} | {error.mean():.3f} | {np.percentile(error, 95):.2f} | {error.max():.2f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.steering", description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    horse = np.load(folder / "horse-gallop.npz")
    frames, faces = horse["vertices"].astype(float), horse["faces"]
    train, test = frames[::2], frames[1::2]
    diagonal = float(np.linalg.norm(np.ptp(train[0], axis=0)))
    markers = markers_of(train[0])
    began = time.perf_counter()
    model = fit_steering(train, faces, markers, REFERENCE)
    print(f"trained in {time.perf_counter() - began:.1f} s, {len(model.parts)} parts")
    print(f"live: {live(model, frames, faces):.0f} us a frame of {frames.shape[1]} vertices, median")
    print("method | mean % | p95 % | max %")
    marks = test[:, model.vertices]
    told("part model, kernel ridge", model(marks, frames.shape[1]), test, diagonal)
    peers(model, train, test, diagonal, faces)


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
    told("nearest training frame", shapes[nearest].reshape(test.shape) + moved, test, diagonal)
    straight = learn(x, shapes)
    told("kernel ridge straight to vertices", straight(query).reshape(test.shape) + moved, test, diagonal)
    mean, ones = shapes.mean(axis=0), x.mean(axis=0)
    left = (x - ones).T @ (x - ones)
    weights = np.linalg.solve(
        left + 1e-2 * np.trace(left) / len(left) * np.eye(len(left)), (x - ones).T @ (shapes - mean)
    )
    told("linear ridge to vertices", ((query - ones) @ weights + mean).reshape(test.shape) + moved, test, diagonal)
    part = near_rigid_parts(train, edges_of(faces), PARTS)
    others = {
        "linear blend skinning, regressed motions": skinning(x, shapes, part),
        "global PCA, ridge": global_pca(x, shapes),
        "linear CCA": canonical(x, shapes, kernel=False),
        "kernel CCA": canonical(x, shapes, kernel=True),
    }
    for name, peer in others.items():
        told(name, peer(x, shapes, query).reshape(test.shape) + moved, test, diagonal)
    apart = np.sqrt(((query[:, None] - x[None]) ** 2).sum(-1).min(axis=1))
    among = np.sqrt(((x[:, None] - x[None]) ** 2).sum(-1) + np.diag(np.full(len(x), np.inf))).min(axis=1)
    print(
        f"nearest training pose, markers: {np.median(apart):.3f} from test frames, {np.median(among):.3f} among themselves"
    )


if __name__ == "__main__":
    main()
