"""When a muscle is active in a cycle: onset and offset of every burst, and what they are on the mean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.contacts.limbs import Belonging
from kinegraph.operators.cycles.cycle import POINTS, REASONS, Expected, check_cycles, some_cycles
from kinegraph.operators.cycles.history import ACCEPTED, CycleHistory
from kinegraph.operators.cycles.running_curve import RunningCurve
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.data.finite import only_finite
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

WHEN = [("onset", "<i8"), ("end", "<i8"), ("number", "<i8"), ("muscle", "<i4"), ("name", "<U16")]
BURST = np.dtype(
    [*WHEN, ("burst", "<i8"), ("on_pct", "<f8"), ("off_pct", "<f8"), ("duration_pct", "<f8"), ("duration_s", "<f8"), ("peak", "<f8")]
)  # fmt: skip
"""A burst of a muscle in a cycle, the `burst`-th; one that runs over the cycle's end has `off_pct` below `on_pct`."""
BURSTS = np.dtype(
    [
        *WHEN, ("cycles", "<i8"), ("per_cycle", "<f8"), ("on_pct", "<f8"), ("on_sd_pct", "<f8"), ("off_pct", "<f8"), ("off_sd_pct", "<f8"),
        ("duration_pct", "<f8"), ("duration_sd_pct", "<f8"),
    ]
)  # fmt: skip
"""A muscle's bursts so far: how many a cycle has, and its main burst (the one with the peak): circular means and deviations."""
MAIN = 6


@dataclass(slots=True)
class BurstsState:
    """
    base (2, m, 20)   mean and variance of the latest cycles' quietest stretches, rings;  seen (m,)
    active, main      share of the cycles in which each point is active; cos and sin of on and off, duration, count (6, m)
    history           (106, m) what was added up of the latest cycles
    """

    expected: Expected
    base: Samples
    seen: Array
    active: RunningCurve
    main: RunningCurve
    history: CycleHistory
    limbs: Belonging
    names: list[str]


