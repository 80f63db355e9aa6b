"""What many gait cycles have in common, and how far they differ: mean curve, spread, repeatability, co-contraction, cadence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from kinegraph.operators.contacts.limbs import Belonging
from kinegraph.operators.cycles.cycle import POINTS, REASONS, Expected, check_cycles, some_cycles
from kinegraph.operators.cycles.deviation_kernel import deviations
from kinegraph.operators.cycles.history import ACCEPTED, CycleHistory
from kinegraph.operators.cycles.running_curve import RunningCurve
from kinegraph.operators.cycles.statistics.co_contraction import CoContraction
from kinegraph.operators.cycles.statistics.ensemble_events import MUSCLE, PAIR, SESSION, rows_of
from kinegraph.operators.cycles.statistics.stride_tally import StrideTally
from kinegraph.stream.chunk import NEVER, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.finite import only_finite
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

SCALES = ("none", "session", "cycle")
RATIO_FROM = 10
"""The variance ratio is given from this many cycles on (Hershler and Milner 1978)."""


@dataclass(slots=True)
class EnsembleState:
    """
    curve                     of all cycles
    kept (remember, 100, m)   the latest cycles, a ring; `seen` in all; kept_numbers (remember,)
    history                   what can still be revised
    tally                     of the session's cycles, accepted and rejected
    reported, never, blanks   the newest `until` that was emitted; stamps and samples of nothing, by output
    counted (m,)              how many cycles of its limb were added up
    co_contraction            of the pairs
    """

    expected: Expected
    curve: RunningCurve
    limbs: Belonging
    counted: Times
    kept: Samples
    kept_numbers: Times
    seen: int
    history: CycleHistory
    tally: StrideTally
    co_contraction: CoContraction
    names: list[str]
    reported: int
    never: Times
    blanks: list[Array]


@dataclass(frozen=True, slots=True)
class CycleEnsemble(Operator[EnsembleState]):
    """Cycles (100, muscles) and their events in; after every accepted cycle, the state of all accepted ones so far.

    mean, sd   (100, muscles) mean curve and standard deviation (n - 1) point by point; NaN until there are enough cycles
    muscles    one event per muscle: how many cycles, and in how many others it was missing or left out; the mean curve's peak and where;
               cv_pct, Winter's coefficient of variation: root mean square of the sd curve over the mean of the mean curve's amount;
               variance_ratio (Hershler and Milner 1978), from 10 cycles on, else NaN: variance about the mean curve over variance about
               the grand mean; 0 means each cycle is like the other, 1 that the curve explains nothing. Above `repeatable_below` the
               `verdict` is "not repeatable", and that is all it says: walking unsteadily, changing speed and a loose electrode look alike;
               deviation and mad, of the latest `remember` cycles: the mean Euclidean distance between a cycle and their mean curve, and
               the mean absolute deviation of these distances from their mean. These two are what the thesis's tables 6.1 and 6.2 hold;
               its eq. 6.9 prints a sum, and 6.10 leaves its n open. Scaled as `scale` says, see `CycleStatistics`
    pairs      one event per pair of `pairs`: the co-contraction of this cycle (Falconer and Winter 1985), 2 sum min(a, b) / sum (a + b)
               in %, and its mean over all cycles. Only of channels normalised in amplitude, because it compares them
    session    one event per cycle, rejected ones too: cadence, 60 over the mean duration of the latest `over` accepted cycles in
               strides/min; mean stance; counts of accepted and rejected cycles, by reason

    With several limbs (`LimbCycles`) `muscles` has an event per muscle of the cycle's limb; `session` counts the cycles of all limbs.
    A muscle that is missing in a cycle keeps the numbers it had. A second event of one of the latest 64 cycles' numbers replaces the first:
    what was added up of that cycle is taken out again, and its new sample, if it is accepted, comes in.

    >>> made = apply(CycleEnsemble(), **some_cycles(8, 2, seed=1))
    >>> made["mean"][-1, ::50].round().tolist(), made["muscles"]["cycles"][-1].item()
    ([[52.0, 74.0], [51.0, 23.0]], 5)
    """

    inputs = {"closed": Input(), "cycles": Input(trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("mean", "sd", "muscles", "pairs", "session")

    pairs: tuple[tuple[str, str], ...] = param((), help="muscles whose co-contraction is reported, e.g. [[TA, SO]]")
    repeatable_below: float = param(0.65, above=0.0, most=1.0, help="a higher variance ratio is 'not repeatable'")
    scale: Literal["session", "cycle", "none"] = param("session", help="what deviations are relative to")
    remember: int = param(64, least=2, most=4096, help="cycles over which deviations are taken")
    over: int = param(10, least=1, most=1000, help="cycles over which cadence and stance are averaged")

    def open(self, specs: Specs) -> Specs:
        spec = check_cycles(specs)
        n = spec.shape[1]
        self.set_state(
            EnsembleState(
                Expected.empty(specs["closed"].dtype), RunningCurve.empty(POINTS, n),
                Belonging.of(spec), np.zeros(n, np.int64), np.full((self.remember, POINTS, n), np.nan),
                np.full(self.remember, -1), 0, CycleHistory.empty(POINTS, n), StrideTally.empty(self.over),
                CoContraction.of(self.pairs, spec), list(spec.channels), NEVER,
                np.empty(0, np.int64), [self._blank(name, (POINTS, n)) for name in self.outputs],
            ),
            decision_s={"muscles": 0.0, "pairs": 0.0, "session": 0.0},
        )  # fmt: skip
        unit = spec.units[0] if len(spec.units) == 1 else ""
        when, meta = ("ns", "ns", ""), {**spec.meta, "deviation_scale": self.scale}
        muscle = (*when, "", "", "", "", unit, "%", "%", "", "", *(2 * [unit if self.scale == "none" else ""]))
        return {
            "mean": spec,
            "sd": spec,
            "muscles": StreamSpec((), MUSCLE, units=muscle, meta=meta),
            "pairs": StreamSpec((), PAIR, units=(*when, "", "", "%", "%", ""), meta=meta),
            "session": StreamSpec(
                (), SESSION, units=(*when, "strides/min", "%", "", "", *(len(REASONS) * [""])), meta=meta
            ),
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]] | None:
        s = self.state
        if not len(chunk.time) and not chunk.lost:
            if chunk.until <= s.reported:
                return None
            s.reported = int(chunk.until)
            return [
                (name, Chunk(s.never, blank, chunk.until)) for name, blank in zip(self.outputs, s.blanks, strict=True)
            ]
        s.reported = max(s.reported, int(chunk.until))
        made: dict[str, list[tuple[int, Array]]] = {name: [] for name in self.outputs}
        if port == "closed":
            s.expected.note(chunk)
            for i, stamp in enumerate(chunk.time.tolist()):
                row = chunk.data[i : i + 1]
                if self._revised(row[0]) and row["rejected"][0]:
                    self._summary(made, stamp, row)
                made["session"].append((stamp, s.tally.add(row[0])))
        else:
            for stamp, closed, curve in s.expected.matched(chunk):
                curve = only_finite(curve)
                self._take(closed[0], curve)
                self._summary(made, stamp, closed)
                made["pairs"].append((stamp, s.co_contraction.add(closed, curve)))
        lost = -1 if chunk.lost else 0
        return [(name, self._chunk(name, parts, chunk.until, lost)) for name, parts in made.items()]

    @classmethod
    def cases(cls) -> list[Case]:
        return [
            Case(cls(pairs=(("TA", "SO"),), remember=8), some_cycles(20, 3, 3), least=60),
            Case(cls(scale="cycle", remember=4, over=3), some_cycles(16, 2, 4), least=40),
        ]

    @staticmethod
    def _blank(name: str, curve: tuple[int, int]) -> Array:
        shape, kind = {"muscles": ((), MUSCLE), "pairs": ((), PAIR), "session": ((), SESSION)}.get(
            name, (curve, np.dtype(np.float64))
        )
        return np.empty((0, *shape), kind)

    def _chunk(self, name: str, parts: list[tuple[int, Array]], until: int, lost: int) -> Chunk:
        s = self.state
        if not parts:
            return Chunk(s.never, s.blanks[self.outputs.index(name)], until, lost)
        stamps = np.array([stamp for stamp, _ in parts], np.int64).repeat([len(part) for _, part in parts])
        return Chunk(stamps, np.concatenate([part for _, part in parts]), until, lost)

    def _summary(self, made: dict[str, list[tuple[int, Array]]], stamp: int, closed: Array) -> None:
        s = self.state
        made["mean"].append((stamp, s.curve.centre()[None]))
        made["sd"].append((stamp, s.curve.sd()[None]))
        made["muscles"].append((stamp, self._repeatability(closed)))

    def _revised(self, closed: np.void) -> bool:
        """Whether a cycle's event replaces one that accepted it; what was added up of it is then taken out."""
        s = self.state
        number, reason = int(closed["number"]), str(closed["rejected"])
        before = s.history.note(number, REASONS.index(reason) if reason else ACCEPTED)
        if before >= 0:
            s.tally.reasons[before] -= 1
        if before != ACCEPTED:
            return False
        s.tally.take_back(number)
        curve = s.history.take(number)
        s.curve.remove(curve)
        s.counted -= s.limbs.mine(closed)
        s.kept[s.kept_numbers == number] = np.nan
        s.co_contraction.remove(curve)
        return True

    def _take(self, closed: np.void, curve: Samples) -> None:
        s, number = self.state, int(closed["number"])
        s.history.put(number, curve)
        there = s.curve.add(curve)
        s.counted += s.limbs.mine(closed)
        s.kept[s.seen % self.remember] = np.where(there, curve, np.nan)
        s.kept_numbers[s.seen % self.remember] = number
        s.seen += 1

    def _repeatability(self, closed: Array) -> Array:
        s = self.state
        n = len(s.names)
        rows = rows_of(MUSCLE, closed, n)
        rows["muscle"], rows["name"], rows["cycles"] = np.arange(n), s.names, s.curve.count
        rows["left_out"] = s.counted - s.curve.count
        mean = s.curve.centre()
        peak = s.curve.mean.argmax(axis=0)
        rows["peak"] = mean[peak, np.arange(n)]
        rows["peak_pct"] = np.where(s.curve.count > 0, peak * (100 / POINTS), np.nan)
        with np.errstate(invalid="ignore", divide="ignore"):
            rows["cv_pct"] = 100 * np.sqrt((s.curve.sd() ** 2).mean(axis=0)) / np.abs(mean).mean(axis=0)
            rows["variance_ratio"] = np.where(s.curve.count >= RATIO_FROM, s.curve.variance_ratio(), np.nan)
        known = np.isfinite(rows["variance_ratio"])
        rows["verdict"] = np.where(
            known, np.where(rows["variance_ratio"] > self.repeatable_below, "not repeatable", "repeatable"), ""
        )
        rows["deviation"], rows["mad"] = self._deviations()
        return np.asarray(rows[s.limbs.mine(closed[0])])

    def _deviations(self) -> Samples:
        """Mean distance to the mean curve, and the mean absolute deviation of the distances, of the cycles kept (2, m); NaN below two."""
        s = self.state
        kept = s.kept[: min(s.seen, self.remember)]
        points, n = s.curve.mean.shape
        out = np.empty((2, n))
        deviations(kept, SCALES.index(self.scale), np.empty((points, n)), np.empty((len(kept), n)), out)
        return out
