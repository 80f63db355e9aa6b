"""A bedroom rendered by nothing of the product: a tilted camera, a room of boxes, bodies of ellipsoids, noise that grows with depth.

It shares no code, no shapes and no noise with devices/simulators: what holds on both is not made for either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.people.bedside import Bedside
from kinegraph.stream.chunk import NS, Chunk
from kinegraph.stream.source import Feed

Depths = NDArray[np.float32]
FOCAL = 0.78
"""Focal length in widths of the picture."""
CAMERA_M = 2.4
BED = (-0.55, 0.55, -1.0, 1.0, 0.5)
"""x from, to, y from, to, height, in m; the camera hangs above the middle."""


@dataclass(frozen=True)
class Scene:
    """What happens, in s since the beginning: stretches (from, to), moments, shifts of the picture.

    sleeper, partner, heap, standing  when each is there; breath_mm of both; moves: when the sleeper stirs (each for 4 s)
    partner_moves                     when the partner does
    lamp                              when a lamp shines on the bed: noise by 1 + lamp_noise at its middle, and pixels lost
    nudges                            (when, by how many m the picture shifts, by how many degrees the camera tilts)
    dark                              since when nothing but a few false pixels is measured
    """

    length: float
    sleeper: tuple[tuple[float, float], ...] = ()
    partner: tuple[tuple[float, float], ...] = ()
    heap: tuple[tuple[float, float], ...] = ()
    standing: tuple[tuple[float, float], ...] = ()
    moves: tuple[float, ...] = ()
    partner_moves: tuple[float, ...] = ()
    lamp: tuple[tuple[float, float], ...] = ()
    nudges: tuple[tuple[float, float, float], ...] = ()
    dark: tuple[tuple[float, float], ...] = ()
    breath_mm: float = 6.0
    lamp_noise: float = 5.0
    coarse: tuple[tuple[float, float], ...] = ()
    """When the blanket itself is measured badly: noise in bed far above the empty bed's."""
    off: tuple[tuple[float, float], ...] = ()
    """When there are no frames, as during a power cut."""
    seed: int = 1


def during(stretches: tuple[tuple[float, float], ...], t: float) -> bool:
    return any(a <= t < b for a, b in stretches)


class Renderer:
    def __init__(self, scene: Scene, width: int, height: int) -> None:
        self.scene, self.width, self.height = scene, width, height
        self.random = np.random.default_rng(scene.seed)
        self._normal = self.random.standard_normal((8, 2 * height, 2 * width), dtype=np.float32)
        self._uniform = self.random.random((8, 2 * height, 2 * width), dtype=np.float32)
        self._cache: dict[tuple[object, ...], Depths] = {}
        self._bumps: dict[tuple[float, ...], Depths] = {}

    def frame(self, t: float) -> NDArray[np.uint16]:
        s = self.scene
        shift = sum(d for at, d, _ in s.nudges if t >= at)
        tilt = np.radians(sum(a for at, _, a in s.nudges if t >= at))
        here = during(s.sleeper, t)
        stir = max((np.sin(np.pi * (t - m) / 4) ** 2 for m in s.moves if m <= t < m + 4), default=0.0) if here else 0.0
        other = during(s.partner, t)
        stir2 = (
            max((np.sin(np.pi * (t - m) / 4) ** 2 for m in s.partner_moves if m <= t < m + 4), default=0.0)
            if other
            else 0.0
        )
        key = (shift, tilt, here, other, during(s.heap, t), during(s.standing, t), round(stir, 6), round(stir2, 6))
        if key not in self._cache:
            if len(self._cache) > 40:
                self._cache.clear()
            self._cache[key] = self._surface(*key)  # type: ignore[arg-type]
        depth = self._cache[key].copy()
        if here and not stir:
            depth -= self._breath(0.24 * t) * self._bump(shift, -0.2, -0.35, 0.17, 0.16)
        if other and not stir2:
            depth -= self._breath(0.31 * t) * self._bump(shift, 0.28, -0.35, 0.17, 0.16)
        noise = np.float32(0.0018) * depth * np.sqrt(depth) * self._drawn(self._normal)
        lost = self._drawn(self._uniform) < 0.04
        if during(s.lamp, t):
            lit = self._bump(shift, 0.0, -0.2, 0.6, 0.7)
            noise *= 1 + np.float32(s.lamp_noise) * lit
            lost |= self._drawn(self._uniform) < 0.3 * lit
        if during(s.coarse, t):
            x, y = self._plane(shift)
            noise *= 1 + 5 * ((abs(x) < 0.55) & (abs(y) < 1.0))
        depth += noise
        if during(s.dark, t):
            lost = self._drawn(self._uniform) > 0.03
            depth = self.random.uniform(0.4, 6.0, depth.shape).astype(np.float32)
        return np.where(lost, 0, np.clip(1000 * depth, 1, 60_000)).astype(np.uint16)

    def _breath(self, cycles: float) -> np.float32:
        return np.float32(1e-3 * self.scene.breath_mm * np.sin(2 * np.pi * cycles))

    def _bump(self, shift: float, *where: float) -> Depths:
        """As `_bump` has it, kept."""
        if (shift, *where) not in self._bumps:
            self._bumps[shift, *where] = _bump(*self._plane(shift), *where).astype(np.float32)
        return self._bumps[shift, *where]

    def _drawn(self, pool: NDArray[np.float32]) -> NDArray[np.float32]:
        """A piece of one of the patterns, at random."""
        k, down, right = self.random.integers((len(pool), self.height, self.width)).tolist()
        return pool[k, down : down + self.height, right : right + self.width]

    def _plane(self, shift: float) -> tuple[Depths, Depths]:
        """Where every pixel looks at 2.4 m, in m."""
        v, u = np.mgrid[: self.height, : self.width]
        scale = CAMERA_M / (FOCAL * self.width)
        return (u - self.width / 2 + 0.5) * scale - shift, (v - self.height / 2 + 0.5) * scale

    def _surface(
        self, shift: float, tilt: float, here: bool, other: bool, heap: bool, standing: bool, stir: float, stir2: float
    ) -> Depths:
        x, y = self._plane(shift)
        high = np.zeros_like(x)
        high[(x > BED[0]) & (x < BED[1]) & (y > BED[2]) & (y < BED[3])] = BED[4]
        high[(x > -1.1) & (x < -0.75) & (y > -1.0) & (y < -0.6)] = 0.45
        if here:
            high = _on_bed(high, _body(x, y, -0.2, stir))
        if other:
            high = _on_bed(high, _body(x, y, 0.28, stir2))
        if heap:
            high = _on_bed(high, 0.24 * _bump(x, y, -0.1, 0.1, 0.2, 0.45))
        if standing:
            high = np.maximum(high, 1.6 * (_bump(x, y, 0.95, 0.2, 0.22, 0.3) > 0.4))
        return (CAMERA_M - high + np.tan(tilt) * x).astype(np.float32)


