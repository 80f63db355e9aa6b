"""Poses to VRChat: its OSC trackers, which move an avatar's hips, chest, feet, knees and elbows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kinegraph.devices.osc.sender import OscSender
from kinegraph.devices.osc.writer import bundles, floats
from kinegraph.stream.chunk import Chunk, Samples, Specs
from kinegraph.stream.domain.humanoid import BONES, humanoid_of, to_humanoid
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.operator import Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param

TRACKERS = ("Hips", "Chest", "LeftFoot", "RightFoot", "LeftLowerLeg", "RightLowerLeg", "LeftLowerArm", "RightLowerArm")
"""Tracker 1, 2, ...: VRChat finds out by itself what each of them is, when the person calibrates in a T-pose."""
WHERE = "/tracking/trackers"


@dataclass(slots=True)
class VrchatState:
    """sent: how many poses."""

    sent: int = 0


@dataclass(slots=True)
class VrchatRuntime:
    """The skeleton of the poses; the socket, once there is one."""

    tree: JointTree
    sender: OscSender | None = None


@dataclass(frozen=True, slots=True)
class VrchatTrackers(Outlet[VrchatState, VrchatRuntime]):
    """Sends every pose as VRChat's OSC trackers: /tracking/trackers/1/position and /rotation to 8, and /head's, as UDP bundles.

    Positions in metres and angles in degrees, in Unity's axes (left-handed, y up; turns about z, then x, then y), with the body as tall as
    the pose's skeleton: VRChat wants the user's height in its settings. 1 hips, 2 chest, 3 and 4 feet, 5 and 6 knees, 7 and 8 elbows, left
    before right. `head` sends the head, too, to which VRChat aligns the others; leave it out where a headset does that. A pose that is not
    finite is not sent.

    Source: https://docs.vrchat.com/docs/osc-trackers
    """

    host: str = param("127.0.0.1", help="where VRChat runs")
    port: int = param(9000, least=1, most=65535, help="VRChat's UDP port for OSC")
    head: bool = param(True, help="whether the head is sent")
    bones: Mapping[str, str] | None = param(None, help="bone: joint, where names do not say")

    inputs = {"pose": Input()}

    def open(self, specs: Specs) -> Specs:
        tree = humanoid_of(specs["pose"], self.bones)
        self.set_state(VrchatState(), VrchatRuntime(tree))
        return {}

    def begin(self) -> None:
        self.runtime.sender = OscSender("VRChat's trackers", self.host, self.port)

    def process(self, port: str, chunk: Chunk) -> None:
        sender = self.runtime.sender
        if sender is None or not len(chunk):
            return
        rows = np.asarray(chunk.data, np.float64)
        rows = rows[np.isfinite(rows).all(axis=1)]
        for row in rows:
            sender.send(bundles(self._elements(row)))
        self.state.sent += len(rows)

    def _elements(self, row: Samples) -> list[bytes]:
        tree, poses = self.runtime.tree, row[None]
        if tree.joints != BONES or self.bones:
            tree, poses = to_humanoid(tree, poses, self.bones)
        turns, places = joints_of(tree, poses)
        made = []
        named = [(str(k + 1), bone) for k, bone in enumerate(TRACKERS)] + ([("head", "Head")] if self.head else [])
        for name, bone in named:
            b = BONES.index(bone)
            x, y, z = places[0, b].tolist()
            w, qx, qy, qz = turns[0, b].tolist()
            about_z, about_x, about_y = Rotation.from_quat([qx, -qy, -qz, w]).as_euler("zxy", degrees=True)
            made.append(floats(f"{WHERE}/{name}/position", (-x, y, z)))
            made.append(floats(f"{WHERE}/{name}/rotation", (about_x, about_y, about_z)))
        return made

    def close(self) -> None:
        if self.runtime.sender is not None:
            self.runtime.sender.close()
            self.runtime.sender = None
