"""The VMC protocol (Virtual Motion Capture, https://protocol.vmc.info/english): poses of humanoid avatars as OSC bundles. No socket.

One frame is one bundle: /VMC/Ext/OK, /VMC/Ext/T, /VMC/Ext/Root/Pos, a /VMC/Ext/Bone/Pos for each bone, and blend shapes with their Apply.
The bytes are laid out once; a frame writes its floats in place, which costs microseconds where composing a bundle costs a millisecond.

Ours is a right-handed world in metres (x to the subject's left, y up, z forward), quaternions are (w, x, y, z). Unity is left-handed: a
position (x, y, z) goes out as (-x, y, z), a rotation as (x, -y, -z, w).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from kinegraph.stream.chunk import Samples

BUNDLE = b"#bundle\x00" + struct.pack(">Q", 1)  # a bundle to be acted on at once
SAFE_BYTES = 1300
"""What fits into a packet of any network; larger datagrams are split by IP, and one lost fragment loses the whole."""

BONES = (
    "Hips", "LeftUpperLeg", "RightUpperLeg", "LeftLowerLeg", "RightLowerLeg", "LeftFoot", "RightFoot", "Spine", "Chest", "Neck", "Head",
    "LeftShoulder", "RightShoulder", "LeftUpperArm", "RightUpperArm", "LeftLowerArm", "RightLowerArm", "LeftHand", "RightHand", "LeftToes",
    "RightToes", "LeftEye", "RightEye", "Jaw",
    *(f"{side}{finger}{joint}" for side in ("Left", "Right") for finger in ("Thumb", "Index", "Middle", "Ring", "Little")
      for joint in ("Proximal", "Intermediate", "Distal")),
    "UpperChest",
)  # fmt: skip
"""Unity's HumanBodyBones, in its order."""


def text(value: str) -> bytes:
    """An OSC string: NUL-terminated, filled up to a multiple of four bytes."""
    coded = value.encode() + b"\x00"
    return coded + b"\x00" * (-len(coded) % 4)


def message(address: str, types: str, arguments: bytes) -> bytes:
    """An element of a bundle: its length, address, types and arguments."""
    body = text(address) + text(f",{types}") + arguments
    return struct.pack(">i", len(body)) + body


class VmcFrame:
    """The datagrams of one skeleton's frames.

    bones     names of `BONES`; an unknown one is refused
    offsets   (bones, 3) m: where each bone begins, seen from its parent, at rest
    blends    names of blend shapes
    most      no datagram is longer than this (bytes), as far as single messages allow; every datagram is a bundle of its own
    """

    def __init__(
        self, bones: Sequence[str], offsets: Samples, blends: Sequence[str] = (), most: int = SAFE_BYTES
    ) -> None:
        if unknown := [bone for bone in bones if bone not in BONES]:
            raise ValueError(f"{unknown[0]!r} is not a bone of a humanoid avatar")
        if np.shape(offsets) != (len(bones), 3):
            raise ValueError(f"offsets of shape {np.shape(offsets)}; they must be ({len(bones)}, 3)")
        state = struct.pack(">iiii", 1, 3, 0, 1)  # loaded; calibrated; as it is; tracking
        parts = [message("/VMC/Ext/OK", "iiii", state), message("/VMC/Ext/T", "f", bytes(4))]
        parts.append(message("/VMC/Ext/Root/Pos", "sfffffff", text("root") + struct.pack(">7f", *([0.0] * 6), 1.0)))
        parts += [message("/VMC/Ext/Bone/Pos", "sfffffff", text(bone) + bytes(28)) for bone in bones]
        parts += [message("/VMC/Ext/Blend/Val", "sf", text(name) + bytes(4)) for name in blends]
        parts += [message("/VMC/Ext/Blend/Apply", "", b"")] if blends else []
        self._datagrams, ends = _packed(parts, most)
        self._floats = [np.frombuffer(datagram, ">f4") for datagram in self._datagrams]
        self._time, _, *rest = ends[1:]
        at, self._blends = rest[: len(bones)], rest[len(bones) : len(bones) + len(blends)]
        self._chosen = [
            np.array([i for i, (d, _) in enumerate(at) if d == datagram], np.intp)
            for datagram in range(len(self._floats))
        ]
        self._where = [
            np.array([at[i][1] for i in chosen], np.intp)[:, None] + np.arange(-7, 0) for chosen in self._chosen
        ]
        self._rows = np.zeros((len(bones), 7), np.float32)
        self._rows[:, 0], self._rows[:, 1:3] = -offsets[:, 0], offsets[:, 1:]
        self._hips = list(bones).index("Hips") if "Hips" in bones else None

    def write(self, time_s: float, hips: Samples, rotations: Samples, blends: Sequence[float] = ()) -> list[memoryview]:
        """The datagrams of a frame; they are valid until the next.

        hips       (3,) m, where the hips are in the world
        rotations  (bones, 4) unit quaternions (w, x, y, z), local and relative to the rest pose
        blends     one weight (0 to 1) for each blend shape
        """
        rows = self._rows
        rows[:, 3], rows[:, 4], rows[:, 5], rows[:, 6] = (
            rotations[:, 1],
            -rotations[:, 2],
            -rotations[:, 3],
            rotations[:, 0],
        )
        if self._hips is not None:
            rows[self._hips, :3] = -hips[0], hips[1], hips[2]
        for floats, chosen, where in zip(self._floats, self._chosen, self._where, strict=True):
            floats[where] = rows[chosen]
        datagram, end = self._time
        self._floats[datagram][end - 1] = time_s
        for (datagram, end), weight in zip(self._blends, blends, strict=True):
            self._floats[datagram][end - 1] = weight
        return [memoryview(datagram) for datagram in self._datagrams]


def _packed(parts: Sequence[bytes], most: int) -> tuple[list[bytearray], list[tuple[int, int]]]:
    """Messages in as few bundles of at most `most` bytes as their order allows; and of each its bundle and where (in words) it ends."""
    bundles = [bytearray(BUNDLE)]
    places: list[tuple[int, int]] = []
    for part in parts:
        if len(bundles[-1]) > len(BUNDLE) and len(bundles[-1]) + len(part) > most:
            bundles.append(bytearray(BUNDLE))
        bundles[-1] += part
        places.append((len(bundles) - 1, len(bundles[-1]) // 4))
    return bundles, places
