"""Poses to avatars: the VMC protocol over UDP, as VSeeFace, Warudo, VMagicMirror and others receive it."""

from __future__ import annotations

import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
import structlog

from kinegraph.devices.formats.gltf.vrm_reader import read_vrm
from kinegraph.devices.osc.sender import BACK_AFTER
from kinegraph.devices.osc.vmc_protocol import SAFE_BYTES, VmcFrame
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.domain.fingers import BENDS, FINGER_BONES, RELAXED, finger_offsets, finger_rotations
from kinegraph.stream.domain.humanoid import BONES, humanoid_of, to_humanoid, usual_body
from kinegraph.stream.domain.skeleton import JointTree
from kinegraph.stream.errors import DeviceError, InputError
from kinegraph.stream.operator import Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class VmcState:
    """weights: of the blend shapes, and turns (30, 4) of the fingers' bones, the newest. begun: stamp of the first pose (ns)."""

    weights: Samples = field(default_factory=lambda: np.zeros(0))
    turns: Samples = field(default_factory=lambda: np.zeros((0, 4)))
    begun: int = 0


class VmcRuntime:
    """What belongs to a running outlet: the skeleton of the poses, the frames that are sent, the socket."""

    def __init__(self, tree: JointTree, frame: VmcFrame, scale: float) -> None:
        self.tree, self.frame, self.scale = tree, frame, scale
        self.socket: socket.socket | None = None
        self.silent = 0


@dataclass(frozen=True, slots=True)
class VmcOutlet(Outlet[VmcState, VmcRuntime]):
    """Sends every pose as a frame of the VMC protocol: one bundle, or several below `max_bytes`, by UDP.

    pose    a stream of poses. One of another skeleton than VRM's is turned into it by the names of its joints, or by `bones`
    blends  weights (0 to 1) of blend shapes, a signal with channels named as the avatar's: Joy, A, Blink_L
    fingers how the fingers bend (of operators.body.camera.hands.Hands): their 30 bones are sent, too

    `avatar` names the VRM file that the receiver shows: bones go out with its lengths, and the hips are moved as far as its legs are
    long. A pose that is not finite is not sent. Bones that are not given (fingers, eyes) are not sent: the receiver keeps them.
    """

    inputs = {"pose": Input(), "blends": Input(optional=True), "fingers": Input(optional=True)}
    in_order: ClassVar[bool] = False

    host: str = param("127.0.0.1", help="who receives")
    port: int = param(39539, least=1, most=65535, help="the receiver's UDP port: 39539 in VSeeFace and Warudo")
    avatar: Path | None = param(None, help="the VRM file of the avatar; left out: a body of usual size")
    bones: Mapping[str, str] | None = param(None, help="bone: joint, where names do not say")
    max_bytes: int = param(SAFE_BYTES, least=200, most=65000, help="no datagram is longer; 65000: a frame is one")

    def open(self, specs: Specs) -> Specs:
        tree = humanoid_of(specs["pose"], self.bones)
        names = _blend_names(specs["blends"]) if "blends" in specs else ()
        avatar = read_vrm(self.avatar) if self.avatar else usual_body()
        body = tree if tree.joints == BONES else to_humanoid(tree, np.zeros((0, tree.width)), self.bones)[0]
        bones, offsets, turns = BONES, avatar.offsets, np.zeros((0, 4))
        if "fingers" in specs:
            if specs["fingers"].channels != BENDS:
                raise InputError("fingers", specs["fingers"].describe(), f"{len(BENDS)} bends of fingers, of Hands")
            bones, offsets = (*BONES, *FINGER_BONES), np.concatenate([offsets, finger_offsets()])
            turns = finger_rotations(RELAXED)
        frame = VmcFrame(bones, offsets, names, self.max_bytes)
        self.set_state(
            VmcState(np.zeros(len(names)), turns), VmcRuntime(tree, frame, _leg(avatar) / max(_leg(body), 1e-3))
        )
        return {}

    def begin(self) -> None:
        try:
            address = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_DGRAM)[0]
            self.runtime.socket = socket.socket(address[0], socket.SOCK_DGRAM)
            self.runtime.socket.setblocking(False)
            self.runtime.socket.connect(address[4])
        except OSError as error:
            raise DeviceError(f"VMC cannot be sent to {self.host}:{self.port}: {error}") from None
        log.info("VMC outlet", host=self.host, port=self.port, avatar=str(self.avatar or ""))

    def process(self, port: str, chunk: Chunk) -> None:
        if port == "blends":
            for weights in chunk.data:
                self.state.weights[:] = np.where(np.isfinite(weights), np.clip(weights, 0.0, 1.0), self.state.weights)
            return
        if port == "fingers":
            for bends in chunk.data[-1:]:
                if np.isfinite(bends).all():
                    self.state.turns[:] = finger_rotations(np.asarray(bends, np.float64))
            return
        for stamp, row in zip(chunk.time.tolist(), self._humanoid(chunk.data), strict=True):
            self.state.begun = self.state.begun or stamp
            if np.isfinite(row).all():
                hips, rotations = self.runtime.scale * row[:3], np.vstack([row[3:].reshape(-1, 4), self.state.turns])
                seconds = (stamp - self.state.begun) / NS
                self._send(self.runtime.frame.write(seconds, hips, rotations, self.state.weights.tolist()))

    def _humanoid(self, rows: Array) -> Samples:
        """Poses (n, ...) on VRM's skeleton."""
        rows = np.asarray(rows, np.float64)
        if self.runtime.tree.joints == BONES or not len(rows):
            return rows
        return to_humanoid(self.runtime.tree, rows, self.bones)[1]

    def _send(self, datagrams: Sequence[memoryview]) -> None:
        """Send at once or not at all: a receiver that is not there, or a full network, holds nothing up."""
        runtime = self.runtime
        if runtime.socket is None:
            return
        try:
            for datagram in datagrams:
                runtime.socket.send(datagram)
            runtime.silent = max(0, runtime.silent - 1)
        except OSError as error:
            if not runtime.silent:
                log.warning("no receiver for VMC", host=self.host, port=self.port, error=str(error))
            runtime.silent = BACK_AFTER

    def close(self) -> None:
        if self.runtime.socket is not None:
            self.runtime.socket.close()
            self.runtime.socket = None


def _blend_names(spec: StreamSpec) -> tuple[str, ...]:
    if not spec.is_signal or spec.dtype.kind != "f" or not spec.channels:
        raise InputError("blends", spec.describe(), "a signal with a named channel for each blend shape")
    return spec.channels


def _leg(tree: JointTree) -> float:
    """The length of a leg at rest (m)."""
    chain = [BONES.index(f"Left{bone}") for bone in ("LowerLeg", "Foot")]
    return float(sum(np.linalg.norm(tree.offsets[b]) for b in chain))