@dataclass(frozen=True, slots=True)
class CycleBursts(Operator[BurstsState]):
    """Cycles of envelopes and their events in, each cycle's bursts out, and what they are on the mean.

    bursts   one event per burst of an accepted cycle (`BURST`)
    session  one event per muscle of the cycle (`BURSTS`): its bursts so far
    active   (100, muscles) in which share of the cycles so far the muscle was active at each point, 0..1; NaN before there is a cycle

    The method is Hodges and Bui's (Electroencephalogr. Clin. Neurophysiol. 101, 1996) with a second, lower threshold (hysteresis): a burst
    begins where the envelope stays for `min_pct` of the cycle at or above baseline + `on_sd` standard deviations of the baseline,
    and ends where it falls below baseline + `off_sd`. Baseline is the mean of the quietest `quiet_pct` of the cycle (one stretch), its
    deviation that within it, both over the latest 20 cycles. As an envelope's baseline hardly varies, a burst must also reach `of_peak`
    of the cycle's peak, and ends at half of that. Bursts less than `join_pct` apart are one; what is active at 99 % and at 0 % is one.

    A cycle that is reported again, among the latest 64, comes again, and replaces what it gave; not in the baseline.

    >>> bursts = apply(CycleBursts(), **some_cycles(8, 1, seed=1))["bursts"]
    >>> bursts[["number", "name", "on_pct", "off_pct"]][:2].tolist()
    [(1, 'TA', 91.0, 60.0), (2, 'TA', 90.0, 60.0)]
    """

    inputs = {"closed": Input(), "cycles": Input(trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("bursts", "session", "active")

    on_sd: float = param(3.0, above=0.0, help="a burst begins this many standard deviations above the baseline")
    off_sd: float = param(1.5, above=0.0, help="and ends below this many")
    of_peak: float = param(0.15, least=0.0, below=1.0, help="a burst reaches this part of the cycle's peak at least")
    min_pct: int = param(3, least=1, most=50, help="a burst lasts this long at least, % of the cycle")
    join_pct: int = param(3, least=0, most=50, help="bursts that are less apart are one, % of the cycle")
    quiet_pct: int = param(10, least=2, most=50, help="length of the stretch that gives the baseline, % of the cycle")

    def open(self, specs: Specs) -> Specs:
        spec = check_cycles(specs)
        if self.off_sd > self.on_sd:
            raise ParameterError("off_sd", self.off_sd, f"at most on_sd ({self.on_sd:g})")
        n = spec.shape[1]
        state = BurstsState(
            Expected.empty(specs["closed"].dtype), np.full((2, n, 20), np.nan), np.zeros(n, np.int64), RunningCurve.empty(POINTS, n),
            RunningCurve.empty(MAIN, n), CycleHistory.empty(POINTS + MAIN, n), Belonging.of(spec), list(spec.channels),
        )  # fmt: skip
        self.set_state(state, decision_s={"bursts": 0.0, "session": 0.0})
        unit = spec.units[0] if len(spec.units) == 1 else ""
        when = ("ns", "ns", "", "", "")
        return {
            "bursts": StreamSpec((), BURST, units=(*when, "", "%", "%", "%", "s", unit), meta=spec.meta),
            "session": StreamSpec((), BURSTS, units=(*when, "", "", *(6 * ["%"])), meta=spec.meta),
            "active": spec.derive(units=("",)),
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        found: list[tuple[int, Array, Array, Samples]] = []
        if port == "closed":
            s.expected.note(chunk)
            for row in chunk.data:
                reason = str(row["rejected"])
                if s.history.note(int(row["number"]), REASONS.index(reason) if reason else ACCEPTED) == ACCEPTED:
                    old = s.history.take(int(row["number"]))
                    s.active.remove(old[:POINTS])
                    s.main.remove(old[POINTS:])
        else:
            for stamp, closed, curve in s.expected.matched(chunk):
                found.append((stamp, *self._cycle(closed[0], only_finite(curve))))
        lost, until = -1 if chunk.lost else 0, chunk.until
        stamps = np.array([stamp for stamp, *_ in found], np.int64)
        bursts = [rows for _, rows, _, _ in found]
        session = [rows for _, _, rows, _ in found]
        shares = np.array([share for *_, share in found]).reshape(-1, POINTS, len(s.names))
        return [
            ("bursts", Chunk(stamps.repeat([len(r) for r in bursts]), np.concatenate([np.empty(0, BURST), *bursts]), until, lost)),
            ("session", Chunk(stamps.repeat([len(r) for r in session]), np.concatenate([np.empty(0, BURSTS), *session]), until, lost)),
            ("active", Chunk(stamps, shares, until, lost)),
        ]  # fmt: skip

    @classmethod
    def cases(cls) -> list[Case]:
        least = cls(of_peak=0.8, min_pct=5, join_pct=0, quiet_pct=20)
        return [Case(cls(), some_cycles(20, 3, 6), least=30), Case(least, some_cycles(20, 3, 7), least=30)]

    def _cycle(self, closed: np.void, curve: Samples) -> tuple[Array, Array, Samples]:
        s = self.state
        kept = np.full((POINTS + MAIN, curve.shape[1]), np.nan)
        rows: list[tuple[float, ...]] = []
        mine = s.limbs.mine(closed)
        for i in np.flatnonzero(mine & ~np.isnan(curve).any(axis=0)).tolist():
            spans = self._spans(i, curve[:, i])
            kept[:POINTS, i] = 0.0
            for on, length in spans:
                kept[(on + np.arange(length)) % POINTS, i] = 1.0
            kept[POINTS:, i] = _main(spans, int(curve[:, i].argmax()))
            for k, (on, length) in enumerate(spans):
                inside = (on + np.arange(length)) % POINTS
                rows.append((i, k + 1, on, length, float(curve[inside, i].max())))
        s.history.put(int(closed["number"]), kept)
        s.active.add(kept[:POINTS])
        s.main.add(kept[POINTS:])
        return self._burst_rows(closed, rows), self._session(closed, mine), s.active.centre()

    def _spans(self, i: int, x: Samples) -> list[tuple[int, int]]:
        """Where the bursts of a muscle's cycle (100,) begin, and how long they are, in points."""
        s = self.state
        around = np.concatenate([x, x[: self.quiet_pct - 1]])
        level = np.convolve(around, np.ones(self.quiet_pct) / self.quiet_pct, "valid")
        first = int(level.argmin())
        quiet = around[first : first + self.quiet_pct]
        k = int(s.seen[i]) % s.base.shape[2]
        s.base[:, i, k] = quiet.mean(), quiet.var()
        s.seen[i] += 1
        count = min(int(s.seen[i]), s.base.shape[2])
        mean, sd = float(s.base[0, i, :count].mean()), float(np.sqrt(s.base[1, i, :count].mean()))
        rise = float(x.max()) - mean
        on = mean + max(self.on_sd * sd, self.of_peak * rise)
        off = mean + max(self.off_sd * sd, 0.5 * self.of_peak * rise)
        return spans(x, on, min(on, off), self.min_pct, self.join_pct)

    def _burst_rows(self, closed: np.void, rows: list[tuple[float, ...]]) -> Array:
        made = np.zeros(len(rows), BURST)
        for name in ("onset", "end", "number"):
            made[name] = closed[name]
        for row, (muscle, burst, on, length, peak) in zip(made, rows, strict=True):
            row["muscle"], row["name"], row["burst"], row["peak"] = muscle, self.state.names[int(muscle)], burst, peak
            row["on_pct"], row["off_pct"], row["duration_pct"] = on, (on + length) % POINTS, length
            row["duration_s"] = length / POINTS * float(closed["duration_s"])
        return made

    def _session(self, closed: np.void, mine: Array) -> Array:
        s, n = self.state, len(self.state.names)
        made = np.zeros(n, BURSTS)
        for name in ("onset", "end", "number"):
            made[name] = closed[name]
        made["muscle"], made["name"], made["cycles"] = np.arange(n), s.names, s.active.count
        mean, sd = s.main.centre(), s.main.sd()
        made["per_cycle"], made["duration_pct"], made["duration_sd_pct"] = mean[5], mean[4], sd[4]
        for k, name in ((0, "on"), (2, "off")):
            made[f"{name}_pct"] = np.arctan2(mean[k + 1], mean[k]) * POINTS / (2 * np.pi) % POINTS
            length = np.minimum(np.hypot(mean[k], mean[k + 1]), 1.0)
            with np.errstate(divide="ignore"):
                made[f"{name}_sd_pct"] = np.sqrt(-2 * np.log(length)) * POINTS / (2 * np.pi)
        return np.asarray(made[mine])


def spans(x: Samples, on: float, off: float, least: int, join: int) -> list[tuple[int, int]]:
    """Bursts of a closed curve (n,): first point and length of each. Above `off` without a break, at or above `on` for `least` in a row."""
    n = len(x)
    above = x >= off
    if above.all():
        return [(0, n)] if _longest(x >= on) >= least else []
    start = int(np.flatnonzero(~above)[0])
    turned, strong = np.roll(above, -start), np.roll(x >= on, -start)
    edges = np.flatnonzero(np.diff(turned.astype(np.int64), prepend=0, append=0)).reshape(-1, 2)
    found = [(int(a), int(b)) for a, b in edges if _longest(strong[a:b]) >= least]
    joined: list[tuple[int, int]] = []
    for a, b in found:
        if joined and a - joined[-1][1] < join:
            joined[-1] = (joined[-1][0], b)
        else:
            joined.append((a, b))
    return sorted(((a + start) % n, b - a) for a, b in joined)


def _longest(flags: Array) -> int:
    """The longest run of true values."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int64), prepend=0, append=0)).reshape(-1, 2)
    return int((edges[:, 1] - edges[:, 0]).max()) if len(edges) else 0


def _main(found: list[tuple[int, int]], peak: int) -> Samples:
    """The burst with the peak: cos and sin of its ends, its length, and the number of bursts; NaN if the peak is outside all bursts."""
    for on, length in found:
        if (peak - on) % POINTS < length:
            turn = 2 * np.pi / POINTS * np.array([on, on + length])
            cos, sin = np.cos(turn), np.sin(turn)
            return np.array([cos[0], sin[0], cos[1], sin[1], length, len(found)])
    return np.full(MAIN, np.nan)
