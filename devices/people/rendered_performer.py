"""Someone who moves before a depth camera, rendered: depth and grey images of a body of capsules, and the truth about it.

Everything is a function of time alone. The body walks on the spot, raises and bends its arms and turns to the sides; it is plausible, not
physical.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.people.capsules import canvas, render
from kinegraph.stream.chunk import Array, Samples

FIELD = 0.70
"""The focal length in widths of the image: 71 degrees from side to side, as devices.oak.Oak supposes."""
HEIGHT_M, AWAY_M, WALL_M = 1.05, 2.7, 4.2
EMPTY_S = 2.0
"""The room is empty at first, so that the background can be learned; then somebody stands there, and moves after two seconds."""
STILL_S = 2.0
VARIANTS = 7
"""Different patterns of noise."""
STRIDE_HZ, TURN_HZ, ARMS_HZ = 0.8, 0.05, 0.25
POINTS = (
    "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
)  # fmt: skip
HALF_SHOULDERS, HALF_HIPS, UPPER_ARM, FOREARM, THIGH, SHANK = 0.18, 0.10, 0.28, 0.26, 0.42, 0.42
SKIN, SHIRT, TROUSERS = 0.9, 0.6, 0.42
APART = ((0.0, 0.0, 0.0),), ((-0.65, 0.0, 0.2), (0.7, 0.0, -0.2))
"""Where people stand (m, in the room), one of them or two; of two, the first is the nearer one."""
LATER_S = 0.45
"""The second one's movement is so late."""


