"""A bedroom as a tilted depth camera sees it: rays that meet boxes and a body, and the noise of time of flight or of stereo.

Written from the geometry and from what such sensors do; it shares nothing with devices/people/bedroom.py. Lengths in m, depths in mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.uint16]
Map = NDArray[Any]
Box = tuple[float, float, float, float, float, float]

FOCAL = 0.72
"""In widths of the picture: 70 degrees."""
STEREO_MM_PX = 33_000.0
"""Focal length times baseline at 320 pixels: .08 px are 9.7 mm at 2 m."""
TOF_MM = 5.0
"""Noise of a pixel at 2 m."""
PATTERNS = 8
MOST_LIFT = 2.5
"""Of a lift of 1 mm, along a ray; at an outline a pixel would otherwise jump to what is behind."""
HEIGHTS = 20
"""A ray that slants is followed down through so many heights above the mattress."""
FAN_MM, FAN_HZ = 12.0, 0.4
"""A fan lifts the blanket in waves."""


@dataclass(frozen=True, slots=True)
class TiltedCamera:
    """Where it hangs: to the side of the bed's middle, behind its foot edge, above the floor (m); it looks at the mattress's middle.

    sensor, noise  `tof`: share of 5 mm a pixel at 2 m; `stereo`: share of .08 px. correlated: how much of a pixel's noise stays from
    frame to frame
    patches, flicker, jump  share of pixels missing in patches that stay, one by one, and in patches that jump from frame to frame
    """

    side: float = 0.0
    behind: float = 0.35
    height: float = 2.25
    sensor: Literal["tof", "stereo"] = "tof"
    noise: float = 1.0
    correlated: float = 0.0
    patches: float = 0.05
    flicker: float = 0.01
    jump: float = 0.0


@dataclass(frozen=True, slots=True)
class Stay:
    """What happens in the bed, in s since the beginning: from when to when somebody lies there, stirs (for 4 s each), how the breath goes.

    lift_mm  of the blanket, from peak to peak; moves: when the sleeper stirs; pauses: when there is no breath
    heap     when a blanket is left in a heap; fan: when one lifts the blanket
    """

    begin: float = 0.0
    end: float = 0.0
    per_min: float = 14.0
    lift_mm: float = 4.0
    moves: tuple[float, ...] = ()
    pauses: tuple[tuple[float, float], ...] = ()
    heap: tuple[float, float] = (0.0, 0.0)
    fan: tuple[float, float] = (0.0, 0.0)
    sits: tuple[float, float] = (0.0, 0.0)


class TiltedRoom:
    """What the camera sees at any time; frames are asked for in order."""

    def __init__(self, width: int, height: int, camera: TiltedCamera, stay: Stay, *, seed: int = 0) -> None:
        self.camera, self.stay, self._width = camera, stay, width
        self._random = np.random.default_rng([seed, 41])
        r = self._random
        self.bed = (float(r.uniform(0.9, 1.6)), 2.0, float(r.uniform(0.42, 0.58)))
        """Width, length, height of the mattress."""
        wide, long, high = self.bed
        self.at = np.array([camera.side, long + camera.behind, camera.height])
        ahead = np.array([0.0, long / 2, high]) - self.at
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right = np.array([-1.0, 0.0, 0.0]) if np.linalg.norm(right) < 1e-6 else right / np.linalg.norm(right)
        down = np.cross(ahead, right)
        self.axes = ahead, right, down
        v, u = np.mgrid[:height, :width]
        focal = FOCAL * width
        self.rays = (
            ahead
            + ((u + 0.5 - width / 2) / focal)[..., None] * right
            + ((v + 0.5 - height / 2) / focal)[..., None] * down
        )
        self.boxes: list[Box] = [
            (-wide / 2, wide / 2, -0.06, 0.0, 0.0, high + float(r.uniform(0.1, 0.6))),
            (wide / 2 + 0.05, wide / 2 + 0.5, 0.0, 0.4, 0.0, float(r.uniform(0.4, 0.7))),
            (-wide / 2 - 1.6, -wide / 2 - 0.9, 0.2, 1.4, 0.0, 1.9),
            (-4.0, 4.0, -0.4, -0.3, 0.0, 3.0),
        ]
        self._walls = self._without_bedding()
        self._lying = float(r.uniform(-0.15, 0.15)) * wide
        self._thick = float(r.uniform(0.17, 0.25))
        self.empty = self._surface(lambda x, y: 0.015 * _bump(x, y, 0.1, 1.3, 0.3, 0.4))
        self._body = self._surface(lambda x, y: self._shape(x, y, 0.0))
        lifted = self._surface(lambda x, y: self._shape(x, y, 0.0) + 0.01 * _bump(x, y, self._lying, 0.62, 0.17, 0.2))
        self._chest = np.clip((self._body - lifted) / np.float32(10.0), 0, MOST_LIFT)
        waved = self._surface(
            lambda x, y: 0.015 * _bump(x, y, 0.1, 1.3, 0.3, 0.4) + 0.01 * _bump(x, y, 0.0, 1.1, 0.4, 0.6)
        )
        self._blanket = np.clip((self.empty - waved) / np.float32(10.0), 0, MOST_LIFT)
        self._heaped: Map | None = None
        self._sitting: Map | None = None
        shape = (PATTERNS, 2 * height, 2 * width)
        self._normal = r.standard_normal(shape, dtype=np.float32)
        self._uniform = r.random((2 * height, 2 * width), dtype=np.float32)
        self._gone = _patches(r, (height, width), camera.patches)
        self._jumping = [_patches(r, (2 * height, 2 * width), camera.jump) for _ in range(4 if camera.jump else 0)]
        self._last: Map | None = None

    def frame(self, seconds: float) -> Frame:
        """(height, width) uint16 mm, 0 where nothing was measured."""
        c = self.camera
        depth = self._scene(seconds)
        noise = c.noise * self._drawn()
        if c.correlated:
            if self._last is not None:
                noise = c.correlated * self._last + np.float32(np.sqrt(1 - c.correlated**2)) * noise
            self._last = noise
        if c.sensor == "tof":
            depth = depth + np.float32(TOF_MM / 4e6) * depth * depth * noise
        else:
            scale = np.float32(STEREO_MM_PX * self._width / 320)
            disparity = np.round(32 * (scale / depth + np.float32(0.08) * noise)) / 32
            depth = scale / np.maximum(disparity, np.float32(1.0))
        lost = self._gone | (self._piece(self._uniform) < c.flicker)
        if c.jump:
            lost |= self._piece(self._jumping[int(self._random.integers(len(self._jumping)))])
        made: Frame = np.where(lost, 0, np.clip(depth + np.float32(0.5), 1, 60_000)).astype(np.uint16)
        return made

    def rectangle(self) -> tuple[int, int, int, int]:
        """The bed in the picture, as a person would set it: first row, first column, rows, columns."""
        at = self.at + self.empty[..., None] / 1000 * self.rays
        wide, long, high = self.bed
        on = (abs(at[..., 0]) < wide / 2) & (at[..., 1] > 0) & (at[..., 1] < long) & (abs(at[..., 2] - high) < 0.03)
        rows, columns = (np.flatnonzero(on.sum(axis=axis) > on.sum(axis=axis).max() / 2) for axis in (1, 0))
        return int(rows[0]), int(columns[0]), int(rows[-1] - rows[0]) + 1, int(columns[-1] - columns[0]) + 1

    def lift(self, seconds: float) -> float:
        """How far the chest has risen, mm: inspiration takes 40 % of a breath, and there is a pause at its end."""
        s = self.stay
        if any(a <= seconds < b for a, b in s.pauses):
            return 0.0
        phase = seconds * s.per_min / 60 % 1.0
        if phase < 0.4:
            return s.lift_mm * float(np.sin(np.pi * phase / 0.8)) ** 2
        return s.lift_mm * float(np.cos(np.pi * min(phase - 0.4, 0.45) / 0.9)) ** 2

    def _scene(self, t: float) -> Map:
        s = self.stay
        if s.begin <= t < s.end:
            stir = max((float(np.sin(np.pi * (t - m) / 4)) ** 2 for m in s.moves if m <= t < m + 4), default=0.0)
            if stir:
                return self._surface(lambda x, y: self._shape(x, y, stir))
            return self._body - self._chest * np.float32(self.lift(t))
        if s.sits[0] <= t < s.sits[1]:
            if self._sitting is None:
                self._sitting = self._surface(
                    lambda x, y: 0.85 * _bump(x, y, self.bed[0] / 2 - 0.15, 1.0, 0.14, 0.2), 0.9
                )
            return self._sitting
        if s.heap[0] <= t < s.heap[1]:
            if self._heaped is None:
                self._heaped = self._surface(lambda x, y: 0.24 * _bump(x, y, -0.1, 1.1, 0.22, 0.4))
            return self._heaped
        if s.fan[0] <= t < s.fan[1]:
            return self.empty - self._blanket * np.float32(FAN_MM * (1 + np.sin(2 * np.pi * FAN_HZ * t)) / 2)
        return self.empty

    def _shape(self, x: Map, y: Map, stir: float) -> Map:
        """How high who lies there is above the mattress; stirring lifts an arm and shifts the legs."""
        at, thick = self._lying, self._thick
        trunk = thick * _bump(x, y, at, 0.65, 0.17, 0.33)
        legs = 0.7 * thick * _bump(x, y, at + 0.06 * stir, 1.4, 0.15, 0.38)
        head = 0.8 * thick * _bump(x, y, at, 0.18, 0.09, 0.1)
        arm = (thick + 0.08) * stir * _bump(x, y, at + 0.15, 0.85, 0.07, 0.15)
        body: Map = np.maximum(np.maximum(trunk, legs), np.maximum(head, arm))
        return body

    def _surface(self, above: Callable[[Map, Map], Map], tallest: float = 0.4) -> Map:
        """Depths (mm) of the room with a bed on which something lies as high as `above` (x, y) -> height has it; nothing is taller."""
        at, (wide, long, high) = self.at, self.bed
        depth = self._walls.copy()
        # from above, height by height, until a ray is below what lies there; then between the last two heights
        over = np.isfinite(_met(at, self.rays, (-wide / 2, wide / 2, 0.0, long, high, high + tallest)))
        over &= self.rays[..., 2] < 0
        ray = self.rays[over]

        def under(height: Map) -> Map:
            t = (high + height - at[2]) / ray[:, 2]
            x, y = at[0] + t * ray[:, 0], at[1] + t * ray[:, 1]
            inside = (np.abs(x) < wide / 2) & (y > 0) & (y < long)
            low: Map = np.where(inside, above(x, y), 0.0) - height
            return low

        upper, lower = np.full(len(ray), tallest), np.zeros(len(ray))
        met = np.zeros(len(ray), np.bool_)
        for k in range(1, HEIGHTS):
            height = np.full(len(ray), tallest * (1 - k / HEIGHTS))
            now = ~met & (under(height) >= 0)
            lower[now], met = height[now], met | now
            upper[~met] = height[~met]
        for _ in range(7):
            middle = (upper + lower) / 2
            hit = under(middle) >= 0
            lower, upper = np.where(hit, middle, lower), np.where(hit, upper, middle)
        t = (high + lower - at[2]) / ray[:, 2]
        depth[over] = np.where(lower > 1e-3, np.minimum(depth[over], t), depth[over])
        made: Map = (1000 * np.minimum(depth, 6.0)).astype(np.float32)
        return made

    def _without_bedding(self) -> Map:
        """Distances (m) to the floor and to what stands in the room, the bed included."""
        at, rays = self.at, self.rays
        wide, long, high = self.bed
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(rays[..., 2] < 0, -at[2] / rays[..., 2], np.inf)
        for box in [(-wide / 2, wide / 2, 0.0, long, 0.0, high), *self.boxes]:
            depth = np.minimum(depth, _met(at, rays, box))
        return depth

    def _drawn(self) -> Map:
        return self._piece(self._normal[int(self._random.integers(PATTERNS))])

    def _piece(self, of: Map) -> Map:
        """A piece of a pattern, at random."""
        height, width = self._gone.shape
        down, right = self._random.integers((height, width)).tolist()
        piece: Map = of[down : down + height, right : right + width]
        return piece


def _bump(x: Map, y: Map, x0: float, y0: float, wide: float, long: float) -> Map:
    bump: Map = np.sqrt(np.clip(1 - ((x - x0) / (1.6 * wide)) ** 2 - ((y - y0) / (1.6 * long)) ** 2, 0, None))
    return bump


def _met(at: NDArray[np.float64], rays: NDArray[np.float64], box: Box) -> NDArray[np.float64]:
    """Where rays from `at` enter a box (x, x, y, y, z, z); infinite where they miss it."""
    enter, leave = np.full(rays.shape[:2], 0.0), np.full(rays.shape[:2], np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis in range(3):
            one, two = ((box[2 * axis + end] - at[axis]) / rays[..., axis] for end in (0, 1))
            enter, leave = np.maximum(enter, np.minimum(one, two)), np.minimum(leave, np.maximum(one, two))
    return np.where((enter < leave) & (enter > 0), enter, np.inf)


def _patches(random: np.random.Generator, shape: tuple[int, int], share: float) -> NDArray[np.bool_]:
    """About this share of the pixels, in patches of some 40."""
    made = np.zeros(shape, np.bool_)
    for _ in range(round(share * shape[0] * shape[1] / 40)):
        row, column = random.integers(shape)
        made[row : row + random.integers(3, 10), column : column + random.integers(3, 10)] = True
    return made
