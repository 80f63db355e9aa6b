"""How somebody walks, over the latest steps: cadence, step time and its spread, length, speed, and how even left and right are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.steps.steps import STEP, Steps, some_walk
from kinegraph.stream.chunk import Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

STATISTICS = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("number", "<i8"),
        ("steps", "<i4"),
        ("cadence", "<f8"),
        ("duration_s", "<f8"),
        ("duration_cv_pct", "<f8"),
        ("length_m", "<f8"),
        ("speed_m_s", "<f8"),
        ("asymmetry_pct", "<f8"),
        ("distance_m", "<f8"),
    ]
)
"""Of the latest `steps` walking steps, from the first one's onset to the last one's end: cadence in steps per minute, mean duration and its
coefficient of variation, mean length and speed; `asymmetry_pct`: the difference of the mean durations of every other step, in % of the
mean, NaN below four; `distance_m`: of all steps since the beginning."""
STATISTICS_UNITS = ("ns", "ns", "", "", "1/min", "s", "%", "m", "m/s", "%", "m")


@dataclass(slots=True)
class StepStatisticsState:
    """latest (n, 2): duration and length of the newest steps, the oldest first, `held` of them;  onsets (n,);  distance_m: of all"""

    latest: Samples
    onsets: Samples
    held: int
    distance_m: float


@dataclass(frozen=True, slots=True)
class StepStatistics(Operator[StepStatisticsState]):
    """Steps (`operators.steps.steps.Steps`) in, statistics of the latest ones out, with every walking step.

    A step that turns the body counts for the distance only. After a pause (a first or a slow step) the statistics begin again; the
    distance is kept. Lengths are those of `Steps`: set its `length_factor` by a known distance.

    >>> given, made = tried(StepStatistics)
    >>> len(given["in"]), made["steps"][-1].item(), made["cadence"][-1].round().item()
    (24, 5, 108.0)
    """

    inputs = {"in": Input()}
    outputs: ClassVar[tuple[str, ...]] = ("statistics",)

    steps: int = param(20, least=2, most=500, help="how many of the latest steps")

    def open(self, specs: Specs) -> Specs:
        if specs["in"].dtype != STEP:
            raise InputError("in", specs["in"].describe(), "steps (operators.steps.steps.Steps)")
        self.set_state(StepStatisticsState(np.full((self.steps, 2), np.nan), np.zeros(self.steps, np.int64), 0, 0.0))
        return {"statistics": StreamSpec((), STATISTICS, units=STATISTICS_UNITS, meta=specs["in"].meta)}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        stamps, rows = list[int](), list[tuple[float, ...]]()
        for stamp, step in zip(chunk.time.tolist(), chunk.data, strict=True):
            if step["kind"] in ("first", "slow"):
                self.state.held = 0
                continue
            self.state.distance_m += float(np.nan_to_num(step["length_m"]))
            if step["kind"] == "walk":
                stamps.append(stamp)
                rows.append(self._take(step))
        data = np.array(rows, STATISTICS) if rows else np.empty(0, STATISTICS)
        return Chunk(np.array(stamps, np.int64), data, chunk.until, -1 if chunk.lost else 0)

    def _take(self, step: np.void) -> tuple[float, ...]:
        s = self.state
        if s.held == len(s.latest):
            s.latest[:-1], s.onsets[:-1] = s.latest[1:].copy(), s.onsets[1:].copy()
            s.held -= 1
        s.latest[s.held] = step["duration_s"], step["length_m"]
        s.onsets[s.held] = step["onset"]
        s.held += 1
        duration, length = s.latest[: s.held].T
        mean = float(duration.mean())
        uneven = abs(float(duration[::2].mean() - duration[1::2].mean())) / mean if s.held >= 4 else np.nan
        spread = 100 * float(duration.std(ddof=1)) / mean if s.held > 1 else np.nan
        return (
            int(s.onsets[0]), int(step["end"]), int(step["number"]), s.held, 60 / mean, mean, spread,
            float(length.mean()), float(length.mean()) / mean, 100 * uneven, s.distance_m,
        )  # fmt: skip

    @classmethod
    def cases(cls) -> list[Case]:
        spec, time, data = some_walk(16.0, 100.0, 6)
        finder = Steps()
        out = finder.open({"in": spec})["steps"]
        steps = finder.process("in", Chunk(time, data, int(time[-1])))
        return [
            Case(cls(steps=5), {"in": (out, steps.time, steps.data)}, least=10),
            Case(cls(), {"in": (out, steps.time, steps.data)}, least=10),
        ]
