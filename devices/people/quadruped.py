"""A simulated quadruped, a mesh of tubes that walks, and two people who steer it: for trying mesh steering without a mesh of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.devices.simulation.paced import FrameSource
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.domain.axes import BODY
from kinegraph.stream.domain.mesh import Topology
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed

AROUND, ALONG = 8, 9
LEGS = {"fl": (0.16, 0.45, 0.0), "fr": (-0.16, 0.45, 0.5), "hl": (0.16, -0.45, 0.75), "hr": (-0.16, -0.45, 0.25)}
"""By leg: how far to the left and to the front it is (m), and by what share of a stride it is late."""
UPPER, LOWER, BACK = 0.42, 0.44, 0.92
ACTOR_PARTS = ("first.hip", "first.foot_l", "first.foot_r", "second.hip", "second.foot_l", "second.foot_r")


def tube(path: Samples, radius: Samples) -> Samples:
    """Rings (n * AROUND, 3) about the points of a path (n, 3) with radii (n,), across its main direction."""
    along = path[-1] - path[0]
    side = np.array([1.0, 0.0, 0.0])
    up = np.cross(along / np.linalg.norm(along), side)
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    ring = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up
    return np.asarray((path[:, None] + radius[:, None, None] * ring).reshape(-1, 3))


def tube_faces(rings: int, first: int) -> Array:
    """The triangles of a tube with vertices from `first` on, without its ends."""
    made = []
    for r in range(rings - 1):
        for a in range(AROUND):
            p, q = first + r * AROUND + a, first + r * AROUND + (a + 1) % AROUND
            made += [(p, q, p + AROUND), (q, q + AROUND, p + AROUND)]
    return np.array(made, np.int32)


def walking(phase: float) -> Samples:
    """The quadruped's vertices at a phase of its stride (0 to 1), standing about the origin and facing z."""
    sway = 0.02 * np.sin(4 * np.pi * phase)
    share = np.linspace(0.0, 1.0, ALONG)
    trunk = np.stack([0 * share, BACK + sway * (1 - 2 * share), -0.6 + 1.2 * share], axis=1)
    nod = 0.1 * np.sin(2 * np.pi * phase)
    neck = trunk[-1] + np.stack([0 * share, (0.45 + nod) * share, 0.4 * share], axis=1)
    made = [tube(trunk, 0.2 + 0.03 * np.sin(np.pi * share)), tube(neck, 0.12 - 0.05 * share)]
    for left, front, late in LEGS.values():
        angle = 2 * np.pi * (phase - late)
        swing, bend = 0.45 * np.sin(angle), 0.7 * max(0.0, np.cos(angle)) ** 2
        hip = np.array([left, BACK - 0.1, front])
        knee = hip + UPPER * np.array([0.0, -np.cos(swing), np.sin(swing)])
        hoof = knee + LOWER * np.array([0.0, -np.cos(swing - bend), np.sin(swing - bend)])
        upper = hip + (knee - hip) * np.minimum(1.0, 2 * share)[:, None]
        made.append(tube(upper + (hoof - knee) * np.maximum(0.0, 2 * share - 1)[:, None], 0.08 - 0.04 * share))
    return np.concatenate(made)


def topology() -> Topology:
    faces = [tube_faces(ALONG, k * AROUND * ALONG) for k in range(2 + len(LEGS))]
    return Topology((2 + len(LEGS)) * AROUND * ALONG, np.concatenate(faces), "quadruped")


def marked() -> dict[str, int]:
    """The vertices that markers stand for: hooves, withers, croup."""
    ring = AROUND * ALONG
    ends = {f"hoof_{leg}": (3 + k) * ring - 1 for k, leg in enumerate(LEGS)}
    return {**ends, "withers": 6 * AROUND + 2, "croup": 2 * AROUND + 2}


@dataclass(frozen=True, slots=True)
class Quadruped(FrameSource):
    """A mesh that walks on the spot, and its markers.

    mesh     (432, 3) float64, m   markers  (6, 3) float64, m: four hooves, withers, croup
    """

    outputs: ClassVar[tuple[str, ...]] = ("mesh", "markers")

    stride_s: float = param(1.2, above=0.2, help="how long a stride takes")

    def specs(self) -> Specs:
        made = {"simulated": True, "axes": BODY.facts()}
        names = tuple(marked())
        markers = StreamSpec((len(names), 3), rate_hz=self.rate_hz, channels=names, units=("m",), meta=made)
        return {"mesh": topology().spec(self.rate_hz, meta=made), "markers": markers}

    def read(self, feed: Feed) -> None:
        numbers = list(marked().values())
        for frame, stamp in self.frames(feed, self.rate_hz):
            mesh = walking((frame / self.rate_hz / self.stride_s) % 1.0)
            at = np.array([stamp])
            feed.emit(Chunk(at, mesh[None], stamp), "mesh")
            feed.emit(Chunk(at, mesh[numbers][None], stamp), "markers")


@dataclass(frozen=True, slots=True)
class TwoActors(FrameSource):
    """Two people who walk on the spot, each with a marker on the hips and one on each foot: NaN while the second one is away.

    out  (6, 3) float64, m: first.hip, first.foot_l, first.foot_r, second.hip, second.foot_l, second.foot_r; y up, z forwards
    """

    stride_s: tuple[float, float] = param((1.1, 1.3), help="how long a stride of each takes")
    leaves_s: float = param(0.0, least=0.0, help="when the second one leaves, for 3 s; 0: never")
    noise_mm: float = param(5.0, least=0.0, help="standard deviation of every coordinate")
    seed: int = param(0, least=0, help="another seed, other noise")

    def specs(self) -> Specs:
        made = {"simulated": True, "axes": BODY.facts()}
        spec = StreamSpec((6, 3), rate_hz=self.rate_hz, channels=ACTOR_PARTS, units=("m",), meta=made)
        return {"out": spec}

    def read(self, feed: Feed) -> None:
        for frame, stamp in self.frames(feed, self.rate_hz):
            feed.emit(Chunk(np.array([stamp]), self.markers(frame)[None], stamp))

    def markers(self, frame: int) -> Samples:
        """The markers (6, 3) of a frame."""
        time = frame / self.rate_hz
        made = np.zeros((6, 3))
        for actor in range(2):
            made[3 * actor] = (1.0 - 2.0 * actor, 0.95, 0.0)
            for side in range(2):
                angle = 2 * np.pi * (time / self.stride_s[actor] + 0.5 * side)
                foot = (0.1 - 0.2 * side, 0.08 + 0.12 * max(0.0, np.cos(angle)), 0.25 * np.sin(angle))
                made[3 * actor + 1 + side] = made[3 * actor] * [1.0, 0.0, 1.0] + foot
        made += np.random.default_rng([self.seed, frame]).normal(0.0, self.noise_mm / 1000, made.shape)
        if self.leaves_s and self.leaves_s <= time < self.leaves_s + 3.0:
            made[3:] = np.nan
        return made
