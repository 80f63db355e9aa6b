"""VMC messages to poses. No socket, no clock."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from kinegraph.devices.osc.protocol import Message
from kinegraph.devices.osc.vmc_protocol import BONES as ALL_BONES
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.humanoid import BONES

BONE, TIME = "/VMC/Ext/Bone/Pos", "/VMC/Ext/T"
OTHERS = {bone.lower() for bone in ALL_BONES}
"""Fingers, eyes and the jaw are not taken: to leave them out is no loss."""
NUMBERS = {bone.lower(): b for b, bone in enumerate(BONES)}


class VmcFrames:
    """Feed it messages as they come; it gives poses, rows (3 + 4 * 22,) of stream/domain/skeleton.py.

    A frame is whole when every bone that was in the frame before has come again, or when the next one begins. Numbers that are not finite,
    quaternions of no length and unknown bones are left out and counted in `dropped`, by reason; a bone keeps its last rotation.
    """

    def __init__(self, hips: Samples) -> None:
        self._row = np.concatenate([hips, np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))])
        self._seen: set[int] = set()
        self._wanted: set[int] = set()
        self.dropped: Counter[str] = Counter()

    @property
    def width(self) -> int:
        return len(self._row)

    def feed(self, messages: Sequence[Message]) -> list[Samples]:
        made: list[Samples] = []
        for address, arguments in messages:
            if address == TIME and self._seen:
                made.append(self._whole())
            elif address == BONE and len(arguments) < 8:
                self.dropped["bone with too few numbers"] += 1
            elif address == BONE:
                if NUMBERS.get(str(arguments[0]).lower()) in self._seen:
                    made.append(self._whole())
                self._take(str(arguments[0]), arguments[1:8])
                if self._wanted and self._seen >= self._wanted:
                    made.append(self._whole())
        return made

    def _take(self, bone: str, numbers: Sequence[object]) -> None:
        b = NUMBERS.get(bone.lower())
        if b is None:
            self.dropped["unknown bone"] += bone.lower() not in OTHERS
            return
        if not all(isinstance(v, int | float) and math.isfinite(v) for v in numbers):
            self.dropped["bone with something else than numbers"] += 1
            return
        x, y, z, qx, qy, qz, qw = (float(v) for v in numbers)  # type: ignore[arg-type]
        length = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
        if length < 1e-6:
            self.dropped["quaternion of no length"] += 1
            return
        self._seen.add(b)
        self._row[3 + 4 * b : 7 + 4 * b] = qw / length, qx / length, -qy / length, -qz / length
        if b == 0:
            self._row[:3] = -x, y, z

    def _whole(self) -> Samples:
        self._wanted, self._seen = self._seen, set()
        return self._row.copy()
