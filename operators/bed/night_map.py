"""The night's motion map: where all the movement in bed was, from one night to the next (thesis, figure 4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph.operators.bed.activity import EPOCH_SEEN
from kinegraph.operators.bed.bed_events import BED
from kinegraph.operators.bed.motion import map_of
from kinegraph.stream.chunk import NEVER, Array, Chunk, Samples, Specs, StreamSpec, add_lost
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Input, Operator, grid


@dataclass(slots=True)
class NightMapState:
    """
    total, frames  (2, rows, columns)  the change of frames since the last night (mm), and of how many: of all, and of still epochs
    onset, end     of what they cover (ns); NEVER: nothing yet
    there          names of those in bed
    plain          whether nothing is taken off
    judged, still  the end of the newest epoch that is known from `seen` (ns), and whether it was still
    lost           how many samples are missing before the next map
    """

    total: Samples
    frames: NDArray[np.int64]
    onset: int
    end: int
    there: list[str]
    plain: bool
    judged: int
    still: bool
    lost: int


@dataclass(frozen=True, slots=True)
class NightMap(Operator[NightMapState]):
    """The epochs' motion maps in (`map`), one map per event of `nights` out: the mean change from look to look (mm) of every cell.

    With `seen` (the output epochs of operators.bed.activity.Activity) it subtracts the mean of the still epochs, cell
    by cell: the frames' own noise, and breath. Without it the edges of the bed outshine whoever lies in it, for there a pixel
    that flickers shows now the bed, now the floor. (The thesis has no such correction.) What is left is movement, and around 0
    where nothing moved, also just below; NaN throughout where no epoch was still.

    It covers every epoch since the night before, with `bed` connected only those that end with somebody in bed; NaN where nothing was
    measured. `onset`, `end`: of the first and last epoch that it covers; `frames`: how many frames, at most of all cells. A night without
    any epoch emits nothing. Sums are of 64 bits: nothing overflows.

    >>> given, made = tried(NightMap)
    >>> given["map"]["frames"][:4], made["frames"]
    (array([30, 30, 30, 30]), array([480,  30, 270]))
    """

    inputs = {
        "bed": Input(optional=True),
        "seen": Input(optional=True),
        "map": Input(trigger=True),
        "nights": Input(trigger=True),
    }

    def open(self, specs: Specs) -> Specs:
        spec = specs["map"]
        shape = spec.dtype["map"].shape if spec.dtype.names and "map" in spec.dtype.names else ()
        if len(shape) != 2 or spec.dtype != map_of(shape):
            raise InputError("map", spec.describe(), "the output map of operators.bed.motion.Motion")
        if not specs["nights"].is_event:
            raise InputError("nights", specs["nights"].describe(), "events, one at the end of each night")
        if "bed" in specs and specs["bed"].dtype != BED:
            raise InputError("bed", specs["bed"].describe(), "the output of operators.bed.presence.Presence")
        if "seen" in specs:
            _check_epochs(specs["seen"], spec)
        there = [] if "bed" in specs else ["anybody"]
        sums = np.zeros((2, *shape)), np.zeros((2, *shape), np.int64)
        self.set_state(NightMapState(*sums, NEVER, NEVER, there, "seen" not in specs, NEVER, False, 0))
        return {"out": spec}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        made: list[tuple[Any, ...]] = []
        if port == "map":
            s.lost = add_lost(s.lost, chunk.lost)
            for event in chunk.data if s.there else ():
                self._add(event)
        elif port == "seen":
            for event in chunk.data:
                s.still = bool(event["moved_s"] == 0 and (s.still or event["end"] != s.judged))
                s.judged = int(event["end"])
        elif port == "bed":
            for event in chunk.data:
                name = str(event["sleeper"])
                s.there = sorted({*s.there, name} if event["state"] == "in" else {*s.there} - {name})
        elif len(chunk.time) and s.onset != NEVER:
            with np.errstate(invalid="ignore"):
                mean, still = s.total / s.frames
            made.append((s.onset, s.end, int(s.frames[0].max()), mean if s.plain else mean - still))
            s.total[:], s.frames[:], s.onset = 0.0, 0, NEVER
        out = np.array(made, map_of(s.total.shape[1:]))
        lost, s.lost = (s.lost, 0) if made else (0, s.lost)
        return Chunk(chunk.time[: len(made)], out, chunk.until, lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(18)
        time = grid(1.0, 40)
        maps = np.zeros(40, map_of((3, 4)))
        maps["onset"], maps["end"], maps["frames"] = time - 10**9 + 1, time + 1, 30
        maps["map"] = random.random((40, 3, 4))
        maps["map"][5:9, 1, 2] = np.nan
        bed = np.zeros(4, BED)
        bed["onset"], bed["sleeper"] = time[[3, 4, 20, 30]], ["a", "b", "a", "a"]
        bed["state"] = ["in", "unknown", "out", "in"]
        epochs = np.zeros(80, EPOCH_SEEN)
        epochs["end"], epochs["sleeper"] = np.repeat(maps["end"], 2), ["a", "b"] * 40
        epochs["moved_s"] = random.choice([0.0, 0.0, 0.5, np.nan], 80)
        nights = np.array([(time[18],), (time[25],), (time[38],)], [("onset", "<i8")])
        inputs = {
            "bed": (StreamSpec((), BED), bed["onset"], bed),
            "seen": (StreamSpec((), EPOCH_SEEN, meta={"epoch_s": 1.0}), np.repeat(time, 2), epochs),
            "map": (StreamSpec((), maps.dtype, units=("ns", "ns", "", "mm"), meta={"epoch_s": 1.0}), time, maps),
            "nights": (StreamSpec((), nights.dtype, units=("ns",)), nights["onset"], nights),
        }
        return [
            Case(cls(), inputs, least=3),
            Case(cls(), {name: inputs[name] for name in ("map", "nights")}, least=3),
        ]

    def _add(self, event: Array) -> None:
        s = self.state
        seen = np.isfinite(event["map"])
        for k in (0, 1) if s.still and s.judged == event["end"] else (0,):
            s.total[k, seen] += event["map"][seen] * float(event["frames"])
            s.frames[k, seen] += int(event["frames"])
        s.onset = int(event["onset"]) if s.onset == NEVER else s.onset
        s.end = int(event["end"])


def _check_epochs(seen: StreamSpec, maps: StreamSpec) -> None:
    """Raises where `seen` does not say of every epoch of the maps whether anybody moved in it."""
    if seen.dtype != EPOCH_SEEN:
        raise InputError("seen", seen.describe(), "the output epochs of operators.bed.activity.Activity")
    if seen.meta.get("epoch_s") != maps.meta.get("epoch_s"):
        found = f"epochs of {seen.meta.get('epoch_s')} s"
        raise InputError(
            "seen", found, f"epochs as long as the maps': epoch_s {maps.meta.get('epoch_s')} in both nodes"
        )
