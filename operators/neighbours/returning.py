"""Which activity of the session a repetition is of: what returns after minutes is known again by its neighbours (thesis 2.5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.neighbours.index import LIMITS, Index
from kinegraph.operators.neighbours.layout import IndexState, allocate
from kinegraph.stream.chunk import NEVER, NS, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.require import numeric, regular, samples_in
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

KNOWN = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("cluster", "<i8"),
        ("known", "<i8"),
        ("returned", "?"),
        ("away_s", "<f8"),
        ("share", "<f8"),
    ]
)
"""A repetition: its cluster by the segmentation, and `known`, the session's number of what it is. `returned`: the segmentation took it for
something new, and it was there before; `away_s`: how long the last of its kind had ended when it began, NaN for the first; `share`: of its
frames that have a neighbour of that kind."""
NEEDED = {"onset", "end", "cluster", "repetition"}
ASKED = 32
"""This many frames of a repetition are looked up."""
MOST = 4096
"""Clusters beyond this many are not remembered."""


@dataclass(slots=True)
class ReturningState:
    """
    index      frames of repetitions that are known, the newest `window`;  labels (window,): what each is, by its number
    frames     (keep, width) the newest frames, from `held` on written over; stamps (keep,)
    known      (4096,) of each cluster the session's number, -1 before its first repetition;  ended (4096,): the last end by that number
    count      how many numbers there are
    """

    index: IndexState
    labels: Times
    frames: Samples
    stamps: Times
    held: int
    radius: float
    known: Times
    ended: Times
    count: int


@dataclass(frozen=True, slots=True)
class Returning(Operator[ReturningState]):
    """Frames and the repetitions that were found in them in; out comes what each repetition is, over the whole session.

    in         features (width,), those that were segmented
    primitive  events with onset, end, cluster and repetition (operators.segmentation.Segment)
    radius     of the segmentation, per feature; or the parameter

    The first repetition of a cluster is looked up, exactly, in the windowed index of the frames of all repetitions (`window_s` of them):
    where at least `share` of its frames have their nearest neighbour of one kind within the radius, it is of that kind, however long that
    was away; else it is a new one. All repetitions of a cluster are of one kind. Frames of repetitions alone are kept: an hour of them at
    30 Hz and 72 features takes 39 MB, and a search 16 us a frame (`python -m bench.neighbours_session`). No delay.

    >>> given, made = tried(Returning)
    >>> made[["cluster", "known", "returned"]][[0, 4, 8]].tolist()
    [(0, 0, False), (1, 1, False), (2, 0, True)]
    """

    inputs = {"in": Input(rows=True), "radius": Input(optional=True), "primitive": Input(trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("known",)

    window_s: float = param(3600.0, above=0.0, help="how long repetitions are remembered")
    share: float = param(
        0.7, above=0.0, most=1.0, help="of a repetition's frames that must have a neighbour of one kind"
    )
    within: float = param(0.0, least=0.0, help="the radius per feature; 0: that of the input `radius`")
    nearer: float = param(0.4, above=0.0, most=2.0, help="neighbours lie within this part of the radius")
    longest_s: float = param(
        120.0, above=1.0, help="a repetition that was decided later than this after its onset is cut"
    )

    def open(self, specs: Specs) -> Specs:
        spec, events = specs["in"], specs["primitive"]
        numeric(spec)
        if not spec.is_signal or not 1 <= spec.shape[0] <= LIMITS["width"][1]:
            raise InputError("in", spec.describe(), f"a signal of 1 to {LIMITS['width'][1]} features")
        if not set(events.dtype.names or ()) >= NEEDED:
            raise InputError("primitive", events.describe(), f"events with the fields {', '.join(sorted(NEEDED))}")
        if "radius" in specs and "radius" not in (specs["radius"].dtype.names or ()):
            raise InputError("radius", specs["radius"].describe(), "events with the field radius")
        if "radius" not in specs and not self.within:
            raise InputError("radius", "no radius", "the segmentation's radius, or the parameter `within`")
        rate_hz, width = regular(spec), spec.shape[0]
        window, keep = samples_in("window_s", self.window_s, rate_hz), samples_in("longest_s", self.longest_s, rate_hz)
        self.set_state(
            ReturningState(
                allocate(width, window, 1), np.full(window, -1), np.zeros((keep, width)), np.full(keep, NEVER), 0, self.within,
                np.full(MOST, -1), np.full(MOST, NEVER), 0,
            )
        )  # fmt: skip
        return {"known": StreamSpec((), KNOWN, units=("ns", "ns", "", "", "", "s", ""), meta=events.meta)}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        made, at = list[tuple[float, ...]](), list[int]()
        if port == "in":
            for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
                s.frames[s.held], s.stamps[s.held] = row, stamp
                s.held = (s.held + 1) % len(s.stamps)
        elif port == "radius":
            if len(chunk) and not self.within:
                s.radius = float(chunk.data["radius"][-1])
        else:
            for stamp, event in zip(chunk.time.tolist(), chunk.data, strict=True):
                if event["repetition"] > 0 and 0 <= event["cluster"] < MOST:
                    made.append(self._meet(int(event["onset"]), int(event["end"]), int(event["cluster"])))
                    at.append(stamp)
        data = np.array(made, KNOWN) if made else np.empty(0, KNOWN)
        return Chunk(np.array(at, np.int64), data, chunk.until, -1 if chunk.lost else 0)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(5)
        turn = 2 * np.pi * np.arange(40) / 40
        circle, eight = (np.stack([np.cos(turn), np.sin(k * turn), np.cos(k * turn)], 1) for k in (1, 2))
        frames = np.concatenate([*[circle] * 4, *[eight + 5.0] * 4, *[circle] * 4]) + rng.normal(0.0, 0.02, (480, 3))
        spec = StreamSpec((3,), rate_hz=30.0, units=("cm",))
        stamps = grid(30.0, 480)
        dtype = np.dtype([("onset", "<i8"), ("end", "<i8"), ("repetition", "<i4"), ("cluster", "<i8")])
        found = np.array([(stamps[40 * k], stamps[40 * k + 39], k % 4 + 1, k // 4) for k in range(12)], dtype)
        inputs = {"in": (spec, stamps, frames), "primitive": (StreamSpec((), dtype), found["end"] + NS // 2, found)}
        return [
            Case(cls(within=0.25), inputs, least=12),
            Case(cls(within=0.25, window_s=4.0, longest_s=2.0), inputs, least=12),
        ]

    def _meet(self, onset: int, end: int, cluster: int) -> tuple[float, ...]:
        s = self.state
        rows = s.frames[(s.stamps >= onset) & (s.stamps <= end)]
        index, known = Index.of(s.index), int(s.known[cluster])
        kind, share = self._looked_up(index, rows)
        returned = known < 0 and kind >= 0 and share >= self.share
        if known < 0:
            known = kind if returned else s.count
            s.known[cluster] = known
            s.count = max(s.count, known + 1)
        away = (onset - int(s.ended[known])) / NS if s.ended[known] != NEVER else np.nan
        s.ended[known] = max(int(s.ended[known]), end)
        s.labels[(index.newest + 1 + np.arange(len(rows))) % len(s.labels)] = known
        index.follow(rows, 0)
        return onset, end, cluster, known, returned, away, share

    def _looked_up(self, index: Index, rows: Samples) -> tuple[int, float]:
        """What most of the frames' nearest neighbours within the radius are; -1 without any. And the share of frames."""
        s = self.state
        if not len(index) or not len(rows):
            return -1, 0.0
        asked = rows[np.linspace(0, len(rows) - 1, min(ASKED, len(rows))).round().astype(np.int64)]
        most = self.nearer * s.radius * float(np.sqrt(rows.shape[1]))
        votes = list[int]()
        for row in asked:
            numbers, distances = index.nearest(1, row, band=-1)
            if len(numbers) and distances[0] <= most:
                votes.append(int(s.labels[numbers[0] % len(s.labels)]))
        if not votes:
            return -1, 0.0
        kinds, counts = np.unique(votes, return_counts=True)
        return int(kinds[counts.argmax()]), float(counts.max() / len(asked))
