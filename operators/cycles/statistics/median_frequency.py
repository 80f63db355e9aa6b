"""Median frequency of each muscle's EMG in each gait cycle, and its slope over the session: a measure of fatigue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.contacts.limbs import Belonging
from kinegraph.operators.cycles.cycle import CLOSED, CLOSED_UNITS, REASONS, is_closed
from kinegraph.operators.cycles.history import ACCEPTED, CycleHistory
from kinegraph.operators.cycles.recent_samples import RecentSamples
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.data.require import regular_signal
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

FREQUENCY = np.dtype(
    [
        ("onset", "<i8"), ("end", "<i8"), ("number", "<i8"), ("muscle", "<i4"), ("name", "<U16"), ("median_hz", "<f8"), ("mean_hz", "<f8"),
        ("slope_pct_per_min", "<f8"), ("cycles", "<i8"),
    ]
)  # fmt: skip


@dataclass(slots=True)
class MedianFrequencyState:
    """
    sums (5, m)   of 1, t, t t, f, t f over the cycles so far, t in minutes from the first cycle, `began`
    history       (3, m) minutes, median and mean of the latest cycles
    """

    recent: RecentSamples
    sums: Samples
    history: CycleHistory
    began: int
    period: int
    limbs: Belonging
    names: list[str]


@dataclass(frozen=True, slots=True)
class MedianFrequency(Operator[MedianFrequencyState]):
    """The raw EMG and cycles' events in, one event per accepted cycle and muscle out.

    median_hz, mean_hz   of the power spectrum (Hann window over the whole cycle, mean taken off) between `low_hz` and `high_hz`
    slope_pct_per_min    the straight line through the medians so far, in % of its value at the first cycle per minute; from 10 cycles on

    The median falls as a muscle tires (De Luca, J. Appl. Biomech. 13, 1997), in contractions that do not move; walking, it also follows the
    phase, the speed and the electrode, so compare like cycles. Of several limbs a cycle has its own limb's muscles only. Cycles with a
    gap or a value that is not finite have no event for that muscle. A cycle that is reported again, among the latest 64, replaces what it
    gave. Memory: `longest_s` of signal, twice.

    >>> given, made = tried(MedianFrequency)
    >>> given["closed"]["duration_s"][0].item(), made["median_hz"][:2].round().tolist()
    (0.0, [232.0, 274.0])
    """

    inputs = {"signal": Input(), "closed": Input(trigger=True)}

    low_hz: float = param(20.0, least=0.0, help="the spectrum counts from here")
    high_hz: float = param(450.0, above=0.0, help="up to here, or to half of the rate where that is less")
    longest_s: float = param(
        6.0, above=0.0, most=60.0, help="how old a cycle's begin may be when the cycle is reported"
    )

    def open(self, specs: Specs) -> Specs:
        spec = specs["signal"]
        rate_hz = regular_signal(spec, "signal", "a raw signal")
        if not is_closed(specs["closed"].dtype):
            raise InputError("closed", specs["closed"].describe(), "cycles' events (operators.cycles.cycles.Cycles)")
        if not self.low_hz < min(self.high_hz, rate_hz / 2):
            raise ParameterError(
                "low_hz", self.low_hz, f"below {min(self.high_hz, rate_hz / 2):g} (high_hz, half of the rate)"
            )
        m = spec.shape[0]
        names = list(spec.channels or [f"channel {i + 1}" for i in range(m)])
        keep = int(self.longest_s * rate_hz) + 8
        closed = specs["closed"].derive(
            shape=(1, m), dtype=np.dtype(np.float64), channels=tuple(names), units=("",), channel_axis=1
        )
        limbs = Belonging.of(closed)
        state = MedianFrequencyState(
            RecentSamples.of(keep, m), np.zeros((5, m)), CycleHistory.empty(3, m), -1, spec.period_ns, limbs, names
        )
        self.set_state(state, decision_s={"out": 0.0})
        meta = {**spec.meta, **{k: v for k, v in specs["closed"].meta.items() if k in ("limbs", "muscles", "side")}}
        units = ("ns", "ns", "", "", "", "Hz", "Hz", "%/min", "")
        return {"out": StreamSpec((), FREQUENCY, units=units, meta=meta)}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        rows: list[Array] = []
        stamps: list[int] = []
        if port == "signal":
            for a in range(0, len(chunk.time), s.recent.keep):
                part = slice(a, a + s.recent.keep)
                s.recent.append(chunk.time[part], np.asarray(chunk.data[part], np.float64))
        else:
            for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
                made = self._closed(row)
                rows.append(made)
                stamps += [stamp] * len(made)
        data = np.concatenate([np.empty(0, FREQUENCY), *rows])
        return Chunk(np.array(stamps, np.int64), data, chunk.until, -1 if chunk.lost else 0)

    @classmethod
    def cases(cls) -> list[Case]:
        n, rng = 6000, np.random.default_rng(5)
        x = rng.standard_normal((n, 2))
        x[2000:2010, 1] = np.nan
        rows = np.zeros(25, CLOSED)
        onset = NS + np.arange(25) * NS // 5 * 1
        rows["onset"], rows["end"], rows["number"] = onset, onset + NS // 5, np.arange(1, 26)
        rows["rejected"][3] = "gap"
        signal = StreamSpec((2,), rate_hz=1000.0, channels=("TA", "SO"), units=("uV",))
        inputs = {
            "signal": (signal, grid(1000.0, n), x),
            "closed": (StreamSpec((), CLOSED, units=CLOSED_UNITS), onset + NS // 5 + 20_000_000, rows),
        }
        return [Case(cls(), inputs, least=40), Case(cls(low_hz=0.0, high_hz=500.0, longest_s=1.0), inputs, least=40)]

    def _closed(self, row: np.void) -> Array:
        """A cycle has ended, or is reported again: its events."""
        s, number, reason = self.state, int(row["number"]), str(row["rejected"])
        before = s.history.note(number, REASONS.index(reason) if reason else ACCEPTED)
        kept = s.history.take(number)
        if before == ACCEPTED:
            self._add(kept, -1)
        measured = kept if reason else self._measured(row)
        measured = kept if np.isnan(measured).all() else measured
        s.history.put(number, measured)
        if reason:
            return np.empty(0, FREQUENCY)
        self._add(measured, 1)
        made = np.zeros(len(s.names), FREQUENCY)
        for name in ("onset", "end", "number"):
            made[name] = row[name]
        made["muscle"], made["name"] = np.arange(len(s.names)), s.names
        made["median_hz"], made["mean_hz"] = measured[1:]
        made["slope_pct_per_min"], made["cycles"] = self._slopes(), s.sums[0]
        return np.asarray(made[np.isfinite(measured[1])])

    def _measured(self, row: np.void) -> Samples:
        """Minutes since the first cycle, median and mean frequency (3, m) of the cycle's signal; NaN where that has a gap or is gone."""
        s, onset, end = self.state, int(row["onset"]), int(row["end"])
        a, b = s.recent.after(onset - 1), s.recent.after(end - 1)
        time, x = s.recent.time[a:b], s.recent.data[a:b]
        newest = int(s.recent.time[s.recent.fill - 1]) if s.recent.fill else onset
        edges = np.diff(time, prepend=onset, append=end)
        measured = np.full((3, len(s.names)), np.nan)
        if len(time) < 16 or newest - onset > self.longest_s * NS or (edges > 1.5 * s.period).any():
            return measured
        s.began = onset if s.began < 0 else s.began
        measured[1:] = _frequencies(x, NS / s.period, self.low_hz, self.high_hz)
        measured[0] = (onset - s.began) / (60 * NS)
        measured[:, ~(np.isfinite(measured[1]) & s.limbs.mine(row))] = np.nan
        return measured

    def _add(self, measured: Samples, count: int) -> None:
        minutes, f = np.nan_to_num(measured[:2])
        ones = np.isfinite(measured[1]).astype(np.float64)
        self.state.sums += count * np.stack([ones, minutes, minutes**2, f, minutes * f])

    def _slopes(self) -> Samples:
        n, t, tt, y, ty = self.state.sums
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = (n * ty - t * y) / (n * tt - t * t)
            first = (y - slope * t) / n
            return np.asarray(np.where(n >= 10, 100 * slope / first, np.nan))


def _frequencies(x: Samples, rate_hz: float, low_hz: float, high_hz: float) -> tuple[Samples, Samples]:
    """Median and mean frequency (m,) of each channel of `x` (n, m)."""
    n, m = x.shape
    f = np.fft.rfftfreq(n, 1 / rate_hz)
    inside = (f >= low_hz) & (f <= high_hz)
    median, mean = np.full(m, np.nan), np.full(m, np.nan)
    for i in range(m):
        column = np.ascontiguousarray(x[:, i])
        if not np.isfinite(column).all():
            continue
        power = np.abs(np.fft.rfft((column - column.mean()) * np.hanning(n))) ** 2
        power, freq = power[inside], f[inside]
        total = np.cumsum(power)
        if len(total) < 2 or total[-1] <= 0:
            continue
        median[i] = np.interp(0.5 * total[-1], total, freq)
        mean[i] = float((power * freq).sum()) / float(total[-1])
    return median, mean
