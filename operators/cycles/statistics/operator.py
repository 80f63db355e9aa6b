"""Numbers of one gait cycle, muscle by muscle, as the cycle ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.operators.contacts.limbs import Belonging
from kinegraph.operators.cycles.cycle import POINTS, REASONS, Expected, check_cycles, some_cycles
from kinegraph.operators.cycles.history import ACCEPTED, CycleHistory
from kinegraph.operators.cycles.running_curve import RunningCurve
from kinegraph.operators.cycles.verdicts import FLAGS
from kinegraph.stream.chunk import NEVER, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.finite import only_finite
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

STATISTICS = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("number", "<i8"),
        ("muscle", "<i4"),
        ("name", "<U16"),
        ("peak", "<f8"),
        ("peak_pct", "<f8"),
        ("mean", "<f8"),
        ("integrated", "<f8"),
        ("mean_stance", "<f8"),
        ("mean_swing", "<f8"),
        ("integrated_stance", "<f8"),
        ("integrated_swing", "<f8"),
        ("contact_pct", "<f8"),
        ("deviation", "<f8"),
        ("flag", "<U8"),
    ]
)

NOTHING = 1e-9
"""Means below this fraction of the peak are treated as zero."""


@dataclass(slots=True)
class CycleStatisticsState:
    """
    curve  of the cycles so far, in the space in which deviations are taken
    top    (muscles,) highest value so far
    history   what can still be revised, in the same space
    flags, flag_of (muscles,)   the latest flag of each muscle, and of which cycle it is
    reported   the newest `until` that was emitted; never, blank: stamps and samples of nothing
    """

    expected: Expected
    curve: RunningCurve
    top: Samples
    history: CycleHistory
    flags: Times
    flag_of: Times
    limbs: Belonging
    names: list[str]
    reported: int
    never: Times
    blank: Array


@dataclass(frozen=True, slots=True)
class CycleStatistics(Operator[CycleStatisticsState]):
    """Cycles (100, muscles) and their events in, one event per accepted cycle and muscle out, stamped like the cycle.

    peak, peak_pct       the highest of the 100 points and where it lies, in % of the cycle (whole ones; the first of equal ones)
    mean                 of the 100 points: the envelope's mean over the cycle's time
    integrated           mean x duration: the integrated EMG (input's unit x s; uV s)
    mean_stance, _swing  of the points before and from lift-off on; integrated_stance + integrated_swing = integrated. NaN where lift-off
                         is not known
    contact_pct          change (%) of mean_stance or mean_swing, whichever is more, where both contacts come `contact_s` earlier or later:
                         nothing in a muscle's signal says when the foot met the ground, so what contacts that are always late do to
                         these two is shown beside them. The cycle is taken to repeat itself
    deviation            Euclidean distance over the 100 points between this cycle and the mean of the accepted cycles before it, both
                         divided by the scale; dimensionless unless `scale: none`. NaN for the first cycle

    flag                 the worst quality of the muscle's signal in the cycle's seconds, with `judged` of `CycleReview`; "" without

    `scale: session` (default) divides by the highest value of that muscle so far, this cycle included; `cycle` scales each cycle to its own
    maximum, as the thesis does (6.2.3), which hides differences in strength; `none` does not scale.

    The deviation is one term of what the thesis's tables 6.1 and 6.2 average: their numbers fit the mean distance per cycle, not the
    root of summed squares that eq. 6.9 prints. There the mean curve is that of the whole session; live it can only be that of the
    cycles until now. `CycleEnsemble` gives the tables' own numbers. A muscle that is missing in a cycle has NaN throughout.

    With several limbs (`LimbCycles`) a cycle has events of its own limb's muscles only.

    A second event in `closed` of one of the latest 64 cycles' numbers replaces the first. If it is accepted its numbers come again, from
    its new sample; either way the mean that later deviations are taken from no longer holds what was reported first.

    >>> made = apply(CycleStatistics(), **some_cycles(8, 1, seed=1))
    >>> made["peak"][:3].round(1).tolist(), made["peak_pct"][:3].tolist()
    ([85.5, 87.2, nan], [16.0, 24.0, nan])
    """

    inputs = {"judged": Input(optional=True), "closed": Input(), "cycles": Input(trigger=True)}

    scale: Literal["session", "cycle", "none"] = param("session", help="what deviations are relative to")
    contact_s: float = param(0.02, least=0.0, most=0.2, help="how far off contacts may be, for `contact_pct`")

    def open(self, specs: Specs) -> Specs:
        spec = check_cycles(specs)
        n = spec.shape[1]
        nothing = (NEVER, np.empty(0, np.int64), np.empty(0, STATISTICS))
        self.set_state(
            CycleStatisticsState(
                Expected.empty(specs["closed"].dtype), RunningCurve.empty(spec.shape[0], n),
                np.zeros(n),
                CycleHistory.empty(spec.shape[0], n),
                np.zeros(n, np.int64), np.full(n, -1), Belonging.of(spec), list(spec.channels), *nothing,
            ),
            decision_s={"out": 0.0},
        )  # fmt: skip
        unit = spec.units[0] if len(spec.units) == 1 else ""
        area, ratio = f"{unit} s".strip(), unit if self.scale == "none" else ""
        units = ("ns", "ns", "", "", "", unit, "%", unit, area, unit, unit, area, area, "%", ratio, "")
        meta = {**spec.meta, "deviation_scale": self.scale, "contact_s": self.contact_s}
        return {"out": StreamSpec((), STATISTICS, units=units, meta=meta)}

    def process(self, port: str, chunk: Chunk) -> Chunk | None:
        s = self.state
        if not len(chunk.time) and not chunk.lost:
            if chunk.until <= s.reported:
                return None
            s.reported = int(chunk.until)
            return Chunk(s.never, s.blank, chunk.until)
        s.reported = max(s.reported, int(chunk.until))
        rows, stamps = [], []
        if port == "judged":
            for row in chunk.data:
                s.flags[int(row["muscle"])], s.flag_of[int(row["muscle"])] = (
                    FLAGS.index(str(row["flag"])),
                    row["number"],
                )
        elif port == "closed":
            s.expected.note(chunk)
            for row in chunk.data:
                self._revise(int(row["number"]), str(row["rejected"]))
        else:
            for stamp, closed, curve in s.expected.matched(chunk):
                rows.append(self._rows(closed[0], curve)[s.limbs.mine(closed[0])])
                stamps += [stamp] * len(rows[-1])
        data = np.concatenate(rows) if rows else s.blank
        return Chunk(np.array(stamps, np.int64), data, chunk.until, -1 if chunk.lost else 0)

    @classmethod
    def cases(cls) -> list[Case]:
        return [Case(cls(), some_cycles(20, 3, 1), least=40), Case(cls(scale="cycle"), some_cycles(12, 2, 2), least=15)]

    def _rows(self, closed: Array, curve: Samples) -> Array:
        duration, stance = float(closed["duration_s"]), float(closed["stance_pct"])
        points, n = curve.shape
        standing = np.arange(points) < stance / 100 * points
        known = stance == stance
        rows = np.empty(n, STATISTICS)
        for name in ("onset", "end", "number"):
            rows[name] = closed[name]
        rows["muscle"], rows["name"] = np.arange(n), self.state.names
        curve = only_finite(curve)
        absent = np.asarray(np.isnan(curve).any(axis=0))
        peak = np.where(absent, 0, curve.argmax(axis=0))
        rows["peak"], rows["peak_pct"] = curve[peak, np.arange(n)], np.where(absent, np.nan, peak * (100 / points))
        rows["mean"] = curve.mean(axis=0)
        rows["integrated"] = rows["mean"] * duration
        for part, chosen in (("stance", standing), ("swing", ~standing)):
            total = curve[chosen].sum(axis=0) if known else np.full(n, np.nan)
            count = int(chosen.sum())
            rows[f"mean_{part}"] = total / count if count else np.nan
            rows[f"integrated_{part}"] = total * (duration / points)
        rows["contact_pct"] = shifted_pct(curve, stance, 100.0 * self.contact_s / duration) if known else np.nan
        known_flag = self.state.flag_of == int(closed["number"])
        rows["flag"] = np.where(known_flag, np.array(FLAGS)[self.state.flags], "")
        rows["deviation"] = self._deviation(int(closed["number"]), curve, absent)
        return rows

    def _revise(self, number: int, rejected: str) -> None:
        """Take a cycle that is reported again out of the mean."""
        s = self.state
        if s.history.note(number, REASONS.index(rejected) if rejected else ACCEPTED) != ACCEPTED:
            return
        curve = s.history.take(number)
        there = ~np.isnan(curve).any(axis=0)
        s.curve.remove(curve)
        if self.scale != "cycle":
            highest = there & (np.fmax.reduce(curve, axis=0) >= s.top)
            s.top[highest] = s.history.highest()[highest]

    def _deviation(self, number: int, curve: Samples, absent: Array) -> Samples:
        """This cycle's distance to the running mean, which then takes it in."""
        s = self.state
        there = ~absent
        s.top[there] = np.maximum(np.where(s.curve.count == 0, -np.inf, s.top), curve.max(axis=0))[there]
        with np.errstate(invalid="ignore", divide="ignore"):
            if self.scale == "cycle":
                curve = curve / curve.max(axis=0)
            distance = np.asarray(np.sqrt(((curve - s.curve.mean) ** 2).sum(axis=0)))
            if self.scale == "session":
                distance = distance / s.top
        distance[s.curve.count == 0] = np.nan
        s.curve.add(np.where(there, curve, np.nan))
        s.history.put(number, np.where(there, curve, np.nan))
        return distance


def shifted_pct(curve: Samples, stance_pct: float, by_pct: float) -> Samples:
    """By how much (%) the mean of each curve (100, m) in stance or in swing changes at most, where both contacts move by `by_pct`."""
    most = np.zeros(curve.shape[1])
    for begin, end in ((0.0, stance_pct), (stance_pct, 100.0)):
        if end > begin:
            before = share_of(begin, end) @ curve
            before = np.where(np.abs(before) <= NOTHING * np.abs(curve).max(axis=0), np.nan, before)
            with np.errstate(invalid="ignore", divide="ignore"):
                for by in (-by_pct, by_pct):
                    now = share_of(begin + by, end + by) @ curve
                    most = np.maximum(most, 100.0 * np.abs(now / before - 1.0))
    return most


def share_of(begin_pct: float, end_pct: float) -> Samples:
    """(100,) which part of each point, one percent wide, lies between two places of a cycle that repeats itself."""
    at = np.arange(-POINTS, 2 * POINTS)
    parts = np.clip(np.minimum(at + 1, end_pct) - np.maximum(at, begin_pct), 0.0, 1.0)
    return np.asarray(parts.reshape(3, POINTS).sum(axis=0))
