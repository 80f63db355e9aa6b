"""What stands before the background of a depth camera that does not move, and where the floor is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import structlog
from numpy.typing import NDArray

from kinegraph.operators.body.background_kernel import cut_out
from kinegraph.operators.body.camera_moved import disagreement, floors_of, people_cut_out, stand_on
from kinegraph.operators.body.floor import FLOOR, floor_of
from kinegraph.operators.body.names import camera_of
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.data.require import regular
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param

log = structlog.get_logger(__name__)

SUSPECT = 2
"""Frames in a row that disagree with the background until the camera is suspected of having been moved."""
AGAIN_S = 0.1
"""The camera must rest for this long before its new view is a background."""
AT_REST = 0.08
"""In a camera at rest no more of the frame changes within that time: people move in it."""
MOSTLY = 0.8
"""A person never covers this much of the frame: the camera was moved towards something."""


@dataclass(slots=True)
class BackgroundState:
    """
    camera    (4,)    fx, fy, cx, cy; NaN where the spec does not say them: then there is no floor
    behind    (h, w)  the background's depth in mm, 0: not known
    streak    (h, w)  frames in a row in which a pixel was farther than its background (1..), or as near as the frame before (-1..)
    front     (h, w)  where a pixel's streak began, in mm
    frames    how many were seen since the background was begun
    enough    how many of them make a background, and
    again     whether it is not the first one
    moved     frames in a row that disagree with it enough for the camera to have been moved
    reported  whether the floor was reported
    earlier   (h, w)  the background of the view before, which may come back
    shown     (2, h, w)  what stood before the background lately, and up to a second earlier
    turned    whether the people stand on a floor at the top of the image
    floors    (2, 4)  the floor's plane, and that of what would be one in an image turned over; NaN: no such plane, or already decided
    """

    rate_hz: float
    camera: Samples
    behind: NDArray[np.float32]
    streak: NDArray[np.int32]
    front: NDArray[np.float32]
    frames: int
    enough: int
    again: bool
    moved: int
    reported: bool
    earlier: NDArray[np.float32]
    shown: NDArray[np.uint16]
    turned: bool
    floors: Samples


@dataclass(frozen=True, slots=True)
class Background(Operator[BackgroundState]):
    """Depth in, the same with 0 wherever it is background out, and an event whenever the floor was found.

    out    (height, width) uint16: depth in mm of what stands before the background by more than `min_mm` and `min_share` of the depth
    floor  an event: the plane's normal (x right, y down, z away from the camera) towards the room, the camera's height above it in m, and
           the share of the background that lies on it

    The background is what was farthest at each pixel: who stands there at the start is part of it until they step aside. What is put down
    becomes background after `absorb_s`; people do not stand so still. When more than `moved_share` of the frame lies behind the
    background, half of that behind and as much before it, or four fifths before it, the camera may have been moved. Nothing is given out
    until its old view is back or a new one has rested for a tenth of a second. People who then stand by themselves in the new view, as high
    and with as much surface as those seen before, are cut out of its background; others are part of it, as at the start. If they stand on
    a floor at the top of the image, the camera was turned over, or has hung like that from the start: nothing is given out until it is
    turned back.

    >>> given, made = tried(Background)
    >>> (given["in"] > 0).sum().item(), (made["out"] > 0).sum().item()
    (65769, 2955)
    """

    outputs: ClassVar[tuple[str, ...]] = ("out", "floor")
    references: ClassVar[str] = "floor: RANSAC, Fischler and Bolles 1981, then least squares"

    learn_s: float = param(1.0, above=0.0, help="how long to observe before anything counts as foreground")
    min_mm: float = param(60.0, above=0.0, help="how far before the background something must stand")
    min_share: float = param(
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
        behind, earlier, front = np.zeros((3, *spec.shape), np.float32)
        streak, shown = np.zeros(spec.shape, np.int32), np.zeros((2, *spec.shape), np.uint16)
        enough = math.ceil(self.learn_s * rate)
        self.set_state(
            BackgroundState(
                rate,
                np.array(camera),
                behind,
                streak,
                front,
                0,
                enough,
                False,
                0,
                False,
                earlier,
                shown,
                False,
                np.full((2, 4), np.nan),
            )
        )
        out = spec.derive(settling_s=spec.settling_s + self.learn_s)
        return {"out": out, "floor": StreamSpec((), FLOOR, units=("ns", "", "m", ""), meta=dict(spec.meta))}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        out = np.zeros_like(chunk.data)
        floors: list[Array] = []
        absorb = max(1, round(self.absorb_s * s.rate_hz))
        for i, time in enumerate(chunk.time.tolist()):
            frame = chunk.data[i]
            self._watch(frame)
            cut_out(frame, s.behind, s.streak, s.front, self.min_mm, self.min_share, absorb, out[i])
            s.frames += 1
            if s.again and s.frames == s.enough:
                self._settle(frame, out[i])
            if s.frames >= s.enough:
                self._stood_on(out[i])
                if s.frames % max(1, round(s.rate_hz)) == 0 and not (s.moved or (s.turned and s.again)):
                    s.shown[1], s.shown[0] = s.shown[0], out[i]
            if s.frames < s.enough or s.turned:
                out[i] = 0
                continue
            if not s.reported:
                s.reported = True
                floors += floor_of(s.behind, s.camera, time, upside_down=self.upside_down)
        found = np.array(floors, FLOOR)
        return [
            ("out", Chunk(chunk.time, out, chunk.until, chunk.lost)),
            ("floor", Chunk(found["onset"].copy(), found, chunk.until, 0)),
        ]

    def _watch(self, frame: Array) -> None:
        """Before a frame is taken: begin a new background where the camera was moved, go back to the old one where it shows that again."""
        s = self.state
        if not s.again and s.frames < s.enough:
            return
        farther, nearer = disagreement(frame, s.behind, self.min_mm, self.min_share)
        if s.frames < s.enough:
            if not self._back(frame) and farther + nearer > AT_REST:
                self._begin()
            return
        young = s.again and s.frames < s.enough + s.rate_hz
        most = AT_REST if young else self.moved_share
        s.moved = s.moved + 1 if farther > most or nearer > MOSTLY or min(farther, nearer) > most / 2 else 0
        if s.moved >= SUSPECT and not self._back(frame):
            if not young:
                log.warning("the depth camera was moved; its background is learned again")
                s.earlier[:] = s.behind
            self._begin()

    def _stood_on(self, out: Array) -> None:
        """Of two planes that may be the floor, that is it on which people stand."""
        s = self.state
        if not (s.reported or s.turned):
            s.floors[:] = floors_of(s.behind, s.camera, upside_down=self.upside_down)
        if s.moved or np.isnan(s.floors[1, 3]):
            return
        right, wrong = stand_on(out, s.floors, s.camera)
        if right or wrong:
            s.floors[:] = np.nan
        if wrong and not right:
            s.turned = True
            log.warning(
                "the depth camera hangs upside down and sees no person; turn it, or set upside_down the other way"
            )

    def _back(self, frame: Array) -> bool:
        """Go back to the background of the view before if a frame shows that."""
        s = self.state
        if not s.earlier.any():
            return False
        farther, nearer = disagreement(frame, s.earlier, self.min_mm, self.min_share)
        if farther > self.moved_share / 2 or nearer > MOSTLY:
            return False
        s.behind[:], s.streak[:], s.front[:], s.earlier[:] = s.earlier, 0, 0.0, 0.0
        s.frames, s.moved, s.turned = s.enough + round(s.rate_hz), 0, False
        return True

    def _begin(self) -> None:
        s = self.state
        s.behind[:], s.streak[:], s.front[:] = 0.0, 0, 0.0
        s.frames, s.enough, s.again = 0, max(2, round(AGAIN_S * s.rate_hz)), True
        s.moved, s.reported = 0, False

    def _settle(self, frame: Array, out: Array) -> None:
        """A new background is complete: the people are cut out of it and given out."""
        s = self.state
        old = s.shown[int(s.shown.any(axis=(1, 2)).all())]
        cut, s.turned = people_cut_out(s.behind, s.camera, old, upside_down=self.upside_down)
        if s.turned:
            log.warning("the depth camera was turned over: no person is found until it is turned back")
        if cut:
            cut_out(frame, s.behind, s.streak, s.front, self.min_mm, self.min_share, 1 << 30, out)

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
