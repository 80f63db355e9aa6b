"""The frame of reference of points, poses and meshes: which axis points up, which way bodies face, and the handedness.

A stream of points declares it in its spec's `meta["axes"]`; the unit of length is the spec's own unit. A stream without it is undeclared:
recordings of earlier versions, and files of formats that do not say it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import StreamSpec

Up: TypeAlias = Literal["x", "y", "z", "-x", "-y", "-z"]
WAYS = ("x", "y", "z", "-x", "-y", "-z")
LENGTHS = ("m", "dm", "cm", "mm", "in")
USUAL_FORWARD = {"x": "z", "-x": "z", "y": "z", "-y": "-z", "z": "-y", "-z": "y"}
"""By what points up: the forward axis that a frame is converted by where the way that bodies face is not known. x stays x if it can."""


@dataclass(frozen=True, slots=True)
class Axes:
    """Directions of a stream's x, y and z.

    up           the axis that points up: x, y, z, -x, -y or -z
    forward      the axis along which bodies face; "" is not known
    left_handed  whether the axes are left-handed, as in Unity

    >>> CAMERA.to(BODY)  # y and z change their sign
    ((0, 1, 2), (1.0, -1.0, -1.0))
    """

    up: str
    forward: str = ""
    left_handed: bool = False

    def __post_init__(self) -> None:
        if self.up not in WAYS or self.forward not in ("", *WAYS) or self.forward[-1:] == self.up[-1:]:
            raise ValueError(
                f"up is {self.up!r} and forward {self.forward!r}; both must be of {', '.join(WAYS)}, along different axes"
            )

    def to(self, wanted: Axes) -> tuple[tuple[int, int, int], tuple[float, float, float]]:
        """By coordinate of the wanted frame: which coordinate of this one it is, and its sign.

        Where one of both does not know which way bodies face, up becomes up, and x stays x if it can.
        """
        known = bool(self.forward and wanted.forward)
        turn = wanted._basis(known=known).T @ self._basis(known=known)
        columns, signs = np.abs(turn).argmax(axis=1).tolist(), turn.sum(axis=1).astype(float).tolist()
        return (columns[0], columns[1], columns[2]), (signs[0], signs[1], signs[2])

    def flipped(self, signs: tuple[float, ...]) -> Axes:
        """The frame of points after x, y and z were multiplied by numbers of these signs."""
        sign = {"xyz"[k]: value < 0 for k, value in enumerate(signs)}

        def turned(way: str) -> str:
            return way if not way or not sign[way[-1]] else way[-1] if way[0] == "-" else f"-{way}"

        return Axes(turned(self.up), turned(self.forward), self.left_handed ^ (sum(sign.values()) % 2 == 1))

    def _basis(self, *, known: bool) -> NDArray[np.int64]:
        """A body's left, up and front (3, 3), in these axes."""
        up, front = _vector(self.up), _vector(self.forward if known else USUAL_FORWARD[self.up])
        left = np.cross(up, front) * (-1 if self.left_handed else 1)
        return np.array([left, up, front])

    def describe(self) -> str:
        """For people: "y up, z forward"."""
        forward = f", {self.forward} forward" if self.forward else ""
        return f"{self.up} up{forward}{', left-handed' if self.left_handed else ''}"

    def facts(self) -> dict[str, Any]:
        """What `meta["axes"]` holds."""
        return {"up": self.up, "forward": self.forward, "handed": "left" if self.left_handed else "right"}

    @staticmethod
    def of(spec: StreamSpec) -> Axes | None:
        """The frame that a stream declares, or None."""
        return Axes.from_facts(spec.meta.get("axes"))

    @staticmethod
    def from_facts(facts: Any) -> Axes | None:
        """What `facts` gave; None for anything else."""
        if facts == "camera":  # as earlier versions wrote it
            return CAMERA
        try:
            return Axes(facts["up"], facts["forward"], facts["handed"] == "left")
        except (KeyError, TypeError, ValueError):
            return None


BODY = Axes("y", "z")
"""Of poses, of our meshes and of glTF: x to the body's left, y up, z to its front."""
CAMERA = Axes("-y", "-z")
"""Of a depth camera: x to the right in the image, y down, z away from the camera, which people face."""
FACED = Axes("y", "-z")
"""Of a Kinect's skeletons: y up, z away from the camera, which people face."""


def _vector(way: str) -> NDArray[np.int64]:
    made = np.zeros(3, np.int64)
    made["xyz".index(way[-1])] = -1 if way[0] == "-" else 1
    return made


def has_places(spec: StreamSpec) -> bool:
    """Whether a stream's samples are places: points (n, 3), vertices, poses, or coordinates that declare their axes."""
    if spec.is_event or not spec.units or spec.units[0] not in LENGTHS:
        return False
    return "skeleton" in spec.meta or (len(spec.shape) == 2 and spec.shape[1] == 3) or "axes" in spec.meta


def describe_axes(spec: StreamSpec) -> str:
    """For people, what a stream of places declares: "y up, z forward"; "" for any other stream."""
    if not has_places(spec):
        return ""
    axes = Axes.of(spec)
    return axes.describe() if axes else "axes not declared"


def in_axes(spec: StreamSpec, axes: Axes | None) -> dict[str, Any]:
    """The stream's `meta` with these axes declared in the place of its own; None: not declared."""
    left = {key: value for key, value in spec.meta.items() if key != "axes"}
    return {**left, "axes": axes.facts()} if axes else left
