"""What the tests of oak_network share."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.oak.keypoint_sets import COCO
from kinegraph.stream.chunk import Samples

HEAD: dict[str, Any] = {
    "parser": "YOLO",
    "metadata": {"n_keypoints": 17, "keypoints_outputs": ["kpt"], "yolo_outputs": ["out"], "classes": ["person"]},
}


# the archive ---------------------------------------------------------------------------------------------------------


def config(*heads: Any) -> dict[str, Any]:
    inputs = {"name": "images", "dtype": "uint8", "input_type": "image", "shape": [1, 3, 256, 256], "layout": "NCHW"}
    inputs["preprocessing"] = {"mean": [0, 0, 0], "scale": [255, 255, 255]}
    facts = {"name": "pose", "path": "pose.onnx", "precision": "float16"}
    outputs = [{"name": name, "dtype": "float32"} for name in ("out", "kpt")]
    return {
        "config_version": "1.0",
        "model": {"metadata": facts, "inputs": [inputs], "outputs": outputs, "heads": list(heads)},
    }


def archive(folder: Path, reported: Any, name: str = "config.json") -> str:
    path = folder / "pose.tar.xz"
    with tarfile.open(path, "w:xz") as tar:
        for entry, data in (
            (name, reported if isinstance(reported, bytes) else json.dumps(reported).encode()),
            ("pose.onnx", b"made up"),
        ):
            about = tarfile.TarInfo(entry)
            about.size = len(data)
            tar.addfile(about, io.BytesIO(data))
    return str(path)


def standing(x: float = 0.0, z: float = 2.5, sure: float = 0.9, *, known: Any = COCO) -> Samples:
    """Someone upright: key points (n, 4) on the body's surface."""
    up = {
        "nose": -0.6,
        "ear": -0.6,
        "shoulder": -0.4,
        "elbow": -0.15,
        "wrist": 0.1,
        "hip": 0.1,
        "knee": 0.5,
        "ankle": 0.9,
        "heel": 0.95,
        "toe": 0.95,
    }
    points = np.empty((len(known.names), 4))
    for row, name in zip(points, known.names, strict=True):
        side = 0.18 if name.startswith("left") else -0.18 if name.startswith("right") else 0.0
        part = name.removeprefix("left_").removeprefix("right_")
        row[:] = x + (side if part not in ("ear", "eye") else side / 3), up.get(part, -0.6), z, sure
    return points
