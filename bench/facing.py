"""`python -m bench.facing FILE.npz`: trains the small network that says where a body's shape faces (operators/body/facing.py).

Needs the folder that KINEGRAPH_DATA names. Poses of 13 motion sequences on one mesh, at random headings, are rendered with the camera's
noise; a hidden layer learns the heading of shoulders and hips from the shape. Then the headings of another mesh in four other sequences are
reported, and the share that is turned round is printed. `--poses N`: how many are rendered; 4000 take some minutes.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.body_render import JOINTS, Studio, studio
from kinegraph.operators.body.facing import CELLS, facing_of, shape_of
from kinegraph.stream.data.model_file import write_model

HELD_OUT = ("14_14", "02_01", "13_29", "01_05")
"""Sequences that are not trained on: those of bench.body's other clips."""
HIDDEN, EPOCHS, BATCH, RATE, DECAY = 32, 60, 64, 2e-3, 1e-4
NEARER = 0.97
"""A pixel is the person's where its depth is less than this share of the room's."""


def heading(joints: Any, names: list[str]) -> NDArray[np.float64]:
    """Where `joints` (31, 3), in the camera's axes, face: x and z, of length 1, square to shoulders and hips."""
    at = [names.index(JOINTS[k]) for k in (1, 2, 7, 8)]
    across = joints[at[0]] - joints[at[1]] + joints[at[2]] - joints[at[3]]
    ahead = np.array([across[2], -across[0]])
    return ahead / np.linalg.norm(ahead)


def rendered(room: Studio, sequences: list[str], n: int, random: np.random.Generator) -> tuple[Any, Any]:
    """Shapes (n, 1152) of random poses at random headings, and where each faces (n, 2)."""
    shapes, headings = np.empty((n, 2, CELLS, CELLS)), np.empty((n, 2))
    for i in range(n):
        sequence = sequences[random.integers(len(sequences))]
        k = int(random.integers(len(room.motion[f"root_{sequence}"])))
        rotations, joints = room.poses(sequence, k, k + 1, float(random.uniform(0, 360)))
        depth, _ = room.frame(rotations[0], joints[0], random)
        shape_of(np.where(depth < NEARER * 1000 * room.room, depth, 0).astype(np.uint16), shapes[i])
        headings[i] = heading((joints[0] - room.place) @ room.axes.T, room.names)
    return shapes.reshape(n, -1), headings


def trained(x: Any, y: Any, random: np.random.Generator) -> dict[str, Any]:
    """Weights that tell headings `y` (n, 2) from shapes `x` (n, 1152): least squares by Adam, so that a doubtful one becomes short."""
    weights = [
        random.normal(0, (2 / x.shape[1]) ** 0.5, (x.shape[1], HIDDEN)), np.zeros(HIDDEN),
        random.normal(0, HIDDEN**-0.5, (HIDDEN, 2)), np.zeros(2),
    ]  # fmt: skip
    means, squares, step = [np.zeros_like(w) for w in weights], [np.zeros_like(w) for w in weights], 0
    for epoch in range(EPOCHS):
        order = random.permutation(len(x))
        for at in range(0, len(x), BATCH):
            rows, step = order[at : at + BATCH], step + 1
            layer = np.maximum(x[rows] @ weights[0] + weights[1], 0.0)
            error = (layer @ weights[2] + weights[3] - y[rows]) / len(rows)
            back = (error @ weights[2].T) * (layer > 0)
            slopes = [x[rows].T @ back + DECAY * weights[0], back.sum(0), layer.T @ error, error.sum(0)]
            for w, slope, mean, square in zip(weights, slopes, means, squares, strict=True):
                mean += 0.1 * (slope - mean)
                square += 0.001 * (slope**2 - square)
                rate = RATE * (1 - epoch / EPOCHS)
                w -= rate * (mean / (1 - 0.9**step)) / (np.sqrt(square / (1 - 0.999**step)) + 1e-8)
    names = ("hidden", "hidden_bias", "out", "out_bias")
    return {name: w.astype(np.float32) for name, w in zip(names, weights, strict=True)}


def turned_round(weights: dict[str, Any], x: Any, y: Any) -> float:
    """The share of shapes with a heading more than 90 degrees off."""
    kept = [weights[name].astype(float) for name in ("hidden", "hidden_bias", "out", "out_bias")]
    result = np.empty(2)
    wrong = 0
    for shape, truth in zip(x, y, strict=True):
        facing_of(shape.reshape(2, CELLS, CELLS), *kept, result)
        wrong += float(result @ truth) < 0.0
    return wrong / len(x)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.facing", description=__doc__)
    parser.add_argument("output", type=Path, help="the model to write (.npz)")
    parser.add_argument("--poses", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    folder, random = Path(os.environ["KINEGRAPH_DATA"]) / "body", np.random.default_rng(given.seed)
    room = studio(folder, "male")
    sequences = sorted(name[5:] for name in room.motion if name.startswith("root_") and name[5:] not in HELD_OUT)
    weights = trained(*rendered(room, sequences, given.poses, random), random)
    x, y = rendered(studio(folder, "female"), list(HELD_OUT), max(50, given.poses // 8), random)
    share = turned_round(weights, x, y)
    text = f"{given.poses} rendered poses of one mesh in {len(sequences)} motion sequences, at random headings"
    write_model(given.output, "facing", {"trained_on": text}, weights)
    print(f"{given.output}: of {len(x)} poses of another mesh and other sequences {100 * share:.1f} % are turned round")


if __name__ == "__main__":
    main()
