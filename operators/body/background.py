"""What stands before the background of a depth camera that does not move, and where the floor is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import structlog
from numpy.typing import NDArray

from operators.body.background_kernel import cut_out
from operators.body.floor import FLOOR, floor_of
from operators.body.names import camera_of
from stream.chunk import Array, Chunk, Samples, Specs, StreamSpec
from stream.errors import InputError
from stream.operator import Case, Operator, grid
from stream.params import param
from stream.require import regular

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class BackgroundState:
    """
    camera    (4,)    fx, fy, cx, cy; NaN where the spec does not say them: then there is no floor
    behind    (h, w)  the background's depth in mm, 0: not known
    streak    (h, w)  frames in a row in which a pixel was farther than its background (1..), or as near as the frame before (-1..)
    front     (h, w)  where a pixel's streak began, in mm
    frames    how many were seen since the background was begun
    moved     frames in a row in which enough is farther away to mean that the camera moved
    told      whether the floor was
    """

    rate_hz: float
    camera: Samples
    behind: NDArray[np.float32]
    streak: NDArray[np.int32]
    front: NDArray[np.float32]
    frames: int
    moved: int
    told: bool


@dataclass(frozen=True, slots=True)
class Background(Operator[BackgroundState]):
    """Depth in, the same with 0 wherever it is background out, and an event whenever the floor was found.

    out    (height, width) uint16: depth in mm of what stands before the background by more than `least_mm` and `least_share` of the depth
    floor  an event: the plane's normal (x right, y down, z away from the camera) towards the room, the camera's height above it in m, and
           the share of the background that lies on it

    The background is what was farthest at each pixel: who stands there at the start is part of it until they step aside. What is put down
    becomes background after `absorb_s`; people do not stand so still. When more than `moved_share` of the frame lies behind the background
    for a second, the camera was moved: the background is learned again, and nothing is given out for `learn_s`.
    """

    outputs: ClassVar[tuple[str, ...]] = ("out", "floor")
    agrees: ClassVar[str] = "floor: RANSAC, Fischler and Bolles 1981, then least squares"

    learn_s: float = param(1.0, above=0.0, help="how long is looked at before anything is taken for a foreground")
    least_mm: float = param(60.0, above=0.0, help="how far before the background something must stand")
    least_share: float = param(
        0.03, above=0.0, most=0.5, help="and at least this share of the background's depth: noise grows with it"
    )
    absorb_s: float = param(120.0, above=0.0, help="what has not moved for so long is background")
    moved_share: float = param(
        0.25, above=0.0, most=1.0, help="the camera was moved if more of the frame lies behind the background"
    )
    upside_down: bool = param(False, help="the camera hangs upside down: the floor is at the top of the image")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if spec.dtype != np.uint16 or len(spec.shape) != 2:
            raise InputError("in", spec.describe(), "depth frames (height, width) uint16 in mm")
        rate = regular(spec)
        camera = camera_of(spec) or (np.nan,) * 4
        zeros = np.zeros(spec.shape, np.float32)
        streak = np.zeros(spec.shape, np.int32)
        self.hold(BackgroundState(rate, np.array(camera), zeros, streak, zeros.copy(), 0, 0, False))
        out = spec.derive(settling_s=spec.settling_s + self.learn_s)
        return {"out": out, "floor": StreamSpec((), FLOOR, units=("ns", "", "m", ""), meta=dict(spec.meta))}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        out = np.zeros_like(chunk.data)
        floors: list[Array] = []
        absorb = max(1, round(self.absorb_s * s.rate_hz))
        for i, time in enumerate(chunk.time.tolist()):
            self._count(
                cut_out(chunk.data[i], s.behind, s.streak, s.front, self.least_mm, self.least_share, absorb, out[i])
            )
            if s.frames < self.learn_s * s.rate_hz:
                out[i] = 0
            elif not s.told:
                s.told = True
                floors += floor_of(s.behind, s.camera, time, upside_down=self.upside_down)
        found = np.array(floors, FLOOR)
        return [
            ("out", Chunk(chunk.time, out, chunk.until, chunk.lost)),
            ("floor", Chunk(found["onset"].copy(), found, chunk.until, 0)),
        ]

    def _count(self, farther: float) -> None:
        """One frame more; from the beginning again where the camera was moved."""
        s = self.state
        s.frames += 1
        s.moved = s.moved + 1 if farther > self.moved_share and s.frames > self.learn_s * s.rate_hz else 0
        if s.moved >= s.rate_hz:
            log.warning("the depth camera was moved; its background is learned again")
            s.behind[:], s.streak[:], s.front[:] = 0.0, 0, 0.0
            s.frames, s.moved, s.told = 0, 0, False

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(8)
        y = np.arange(24)[:, None]
        room = np.broadcast_to(np.minimum(3000.0, 20000.0 / np.maximum(y - 8.0, 1.0)), (24, 32))
        frames = np.repeat(room[None], 90, 0) + random.normal(0, 8, (90, 24, 32))
        for k in range(20, 60):
            frames[k, 6:20, k // 3 : k // 3 + 6] = 1200.0
        frames[60:] = 4000.0 + random.normal(0, 8, (30, 24, 32))
        frames[random.random(frames.shape) < 0.05] = 0
        meta = {"camera": {"fx": 30.0, "fy": 30.0, "cx": 15.5, "cy": 11.5}}
        spec = StreamSpec((24, 32), np.dtype(np.uint16), rate_hz=30.0, units=("mm",), meta=meta)
        given = {"in": (spec, grid(30.0, 90), frames.astype(np.uint16))}
        return [Case(cls(learn_s=0.3, absorb_s=0.5), given, least=91), Case(cls(upside_down=True), given, least=90)]
