"""Takes: what an avatar does between two presses of a button on the page, as files for animation programs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import structlog

from kinegraph.stream.chunk import NS, Array, Chunk, Samples, StreamSpec
from kinegraph.stream.domain.humanoid import BONES, to_humanoid
from kinegraph.stream.domain.skeleton import JointTree
from kinegraph.stream.errors import InputError, KinegraphError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from kinegraph.stream.engine.pipeline import Pipeline

FOLDER = "takes"
MAX_SAMPLES = 60_000
"""A take of more poses is ended: it is held in memory."""
MAX_NAME = 64

log = structlog.get_logger(__name__)


class Takes:
    """Keeps the poses of the first avatar of a page while a take runs, and writes them when it ends.

    name   the stream of poses; "": the page shows no avatar, and takes cannot be recorded
    """

    def __init__(self, panels: Sequence[Mapping[str, Any]], specs: Mapping[str, StreamSpec]) -> None:
        self.name, self._tree, self._rate_hz = "", JointTree(("root",), np.array([-1]), np.zeros((1, 3))), 30.0
        for name in (n for panel in panels if panel["kind"] == "avatar" for n in panel["of"] if n in specs):
            try:
                self._tree, self.name = JointTree.of(specs[name]), name
            except InputError:
                continue
            self._rate_hz = specs[name].rate_hz or self._rate_hz
            break
        self._called = ""
        self._kept: list[Chunk] = []
        self._count = 0

    def observe(self, pipeline: Pipeline) -> None:
        if self.name in pipeline.edges:
            pipeline.edges[self.name].observers.append(self._keep)

    def _keep(self, chunk: Chunk) -> None:
        """In the graph's thread: arrays that are emitted are never written again."""
        if self._called and len(chunk.time) and self._count < MAX_SAMPLES:
            self._kept.append(chunk)
            self._count += len(chunk.time)

    def begin(self, called: str) -> str:
        """Begin a take, and end the one that runs; returns its name."""
        self._kept, self._count = [], 0
        self._called = re.sub(r"[^\w.-]+", "_", called.strip())[:MAX_NAME].strip("._") or "take"
        return self._called

    def end(self, folder: Path) -> list[Path]:
        """Write the take that runs as a VRM animation and as BVH. Raises KinegraphError for one without poses, and where it cannot."""
        called, kept, self._called, self._kept = self._called, self._kept, "", []
        if not kept:
            raise KinegraphError("no take runs, or no pose has come since it began")
        times, poses = np.concatenate([chunk.time for chunk in kept]), np.concatenate([chunk.data for chunk in kept])
        good = np.isfinite(poses).all(axis=1)
        if not good.any():
            raise KinegraphError(f"the take {called!r} has no finite pose")
        try:
            return self._written(folder, called, (times[good] - times[good][0]) / NS, poses[good])
        except OSError as error:
            raise KinegraphError(f"{folder}: the take cannot be written ({error.strerror or error})") from None

    def _written(self, folder: Path, called: str, seconds: Samples, poses: Array) -> list[Path]:
        from kinegraph.devices.formats.bvh.writer import COUNT, bvh_head, bvh_rows
        from kinegraph.devices.formats.gltf.writer import write_vrm_animation
        from kinegraph.stream.system.atomic_file import complete, private_folder

        private_folder(folder)
        number, name = 1, called
        while any((folder / f"{name}{end}").exists() for end in (".vrma", ".bvh")):
            number += 1
            name = f"{called}-{number}"
        body, own = self._tree, np.asarray(poses, np.float64)
        if body.joints != BONES:
            body, own = to_humanoid(body, own)
        with complete(folder / f"{name}.vrma") as draft:
            write_vrm_animation(draft, seconds, body, own)
        head, at = bvh_head(self._tree, self._rate_hz)
        with complete(folder / f"{name}.bvh") as draft:
            text = f"{head[:at]}{len(poses):{COUNT}d}{head[at + COUNT :]}{bvh_rows(self._tree, np.asarray(poses, np.float64))}"
            draft.write_text(text, encoding="ascii", errors="replace", newline="\n")
        return [folder / f"{name}.vrma", folder / f"{name}.bvh"]