def _on_bed(high: Depths, thick: Depths) -> Depths:
    return np.where(thick > 0, np.maximum(high, BED[4] + thick), high)


def _bump(x: Depths, y: Depths, x0: float, y0: float, wide: float, long: float) -> Depths:
    return np.sqrt(np.clip(1 - ((x - x0) / (1.6 * wide)) ** 2 - ((y - y0) / (1.6 * long)) ** 2, 0, None))


def _body(x: Depths, y: Depths, x0: float, stir: float) -> Depths:
    """A trunk, a head and legs under a blanket; stirring lifts an arm and shifts the legs."""
    trunk = 0.22 * _bump(x, y, x0, -0.3, 0.15, 0.28)
    legs = 0.15 * _bump(x, y, x0 + 0.06 * stir, 0.4, 0.13, 0.36)
    arm = 0.25 * stir * _bump(x, y, x0 + 0.14, -0.1, 0.06, 0.14)
    return np.maximum(np.maximum(trunk, legs), np.maximum(0.18 * _bump(x, y, x0, -0.8, 0.08, 0.09), arm))


class RenderedRoom(Bedside):
    """The scene in the simulated bedroom's place: only what says which streams there are is inherited."""

    __slots__ = ("scene",)
    scene: Scene

    @staticmethod
    def of(source: Bedside, scene: Scene) -> RenderedRoom:
        made = RenderedRoom(width=source.width, height=source.height, fps=source.fps)
        object.__setattr__(made, "scene", scene)
        return made

    def unopened(self) -> RenderedRoom:
        return self

    def read(self, feed: Feed) -> None:
        renderer, begun = Renderer(self.scene, self.width, self.height), feed.now()
        times = np.arange(round(self.scene.length * self.fps)) / self.fps
        lost = 0
        for part in np.array_split(times, max(1, len(times) // 8)):
            seen = part[[not during(self.scene.off, float(t)) for t in part]]
            lost = lost if len(seen) == len(part) else -1
            if len(seen):
                stamps = begun + np.round(seen * NS).astype(np.int64)
                frames = np.stack([renderer.frame(float(t)) for t in seen])
                feed.emit(Chunk(stamps, frames, int(stamps[-1]), lost), "depth")
                lost = 0
