"""Markers of a body from its depth alone, without a network: ends of limbs by geodesic extrema, the joints on the way to them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.body.bones import possible
from kinegraph.operators.body.ends import (
    CUT_M,
    ENDS,
    MOST_ENDS,
    ROUND_M,
    USUAL,
    beside,
    border_of,
    cheapest,
    costs,
    cut_off,
    head_cut_off,
    outside,
)
from kinegraph.operators.body.facing import CELLS, facing_of, shape_of, weights
from kinegraph.operators.body.geodesic_kernel import (
    area_around,
    extrema_of,
    middle_of,
    place_between,
    surface_at,
    surface_of,
    walk_back,
)
from kinegraph.operators.body.names import MARKERS, camera_of, markers_specs
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import InputError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param

JOINTS = (
    ((0.10, "head", 0.09),),
    ((0.13, "left_wrist", 0.025), (0.38, "left_elbow", 0.035)),
    ((0.13, "right_wrist", 0.025), (0.38, "right_elbow", 0.035)),
    ((0.03, "left_toe", 0.02), (0.15, "left_ankle", 0.04), (0.55, "left_knee", 0.055)),
    ((0.03, "right_toe", 0.02), (0.15, "right_ankle", 0.04), (0.55, "right_knee", 0.055)),
)
"""By end: how far back along the surface a marker lies (m, for 1.75 m), which one, how far inside the body."""
INSIDE = {"shoulder": (0.08, 0.08), "hip": (0.11, 0.04)}
"""How far inside the trunk its middle is there (m, for 1.75 m): seen from the front, and how much farther from the side."""
HIPS_AT, WAYS = 0.42, (1.3, 2.6)
"""The hips lie so far along the way from head to foot, as a share of it; and how long such a way is (m, for 1.75 m)."""
NEAR_AXIS_M = 0.10
"""The trunk's surface is what is seen within this distance of its axis."""
MOST_WIDTH = 160
LEAST_PIXELS = 60
ARMS, LEGS = (1, 2), (3, 4)
"""Left and right of ENDS."""
HAVE_SIDES = [k for k, name in enumerate(MARKERS) if name.startswith(("left_", "right_"))]
LEAP_M, REMEMBERED_S = 0.35, 0.5
"""An end that leaps farther from a frame to the next is doubtful; of a body that does, nothing that was remembered holds."""
KEEPS = 0.8
TOWARDS = (0.0, -0.3)
"""What speaks for facing the camera as long as nothing is known."""
FACES = 0.5
"""How likely whoever comes into view faces the way that the shape of the first frame shows (log odds)."""
SPEAKS, MOST_ODDS, CHANGES, SURE = 1.0, 2.0, -0.1, 0.1
"""How much the shape of a frame that is sure of it counts for the heading, or against it, and the most that it adds up to; below which the
heading is turned round; below which it is as likely as not that left is left: what has another side is missing then."""
CROSSED_M, ASTRAY_M = (0.10, 0.04), 0.15
"""Elbows that lie on each other's side by the first, and knees by the second, are exchanged; one alone, by the third, is left out."""
HIPS, BESIDE_M = [MARKERS.index(f"{side}_hip") for side in ("left", "right")], 0.03
"""Where a hip lies beside the body by this as the camera sees it, neither is where it was put. If nothing of the body is seen below
them they are kept: they are hidden, as those of somebody at a desk."""
ALONG = 0.4
"""The chest is widest along the shoulders if that is so far from where the shape says that the left is (a cosine)."""


@dataclass(slots=True)
class ExtremaState:
    """
    camera   (4,)    fx, fy, cx, cy in pixels
    heading  (2,)    x and z of where the person faces
    odds     log odds that this is not the other way round, and left is left
    before   (5, 3)  where the ends were when they were seen last (m; NaN: never)
    seen     (5,)    when that was (ns)
    middle   (3,)    where its middle was then (m)
    last     stamp of the newest frame that showed somebody
    """

    camera: Samples
    heading: Samples
    odds: float
    before: Samples
    seen: Array
    middle: Samples
    last: int


