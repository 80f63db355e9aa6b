"""Which of a NatNet frame's bodies, markers and channels are those that a graph names."""

from __future__ import annotations

from typing import Protocol, TypeVar

import numpy as np

from kinegraph.devices.natnet.numbers import WANTED, numbers
from kinegraph.devices.natnet.protocol import NatNetModels
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.errors import DeviceError, nearest

T = TypeVar("T")
OUTPUTS = ("bodies", "rotations", "markers", "analog")
KINDS = ("plate", "device")
"""What has analog channels, in the order of a frame's sections."""


class Named(Protocol):
    """What a graph names."""

    @property
    def outputs(self) -> tuple[str, ...]: ...

    @property
    def bodies(self) -> tuple[str, ...]: ...

    @property
    def markers(self) -> tuple[str, ...]: ...

    @property
    def analog(self) -> tuple[str, ...]: ...

    @property
    def analog_samples(self) -> int: ...


class NatNetNames:
    """Places of ids in the rows of each output. Raises DeviceError for a name that the server does not have."""

    def __init__(self, of: Named, models: NatNetModels) -> None:
        known, markers, channels = bodies_of(models), markers_of(models), channels_of(models)
        wanted = [(*_find(known, name, "rigid body or bone"), 0) for name in of.bodies]
        wanted += [(*_find(markers, name, "marker"), 0) for name in of.markers]
        for name in of.analog:
            kind, number, channel = _find(channels, name, "analog channel")
            wanted.append((KINDS.index(kind), number, channel))
        self._wanted = np.array(wanted, WANTED)
        b, m = len(of.bodies), len(of.markers)
        self._shapes = (1, b, 3), (1, b, 4), (1, m, 3), (of.analog_samples, len(of.analog))
        self._outputs = [(OUTPUTS.index(name), name) for name in of.outputs if name in OUTPUTS]

    def rows(self, payload: bytes, sized: bool, head: Array) -> list[tuple[str, Samples]] | None:
        """By output, its samples in a frame; None if it is cut off, or has no valid time. `head` as `natnet_numbers.numbers` has it."""
        made = positions, rotations, points, analog = [np.empty(shape) for shape in self._shapes]
        data = np.frombuffer(payload, np.uint8)
        if not numbers(data, sized, self._wanted, positions, rotations, points, analog, head):
            return None
        return [(name, made[i]) for i, name in self._outputs]


def bodies_of(models: NatNetModels) -> dict[str, tuple[int, int]]:
    """By name, the skeleton's id (0: a rigid body) and the body's."""
    found = {name: (0, number) for number, name in models.bodies.items()}
    for number, (skeleton, bones) in models.skeletons.items():
        found |= {f"{skeleton}:{name}": (number, bone & 0xFFFF) for bone, (name, _) in bones.items()}
    return found


def markers_of(models: NatNetModels) -> dict[str, tuple[int, int]]:
    """By name, the model's id and the marker's number, which begins at 1."""
    found: dict[str, tuple[int, int]] = {}
    for number, body in models.bodies.items():
        names = models.markers.get(number) or models.sets.get(body, [])
        found |= {f"{body}:{i}": (number, i) for i in range(1, max(len(names), 1) + 1)}
        found |= {f"{body}:{name}": (number, i) for i, name in enumerate(names, 1) if name}
    return found


def channels_of(models: NatNetModels) -> dict[str, tuple[str, int, int]]:
    """By name, the kind ("plate", "device"), its id, the channel's place."""
    found: dict[str, tuple[str, int, int]] = {}
    for (kind, number), names in models.analog.items():
        found |= {f"{kind} {number}:{i}": (kind, number, i - 1) for i in range(1, len(names) + 1)}
        found |= {f"{kind} {number}:{name}": (kind, number, i) for i, name in enumerate(names)}
    return found


def _find(known: dict[str, T], name: str, what: str) -> T:
    if name not in known:
        raise DeviceError(f"Motive streams no {what} {name!r}; {nearest(name, known)}")
    return known[name]
