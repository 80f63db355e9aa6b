"""Which of a NatNet frame's bodies, markers and channels are those that a graph names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeVar

import numpy as np

from devices.protocols.natnet import OCCLUDED, NatNetBody, NatNetFrame, NatNetModels
from stream.chunk import Samples
from stream.errors import DeviceError, nearest

T = TypeVar("T")


class Named(Protocol):
    """What a graph names."""

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
        self._of = of
        known = bodies_of(models)
        self._bodies = {_find(known, name, "rigid body or bone"): i for i, name in enumerate(of.bodies)}
        markers = markers_of(models)
        self._markers = {_find(markers, name, "marker"): i for i, name in enumerate(of.markers)}
        channels = channels_of(models)
        self._points = np.full((1, len(of.markers), 3), np.nan)
        self._positions, self._rotations = (np.full((1, len(of.bodies), n), np.nan) for n in (3, 4))
        """What nothing has been seen of, to be copied."""
        self._channels = [_find(channels, name, "analog channel") for name in of.analog]

    def rows(self, frame: NatNetFrame) -> dict[str, Samples]:
        """By output, its samples in a frame."""
        made: dict[str, Samples] = {}
        if self._of.bodies:
            made["bodies"], made["rotations"] = self._placed(frame)
        if self._of.markers:
            points = self._points.copy()
            for marker in frame.markers:
                place = self._markers.get((marker.model, marker.marker))
                if place is not None and not marker.flags & OCCLUDED:
                    points[0, place] = marker.position
            made["markers"] = points
        if self._of.analog:
            made["analog"] = self._analog(frame)
        return made

    def _placed(self, frame: NatNetFrame) -> tuple[Samples, Samples]:
        positions, rotations = self._positions.copy(), self._rotations.copy()

        def put(skeleton: int, bodies: Sequence[NatNetBody]) -> None:
            for body in bodies:
                place = self._bodies.get((skeleton, body.id & 0xFFFF if skeleton else body.id))
                if place is not None and body.tracked:
                    x, y, z, w = body.rotation
                    positions[0, place], rotations[0, place] = body.position, (w, x, y, z)

        put(0, frame.bodies)
        for skeleton, bones in frame.skeletons.items():
            put(skeleton, bones)
        return positions, rotations

    def _analog(self, frame: NatNetFrame) -> Samples:
        rows = np.full((self._of.analog_samples, len(self._of.analog)), np.nan)
        for place, (kind, number, channel) in enumerate(self._channels):
            values = frame.analog.get((kind, number), [])
            if channel < len(values):
                n = min(len(values[channel]), len(rows))
                rows[:n, place] = values[channel][:n]
        return rows


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