@dataclass(frozen=True, slots=True)
class Extrema(Operator[ExtremaState]):
    """Depth of one person in (0 elsewhere, of operators.body.persons.Persons), markers out: no network, no image, in the dark.

    out         (20, 3)  as of operators.body.markers.Markers: x right, y down, z away from the camera, m; NaN where a marker is not known
    confidence  (20,)    0 to 1

    Head, hands and feet are the points farthest along the body's surface from its middle, distinguished by where they were and where they
    usually are; wrists, elbows, ankles and knees lie on the way back from them. What something nearer cuts off, as a raised arm the head,
    is joined by the shortest way across. Shoulders and hips are where they usually are below the head, on the ways from it to the feet,
    across where the body's shape faces, and missing where that is beside the body. Hands before the trunk are not found, and are missing.
    Nose, ears and heels always are.
    Much coarser than the network: what there is where it cannot be used.

    >>> given, made = tried(Extrema)
    >>> given["in"].shape, made["out"][-1, 0].round(2)
    ((60, 60, 48), array([-0.09, -0.79,  2.1 ]))
    """

    outputs: ClassVar[tuple[str, ...]] = ("out", "confidence")
    references: ClassVar[str] = "geodesic extrema: Plagemann 2010, Baak 2011"

    height_m: float = param(1.75, above=0.5, most=2.5, help="the person's height: all lengths go with it")
    apart_m: float = param(0.10, above=0.01, most=0.5, help="pixels side by side are one surface if they are nearer")
    reset_gap_s: float = reset_gap(0.5, "after so long without a person nothing is remembered", above=0.0)

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if spec.dtype != np.uint16 or len(spec.shape) != 2:
            raise InputError("in", spec.describe(), "depth frames (height, width) uint16 in mm, 0 but for one person")
        camera = camera_of(spec)
        if camera is None:
            raise InputError("in", "a stream of unknown geometry", "one with `camera` in its spec: fx, fy, cx, cy")
        n = len(ENDS)
        self.set_state(
            ExtremaState(
                np.array(camera), np.zeros(2), 0.0, np.full((n, 3), np.nan), np.zeros(n, np.int64), np.zeros(3), 0
            )
        )
        return markers_specs(spec)

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        n = len(chunk)
        out, confidence = np.full((n, len(MARKERS), 3), np.nan), np.zeros((n, len(MARKERS)))
        for i, time in enumerate(chunk.time.tolist()):
            self._find(time, chunk.data[i], out[i], confidence[i])
        return [
            ("out", Chunk(chunk.time, out, chunk.until, chunk.lost)),
            ("confidence", Chunk(chunk.time, confidence, chunk.until, chunk.lost)),
        ]

    def _find(self, time: int, depth: Array, out: Samples, confidence: Samples) -> None:
        """One frame."""
        s, step = self.state, max(1, -(-depth.shape[1] // MOST_WIDTH))
        points, middle = np.empty((depth.shape[0] // step, depth.shape[1] // step, 3)), np.empty(3)
        if surface_of(depth, s.camera, step, points) < LEAST_PIXELS:
            return
        if time - s.last > self.reset_gap_s * NS:
            s.heading[:], s.odds, s.before[:], s.seen[:] = 0.0, 0.0, np.nan, 0
        s.last = time
        self._face(depth)
        size = self.height_m / 1.75
        pixels = points.shape[0] * points.shape[1]
        distance, parent, found = np.empty(pixels), np.empty(pixels, np.int64), np.empty(MOST_ENDS, np.int64)
        count = extrema_of(points, middle_of(points, middle), self.apart_m, distance, parent, found, 0.2 * size)
        at = points.reshape(-1, 3)[found[:count]]
        middle *= 1.0 + INSIDE["hip"][0] * size / middle[2]
        areas = np.array([area_around(points, place, ROUND_M * size, s.camera / step) for place in at]) / size**2
        border = border_of(points)
        cut = cut_off(border, at, CUT_M * size)
        areas[cut] = np.nan
        self._moved_on(middle)
        usual = middle + size * (USUAL[:, :1] * self._left() - USUAL[:, 1:] * np.array([0.0, 1.0, 0.0]))
        fresh = (time - s.seen < REMEMBERED_S * NS) & (s.seen > 0)
        named = cheapest(costs(at, areas, usual, s.before, fresh, size))
        if named[0] >= 0 and head_cut_off(border, at[named[0]], usual[0]):
            named[0] = -1
        for end, k in enumerate(named):
            if k < 0:
                continue
            doubtful = math.dist(s.before[end], at[k]) > LEAP_M if s.seen[end] else False
            s.before[end], s.seen[end] = at[k], time
            if cut[k]:
                continue
            self._joints(end, points, parent, int(found[k]), 0.4 if doubtful else 0.7, size, out, confidence)
        across = self._across(size, points, middle, out)
        ends = [int(found[k]) if k >= 0 else -1 for k in named]
        self._trunk(size, points, hips_between(size, points, parent, ends, middle), across, out, confidence)
        self._own_sides(size, across, out, confidence)
        if s.odds < SURE:
            confidence[HAVE_SIDES] = 0.0
        confidence[~possible(size, out) | outside(out, s.camera, depth.shape)] = 0.0
        is_seen_below = bool((points[..., 1] > out[HIPS, 1].max()).any())
        if is_seen_below and any(beside(points, out[k], s.camera / step, BESIDE_M) for k in HIPS):
            confidence[HIPS] = 0.0
        out[confidence < 0.5] = np.nan

    def _moved_on(self, middle: Samples) -> None:
        """Forget where the ends were when the body, of this `middle` (3,), is somewhere else at once."""
        s = self.state
        if math.dist(s.middle, middle) > LEAP_M:
            s.seen[:] = 0
        s.middle[:] = middle

    def _face(self, depth: Array) -> None:
        """Where the body faces, by its shape, smoothed."""
        shape, facing, heading = np.empty((2, CELLS, CELLS)), np.zeros(2), self.state.heading
        shape_of(depth, shape)
        facing_of(shape, *weights(), facing)
        if not heading.any():
            heading[:] = facing + TOWARDS
            self.state.odds = FACES
        speaks = SPEAKS * math.hypot(*facing) * float(facing @ heading) / math.hypot(*heading)
        self.state.odds = min(self.state.odds + speaks, MOST_ODDS)
        if self.state.odds < CHANGES:
            heading *= -1.0
            self.state.odds *= -1.0
            self._exchange(ARMS, LEGS)
        heading[:] = KEEPS * heading + (1 - KEEPS) * facing

    def _exchange(self, *ends: tuple[int, int]) -> None:
        """Take what was remembered of a left end for that of the right one."""
        s = self.state
        for left, right in ends:
            s.before[[left, right]], s.seen[[left, right]] = s.before[[right, left]], s.seen[[right, left]]

    def _own_sides(self, size: float, left: Samples, out: Samples, trust: Samples) -> None:
        """Exchange arms, or legs, that are on each other's side, and leave out one that is alone on the other side."""
        hips = 0.5 * (out[MARKERS.index("left_hip")] + out[MARKERS.index("right_hip")])
        if not np.isfinite(hips).all():
            return
        for ends, names, crossed in zip(
            (ARMS, LEGS), (("elbow", "wrist"), ("knee", "ankle", "toe")), CROSSED_M, strict=True
        ):
            pairs = [(MARKERS.index(f"left_{n}"), MARKERS.index(f"right_{n}")) for n in names]
            aside = [float((out[k] - hips) @ left) / size for k in pairs[0]]
            if aside[1] - aside[0] > crossed:
                self._exchange(ends)
                for a, b in pairs:
                    out[[a, b]], trust[[a, b]] = out[[b, a]], trust[[b, a]]
            elif (np.isnan(aside[1]) and aside[0] < -ASTRAY_M) or (np.isnan(aside[0]) and aside[1] > ASTRAY_M):
                trust[[k for pair in pairs for k in pair]] = 0.0
                self.state.seen[list(ends)] = 0

    def _left(self) -> Samples:
        """The direction of the person's left."""
        x, z = self.state.heading
        length = math.hypot(x, z)
        return np.array([-z / length, 0.0, x / length]) if length > 0.0 else np.array([1.0, 0.0, 0.0])

    def _joints(
        self,
        end: int,
        points: Samples,
        parent: Array,
        pixel: int,
        sure: float,
        size: float,
        out: Samples,
        trust: Samples,
    ) -> None:
        """The markers on the way back from an end."""
        place = np.empty(3)
        for along, name, inside in JOINTS[end]:
            if walk_back(points, parent, pixel, along * size, self.apart_m, place):
                k = MARKERS.index(name)
                out[k], trust[k] = place * (1.0 + inside / place[2]), sure

    def _across(self, size: float, points: Samples, middle: Samples, out: Samples) -> Samples:
        """The direction of the left shoulder: along which the chest's surface is widest, unless the body is seen from the side."""
        left, top = self._left(), out[MARKERS.index("head"), 1] + 0.22 * size
        if not np.isfinite(top):
            return left
        level = (points[..., 1] > top) & (points[..., 1] < top + 0.3 * size)
        chest = points[level & (np.abs(points[..., 0] - middle[0]) < 0.25 * size)][:, ::2]
        if len(chest) < LEAST_PIXELS:
            return left
        x, z = (chest - np.median(chest, axis=0)).T
        angle = 0.5 * math.atan2(2.0 * float(np.mean(x * z)), float(np.mean(x * x) - np.mean(z * z)))
        widest = np.array([math.cos(angle), 0.0, math.sin(angle)])
        along = float(widest @ left)
        if abs(along) > ALONG:
            left = widest * math.copysign(1.0, along)
            self.state.heading[:] = (
                left[2],
                -left[0],
            )  # what has been seen of it is kept against a shape that is not sure
        return left

    def _trunk(self, size: float, points: Samples, hips: Samples, left: Samples, out: Samples, trust: Samples) -> None:
        """Shoulders and hips: below the head, towards `hips` (3,), across where the body faces, inside what is seen there."""
        head = MARKERS.index("head")
        if not trust[head]:
            return
        down = hips - out[head]
        length = float(np.linalg.norm(down))
        down = down / length if 0.3 * size < length < 1.1 * size else np.array([0.0, 1.0, 0.0])
        for name, below, half in (("shoulder", 0.25, 0.18), ("hip", 0.72, 0.10)):
            place = out[head] + size * below * down
            least, more = INSIDE[name]
            surface = surface_at(points, place, NEAR_AXIS_M * size)
            if math.isfinite(surface):
                place *= (surface + size * (least + more * left[2] ** 2)) / place[2]
            for side, sign in (("left", 1.0), ("right", -1.0)):
                k = MARKERS.index(f"{side}_{name}")
                out[k] = place + size * sign * half * left
                trust[k] = 0.6

    @classmethod
    def warm_up_cases(cls) -> Sequence[Case]:
        one = np.array([-1])
        hips_between(1.0, np.ones((1, 1, 3)), one, [0] * len(ENDS), np.zeros(3))  # no made-up body has a head and feet
        return cls.cases()

    @classmethod
    def cases(cls) -> Sequence[Case]:
        n, random = 60, np.random.default_rng(3)
        frames = np.zeros((n, 60, 48), np.uint16)
        frames[:, 4:14, 20:28] = 2000
        frames[:, 14:34, 16:32] = 2000
        frames[:, 34:58, 17:22] = frames[:, 34:58, 26:31] = 2000
        for k in range(n):
            frames[k, 14 + k // 6 : 18 + k // 6, 4:16] = 1980
            frames[k, 16:36, 33:36] = frames[k, 15:18, 31:34] = 2010
        frames[40:43] = 0
        frames[frames > 0] += random.integers(0, 12, int((frames > 0).sum())).astype(np.uint16)
        meta = {"camera": {"fx": 60.0, "fy": 60.0, "cx": 23.5, "cy": 29.5}}
        spec = StreamSpec((60, 48), np.dtype(np.uint16), rate_hz=30.0, units=("mm",), meta=meta)
        return [Case(cls(), {"in": (spec, grid(30.0, n), frames)}, least=2 * n)]


def hips_between(size: float, points: Samples, parent: Array, ends: Sequence[int], middle: Samples) -> Samples:
    """About where the hips are (3,): on the ways from the head to the feet, or the body's `middle` where neither way is possible.

    `ends` are the pixels of ENDS, -1 where one was not found. When somebody bends or crouches, the middle is far from the hips.
    """
    place, ways = np.empty(3), list[Samples]()
    for foot in ends[3:]:
        if min(ends[0], foot) >= 0:
            long = place_between(points, parent, ends[0], foot, HIPS_AT, place)
            if WAYS[0] * size < long < WAYS[1] * size:
                ways.append(place * (1.0 + INSIDE["hip"][0] * size / place[2]))
    return np.mean(ways, axis=0) if ways else middle