def camera_of(width: int, height: int) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy in pixels."""
    return FIELD * width, FIELD * width, (width - 1) / 2, (height - 1) / 2


def body_at(seconds: float) -> tuple[dict[str, Samples], float]:
    """The joints in the room (m; x right as the camera sees it, y up from the floor, z towards the camera) and the heading (rad)."""
    t = max(0.0, seconds - EMPTY_S - STILL_S)
    grown = min(1.0, t)
    heading = 0.7 * math.sin(2 * math.pi * TURN_HZ * t)
    stride = grown * 0.45 * math.sin(2 * math.pi * STRIDE_HZ * t)
    raised = grown * (0.5 - 0.5 * math.cos(2 * math.pi * ARMS_HZ * t))
    joints: dict[str, Samples] = {}
    hips = np.array([0.05 * math.sin(0.9 * t), 0.92, 0.0])
    joints["neck"], joints["head"] = hips + np.array([0.0, 0.53, 0.0]), hips + np.array([0.0, 0.70, 0.02])
    joints["nose"] = hips + np.array([0.0, 0.69, 0.13])
    for side, s in (("left", 1.0), ("right", -1.0)):
        swing = s * stride
        lift = max(0.0, swing)
        hip = hips + np.array([s * HALF_HIPS, 0.0, 0.0])
        knee = hip + THIGH * np.array([0.04 * s, -math.cos(0.9 * lift), math.sin(0.9 * lift)])
        ankle = knee + SHANK * np.array([0.0, -math.cos(0.7 * lift), -math.sin(0.7 * lift)])
        shoulder = hips + np.array([s * HALF_SHOULDERS, 0.48, 0.0])
        up = 0.15 + 1.3 * raised
        elbow = shoulder + UPPER_ARM * np.array([s * math.sin(up), -math.cos(up), -0.3 * swing])
        bend = up + 0.9 * raised
        wrist = elbow + FOREARM * np.array([s * math.sin(bend), -math.cos(bend), 0.35]) / math.hypot(1.0, 0.35)
        made = {"hip": hip, "knee": knee, "ankle": ankle, "shoulder": shoulder, "elbow": elbow, "wrist": wrist}
        made |= {"toe": ankle + np.array([0.0, -0.04, 0.16]), "hand": wrist + 0.3 * (wrist - elbow)}
        joints |= {f"{side}_{name}": place for name, place in made.items()}
    c, s = math.cos(heading), math.sin(heading)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return {name: turn @ place for name, place in joints.items()}, heading


def _bones() -> list[tuple[str, str, float, float]]:
    """From joint to joint, with radius (m) and brightness."""
    bones = [("neck", "head", 0.055, SKIN), ("head", "head", 0.105, SKIN), ("nose", "nose", 0.02, SKIN)]
    bones += [("left_shoulder", "right_shoulder", 0.07, SHIRT), ("left_hip", "right_hip", 0.10, TROUSERS)]
    for side in ("left", "right"):
        bones += [
            (f"{side}_shoulder", f"{side}_hip", 0.095, SHIRT), (f"{side}_shoulder", f"{side}_elbow", 0.05, SHIRT),
            (f"{side}_elbow", f"{side}_wrist", 0.04, SKIN), (f"{side}_wrist", f"{side}_hand", 0.04, SKIN),
            (f"{side}_hip", f"{side}_knee", 0.075, TROUSERS), (f"{side}_knee", f"{side}_ankle", 0.055, TROUSERS),
            (f"{side}_ankle", f"{side}_toe", 0.04, SKIN),
        ]  # fmt: skip
    return bones


class RenderedPerformer:
    """What the camera sees at any time."""

    def __init__(
        self, width: int, height: int, *, seed: int = 0, invalid: float = 0.02, noise_mm: float = 4.0, people: int = 1
    ) -> None:
        self.width, self.height, self.people = width, height, people
        random, shape = np.random.default_rng([seed, 3]), (VARIANTS, height, width)
        noise, grain = (size * random.standard_normal(shape, np.float32) for size in (noise_mm, 4.0))
        self._spoils = noise, random.random(shape, np.float32) >= invalid, grain
        self._camera = np.array(camera_of(width, height))
        self._bones = _bones()
        y = (np.arange(height)[:, None] - self._camera[3]) / self._camera[1]
        self._room = np.broadcast_to(np.minimum(WALL_M, HEIGHT_M / np.maximum(y, 1e-6)), (height, width))
        self._newest: tuple[int, Array, Array] = (-1, np.empty(0), np.empty(0))

    def joints(self, seconds: float, who: int = 0) -> Samples:
        """Where POINTS are (13, 3) in m of one of the people: x right, y down, z away from the camera."""
        places = self._body(seconds, who)
        return np.stack([_seen(places[name]) for name in POINTS])

    def _body(self, seconds: float, who: int) -> dict[str, Samples]:
        """The joints of one of the people in the room."""
        places, _ = body_at(seconds - LATER_S * who)
        if self.people == 1:
            return places
        return {name: place + APART[self.people - 1][who] for name, place in places.items()}

    def frame(self, index: int, seconds: float) -> NDArray[np.uint16]:
        """Depth (height, width) in mm, 0 where nothing was measured."""
        return self._both(index, seconds)[0]

    def image(self, index: int, seconds: float) -> NDArray[np.uint8]:
        """The grey image (height, width) of the same moment."""
        return self._both(index, seconds)[1]

    def _both(self, index: int, seconds: float) -> tuple[Array, Array]:
        if self._newest[0] == index:
            return self._newest[1:]
        depth, light = canvas(self.height, self.width, math.inf)
        depth[:] = self._room
        if seconds >= EMPTY_S:
            for who in range(self.people):
                places = self._body(seconds, who)
                rows = [(*_seen(places[a]), *(_seen(places[b]) + 1e-6), r, bright) for a, b, r, bright in self._bones]
                render(np.array(rows), self._camera, depth, light)
        noise, there, grain = (kept[index % VARIANTS] for kept in self._spoils)
        measured = np.where(there, 1000 * depth + noise * (depth / 2) ** 2, 0)
        grey = np.where(light > 0, 200 * light, 45.0) + grain
        self._newest = index, measured.clip(0, 65535).astype(np.uint16), grey.clip(0, 255).astype(np.uint8)
        return self._newest[1:]


def _seen(place: Samples) -> Samples:
    """A place in the room as the camera has it. It sees the person's left on its right."""
    return np.array([place[0], HEIGHT_M - place[1], AWAY_M - place[2]])
