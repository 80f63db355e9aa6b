"""A person's markers in space, from what a frame shows of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.body.confidence import trusted
from kinegraph.operators.body.left_right import SURE, unturned
from kinegraph.operators.body.legs import own_legs
from kinegraph.operators.body.names import MARKERS, OTHER_SIDE, SEEN, SIDED, TAKEN, camera_of, markers_specs
from kinegraph.operators.body.placing import INSIDE, LENGTHS
from kinegraph.stream.chunk import NS, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import InputError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param

NOSE, EARS, SHOULDERS, HIPS = 0, [7, 8], [11, 12], [23, 24]
"""Landmarks, the left one first."""


@dataclass(slots=True)
class MarkersState:
    """
    camera    (4,)     fx, fy, cx, cy in pixels
    heading   (4,)     x and z of where the person faces, whether that is known, and the log odds that left is left
    pixels    (34, 2)  where the landmarks were in the image of the newest frame
    lengths   (7,)     of bones (m), and counts (7,): of how much was measured they are
    before    (34, 3)  where the landmarks were in the newest frame (m; NaN: unknown)
    last      stamp of the newest frame
    """

    camera: Samples
    heading: Samples
    pixels: Samples
    lengths: Samples
    counts: Samples
    before: Samples
    last: int


@dataclass(frozen=True, slots=True)
class Markers(Operator[MarkersState]):
    """What a frame shows of a person (operators.body.network.PoseNetwork) in, 20 markers in metres out.

    out         (20, 3)  x right, y down, z away from the camera; NaN where a marker is not known
    confidence  (20,)    0 to 1; below `least` a marker is NaN

    A depth is believed where it was measured and fits the network's guess or the bone's length, which is learned from the frames in which
    both its ends were measured; a marker that something hides is put on its line of sight where the bone is as long as it is. Left and
    right stay what they are when the person turns: a network that takes a back for a front is corrected by the heading so far, by the
    body's shape and by depths; while these do not tell which side is left, markers that have another side are missing. After a gap the
    heading is taken from the shape; bones keep their lengths until the person was out of view for `forget_s`.

    >>> given, made = tried(Markers)
    >>> given["in"]["points"].shape, made["out"].shape
    ((90, 34, 8), (90, 20, 3))
    """

    outputs: ClassVar[tuple[str, ...]] = ("out", "confidence")

    least: float = param(0.5, least=0.0, most=1.0, help="a marker with less confidence is NaN; 0: keep all")
    presence: float = param(
        0.5, least=0.0, most=1.0, help="frames with less confidence that a person is there give no markers"
    )
    reset_gap_s: float = reset_gap(0.5, "after so long without a person the heading is forgotten", above=0.0)
    forget_s: float = param(
        5.0, above=0.0, help="after so long without a person the lengths of bones are: another one may come"
    )

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if spec.dtype != SEEN:
            raise InputError("in", spec.describe(), "what operators.body.network.PoseNetwork gives")
        camera = camera_of(spec)
        if camera is None:
            raise InputError("in", "a stream of unknown geometry", "one with `camera` in its spec: fx, fy, cx, cy")
        self.set_state(
            MarkersState(
                np.array(camera),
                np.zeros(4),
                np.full((34, 2), np.nan),
                LENGTHS.copy(),
                np.zeros_like(LENGTHS),
                np.full((34, 3), np.nan),
                0,
            )
        )
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
        if not seen["presence"] >= self.presence:
            return
        if time - s.last > self.forget_s * NS:
            s.lengths[:], s.counts[:] = LENGTHS, 0.0
        if time - s.last > self.reset_gap_s * NS:
            s.heading[:], s.before[:] = 0.0, np.nan
        points, places, doubt = np.empty((34, 8)), np.empty((34, 3)), np.empty((34, 2))
        given, facing = (np.ascontiguousarray(seen[name]) for name in ("points", "facing"))
        unturned(given, facing, OTHER_SIDE, s.heading, s.pixels, points)
        trunk = own_legs(points, s.camera, s.lengths, s.counts, s.pixels, places, doubt)
        if np.isnan(trunk):
            return
        trust, presence, seconds = np.empty(34), float(seen["presence"]), min((time - s.last) / NS, 1.0)
        trusted(points, places, doubt, s.before, seconds, presence, OTHER_SIDE, trunk, INSIDE, s.camera[0], trust)
        trust[SIDED] = np.minimum(trust[SIDED], max(s.heading[3], 0.0) / (2.0 * SURE))
        if shows_back_of_head(points):
            trust[NOSE] = 0.0
        s.last, s.before[:] = time, places
        confidence[:] = trust[TAKEN]
        out[:] = places[TAKEN]
        out[confidence < self.least] = np.nan

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random, n = np.random.default_rng(6), 90
        seen = np.zeros(n, SEEN)
        k = np.arange(34)
        seen["points"][..., 0] = 160 + np.where(k % 2, 20, -20) + random.normal(0, 1, (n, 34))
        seen["points"][..., 1] = 30 + 5 * k
        seen["points"][..., 2] = 2.5 + random.normal(0, 0.05, (n, 34))
        seen["points"][..., 3:5] = 0.95
        seen["points"][..., 5] = np.where(k % 2, 0.2, -0.2)
        seen["points"][..., 6] = 0.05 * (k - 23)
        seen["points"][:, ::5, 2] = np.nan
        seen["facing"][:, 1] = np.where(np.arange(n) < 60, -0.8, 0.8)
        seen["presence"] = 0.95
        seen["presence"][40:44], seen["points"][40:44] = np.nan, np.nan
        meta = {"camera": {"fx": 285.6, "fy": 285.6, "cx": 159.5, "cy": 119.5}}
        spec = StreamSpec((), SEEN, rate_hz=30.0, units=("px, m", "", ""), meta=meta)
        return [
            Case(cls(), {"in": (spec, grid(30.0, n), seen)}, least=80),
            Case(cls(least=0.0, reset_gap_s=0.05), {"in": (spec, grid(30.0, n), seen)}, least=80),
        ]


def shows_back_of_head(points: Samples) -> bool:
    """Whether the camera sees the head of `points` (34, 8) from behind: the left ear is to the left, for who looks along the trunk."""
    left, right = points[EARS, :2]
    down = points[HIPS, :2].mean(axis=0) - points[SHOULDERS, :2].mean(axis=0)
    return bool((left[0] - right[0]) * down[1] < (left[1] - right[1]) * down[0])
