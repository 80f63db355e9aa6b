"""The neighbours of every frame of a stream, among those that came within a window before it (thesis 2.3.1, online)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np

from kinegraph.operators.inputs.continuity import Continuity, watch
from kinegraph.operators.neighbours.follow import FoundWithin, follow_within
from kinegraph.operators.neighbours.index import LIMITS, set_weights
from kinegraph.operators.neighbours.layout import IndexState, allocate, clear
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec, Times, empty
from kinegraph.stream.data.require import numeric, regular, samples_in
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

NEAREST = np.dtype([("frame", "<i8"), ("time", "<i8"), ("distance", "<f4")])
WITHIN = np.dtype(
    [
        ("frame", "<i8"),
        ("neighbour", "<i8"),
        ("neighbour_time", "<i8"),
        ("distance", "<f4"),
        ("near", "?"),
        ("reaches", "?"),
    ]
)
LARGEST = float(np.finfo(np.float32).max)
"""float32 cannot hold a weight or a radius beyond this."""
Found: TypeAlias = list[tuple[Times, Array]]
"""Pieces of the output `within`: stamps (m,) and events (m,)."""


@dataclass(slots=True)
class NeighboursState(Continuity):
    """index: see layout.py; stamps (2 window,) of frames, by number modulo that length; band: in frames; radius: NaN without one."""

    index: IndexState
    stamps: Times
    band: int
    radius: float


@dataclass(frozen=True, slots=True)
class Neighbours(Operator[NeighboursState]):
    """Frames of features (width,) in; the nearest of each, and all within a radius, among the newest `window_s`, exactly.

    nearest  one sample (k,) per frame, the nearest first: frame (the number of the neighbour), time (its stamp, ns), distance.
             Where there are fewer than k, frame and time are -1 and distance NaN; so also for a bad frame
    within   one event per pair, if there is a radius: frame, neighbour, neighbour_time (ns), distance, and two answers: `near`, whether
             the neighbour lies within this frame's radius; `reaches`, whether this frame lies within the radius that the neighbour
             had when it came (only with `both`; with an unchanging radius the answers are the same)

    weights  input, optional: (width,), the weight of every feature's squared difference from its stamp on, for all frames
    radius   input, optional: (1,), the radius from its stamp on

    Frames are numbered from 0 as they come, bad ones too; an input's stamp counts as before any later frame's, and as after one of the same
    time. Frames less than `band_s` away, counted in frames, are passed over. Distances are Euclidean in float32, exact, with one rule for
    ties: `docs/method/neighbours.md`. A frame with a bad value is never a neighbour. Weights or radii that are not finite, or negative, are
    passed over.

    No delay. Memory: some (4.6 width + 50) bytes per frame of the window and some 1000 frames more, all of it from the start; nothing is
    ever rebuilt as a whole.
    Source: thesis 2.3.1, which builds one kd-tree of a whole recording; here only what came before is searched, so that a pair is reported
    once, when its later frame comes.

    >>> frames = np.array([0.0, 5.0, 0.1, 5.2])
    >>> found = Neighbours(k=1, band_s=0.0, window_s=1.0)(frames, rate_hz=30)["nearest"]
    >>> found["frame"].ravel(), found["distance"].ravel().round(1)
    (array([-1,  0,  0,  1]), array([nan, 5. , 0.1, 0.2], dtype=float32))
    """

    inputs = {
        "in": Input(rows=True),
        "weights": Input(rows=True, trigger=True, optional=True),
        "radius": Input(rows=True, trigger=True, optional=True),
    }
    outputs: ClassVar[tuple[str, ...]] = ("nearest", "within")

    window_s: float = param(60.0, above=0.0, help="how far back to search for neighbours")
    k: int = param(32, least=0, most=1024, help="how many nearest are given with every frame")
    within: float | None = param(
        None, least=0.0, help="radius, in the features' unit; left out: no radius until the input"
    )
    both: bool = param(False, help="also neighbours that have the frame in their own radius")
    band_s: float = param(1.0, least=0.0, help="frames less far away in time are passed over; 0: only the frame itself")
    weights: tuple[float, ...] | None = param(None, least=0.0, help="one per feature; left out: 1 each")
    reset_gap_s: float = reset_gap(60.0)

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        numeric(spec)
        if not spec.is_signal or not 1 <= spec.shape[0] <= LIMITS["width"][1]:
            raise InputError("in", spec.describe(), f"a signal of 1 to {LIMITS['width'][1]} features")
        rate_hz = regular(spec)
        window = samples_in("window_s", self.window_s, rate_hz)
        if window > LIMITS["window"][1]:
            raise ParameterError("window_s", self.window_s, f"at most {LIMITS['window'][1] / rate_hz:g}")
        for port, width in (("weights", spec.shape[0]), ("radius", 1)):
            if port in specs and (not specs[port].is_signal or specs[port].shape != (width,)):
                raise InputError(port, specs[port].describe(), f"a signal of {width} numbers")
        index = allocate(spec.shape[0], window, self.k)
        if self.weights is not None:
            if len(self.weights) != spec.shape[0]:
                raise ParameterError("weights", self.weights, f"{spec.shape[0]} numbers, one per feature")
            if max(self.weights) > LARGEST:
                raise ParameterError("weights", self.weights, f"at most {LARGEST:.3g} each")
            set_weights(index, self.weights)
        state = NeighboursState(
            **watch(spec, reset_gap_s=self.reset_gap_s),
            index=index,
            stamps=np.full(2 * window, -1, np.int64),
            band=round(self.band_s * rate_hz),
            radius=np.nan if self.within is None else float(self.within),
        )
        self.set_state(state)
        unit = spec.units[0] if len(set(spec.units)) == 1 else ""
        return {
            "nearest": spec.derive(shape=(self.k,), dtype=NEAREST, channels=(), units=("", "ns", unit), channel_axis=0),
            "within": StreamSpec((), WITHIN, units=("", "", "ns", unit, "", ""), meta=spec.meta),
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        if port != "in":
            self._steer(port, chunk.data)
            return self._emitted(empty(StreamSpec((1,)), chunk.until), np.empty((0, self.k), NEAREST), [])
        s = self.state
        if chunk.lost and s.breaks(chunk):
            clear(s.index)
        nearest: Array = np.empty((len(chunk), self.k), NEAREST)
        found: Found = []
        if len(chunk):
            s.last[0] = chunk.time[-1]
            self._follow(chunk.data, chunk.time, nearest, found)
        return self._emitted(chunk, nearest, found)

    def _follow(self, x: Samples, time: Times, nearest: Array, found: Found) -> None:
        """Work through frames `x` (n, width) in as many turns as there is room for what is found."""
        s = self.state
        ring = len(s.stamps)
        window = ring // 2
        room = ring if len(x) > 1 else window
        frames, distances = np.empty(nearest.shape, np.int64), np.empty(nearest.shape, np.float32)
        within = FoundWithin.of(room)
        first = int(s.index.head["next"])
        done = 0
        while done < len(x):
            start, limit = done, min(len(x), done + window)
            s.stamps[np.arange(first + start, first + limit) % ring] = time[start:limit]
            done, made = follow_within(
                s.index.floats, s.index.books, x[:limit], start, s.band, s.radius, self.both, frames, distances, within
            )
            near = frames[start:done]
            nearest["time"][start:done] = np.where(near < 0, -1, s.stamps[near % ring])
            if made:
                events = np.empty(made, WITHIN)
                events["frame"], events["neighbour"] = first + within.who[:made], within.frames[:made]
                events["neighbour_time"], events["distance"] = (
                    s.stamps[within.frames[:made] % ring],
                    within.distances[:made],
                )
                events["near"], events["reaches"] = within.ways[:made, 0], within.ways[:made, 1] & self.both
                found.append((time[within.who[:made]], events))
        nearest["frame"], nearest["distance"] = frames, distances

    def _steer(self, port: str, data: Array) -> None:
        """The newest good weights or radius hold from now on."""
        s = self.state
        for row in data[::-1]:
            if ((row >= 0.0) & (row <= LARGEST)).all():
                if port == "weights":
                    set_weights(s.index, row)
                else:
                    s.radius = float(row[0])
                return

    def _emitted(self, chunk: Chunk, nearest: Array, found: Found) -> list[tuple[str, Chunk]]:
        lost = -1 if chunk.lost else 0
        stamps = np.concatenate([stamp for stamp, _ in found]) if found else np.empty(0, np.int64)
        events = np.concatenate([event for _, event in found]) if found else np.empty(0, WITHIN)
        return [
            ("nearest", Chunk(chunk.time, nearest, chunk.until, chunk.lost)),
            ("within", Chunk(stamps, events, chunk.until, lost)),
        ]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(11)
        time = grid(30.0, 700)
        phase = np.arange(700) * 0.21
        x = np.stack([np.sin(phase + i) + 0.5 * np.cos(2.0 * phase - i) for i in range(5)], 1)
        x += 0.05 * rng.normal(size=x.shape)
        motion = {"in": (StreamSpec((5,), rate_hz=30.0, units=("rad",)), time, x)}
        at = time[50::120] + 1000
        weights = (StreamSpec((5,)), at, rng.uniform(0.0, 2.0, (len(at), 5)).round(1))
        radius = (StreamSpec((1,), units=("rad",)), at + 7_000_000, rng.uniform(0.3, 0.8, (len(at), 1)))
        return [
            Case(cls(window_s=10.0, k=8), motion, least=700),
            Case(cls(window_s=8.0, k=4, within=0.5, both=True, band_s=0.2, weights=(1.0, 0.5, 0.0, 2.0, 1.0)),
                 {**motion, "weights": weights, "radius": radius}, least=2000),
        ]  # fmt: skip
