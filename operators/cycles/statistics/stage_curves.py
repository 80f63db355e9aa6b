"""The mean curve of the stage under way, live: what `CycleEnsemble` gives of the session, restarted with each stage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.cycles.cycle import POINTS, REASONS, Expected, check_cycles, some_cycles
from kinegraph.operators.cycles.history import ACCEPTED, CycleHistory
from kinegraph.operators.cycles.running_curve import RunningCurve
from kinegraph.stream.chunk import Array, Chunk, Specs, StreamSpec
from kinegraph.stream.data.finite import only_finite
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Input, Operator

STAGE_SO_FAR = np.dtype(
    [("onset", "<i8"), ("end", "<i8"), ("number", "<i8"), ("stage", "<U32"), ("speed_m_s", "<f8"), ("cycles", "<i4")]
)
"""The stage of the latest cycle, and how many of its accepted cycles (of all limbs) the mean curves are of."""


@dataclass(slots=True)
class StageCurvesState:
    """curve: of the stage under way;  history: its cycles that may be emitted again;  stage: its name, cycles: how many."""

    expected: Expected
    curve: RunningCurve
    history: CycleHistory
    stage: str
    cycles: int


@dataclass(frozen=True, slots=True)
class StageCurves(Operator[StageCurvesState]):
    """Cycles (100, muscles) and their events with a field `stage` in; after every accepted cycle of a stage, its mean curve so far.

    closed     of `operators.cycles.stages.Stages`;  cycles: of `operators.cycles.cycles.Cycles`, or of the review after it
    mean, sd   (100, muscles) mean and standard deviation (n - 1) of the stage's accepted cycles, point by point; NaN until there are enough
    sofar      one event with each (`STAGE_SO_FAR`)

    A cycle across two stages, or outside any, gives nothing. A stage restarts after a cycle of another one. A cycle that is
    emitted again is taken out of its stage's curve as long as that stage is under way; afterwards its curve has gone out as it was.

    >>> given, made = tried(StageCurves)
    >>> given["cycles"][0, ::50, 0].round().tolist(), made["mean"][-1, ::50, 0].round().tolist()
    ([45.0, 55.0], [50.0, 49.0])
    """

    inputs = {"closed": Input(), "cycles": Input(trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("mean", "sd", "sofar")

    def open(self, specs: Specs) -> Specs:
        spec, closed = check_cycles(specs), specs["closed"]
        if not {"stage", "speed_m_s"} <= set(closed.dtype.names or ()):
            raise InputError(
                "closed", closed.describe(), "cycles' events with their stage (operators.cycles.stages.Stages)"
            )
        n = spec.shape[1]
        state = StageCurvesState(
            Expected.empty(closed.dtype), RunningCurve.empty(POINTS, n), CycleHistory.empty(POINTS, n), "", 0
        )
        self.set_state(state, decision_s={"sofar": 0.0})
        return {
            "mean": spec,
            "sd": spec,
            "sofar": StreamSpec((), STAGE_SO_FAR, units=("ns", "ns", "", "", "m/s", ""), meta=spec.meta),
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        made: list[tuple[int, Array, Array, Array]] = []
        if port == "closed":
            s.expected.note(chunk)
            for row in chunk.data:
                self._revise(row)
        else:
            for stamp, closed, curve in s.expected.matched(chunk):
                if closed["stage"][0]:
                    self._take(closed[0], only_finite(curve))
                    made.append((stamp, s.curve.centre(), s.curve.sd(), self._so_far(closed)))
        stamps = np.array([stamp for stamp, *_ in made], np.int64)
        shape, lost = (0, *s.curve.mean.shape), -1 if chunk.lost else 0
        curves = [np.array([one[k] for one in made]) if made else np.empty(shape) for k in (1, 2)]
        rows = np.concatenate([np.empty(0, STAGE_SO_FAR), *(one[3] for one in made)])
        return [
            (name, Chunk(stamps, data, chunk.until, lost))
            for name, data in zip(self.outputs, (*curves, rows), strict=True)
        ]

    @classmethod
    def cases(cls) -> list[Case]:
        inputs = some_cycles(24, 3, 9)
        spec, stamps, rows = inputs["closed"]
        staged = np.zeros(len(rows), [*rows.dtype.descr, ("stage", "<U32"), ("speed_m_s", "<f8")])
        for name in rows.dtype.names or ():
            staged[name] = rows[name]
        staged["stage"] = np.select(
            [rows["number"] < 9, rows["number"] == 9, rows["number"] < 20], ["slow", "", "fast"], "slow"
        )
        units = (*spec.units, "", "m/s")
        closed = StreamSpec((), staged.dtype, units=units, meta=spec.meta)
        return [Case(cls(), {"closed": (closed, stamps, staged), "cycles": inputs["cycles"]}, least=15)]

    def _revise(self, closed: np.void) -> None:
        """A cycle of this stage that was accepted is reported again: take it out."""
        s = self.state
        number, reason = int(closed["number"]), str(closed["rejected"])
        if s.history.note(number, REASONS.index(reason) if reason else ACCEPTED) != ACCEPTED:
            return
        curve = s.history.take(number)
        if np.isfinite(curve).any():
            s.curve.remove(curve)
            s.cycles -= 1

    def _take(self, closed: np.void, curve: Array) -> None:
        s, stage = self.state, str(closed["stage"])
        if stage != s.stage:
            s.curve, s.stage, s.cycles = RunningCurve.empty(*s.curve.mean.shape), stage, 0
            s.history.curves[:] = np.nan
        s.history.put(int(closed["number"]), curve)
        s.curve.add(curve)
        s.cycles += 1

    def _so_far(self, closed: Array) -> Array:
        made = np.zeros(1, STAGE_SO_FAR)
        for name in ("onset", "end", "number", "stage", "speed_m_s"):
            made[name] = closed[name]
        made["cycles"] = self.state.cycles
        return made
