"""The self-organising map of poses, learned while they come: where each lies among the poses so far (thesis, 5.3.3)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np

from kinegraph.operators.inputs.channels import names_of
from kinegraph.operators.inputs.lengths import CM, metres
from kinegraph.operators.maps.pose_map.som_kernel import learn_pose, nearest_cells, next_random, place_between, touch
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.compiler.record import numbers_of, record
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import regular, samples_in, width_of
from kinegraph.stream.domain.pose_map import MotionIndex
from kinegraph.stream.errors import InputError, nearest
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Emitted, Operator, grid
from kinegraph.stream.params import param

WIDEST = 300
"""More features take longer than a frame."""
TRIED = 256
"""A map is tried on this many poses before it is shown."""


class GridNumbers:
    columns: int
    every: int
    tried: int
    steps: int
    most: int
    seen: int
    step: int
    shown: int
    good: int
    torn: int
    drawn: int


@record
@dataclass(slots=True)
class PoseGridState(GridNumbers):
    """
    used (u,)             which of the input's numbers count
    columns               of the grid
    every, tried          frames between maps; how many of them are for trying
    steps                 of learning with every pose
    most                  maps after which nothing more is learned; 0: always learn
    seen, step, shown     whole poses so far; frame of the map that is being learned; maps shown
    good, torn            poses tried; those with nearest cells that do not touch
    drawn                 how many maps `poses` has emitted
    frame (u,), reservoir (r, u)
    draft, codes (u, c)   the map that is being learned, and the one that is shown
    errors, trial (e,)    of the poses that the map shown, and the one being learned, was tried on
    hits (c,)             how many of these fell on each cell
    apart, share (c,), found, distances   room, which remembers nothing
    """

    numbers: Array
    used: Times
    frame: Samples
    reservoir: Samples
    draft: Samples
    codes: Samples
    random: Times
    errors: Samples
    trial: Samples
    hits: Times
    apart: Samples
    share: Samples
    found: Times
    distances: Samples


NUMBERS = numbers_of(GridNumbers)


@kernel
def keep(s: PoseGridState) -> None:
    """Take a pose into the reservoir, which holds each of those so far with the same probability (Vitter 1985, algorithm R)."""
    s.seen += 1
    at = s.seen - 1 if s.seen <= s.reservoir.shape[0] else next_random(s.random, s.seen)
    if at < s.reservoir.shape[0]:
        s.reservoir[at] = s.frame


@kernel
def work_on(s: PoseGridState) -> None:
    """One frame's part of the work on the next map: some steps of learning, or one pose that it is tried on."""
    reservoir, draft, found, distances = s.reservoir, s.draft, s.found, s.distances
    held = min(s.seen, reservoir.shape[0])
    if s.step == 0 and s.shown == 0:
        for k in range(draft.shape[1]):
            draft[:, k] = reservoir[next_random(s.random, held)]
    learning = s.every - s.tried
    first = s.shown == 0
    widest = 0.5 * max(s.columns, draft.shape[1] // s.columns) if first else 1.5
    fastest = 0.4 if first else 0.1
    if s.step < learning:
        done = s.step / learning
        for _ in range(s.steps):
            pose = reservoir[next_random(s.random, held)]
            nearest_cells(draft, pose, s.apart, found, distances)
            rate, radius = fastest * (0.02 / fastest) ** done, widest * (0.6 / widest) ** done
            learn_pose(draft, s.columns, pose, found[0], rate, max(radius, 0.3), s.share)
    else:
        if s.step == learning:
            s.good, s.torn = 0, 0
            s.hits[:] = 0
        nearest_cells(draft, reservoir[next_random(s.random, held)], s.apart, found, distances)
        s.trial[s.good] = distances[0]
        s.hits[found[0]] += 1
        s.good += 1
        s.torn += not touch(found[0], found[1], s.columns)
    s.step += 1


@kernel
def map_poses(s: PoseGridState, x: Samples, place: Samples, error: Samples, begin: int) -> int:
    """Places (n, 2) and errors (n, 2) of the poses `x` (n, width) from `begin` on; stops after a frame with which a map is to be shown.

    Returns how far it came.
    """
    for i in range(begin, x.shape[0]):
        whole = True
        for c in range(s.used.shape[0]):
            s.frame[c] = finite(x[i, s.used[c]])
            whole = whole and s.frame[c] == s.frame[c]
        place[i, 0], place[i, 1], error[i, 0], error[i, 1] = math.nan, math.nan, math.nan, math.nan
        if not whole:
            continue
        if s.shown > 0:
            nearest_cells(s.codes, s.frame, s.apart, s.found, s.distances)
            place_between(s.apart, s.columns, s.found[0], place[i])
            error[i, 0] = s.distances[0]
            below = 0
            for k in range(s.errors.shape[0]):
                below += s.errors[k] <= s.distances[0]
            error[i, 1] = below / s.errors.shape[0]
        if s.most == 0 or s.shown < s.most:
            keep(s)
            work_on(s)
            if s.step == s.every:
                s.codes[:] = s.draft
                s.errors[:] = s.trial
                s.shown += 1
                s.step = 0
                return i + 1
    return int(x.shape[0])


@dataclass(frozen=True, slots=True)
class PoseGrid(Operator[PoseGridState]):
    """Poses or other features (width,) in; out comes the place of each on a self-organising map, a grid of cells of like poses.

    place  (2,)  column and row, from 0, between the cells; NaN before the first map, and where a feature is
    error  (2,)  the distance to the nearest cell (quantisation error, in the input's unit); `rank`: which share of the poses that the map
                 was tried on lies no further from it. An outlier is a pose with a rank above, say, 0.99
    cells  an event whenever a map is shown: its number, mean quantisation error, topographic error (share of poses with two nearest
                 cells that do not touch), how many poses it was tried on, per cell how many of these it has, and its pose
    poses  (cells, width)  the poses of the cells, row by row, whenever a map is shown, a trained one with the first pose; the page's
                 panel `map` draws them

    It learns from a random sample of all poses so far (`reservoir` of them), `steps` a frame. Every `learn_s` the new map takes the place
    of the one shown, which does not change in between. Each begins as the one before it, so that cells hardly move. After `maps` of them
    nothing changes any more. With `model` the map is that of `kinegraph motion train map`, in the input's unit of length, and
    nothing is learned.

    Time is counted in whole poses: it learns nothing in a gap. Channels in the input's `meta["missing"]` are left out. No delay.

    Source: thesis, 5.3.3; Kohonen 1982. Departure: live, out of a reservoir; the thesis trains on whole recordings.

    >>> given, made = tried(PoseGrid)
    >>> given["in"][-1].round(1), made["place"][-1].round(1)
    (array([ 2.1,  3.8,  1.9, -0.6, -0.8]), array([2.2, 0.4]))
    """

    outputs: ClassVar[tuple[str, ...]] = ("place", "error", "cells", "poses")

    rows: int = param(12, least=1, most=40, help="rows of the grid")
    columns: int = param(12, least=1, most=40, help="columns of the grid")
    learn_s: float = param(20.0, above=0.0, help="how often a new map is shown")
    maps: int = param(0, least=0, help="maps after which nothing more is learned; 0: always learn")
    reservoir: int = param(4096, least=2, most=100_000, help="poses that it learns from")
    steps: int = param(3, least=1, most=100, help="steps of learning with every pose")
    seed: int = param(1, least=1, most=2_000_000_000, help="another seed, another sample")
    model: Path | None = param(
        None, help="a map that `kinegraph motion train map` has made; rows and columns are its own"
    )

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if not spec.is_signal or len(set(spec.units)) != 1:
            raise InputError("in", spec.describe(), "a signal of features in one unit")
        rate_hz = regular(spec)
        index = MotionIndex.read(self.model) if self.model else None
        s = self._learned(spec, index) if index else self._fresh(spec, rate_hz)
        self.set_state(s)
        place = spec.derive(shape=(2,), dtype=np.dtype(np.float64), channels=("column", "row"), units=("", ""))
        names = names_of(spec)
        facts = {**spec.meta, "columns": s.columns, "features": [names[c] for c in s.used]}
        if index:
            facts["bones"] = [[index.markers[a], index.markers[b]] for a, b in index.bones.tolist()]
        poses = StreamSpec(
            s.codes.T.shape, channels=tuple(facts["features"]), channel_axis=1, units=spec.units[:1], meta=facts
        )
        units = ("", spec.units[0], "", "", "", spec.units[0])
        return {
            "place": place,
            "error": place.derive(channels=("error", "rank"), units=(spec.units[0], "")),
            "cells": StreamSpec((), _event_of(*s.codes.T.shape), units=units, meta=facts),
            "poses": poses,
        }

    def _fresh(self, spec: StreamSpec, rate_hz: float) -> PoseGridState:
        """Nothing is known yet."""
        missing = set(spec.meta.get("missing", ()))
        names = names_of(spec)
        used = np.array([c for c in range(width_of(spec)) if names[c] not in missing], np.int64)
        if not 1 <= len(used) <= WIDEST:
            raise InputError(
                "in", spec.describe(), f"1 to {WIDEST} features (operators.filters.channels.Select takes some)"
            )
        every = max(4, samples_in("learn_s", self.learn_s, rate_hz))
        codes = np.zeros((self.rows * self.columns, len(used)))
        tried = min(TRIED, max(1, every // 4))
        return _state(used, self.columns, codes, every, tried, self.steps, self.maps, self.reservoir, self.seed)

    def _learned(self, spec: StreamSpec, index: MotionIndex) -> PoseGridState:
        """The map of a model."""
        names = names_of(spec)
        absent = [name for name in index.channels if name not in names or name in spec.meta.get("missing", ())]
        if absent:
            hint = nearest(absent[0], names)
            raise InputError("in", spec.describe(), f"the channels of {self.model}, {absent[0]} among them; {hint}")
        size = 1.0
        if spec.units[0] != index.unit:
            if spec.units[0] not in CM or index.unit not in CM or not (spec.units[0] and index.unit):
                raise InputError(
                    "in", spec.describe(), f"{index.unit}, as {self.model} was trained on, or another unit of length"
                )
            size = metres(index.unit) / metres(spec.units[0])
        used = np.array([names.index(name) for name in index.channels], np.int64)
        s = _state(used, index.columns, index.codes * size, 4, len(index.errors), self.steps, 1, 2, self.seed)
        s.errors[:] = index.errors * size
        s.shown = 1
        return s

    def process(self, port: str, chunk: Chunk) -> Emitted:
        s, n = self.state, len(chunk.time)
        place, error = np.empty((n, 2)), np.empty((n, 2))
        events, at, done = list[Array](), list[int](), 0
        drawn, drawn_at = list[Samples](), list[int]()
        if n and s.shown > s.drawn:
            drawn, drawn_at, s.drawn = [s.codes.T.copy()], [0], s.shown
        x = np.ascontiguousarray(chunk.data, np.float64)
        while done < n:
            shown = s.shown
            done = map_poses(s, x, place, error, done)
            if s.shown > shown:
                one = np.zeros(1, _event_of(*s.codes.T.shape))
                one["map"], one["tried"] = shown + 1, s.tried
                one["quantisation"], one["topographic"] = s.errors.mean(), s.torn / s.tried
                one["count"], one["pose"] = s.hits, s.codes.T
                events.append(one)
                at.append(done - 1)
                drawn.append(s.codes.T.copy())
                drawn_at.append(done - 1)
                s.drawn = shown + 1
        shape, never = s.codes.T.shape, chunk.time[:0]
        poses = np.array(drawn) if drawn else np.empty((0, *shape))
        cells = np.concatenate(events) if events else np.empty(0, _event_of(*shape))
        return [
            ("place", Chunk(chunk.time, place, chunk.until, chunk.lost)),
            ("error", Chunk(chunk.time, error, chunk.until, chunk.lost)),
            ("cells", Chunk(chunk.time[at] if at else never, cells, chunk.until, -1 if chunk.lost else 0)),
            ("poses", Chunk(chunk.time[drawn_at] if drawn_at else never, poses, chunk.until, -1 if chunk.lost else 0)),
        ]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(55)
        phase = np.arange(400) * 0.19
        data = np.stack([np.sin(phase + k) * (5.0 - k) for k in range(5)], 1) + 0.1 * rng.normal(size=(400, 5))
        spec = StreamSpec((5,), rate_hz=50.0, channels=tuple("abcde"), units=("cm",), meta={"missing": ["e"]})
        inputs = {"in": (spec, grid(50.0, 400), data)}
        return [
            Case(cls(rows=3, columns=4, learn_s=1.5, reservoir=60), inputs, least=810),
            Case(cls(rows=1, columns=5, learn_s=2.0, maps=1), inputs, least=802),
        ]


@cache
def _event_of(cells: int, width: int) -> np.dtype[np.void]:
    """The dtype of the event that describes a map; to make it takes longer than a pose."""
    return np.dtype([
        ("map", "<i8"), ("quantisation", "<f8"), ("topographic", "<f8"), ("tried", "<i8"), ("count", "<i8", (cells,)),
        ("pose", "<f8", (cells, width)),
    ])  # fmt: skip


def _state(
    used: Times, columns: int, codes: Samples, every: int, tried: int, steps: int, most: int, reservoir: int, seed: int
) -> PoseGridState:
    """Of cells `codes` (c, u)."""
    cells, width = codes.shape
    by_feature = np.ascontiguousarray(codes.T)
    made = PoseGridState(
        numbers=np.zeros((), NUMBERS), used=used, frame=np.zeros(width), reservoir=np.zeros((reservoir, width)),
        draft=by_feature.copy(), codes=by_feature, random=np.array([seed], np.int64), errors=np.zeros(tried), trial=np.zeros(tried),
        hits=np.zeros(cells, np.int64), apart=np.zeros(cells), share=np.zeros(cells), found=np.zeros(2, np.int64), distances=np.zeros(2),
    )  # fmt: skip
    made.columns, made.every, made.tried, made.steps, made.most = columns, every, tried, steps, most
    return made
