"""How alike two limbs are: a symmetry index per stride and measure, its mean over the session, and the mean's interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from kinegraph.operators.contacts.limbs import limbs_of
from kinegraph.operators.cycles.cycle import is_closed, longest_cycle_s
from kinegraph.operators.cycles.limb_cycles import LIMB_CLOSED
from kinegraph.operators.cycles.running_curve import RunningCurve
from kinegraph.operators.cycles.statistics.operator import STATISTICS
from kinegraph.stream.chunk import NEVER, NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.finite import only_finite
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

MEASURES = ("peak", "mean", "integrated")
STRIDE = ("duration_s", "stance_pct")
REVISABLE = 64
SYMMETRY = np.dtype(
    [
        ("onset", "<i8"), ("end", "<i8"), ("number", "<i8"), ("name", "<U16"), ("measure", "<U16"), ("first", "<f8"), ("second", "<f8"),
        ("index_pct", "<f8"), ("mean_pct", "<f8"), ("low_pct", "<f8"), ("high_pct", "<f8"), ("pairs", "<i8"),
    ]
)  # fmt: skip
"""A measure of a muscle (or of the stride: name "") in two limbs' neighbouring cycles; `number` is the second's."""


@dataclass(slots=True)
class SymmetryState:
    """
    numbers, onsets, ends (2, 64)   of the latest cycles of both limbs, rings; seen (2,)
    values (2, 64, k)               their measures;  partner (64,) the first limb's cycle beside each of the second's, or -1
    indices (64, k)                 what was added up of each pair; session: of all
    pending                         the stamp of cycles that still wait for measures; changed (2, 64): 1 for those
    channels                        of the first limb's muscles, then of the second's
    """

    numbers: Times
    onsets: Times
    ends: Times
    seen: Times
    values: Samples
    partner: Times
    indices: Samples
    session: RunningCurve
    pending: int
    changed: Times
    limbs: list[str]
    muscles: list[str]
    channels: list[str]


@dataclass(frozen=True, slots=True)
class LimbSymmetry(Operator[SymmetryState]):
    """Cycles of several limbs and their muscles' numbers in, for every pair of neighbouring cycles of two limbs one event per measure out.

    The index is that of Robinson (1987): 100 (X2 - X1) / ((X1 + X2) / 2) in %, where X1 is the first limb's and X2 the second's (`pair`): 0
    is alike, positive: the second is larger. Measured are each muscle's peak, mean and integrated EMG, and (name "") the stride's
    duration_s and stance_pct. `mean_pct` is the mean over all pairs of the session, `low_pct` and `high_pct` its 95 % interval by
    Student's t, from three pairs on. Neighbours are a cycle of the second limb and the first limb's accepted one that began last before
    it, at most the second's duration earlier.

    An amplitude of two muscles is compared as it is: not normalised, electrodes differ too, and the index means less. A cycle that
    is reported again, among the latest 64 of its limb, replaces what it gave. Stamped like the cycle that completes the pair.

    >>> given, made = tried(LimbSymmetry)
    >>> made[["number", "name", "measure"]][0].item(), made["first"][0].round(1).item(), made["index_pct"][0].round(3).item()
    ((2, 'TA', 'peak'), 100.5, -0.004)
    """

    inputs = {"closed": Input(), "statistics": Input(trigger=True)}

    pair: tuple[str, ...] = param((), help="the two limbs; empty: the first two")

    def open(self, specs: Specs) -> Specs:
        closed, statistics = specs["closed"], specs["statistics"]
        limbs = limbs_of(statistics)
        if not is_closed(closed.dtype) or "limb" not in (closed.dtype.names or ()) or len(limbs) < 2:
            raise InputError(
                "closed", closed.describe(), "cycles of several limbs (operators.cycles.limb_cycles.LimbCycles)"
            )
        if statistics.dtype != STATISTICS:
            raise InputError(
                "statistics", statistics.describe(), "what operators.cycles.statistics.CycleStatistics gives"
            )
        for limb in self.pair:
            if limb not in limbs:
                raise ParameterError("pair", limb, f"one of the limbs; {nearest(limb, limbs)}")
        if self.pair and len(set(self.pair)) != 2:
            raise ParameterError("pair", list(self.pair), "two different limbs")
        first, second = self._pair(statistics)
        muscle = dict(statistics.meta["muscles"])
        there = {muscle[name] for name in limbs[second]}
        muscles = [muscle[name] for name in limbs[first] if muscle[name] in there]
        channels = [
            next(name for name in limbs[limb] if muscle[name] == m) for limb in (first, second) for m in muscles
        ]
        k = len(MEASURES) * len(muscles) + len(STRIDE)
        both, longest_s = (2, REVISABLE), longest_cycle_s(closed)
        self.set_state(
            SymmetryState(
                np.full(both, -1), np.zeros(both, np.int64), np.zeros(both, np.int64), np.zeros(2, np.int64), np.full((*both, k), np.nan),
                np.full(REVISABLE, -1), np.full((REVISABLE, k), np.nan), RunningCurve.empty(1, k), NEVER, np.zeros(both, np.int64),
                [first, second], muscles, channels,
            ),
            decision_s={"out": longest_s} if longest_s else None,
        )  # fmt: skip
        meta = {**statistics.meta, "pair": [first, second], "symmetry_index": "Robinson 1987"}
        units = ("ns", "ns", *(5 * [""]), "%", "%", "%", "%", "")
        return {"out": StreamSpec((), SYMMETRY, units=units, meta=meta)}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        out: list[tuple[int, Array]] = []
        for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
            self._settle(out, stamp - 1)
            if port == "closed":
                self._closed(row)
            else:
                self._measured(stamp, row)
        self._settle(out, chunk.until)
        stamps = np.array([stamp for stamp, _ in out], np.int64).repeat([len(rows) for _, rows in out])
        data = np.concatenate([np.empty(0, SYMMETRY), *(rows for _, rows in out)])
        return Chunk(stamps, data, chunk.until, -1 if chunk.lost else 0)

    @classmethod
    def cases(cls) -> list[Case]:
        n, rng = 24, np.random.default_rng(4)
        meta = {"limbs": {"left": ["L_TA"], "right": ["R_TA"]}, "muscles": {"L_TA": "TA", "R_TA": "TA"}}
        onset = NS + np.arange(n) * (NS // 2)
        closed, statistics = np.zeros(n, LIMB_CLOSED), np.zeros(n, STATISTICS)
        closed["onset"], closed["end"], closed["number"] = onset, onset + NS, np.arange(1, n + 1)
        closed["limb"], closed["duration_s"], closed["stance_pct"] = (
            np.resize(["left", "right"], n),
            1.0,
            60 + rng.random(n),
        )
        for name in ("onset", "end", "number"):
            statistics[name] = closed[name]
        statistics["name"] = np.resize(["L_TA", "R_TA"], n)
        for name in MEASURES:
            statistics[name] = 100 + rng.random(n)
        stamps = onset + NS + 20_000_000
        back = closed[9:10].copy()
        back["rejected"] = "by hand"
        again = np.concatenate([closed[:12], back, closed[12:14], closed[9:10], closed[14:]])
        when = stamps[[*range(12), 11, 12, 13, 13, *range(14, n)]]
        rows, at = (
            np.concatenate([statistics[:14], statistics[9:10], statistics[14:]]),
            stamps[[*range(14), 13, *range(14, n)]],
        )
        inputs = {
            "closed": (StreamSpec((), LIMB_CLOSED, units=("",), meta=meta), when, again),
            "statistics": (StreamSpec((), STATISTICS, units=("",), meta=meta), at, rows),
        }
        return [Case(cls(), inputs, least=40), Case(cls(pair=("right", "left")), inputs, least=40)]

    def _pair(self, statistics: StreamSpec) -> tuple[str, str]:
        first, second, *_ = self.pair or tuple(limbs_of(statistics))
        return first, second

    def _closed(self, row: np.void) -> None:
        """A cycle has ended, or is reported again: what was made of it is taken out."""
        s = self.state
        if str(row["limb"]) not in s.limbs:
            return
        limb, number = s.limbs.index(str(row["limb"])), int(row["number"])
        found = np.flatnonzero(s.numbers[limb] == number)
        k = int(found[0]) if len(found) else int(s.seen[limb] % REVISABLE)
        if not len(found):
            s.seen[limb] += 1
            if limb == 1:
                self._forget(k)
        elif limb == 1:
            self._take_out(k)
        else:
            for other in np.flatnonzero((s.partner == number) & (s.partner >= 0)).tolist():
                self._take_out(other)
            later = s.onsets[1] - int(row["onset"])
            s.changed[1, (s.numbers[1] >= 0) & (later > 0) & (later < s.ends[1] - s.onsets[1])] = 1
        s.numbers[limb, k], s.onsets[limb, k], s.ends[limb, k] = number, row["onset"], row["end"]
        s.values[limb, k] = np.nan
        s.changed[limb, k] = 0
        if not row["rejected"]:
            s.values[limb, k, -len(STRIDE) :] = [row[name] for name in STRIDE]

    def _measured(self, stamp: int, row: np.void) -> None:
        s = self.state
        name, number = str(row["name"]), int(row["number"])
        if name not in s.channels:
            return
        limb, muscle = divmod(s.channels.index(name), len(s.muscles))
        for k in np.flatnonzero(s.numbers[limb] == number).tolist():
            s.values[limb, k, muscle : len(s.muscles) * len(MEASURES) : len(s.muscles)] = [row[m] for m in MEASURES]
            s.changed[limb, k], s.pending = 1, stamp

    def _settle(self, out: list[tuple[int, Array]], until: int) -> None:
        """Make the pairs that have all measures."""
        s = self.state
        if s.pending == NEVER or s.pending > until:
            return
        stamp, s.pending = s.pending, NEVER
        for k in np.argsort(s.numbers[1], kind="stable").tolist():
            if s.changed[1, k] and s.numbers[1, k] >= 0 and (j := self._neighbour(k)) is not None:
                self._take_out(k)
                s.partner[k] = s.numbers[0, j]
                out.append((stamp, self._pair_rows(j, k)))
        s.changed[:] = 0

    def _neighbour(self, k: int) -> int | None:
        """Where the first limb's cycle stands that began last before the second's cycle `k`."""
        s = self.state
        onset, duration = int(s.onsets[1, k]), int(s.ends[1, k] - s.onsets[1, k])
        near = (s.numbers[0] >= 0) & np.isfinite(s.values[0]).any(axis=1)
        near &= (s.onsets[0] < onset) & (s.onsets[0] > onset - duration)
        if not near.any() or not np.isfinite(s.values[1, k]).any():
            return None
        return int(np.where(near, s.onsets[0], NEVER).argmax())

    def _take_out(self, k: int) -> None:
        s = self.state
        s.session.remove(s.indices[k][None])
        self._forget(k)

    def _forget(self, k: int) -> None:
        """The second limb's cycle at `k` can no longer be revised; its pair stays in the session's mean."""
        s = self.state
        s.indices[k], s.partner[k] = np.nan, -1

    def _pair_rows(self, j: int, k: int) -> Array:
        s = self.state
        first, second = s.values[0, j], s.values[1, k]
        with np.errstate(invalid="ignore", divide="ignore"):
            index = 200 * (second - first) / (first + second)
        index = only_finite(index)
        s.indices[k] = index
        s.session.add(index[None])
        count, mean, sd = s.session.count, s.session.centre()[0], s.session.sd()[0]
        wide = np.where(
            count > 2, stdtrit(np.maximum(count - 1, 1), 0.975) * sd / np.sqrt(np.maximum(count, 1)), np.nan
        )
        rows = np.zeros(len(index), SYMMETRY)
        for name, value in (("onset", s.onsets[1, k]), ("end", s.ends[1, k]), ("number", s.numbers[1, k])):
            rows[name] = value
        rows["name"] = [*(s.muscles * len(MEASURES)), *([""] * len(STRIDE))]
        rows["measure"] = [*(m for m in MEASURES for _ in s.muscles), *STRIDE]
        rows["first"], rows["second"], rows["index_pct"], rows["mean_pct"] = first, second, index, mean
        rows["low_pct"], rows["high_pct"], rows["pairs"] = mean - wide, mean + wide, count
        return rows[np.isfinite(index)]
