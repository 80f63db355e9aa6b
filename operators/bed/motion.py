"""Movement in depth frames: how much each sleeper's region changes within half a second, and where the epoch's change was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from kinegraph.operators.bed.frames.blocks import Frame
from kinegraph.operators.bed.frames.change import Seen, Sums, change, conclude, distance
from kinegraph.operators.bed.frames.regions import REGION, region_spec, sleepers_of, take
from kinegraph.operators.bed.frames.simplify import SCENE, frames_of
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Samples, Specs, StreamSpec, Times, add_lost
from kinegraph.stream.data.require import regular
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

LONGEST_EPOCH = 60_000
"""Frames that an epoch may have: beyond, its sums could overflow."""


def map_of(shape: tuple[int, int]) -> np.dtype[Any]:
    """One motion map: mean change from look to look (mm) of every cell in an epoch; NaN where nothing was measured."""
    return np.dtype([("onset", "<i8"), ("end", "<i8"), ("frames", "<i8"), ("map", "<f4", shape)])


@dataclass(slots=True)
class MotionState:
    """
    every    frames between two looks; step_ns: that time; taken: when the newest look was (ns), NEVER before the first
    last     (h, w)  the frame of the last look; time: its stamp, NEVER if there is nothing to compare with
    older    (h, w)  the one before; known: whether it is exactly one look before
    regions  (k, 4)  per sleeper: row, column, rows, columns; no rows: not known. edges: the columns where they begin and end
    sums, seen (h, w)  the open epoch's change of every pixel (mm), and how often it was measured
    begin    start of the open epoch (ns); NEVER if closed. frames: how many were compared in it
    gap_ns   looks farther apart are not compared; gone: samples that the input reported missing since the last one
    cell     side of a cell of the map, in pixels
    lost     what the next map says is missing before it
    """

    sleepers: list[str]
    epoch_ns: int
    every: int
    step_ns: int
    taken: int
    gap_ns: int
    gone: int
    cell: int
    last: Frame
    time: int
    older: Frame
    known: bool
    regions: Times
    edges: Times
    sums: Sums
    seen: Seen
    begin: int
    frames: int
    lost: int


@dataclass(frozen=True, slots=True)
class Motion(Operator[MotionState]):
    """Simplified depth frames in; how much moves, per sleeper and look, and where, per epoch.

    out  (sleepers,) float64, mm: N(t), the mean change since the look before over the sleeper's region (thesis, eq. 4.2; stamped with
         the later frame); without `regions` over the whole frame, and the channel is called "frame"
    far  (sleepers,) float64, mm: the same over two looks. What is displaced moves farther in twice the time, noise does not: so light on
         the bed, which makes depths noisier, is distinguished from movement (operators.bed.activity.Activity)
    map  an event per epoch: D(p), the mean change from look to look (thesis, eq. 4.1), as means of cells of a block

    A look is a frame in `step_s`, the others are passed over. The thesis compares every frame with the next. But a limb that takes a
    second to turn moves from one frame to the next, a thirtieth of a second later, by less than the frames' noise, and in half a second
    by fifteen times as much, in the same noise.

    Only pixels that were measured in both frames count: the thesis has no such mask, but what flickers between measured and not is most
    of what changes in real frames. (The remarks on 4.1 and 4.2 are exchanged in print.) N is NaN: in the first frame, after a gap of more
    than `longest_gap_s`, in the first frame under another basis (`scene`), where less than `min_valid` of the region was measured in
    both frames, while the region is not known, and where no pixel of the whole frame has changed, for it repeats the last one.

    The state holds a frame. So that no checkpoint holds a raw one, frames that were not simplified are refused, unless `raw`.

    >>> given, made = tried(Motion)
    >>> given["frames"][:2, 0, 0], made["out"][-1].round(2)
    (array([944,   0], dtype=uint16), array([22.75, 13.9 ]))
    """

    inputs = {"scene": Input(optional=True), "regions": Input(optional=True), "frames": Input(trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("out", "far", "map")

    epoch_s: float = param(30.0, above=0.0, help="length of an epoch; epochs begin at whole multiples of it since 1970")
    min_valid: float = param(0.2, above=0.0, most=1.0, help="share of the region's pixels that must be measured")
    step_s: float = param(
        0.5, least=0.0, help="how far apart the frames are that are compared; 0: every frame with the next"
    )
    longest_gap_s: float = param(1.0, above=0.0, help="frames farther apart (and than 1.5 steps) are not compared")
    raw: bool = param(False, help="take frames that were not simplified: then checkpoints hold the newest raw frame")

    def open(self, specs: Specs) -> Specs:
        spec = specs["frames"]
        frames_of(spec, "frames")
        simplified = spec.meta.get("simplified")
        if not simplified and not self.raw:
            raise InputError(
                "frames", f"{spec.describe()}, not simplified",
                "frames from kinegraph.operators.bed.frames.simplify.Simplify, so that no checkpoint holds a raw one; or say `raw: true`",
            )  # fmt: skip
        if "scene" in specs and specs["scene"].dtype != SCENE:
            raise InputError(
                "scene", specs["scene"].describe(), "the output scene of operators.bed.frames.simplify.Simplify"
            )
        every = max(1, round(self.step_s * regular(spec, "frames")))
        rate_hz = regular(spec, "frames") / every
        if rate_hz * self.epoch_s > LONGEST_EPOCH:
            raise ParameterError(
                "epoch_s", self.epoch_s, f"at most {LONGEST_EPOCH / rate_hz:g} ({LONGEST_EPOCH} looks)"
            )
        sleepers = sleepers_of(specs) if "regions" in specs else ("frame",)
        height, width = spec.shape
        cell = int(simplified["block"]) if simplified else 1
        regions = np.zeros((len(sleepers), 4), np.int64)
        if "regions" not in specs:
            regions[0] = 0, 0, height, width
        self.set_state(
            MotionState(
                list(sleepers), round(self.epoch_s * NS), every, round(NS / rate_hz), NEVER,
                round(max(self.longest_gap_s, 1.5 / rate_hz) * NS), 0, cell, np.zeros(spec.shape, np.uint16), NEVER,
                np.zeros(spec.shape, np.uint16), False, regions,
                _edges(regions, width), np.zeros(spec.shape, np.uint32), np.zeros(spec.shape, np.uint16), NEVER, 0, 0,
            )
        )  # fmt: skip
        settling = max(s.settling_s for s in specs.values())
        meta = {key: value for key, value in spec.meta.items() if key != "sleepers"}
        out = spec.derive(
            shape=(len(sleepers),),
            dtype=np.dtype(np.float64),
            rate_hz=rate_hz,
            channels=sleepers,
            meta=meta,
            settling_s=settling,
        )
        made = map_of((height // cell, width // cell))
        maps = StreamSpec((), made, units=("ns", "ns", "", spec.units[0]), meta={**meta, "epoch_s": self.epoch_s})
        return {"out": out, "far": out, "map": maps}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        emitted: list[tuple[str, Chunk]] = []
        maps: list[tuple[Any, ...]] = []
        looks: list[tuple[int, Samples, Samples]] = []
        lost = 0
        if port == "frames":
            if chunk.lost:
                before = int(chunk.time[0]) - 1 if len(chunk.time) else chunk.until
                self._close_epoch(before, maps)
                emitted.append(("map", self._maps(maps, before)))
                maps, s.lost, s.gone = [], add_lost(s.lost, chunk.lost), add_lost(s.gone, chunk.lost)
            for i, time in enumerate(chunk.time.tolist()):
                self._close_epoch(time - 1, maps)
                if self._is_look(time):
                    lost = lost if looks else self._missing(time)
                    looks.append((time, *self._look(chunk.data[i], time)))
        elif port == "scene" and len(chunk.time):
            s.time, s.known = NEVER, False
        elif port == "regions" and len(chunk.time):
            take(chunk.data, tuple(s.sleepers), s.regions)
            s.edges = _edges(s.regions, s.last.shape[1])
        self._close_epoch(chunk.until, maps)
        times, shape = np.array([t for t, *_ in looks], np.int64), (len(looks), len(s.sleepers))
        moved = Chunk(times, np.array([n for _, n, _ in looks]).reshape(shape), chunk.until, lost)
        far = Chunk(times, np.array([n for *_, n in looks]).reshape(shape), chunk.until, lost)
        return [*emitted, ("out", moved), ("far", far), ("map", self._maps(maps, chunk.until))]

    def close(self) -> list[tuple[str, Chunk]]:
        maps: list[tuple[Any, ...]] = []
        self._close_epoch(FOREVER, maps)
        return [("map", self._maps(maps, FOREVER))]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(13)
        frames = np.repeat(np.repeat(random.integers(900, 950, (120, 3, 4)), 4, axis=1), 4, axis=2).astype(np.uint16)
        frames[random.random(frames.shape) < 0.05] = 0
        frames[30:33] = frames[30]
        frames[60:63] = 0
        meta = {"simplified": {"block": 4, "components": 1}}
        spec = StreamSpec((12, 16), np.dtype(np.uint16), 30.0, units=("mm",), meta=meta)
        time = grid(30.0, 120)
        regions = np.array([(time[7], "left", 0, 0, 12, 7, True), (time[9] - 1, "right", 2, 7, 8, 9, True)], REGION)
        scene = np.array([(time[80], "relearned", 1.0)], SCENE)
        inputs = {
            "scene": (StreamSpec((), SCENE), scene["onset"], scene),
            "regions": (region_spec(("left", "right"), meta), np.array([time[7], time[9]]), regions),
            "frames": (spec, time, frames),
        }
        return [
            Case(cls(epoch_s=1.0, step_s=0.0), inputs, least=124),
            Case(cls(epoch_s=0.5, step_s=0.1, raw=True), {"frames": (spec.derive(meta={}), time, frames)}, least=47),
        ]

    def _is_look(self, time: int) -> bool:
        """Whether a frame is one of those that are compared: a step after the last one, or half a frame less."""
        s = self.state
        return s.every == 1 or s.taken == NEVER or time - s.taken >= s.step_ns - s.step_ns // (2 * s.every)

    def _missing(self, time: int) -> int:
        """Number of looks missing before the one at `time`; -1 if unknown, or if it is only late."""
        s = self.state
        gone, s.gone = s.gone, 0
        if s.every == 1 or not gone:
            return gone
        if s.taken == NEVER:
            return -1
        away = time - s.taken
        return max(0, round(away / s.step_ns) - 1) or -int(away - s.step_ns > s.step_ns // (2 * s.every))

    def _look(self, frame: Frame, time: int) -> tuple[Samples, Samples]:
        """N (k,) of a frame that is compared, over one look and over two."""
        s = self.state
        out, far = np.full((2, len(s.sleepers)), np.nan)
        if s.begin == NEVER:
            s.begin = time // s.epoch_ns * s.epoch_ns
        if s.time != NEVER and time - s.time <= s.gap_ns:
            if s.known:
                distance(frame, s.older, s.regions, self.min_valid, far)
            s.older[:], s.known = s.last, True
            if change(frame, s.last, s.regions, s.edges, self.min_valid, s.sums, s.seen, out):
                s.frames += 1
            else:
                np.subtract(s.seen, 1, out=s.seen, where=(frame != 0) & (s.seen > 0))
                out[:] = far[:] = np.nan
                s.known = False
        else:
            s.last[:], s.known = frame, False
        s.time = s.taken = time
        return out, far

    def _close_epoch(self, until: int, maps: list[tuple[Any, ...]]) -> None:
        """The map of the epoch that is over by `until`."""
        s = self.state
        if s.begin == NEVER or until < s.begin + s.epoch_ns - 1:
            return
        height, width = s.last.shape
        made = np.empty((height // s.cell, width // s.cell))
        conclude(s.sums, s.seen, s.cell, made)
        maps.append((s.begin, s.begin + s.epoch_ns, s.frames, made))
        s.begin, s.frames = NEVER, 0

    def _maps(self, maps: list[tuple[Any, ...]], until: int) -> Chunk:
        s = self.state
        height, width = s.last.shape
        made = np.array(maps, map_of((height // s.cell, width // s.cell)))
        lost, s.lost = s.lost, 0
        return Chunk(made["end"] - 1, made, until, lost)


def _edges(regions: Times, width: int) -> Times:
    """The columns at which regions begin and end, with 0 and the width; in order, padded with the width to a fixed number."""
    columns = np.sort(np.r_[regions[:, 1], regions[:, 1] + regions[:, 3]])
    edges = np.full(len(columns) + 2, width, np.int64)
    edges[0], edges[1:-1] = 0, np.minimum(columns, width)
    return edges
