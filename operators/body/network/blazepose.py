"""A pose network on this computer: BlazePose through LiteRT, one thread, the same bits for the same image."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinegraph.operators.body.network.crop import Single
from kinegraph.operators.body.network.published import POSE, interpreter
from kinegraph.stream.chunk import Samples

SIZE, POINTS = 256, 39
"""Pixels along a side of what the network takes; how many points it gives: 33 landmarks and six that help."""
READ = ((1, 195), (1, 1), (1, 64, 64, POINTS), (1, 117))
"""The outputs that are read, by shape: points, presence, heat, points in metres. A mask of the person is not: depth says it better."""


class Raw(NamedTuple):
    """The network's output: points (39, 5) in its pixels with logits, presence, heat (k, k, 39), world (39, 3) in metres."""

    points: Samples
    presence: float
    heat: Single
    world: Samples


def default_model() -> Path:
    """Where `kinegraph files fetch pose-model` keeps the network."""
    return POSE.default()


def model_path(model: str) -> Path:
    """The file that a parameter `model` names; checked. Raises ParameterError."""
    return POSE.path("model", model)


def look(path: str, image: Single) -> Raw:
    """What the network sees in `image` (256, 256, 3) float32, 0 to 1."""
    network, given, outputs = _interpreter(path)
    network.set_tensor(given, image[None])
    network.invoke()
    points, presence, heat, world = (network.get_tensor(index)[0] for index in outputs)
    return Raw(
        points.reshape(POINTS, 5).astype(np.float64),
        float(presence[0]),
        heat,
        world.reshape(POINTS, 3).astype(np.float64),
    )


def _interpreter(path: str) -> tuple[Any, int, list[int]]:
    return interpreter(path, READ, POSE.what, "model")
