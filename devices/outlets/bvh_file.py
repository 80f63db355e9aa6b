"""Poses into a BVH file while they come; what already exists can be opened at any time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from kinegraph.devices.formats.bvh.writer import COUNT, bvh_head, bvh_rows
from kinegraph.devices.outlets.output_lock import check_path
from kinegraph.stream.chunk import Chunk, Samples, Specs
from kinegraph.stream.domain.skeleton import JointTree
from kinegraph.stream.errors import DeviceError, InputError, ParameterError
from kinegraph.stream.operator import Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param
from kinegraph.stream.system.atomic_file import private_folder

MAX_REPEATED = 3000
"""A gap of more frames is not filled."""


@dataclass(slots=True)
class BvhState:
    """newest: the pose that was written last; frames: how many were."""

    newest: Samples
    frames: int


class BvhRuntime:
    """The skeleton; where in the file the number of frames is; the file, once there is one."""

    def __init__(self, tree: JointTree, head: str, count_at: int) -> None:
        self.tree, self.head, self.count_at = tree, head, count_at
        self.file: BinaryIO | None = None


@dataclass(frozen=True, slots=True)
class BvhFile(Outlet[BvhState, BvhRuntime]):
    """Writes a regular stream of poses as BVH, in centimetres; the number of frames in its head is kept up to date.

    BVH frames have no times of their own: where samples are missing, the pose before them is written again. A pose that is not finite is
    replaced by the one before it, too. A file that already exists is not overwritten.
    """

    inputs = {"pose": Input()}

    path: str = param(help="the file, NAME.bvh; folders are made")

    def open(self, specs: Specs) -> Specs:
        if wrong := check_path(Path(self.path)):
            raise ParameterError("path", self.path, wrong)
        spec = specs["pose"]
        tree = JointTree.of(spec, "pose")
        if not spec.rate_hz:
            raise InputError("pose", spec.describe(), "a regular stream: BVH has one time between all its frames")
        rest = np.concatenate([tree.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(tree.joints))])
        self.set_state(BvhState(rest, 0), BvhRuntime(tree, *bvh_head(tree, spec.rate_hz)))
        return {}

    @property
    def file(self) -> str:
        return self.path

    def begin(self) -> None:
        private_folder(Path(self.path).absolute().parent)
        try:
            self.runtime.file = Path(self.path).open("xb")  # noqa: SIM115 - for as long as the session runs
            self.runtime.file.write(self.runtime.head.encode("ascii", "replace"))
            self.runtime.file.flush()
        except FileExistsError:
            raise DeviceError(f"{self.path} exists already; it is not overwritten: choose another path") from None
        except OSError as error:
            raise DeviceError(f"cannot write {self.path}: {error.strerror}; choose another path") from None

    def process(self, port: str, chunk: Chunk) -> None:
        state, rows = self.state, list[Samples]()
        for i, pose in enumerate(np.asarray(chunk.data, np.float64)):
            if i == 0 and state.frames and chunk.lost > 0:
                rows += min(chunk.lost, MAX_REPEATED) * [state.newest.copy()]
            if np.isfinite(pose).all():
                state.newest[:] = pose
            rows.append(state.newest.copy())
        if rows:
            state.frames += len(rows)
            self._write(np.array(rows))

    def _write(self, rows: Samples) -> None:
        """Frames at the end, then their number in the head; raises DeviceError."""
        file = self.runtime.file
        if file is None:
            return
        try:
            file.seek(0, 2)
            file.write(bvh_rows(self.runtime.tree, rows).encode("ascii"))
            file.flush()
            file.seek(self.runtime.count_at)
            file.write(f"{self.state.frames:{COUNT}d}".encode())
            file.flush()
        except OSError as error:
            raise DeviceError(f"cannot write {self.path}: {error.strerror}; free some space") from None

    def close(self) -> None:
        if self.runtime.file is not None:
            self.runtime.file.close()
            self.runtime.file = None
