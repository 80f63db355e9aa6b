"""The night's motion map: where all the movement in bed was, from one night to the next (thesis, figure 4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from operators.depth.motion import map_of
from operators.depth.presence import BED
from stream.chunk import NEVER, Array, Chunk, Samples, Specs, StreamSpec, add_lost
from stream.errors import InputError
from stream.operator import Case, Operator, grid


@dataclass(slots=True)
class NightMapState:
    """
    total, frames  (rows, columns)  the change of all frames since the last night (mm), and of how many
    onset, end     of what they cover (ns); NEVER: nothing yet
    there          names of those in bed
    lost           what the next map says is missing before it
    """

    total: Samples
    frames: NDArray[np.int64]
    onset: int
    end: int
    there: list[str]
    lost: int


@dataclass(frozen=True, slots=True)
class NightMap(Operator[NightMapState]):
    """The epochs' motion maps in (`map`), one map per event of `nights` out: the mean change from frame to frame (mm) of every cell.

    It covers every epoch since the night before, with `bed` connected only those at whose end somebody is in bed; NaN where nothing was
    measured. `onset`, `end`: of the first and last epoch that it covers; `frames`: how many frames, at most of all cells. A night without
    any epoch gives none. Sums are of 64 bits: nothing overflows.
    """

    inputs: ClassVar[tuple[str, ...]] = ("bed", "map", "nights")
    optional: ClassVar[tuple[str, ...]] = ("bed",)

    def open(self, specs: Specs) -> Specs:
        spec = specs["map"]
        shape = spec.dtype["map"].shape if spec.dtype.names and "map" in spec.dtype.names else ()
        if len(shape) != 2 or spec.dtype != map_of(shape):
            raise InputError("map", spec.describe(), "the output map of operators.depth.motion.Motion")
        if not specs["nights"].is_event:
            raise InputError("nights", specs["nights"].describe(), "events, one at the end of each night")
        if "bed" in specs and specs["bed"].dtype != BED:
            raise InputError("bed", specs["bed"].describe(), "the output of operators.depth.presence.Presence")
        there = [] if "bed" in specs else ["anybody"]
        self.hold(NightMapState(np.zeros(shape), np.zeros(shape, np.int64), NEVER, NEVER, there, 0))
        return {"out": spec}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        made: list[tuple[Any, ...]] = []
        if port == "map":
            s.lost = add_lost(s.lost, chunk.lost)
            for event in chunk.data if s.there else ():
                self._add(event)
        elif port == "bed":
            for event in chunk.data:
                name = str(event["sleeper"])
                s.there = sorted({*s.there, name} if event["state"] == "in" else {*s.there} - {name})
        elif len(chunk.time) and s.onset != NEVER:
            with np.errstate(invalid="ignore"):
                mean = s.total / s.frames
            made.append((s.onset, s.end, int(s.frames.max()), mean))
            s.total[:], s.frames[:], s.onset = 0.0, 0, NEVER
        out = np.array(made, map_of(s.total.shape))
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
        nights = np.array([(time[18],), (time[25],), (time[38],)], [("onset", "<i8")])
        inputs = {
            "bed": (StreamSpec((), BED), bed["onset"], bed),
            "map": (StreamSpec((), maps.dtype, units=("ns", "ns", "", "mm")), time, maps),
            "nights": (StreamSpec((), nights.dtype, units=("ns",)), nights["onset"], nights),
        }
        return [
            Case(cls(), inputs, least=3),
            Case(cls(), {name: inputs[name] for name in ("map", "nights")}, least=3),
        ]

    def _add(self, event: Array) -> None:
        s = self.state
        seen = np.isfinite(event["map"])
        s.total[seen] += event["map"][seen] * float(event["frames"])
        s.frames[seen] += int(event["frames"])
        s.onset = int(event["onset"]) if s.onset == NEVER else s.onset
        s.end = int(event["end"])
