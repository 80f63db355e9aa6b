"""Takes: what an avatar does between two presses of a button on the page, as files for animation programs."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import structlog

from kinegraph.stream.chunk import Array, Chunk, StreamSpec, Times
from kinegraph.stream.domain.humanoid import BONES, to_humanoid
from kinegraph.stream.domain.performance import Performance, is_face, is_fingers
from kinegraph.stream.domain.skeleton import JointTree
from kinegraph.stream.errors import InputError, KinegraphError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from kinegraph.stream.engine.pipeline import Pipeline

FOLDER = "takes"
MAX_SAMPLES = 60_000
"""Of each stream a take keeps this many: it is held in memory."""
MAX_NAME = 64
SUFFIXES = (".vrma", ".glb", ".bvh")

log = structlog.get_logger(__name__)


class Takes:
    """Keeps what the first avatar of a page does while a take runs, hands and face with it, and writes it when the take ends.

    name           the stream of poses; "": the page shows no avatar, and takes cannot be recorded
    fingers, face  the streams that the same panel shows beside it, or ""
    """

    def __init__(self, panels: Sequence[Mapping[str, Any]], specs: Mapping[str, StreamSpec]) -> None:
        self.name, self._tree, self._rate_hz = "", JointTree(("root",), np.array([-1]), np.zeros((1, 3))), 30.0
        self.fingers, self.face, self._expressions = "", "", tuple[str, ...]()
        for panel in panels:
            if panel["kind"] == "avatar" and not self.name:
                self._choose([name for name in panel["of"] if name in specs], specs)
        self._called = ""
        self._kept: dict[str, list[Chunk]] = {}
        self._counts = Counter[str]()

    def _choose(self, names: Sequence[str], specs: Mapping[str, StreamSpec]) -> None:
        for name in names:
            spec = specs[name]
            if is_fingers(spec):
                self.fingers = self.fingers or name
            elif is_face(spec) and not self.face:
                self.face, self._expressions = name, spec.channels
            elif not self.name:
                try:
                    self._tree, self.name = JointTree.of(spec), name
                except InputError:
                    continue
                self._rate_hz = spec.rate_hz or self._rate_hz

    def observe(self, pipeline: Pipeline) -> None:
        for name in (self.name, self.fingers, self.face):
            if name in pipeline.edges:
                pipeline.edges[name].observers.append(partial(self._keep, name))

    def _keep(self, name: str, chunk: Chunk) -> None:
        """In the graph's thread: arrays that are emitted are never written again."""
        if self._called and len(chunk.time) and self._counts[name] < MAX_SAMPLES:
            self._kept.setdefault(name, []).append(chunk)
            self._counts[name] += len(chunk.time)

    def begin(self, called: str) -> str:
        """Begin a take, and end the one that runs; returns its name."""
        self._kept, self._counts = {}, Counter()
        self._called = re.sub(r"[^\w.-]+", "_", called.strip())[:MAX_NAME].strip("._") or "take"
        return self._called

    def end(self, folder: Path) -> list[Path]:
        """Write the take that runs as VRM animation, GLB and BVH. Raises KinegraphError for one without poses, and where it cannot."""
        called, kept, self._called, self._kept = self._called, self._kept, "", {}
        if not kept.get(self.name):
            raise KinegraphError("no take runs, or no pose has come since it began")
        (times, poses), fingers, face = (_whole(kept.get(name)) for name in (self.name, self.fingers, self.face))
        good = np.isfinite(poses).all(axis=1)
        if not good.any():
            raise KinegraphError(f"the take {called!r} has no finite pose")
        beside = {
            "fingers": fingers if len(fingers[0]) else None,
            "face": (self._expressions, *face) if len(face[0]) else None,
        }
        try:
            return self._written(folder, called, times[good], poses[good], beside)
        except OSError as error:
            raise KinegraphError(f"{folder}: the take cannot be written ({error.strerror or error})") from None

    def _written(self, folder: Path, called: str, times: Times, poses: Array, beside: Mapping[str, Any]) -> list[Path]:
        from kinegraph.devices.formats.bvh.writer import COUNT, bvh_head, bvh_rows
        from kinegraph.devices.formats.gltf.writer import write_skeleton, write_vrm_animation
        from kinegraph.stream.system.atomic_file import complete, private_folder

        private_folder(folder)
        number, name = 1, called
        while any((folder / f"{name}{end}").exists() for end in SUFFIXES):
            number += 1
            name = f"{called}-{number}"
        made = [folder / f"{name}{end}" for end in SUFFIXES]
        body, own = (self._tree, poses) if self._tree.joints == BONES else to_humanoid(self._tree, poses)
        with complete(made[0]) as draft:
            write_vrm_animation(draft, Performance.joined(body, times, own, **beside))
        played = Performance.joined(self._tree, times, poses, **beside)
        with complete(made[1]) as draft:
            write_skeleton(draft, played, name)
        head, at = bvh_head(played.tree, self._rate_hz)
        with complete(made[2]) as draft:
            text = f"{head[:at]}{len(poses):{COUNT}d}{head[at + COUNT :]}{bvh_rows(played.tree, played.poses)}"
            draft.write_text(text, encoding="ascii", errors="replace", newline="\n")
        return made


def _whole(chunks: Sequence[Chunk] | None) -> tuple[Times, Array]:
    """Stamps and samples of chunks."""
    if not chunks:
        return np.zeros(0, np.int64), np.zeros((0, 0))
    return np.concatenate([chunk.time for chunk in chunks]), np.concatenate([chunk.data for chunk in chunks])
