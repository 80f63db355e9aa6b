"""A person's markers in metres from one ordinary camera, by the body's height."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.body.camera.distance import BODY, bones_of, distance, scale_of
from kinegraph.operators.body.names import MARKERS, SEEN, TAKEN, camera_of, markers_specs
from kinegraph.operators.body.placing import placed_at
from kinegraph.stream.chunk import NS, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import InputError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param

MAX_COUNTED = 60.0
"""The scale of the network's guess is a mean over this many frames at least."""


@dataclass(slots=True)
class OneCameraState:
    """
    camera   (4,)  fx, fy, cx, cy in pixels
    lengths  (7,)  of bones (m)
    scale    (2,)  how much larger the body is than the network takes it for, and of how many frames that is the mean
    away     (1,)  how far away the hips are (m), smoothed; NaN: not known
    last     stamp of the newest frame with a person
    """

    camera: Samples
    lengths: Samples
    scale: Samples
    away: Samples
    last: int


@dataclass(frozen=True, slots=True)
class OneCamera(Operator[OneCameraState]):
    """What a network sees in an ordinary image (operators.body.camera.image_pose.ImagePose) in, 20 markers in metres out.

    out         (20, 3)  x right, y down, z away from the camera; NaN where a marker is not known
    confidence  (20,)    0 to 1; below `least` a marker is NaN

    One camera measures no depth. How far away the person is follows from `height_m`: at that distance the network's own guess of the body,
    with bones as long as those of somebody of that height, covers its landmarks. Then each joint is put on its line of sight where its bone
    is as long as it is, on the side (nearer, farther) that the network takes it for. The distance is smoothed over `smooth_s`, as it hardly
    changes from frame to frame and is the least certain of all. A wrong height makes everything larger or smaller, by its share.

    >>> given, made = tried(OneCamera)
    >>> made["out"].shape, made["confidence"].max().round(2).item()
    ((90, 20, 3), 0.95)
    """

    outputs: ClassVar[tuple[str, ...]] = ("out", "confidence")

    height_m: float = param(1.75, least=0.5, most=2.5, help="how tall the person is")
    least: float = param(0.3, least=0.0, most=1.0, help="a marker with less confidence is NaN; 0: keep all")
    smooth_s: float = param(0.3, least=0.0, most=5.0, help="over how long the distance is smoothed")
    reset_gap_s: float = reset_gap(1.0, "after so long without a person another one may come", above=0.0)

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if spec.dtype != SEEN:
            raise InputError("in", spec.describe(), "what operators.body.camera.image_pose.ImagePose gives")
        camera = camera_of(spec)
        if camera is None:
            raise InputError("in", "a stream of unknown geometry", "one with `camera` in its spec: fx, fy, cx, cy")
        self.set_state(OneCameraState(np.array(camera), bones_of(self.height_m), np.zeros(2), np.full(1, np.nan), 0))
        return markers_specs(spec)

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        n = len(chunk)
        out, confidence = np.full((n, len(MARKERS), 3), np.nan), np.zeros((n, len(MARKERS)))
        for i, time in enumerate(chunk.time.tolist()):
            self._place(time, chunk.data[i], out[i], confidence[i])
        return [
            ("out", Chunk(chunk.time, out, chunk.until, chunk.lost)),
            ("confidence", Chunk(chunk.time, confidence, chunk.until, chunk.lost)),
        ]

    def _place(self, time: int, seen: np.void, out: Samples, confidence: Samples) -> None:
        """One frame."""
        s = self.state
        if not seen["presence"] >= 0.5:
            return
        if time - s.last > self.reset_gap_s * NS:
            s.scale[:], s.away[0] = 0.0, np.nan
        points = seen["points"].copy()
        now = scale_of(points, s.lengths)
        if not math.isnan(now):
            s.scale[1] = min(s.scale[1] + 1.0, MAX_COUNTED)
            s.scale[0] += (now - s.scale[0]) / s.scale[1]
        if s.scale[1] == 0.0:
            return
        away = distance(points, s.camera, s.scale[0], BODY)
        if math.isnan(away):
            return
        before = (time - s.last) / NS
        share = 1.0 if math.isnan(s.away[0]) or self.smooth_s == 0.0 else 1.0 - math.exp(-before / self.smooth_s)
        s.away[0] = away if share == 1.0 else s.away[0] + share * (away - s.away[0])
        s.last = time
        points[:, 5:8] *= s.scale[0]
        places, doubt = np.empty((34, 3)), np.empty((34, 2))
        placed_at(points, s.camera, s.away[0], s.lengths.copy(), np.zeros(7), places, doubt)
        seen_of = np.minimum(points[:, 3], points[:, 4]) * (1.0 - np.minimum(doubt[:, 1], 1.0))
        confidence[:] = seen_of[TAKEN]
        out[:] = places[TAKEN]
        out[confidence < self.least] = np.nan

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random, n = np.random.default_rng(6), 90
        seen = np.zeros(n, SEEN)
        k = np.arange(34)
        side, down = np.where(k % 2, 0.1, -0.1), 0.06 * (k - 23.0)
        points = seen["points"]
        points[..., 0] = 160 + 285.0 * side / 2.5 + random.normal(0, 0.5, (n, 34))
        points[..., 1] = 120 + 285.0 * down / 2.5 + random.normal(0, 0.5, (n, 34))
        points[..., 2] = np.nan
        points[..., 3:5] = 0.95
        points[..., 5], points[..., 6] = side, down
        points[:, ::7, 3] = 0.2
        seen["presence"] = 0.95
        seen["presence"][40:44], points[40:44] = np.nan, np.nan
        meta = {"camera": {"fx": 285.6, "fy": 285.6, "cx": 159.5, "cy": 119.5}}
        spec = StreamSpec((), SEEN, rate_hz=30.0, units=("px, m", "", ""), meta=meta)
        return [
            Case(cls(), {"in": (spec, grid(30.0, n), seen)}, least=80),
            Case(cls(least=0.0, smooth_s=0.0, reset_gap_s=0.05), {"in": (spec, grid(30.0, n), seen)}, least=80),
        ]
