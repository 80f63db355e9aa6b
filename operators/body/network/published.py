"""The networks that `kinegraph files fetch` brings: their files, what their bytes must be, and how one is run.

One thread for each, since a second one has not made them faster: their layers are so small that waking that thread takes what it saves.
"""

from __future__ import annotations

import threading
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import platformdirs

from kinegraph.operators.body.network.trimmed import Shape, trimmed
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.system.file_digest import bytes_of, sha256_of

_local = threading.local()
_digest = cache(sha256_of)


@dataclass(frozen=True, slots=True)
class Published:
    """A network as it was published. `fetch`: what `kinegraph files fetch` calls it; `what`: what it is called in messages.

    An operator that runs some lists them as `networks`.
    """

    file: str
    sha256: str
    fetch: str
    what: str
    licence: str = "Apache-2.0"

    def default(self) -> Path:
        """Where `kinegraph files fetch` keeps it."""
        return Path(platformdirs.user_data_dir("kinegraph")) / "models" / self.file

    def is_kept(self) -> bool:
        """Whether the published file is where `kinegraph files fetch` keeps it."""
        return self.default().is_file() and sha256_of(self.default()) == self.sha256

    def path(self, parameter: str, given: str = "") -> Path:
        """The file that a parameter names; left out, the published one, checked. Raises ParameterError."""
        path, fetch = Path(given) if given else self.default(), f"kinegraph files fetch {self.fetch}"
        if not path.is_file():
            raise ParameterError(parameter, given or str(path), f"a file that is there; get it with: {fetch}")
        if not given and _digest(path) != self.sha256:
            raise ParameterError(parameter, str(path), f"the file that was published; get it again: {fetch}")
        try:
            import ai_edge_litert  # noqa: F401
        except ImportError as error:
            raise ParameterError(
                parameter, str(path), f"run by LiteRT: pip install 'kinegraph[pose]' ({error})"
            ) from None
        return path


POSE = Published(
    "pose_landmark_full.tflite",
    "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
    "pose-model",
    "a landmark network of BlazePose",
)
PERSON = Published(
    "pose_detection.tflite",
    "a63c614bef30d35947f13be361820b1e4e3bec9cfeebf4d11216a18373108e85",
    "camera-models",
    "the detector of BlazePose",
)
HAND = Published(
    "hand_landmark_full.tflite",
    "8c026882c9ec059ce0f8e75266bee5a9a23c341a40e0000df755374d3d1b9b68",
    "camera-models",
    "a hand network of MediaPipe",
)
FACE = Published(
    "face_landmark.tflite",
    "c603fa6149219a3e9487dc9abd7a0c24474c77263273d24868378cdf40aa26d1",
    "camera-models",
    "a face network of MediaPipe",
)


def interpreter(path: str, outputs: Collection[Shape], what: str, parameter: str) -> tuple[Any, int, list[int]]:
    """The network as this thread runs it, its input, and the outputs of these shapes. It remembers nothing from one image to the next.

    Outputs that are not asked for are not computed. Raises ParameterError for a file that is no such network.
    """
    loaded: dict[str, tuple[Any, int, list[int]]] = _local.__dict__.setdefault("loaded", {})
    if path not in loaded:
        from ai_edge_litert.interpreter import Interpreter

        try:
            Interpreter(path)  # refuses what is no network
            network = Interpreter(model_content=trimmed(bytes_of(Path(path)), outputs), num_threads=1)
            network.allocate_tensors()
            by_shape: dict[Shape, list[int]] = {}
            for detail in network.get_output_details():
                by_shape.setdefault(tuple(int(size) for size in detail["shape"]), []).append(detail["index"])
            indices = [by_shape[shape].pop(0) for shape in outputs]
        except (ValueError, RuntimeError, KeyError, IndexError) as error:
            raise ParameterError(parameter, path, f"{what} in LiteRT's format ({error})") from None
        loaded[path] = network, network.get_input_details()[0]["index"], indices
    return loaded[path]
