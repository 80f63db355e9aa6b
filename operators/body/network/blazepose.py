"""A pose network on this computer: BlazePose through LiteRT, one thread, the same bits for the same image.

One thread, since a second one has not made it faster: its layers are so small that waking that thread takes what it saves.
"""

from __future__ import annotations

import threading
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import platformdirs

from kinegraph.operators.body.network.crop import Single
from kinegraph.operators.body.network.trimmed import trimmed
from kinegraph.stream.chunk import Samples
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.system.file_digest import bytes_of, sha256_of

SIZE, POINTS = 256, 39
"""Pixels along a side of what the network takes; how many points it gives: 33 landmarks and six that help."""
FILE = "pose_landmark_full.tflite"
SHA256 = "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f"
"""The file, and what its bytes must be, as `kinegraph files fetch pose-model` brings it."""
READ = ((1, 195), (1, 1), (1, 64, 64, POINTS), (1, 117))
"""The outputs that are read, by shape: points, presence, heat, points in metres. A mask of the person is not: depth says it better."""
_local = threading.local()
_digest = cache(sha256_of)


class Raw(NamedTuple):
    """The network's output: points (39, 5) in its pixels with logits, presence, heat (k, k, 39), world (39, 3) in metres."""

    points: Samples
    presence: float
    heat: Single
    world: Samples


def default_model() -> Path:
    """Where `kinegraph files fetch pose-model` keeps the network."""
    return Path(platformdirs.user_data_dir("kinegraph")) / "models" / FILE


def model_path(model: str) -> Path:
    """The file that a parameter `model` names; checked. Raises ParameterError."""
    path = Path(model) if model else default_model()
    if not path.is_file():
        raise ParameterError(
            "model", model or str(path), "a file that is there; get it with: kinegraph files fetch pose-model"
        )
    if not model and _digest(path) != SHA256:
        raise ParameterError(
            "model", str(path), "the file that was published; get it again: kinegraph files fetch pose-model"
        )
    try:
        import ai_edge_litert  # noqa: F401
    except ImportError as error:
        raise ParameterError("model", str(path), f"run by LiteRT: pip install 'kinegraph[pose]' ({error})") from None
    return path


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
    """The network as this thread runs it: an interpreter is for one thread. It remembers nothing from one image to the next."""
    loaded: dict[str, tuple[Any, int, list[int]]] = _local.__dict__.setdefault("loaded", {})
    if path not in loaded:
        from ai_edge_litert.interpreter import Interpreter

        try:
            Interpreter(path)  # refuses what is no network
            network = Interpreter(model_content=trimmed(bytes_of(Path(path)), READ), num_threads=1)
            network.allocate_tensors()
            by_shape = {tuple(o["shape"]): o["index"] for o in network.get_output_details()}
            outputs = [by_shape[shape] for shape in READ]
        except (ValueError, RuntimeError) as error:
            raise ParameterError(
                "model", str(path), f"a landmark network of BlazePose in LiteRT's format ({error})"
            ) from None
        loaded[path] = network, network.get_input_details()[0]["index"], outputs
    return loaded[path]
