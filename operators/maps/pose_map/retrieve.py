"""Query by example: the poses and the stretches of recorded motion that are nearest to one of them (thesis, 5.3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np

from kinegraph.operators.maps.pose_map.warp_kernel import far_apart, warp_all
from kinegraph.operators.neighbours.index import Index
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.domain.pose_map import MISSING, MotionIndex
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Emitted, Operator, grid
from kinegraph.stream.params import param

QUERY = np.dtype(
    [("query", "<i8"), ("first", "<i8"), ("last", "<i8"), ("count", "<i4"), ("band_s", "<f8"), ("markers", "<u8")]
)
"""Query number; frames of the index, `last` included: one frame asks for poses, more for stretches; how many; frames of the same sequence
that are less far away are passed over; the markers that count, by their bits, 0: all."""
ANSWER = np.dtype(
    [("query", "<i8"), ("place", "<i4"), ("sequence", "<i4"), ("first", "<i8"), ("last", "<i8"), ("distance", "<f8")]
)
"""The n-th nearest (`place`, from 0): frames `first` to `last`, and the distance, rms over the markers that count, in the index's unit.
`place` is -1 where nothing (more) was found: the end of an answer."""
MAX = 4096
"""This many near poses are looked at where poses are asked for."""
AROUND = 2048
"""This many near poses of each anchor of a stretch."""
REGIONS = 96
"""A stretch is looked for in this many places."""
LONGEST = 48
"""A stretch is compared by at most this many of its frames."""
ANCHORS = (0.2, 0.5, 0.8)
"""Where in a stretch its poses are taken by which places are found."""
EXAMPLE = Path(__file__).with_name("example.npz")
"""A little made-up motion, for the laws."""


class PoseSearch:
    """An index of motion, made ready for queries: its poses in the neighbour index, used markers only."""

    def __init__(self, motion: MotionIndex) -> None:
        self.motion = motion
        self.ends = np.array([s.last for s in motion.sequences])
        self.columns = (3 * motion.used[:, None] + np.arange(3)).ravel()
        n = len(motion.poses)
        self.near = Index(len(self.columns), max(n, 1), min(MAX, max(n, 1)))
        for begin in range(0, n, 4096):
            self.near.follow(self.rows(np.arange(begin, min(n, begin + 4096))), 0)

    def rows(self, frames: Times) -> Samples:
        """(k, 3 u) of these frames; NaN where a marker is not known."""
        found = self.motion.poses[frames][:, self.columns]
        return np.where(found == MISSING, np.nan, found * self.motion.step)

    def of(self, frame: int) -> int:
        """The number of the sequence that a frame lies in."""
        return int(self.ends.searchsorted(frame, side="right"))

    def weights(self, markers: int) -> Samples:
        """One weight per feature, so that the distance is rms over the markers that count."""
        chosen = np.array([markers == 0 or bool(markers >> int(m) & 1) for m in self.motion.used])
        if not chosen.any():
            chosen[:] = True
        return np.repeat(chosen / chosen.sum(), 3)

    def nearest(self, frame: int, most: int) -> tuple[Times, Array]:
        """The poses nearest to a frame, itself included."""
        row = self.rows(np.array([frame]))[0]
        if not np.isfinite(row).all():
            return np.empty(0, np.int64), np.empty(0, np.float32)
        return self.near.nearest(min(most, int(self.near.state.head["most"])), row, at=frame, band=-1)

    def poses(self, frame: int, count: int, band: int) -> list[tuple[int, int, int, float]]:
        """(sequence, frame, frame, distance) of the nearest poses outside of the band around `frame`."""
        mine = self.of(frame)
        found = []
        for other, apart in zip(*self.nearest(frame, count + 2 * band + 1), strict=True):
            sequence = self.of(int(other))
            if sequence != mine or abs(int(other) - frame) > band:
                found.append((sequence, int(other), int(other), float(apart)))
        return found[:count]

    def stretches(
        self, first: int, last: int, count: int, band: int, weights: Samples
    ) -> list[tuple[int, int, int, float]]:
        """The nearest stretches that do not overlap one another, outside of the band around the one asked for."""
        length = last - first + 1
        step = max(1, -(-length // LONGEST))
        query = np.ascontiguousarray(self.rows(np.arange(first, last + 1, step)))
        places = self.regions(first, last, band)
        begins, ends = (np.array([place[k] for place in places], np.int64) for k in (1, 2))
        room = -(-2 * length // step) + 2 * LONGEST
        out, cost, start = np.empty((len(places), 3)), np.empty((4, room)), np.empty((3, room), np.int64)
        warp_all(
            self.motion.poses, self.columns, self.motion.step, step, begins, ends, query, weights,
            np.empty((len(weights), room)), cost, start, out,
        )  # fmt: skip
        found = [
            (float(apart), place[0], place[1] + step * int(a), place[1] + step * int(b))
            for place, (a, b, apart) in zip(places, out, strict=True)
            if apart < np.inf
        ]
        kept = list[tuple[int, int, int, float]]()
        for apart, sequence, a, b in sorted(found):
            if len(kept) < count and all(b < c or a > d for _, c, d, _ in kept):
                kept.append((sequence, a, b, apart))
        return kept

    def regions(self, first: int, last: int, band: int) -> list[tuple[int, int, int]]:
        """(sequence, begin, end) of places with a pose near to one of the stretch's, the nearest first, outside the band."""
        length = last - first + 1
        anchors = [first + int(share * (length - 1)) for share in ANCHORS]
        found = [self.nearest(anchor, AROUND) for anchor in anchors]
        starts = np.concatenate([frames - (a - first) for a, (frames, _) in zip(anchors, found, strict=True)])
        apart = np.concatenate([d for _, d in found]).astype(np.float64)
        middles = starts + length // 2
        within = (middles >= 0) & (middles < len(self.motion.poses))
        starts, apart = starts[within], apart[within]
        places = np.empty(REGIONS, np.int64)
        count = far_apart(starts[np.lexsort((starts, apart))], max(1, length // 2), places)
        made = list[tuple[int, int, int]]()
        for at in places[:count].tolist():
            made += self._region(at, first, last, band)
        return made

    def _region(self, at: int, first: int, last: int, band: int) -> list[tuple[int, int, int]]:
        """The place around a stretch that begins at frame `at`, within one sequence and outside of the band; empty if it is too short."""
        length = last - first + 1
        middle = at + length // 2
        sequence = self.of(middle)
        one = self.motion.sequences[sequence]
        begin, end = max(one.first, at - length // 2), min(one.last, at + length + length // 2)
        if sequence == self.of(first) and begin <= last + band and end > first - band:
            if middle < first + length // 2:
                end = min(end, first - band)
            else:
                begin = max(begin, last + band + 1)
        return [(sequence, begin, end)] if end - begin >= max(2, length // 2) else []

    def answer(self, query: Array) -> Array:
        """The answer (n,) to one query, its last row the end."""
        first, last, count = int(query["first"]), int(query["last"]), int(query["count"])
        found: list[tuple[int, int, int, float]] = []
        n = len(self.motion.poses)
        if 0 <= first <= last < n and self.of(first) == self.of(last) and count > 0 and query["band_s"] >= 0:
            band = int(min(float(query["band_s"]) * self.motion.rate_hz, n))
            weights = self.weights(int(query["markers"]))
            self.near.weigh(weights)
            count = min(count, MAX)
            found = (
                self.poses(first, count, band) if first == last else self.stretches(first, last, count, band, weights)
            )
        rows = [(int(query["query"]), k, *one) for k, one in enumerate(found)]
        return np.array([*rows, (int(query["query"]), -1, -1, -1, -1, np.nan)], ANSWER)


@lru_cache(maxsize=2)
def _prepared(path: Path, changed: int) -> PoseSearch:
    """A search of a model, made once in a process."""
    return PoseSearch(MotionIndex.read(path))


class _Searching(Operator[None]):
    """What stays as it is while queries come: the model, ready to be searched."""

    __slots__ = ("search",)
    search: PoseSearch


@dataclass(frozen=True, slots=True)
class Retrieve(_Searching):
    """Queries in; out come the nearest poses or stretches of all sequences of a map (`kinegraph motion train map`), the nearest first.

    in   events of the dtype QUERY: from where to where in the index, how many, the band in s, which markers count (bits; 0: all)
    out  per query one event (ANSWER) for each that was found, then one with place -1

    One frame asks for poses: exact, by the neighbour index over all frames. More frames ask for stretches, of half to twice the length:
    places are found by the poses nearest to three of the stretch's own (2048 each, 96 places at most), and each is searched by subsequence
    warping, with at most 48 frames of the query. So it misses stretches that resemble the query at no such pose. Nothing within `band_s`
    of the query in its own sequence is an answer. A query that names no stretch of one sequence is answered by its end at once. No delay.

    Source: thesis, 5.3.4 (poses by a kd-tree). Stretches, the band, and markers chosen with the query are this project's.

    >>> given, made = tried(Retrieve)
    >>> given["in"][["first", "last"]][0].item(), made[["sequence", "first", "last"]][0].item()
    ((5, 5), (0, 25, 25))
    """

    outputs: ClassVar[tuple[str, ...]] = ("out",)

    model: Path = param(help="a map that `kinegraph motion train map` has made")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if spec.dtype != QUERY or spec.shape != ():
            raise InputError("in", spec.describe(), f"queries: events with the fields {', '.join(QUERY.names or ())}")
        self.set_state(None)
        found = _prepared(self.model, self.model.stat().st_mtime_ns if self.model.exists() else 0)
        object.__setattr__(self, "search", found)
        unit = found.motion.unit
        return {"out": StreamSpec((), ANSWER, units=("", "", "", "", "", unit), meta={"index": str(self.model.name)})}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        answers = [self.search.answer(query) for query in chunk.data]
        time = np.repeat(chunk.time, [len(a) for a in answers]) if answers else chunk.time
        data = np.concatenate(answers) if answers else np.empty(0, ANSWER)
        return Chunk(time, data, chunk.until, chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        time = grid(10.0, 24)
        asked = np.zeros(len(time), QUERY)
        asked["query"], asked["first"] = np.arange(24), 5 + 9 * np.arange(24)
        asked["last"] = asked["first"] + np.where(np.arange(24) % 2, 20, 0)
        asked["count"], asked["band_s"], asked["markers"] = 4, 0.5, np.where(np.arange(24) % 3, 0, 2)
        return [
            Case(cls(EXAMPLE), {"in": (StreamSpec((), QUERY, units=("", "", "", "", "s", "")), time, asked)}, least=60)
        ]
